"""Trackers that link positions without a filter: trackpy and laptrack."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import pandas as pd

from kilnflight.checks import InputError, check_at_least, check_count, check_positive
from kilnflight.experiments.other_trackers.table import PLACE, named, need


@dataclass(frozen=True)
class Trackpy:
    """Linking of Crocker and Grier by trackpy.

    Notes
    -----
    With ``predict``, a particle is looked for where it would be with the latest velocity of
    the particle nearest to it, mostly its own; frames without any detection are then passed
    over, by ``memory`` too.
    """

    search_range: float = 15.0  # px, largest step; or largest distance from what is predicted
    memory: int = 0  # frames that a particle may be missed
    predict: bool = False  # by trackpy.predict.NearestVelocityPredict

    def __post_init__(self) -> None:
        """Refuse what is no distance and no number of frames."""
        check_positive(self.search_range, "Trackpy: search_range")
        check_count(self.memory, "Trackpy: memory", 0)

    def __call__(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return ``detections`` with ``particle``; see `kilnflight.tracking.tracker.track`."""
        need("trackpy")
        return named(detections, self._link)

    def _link(self, table: pd.DataFrame) -> Any:
        import trackpy
        from trackpy.linking.utils import SubnetOversizeException

        trackpy.quiet()
        link = trackpy.predict.NearestVelocityPredict().link_df if self.predict else trackpy.link
        try:
            with warnings.catch_warnings():  # trackpy 0.7 with pandas 3; no velocity to predict by
                warnings.simplefilter("ignore")
                linked = link(table, self.search_range, pos_columns=PLACE, memory=self.memory)
        except SubnetOversizeException as error:
            raise InputError(
                f"Trackpy: search_range {self.search_range:g} px joins too many particles "
                f"({error}). Take a smaller one."
            ) from error
        return linked["particle"].sort_index()


@dataclass(frozen=True)
class LapTrack:
    """Linear assignment after Jaqaman by laptrack, without splitting and merging."""

    cutoff: float = 15.0  # px, largest step
    gap_closing_cutoff: float = 15.0  # px, largest step over a gap; 0: gaps are not closed
    gap_closing_max_frame_count: int = 2  # frames that a particle may be missed

    def __post_init__(self) -> None:
        """Refuse what is no distance and no number of frames."""
        check_positive(self.cutoff, "LapTrack: cutoff")
        check_at_least(self.gap_closing_cutoff, 0, "LapTrack: gap_closing_cutoff")
        check_count(self.gap_closing_max_frame_count, "LapTrack: gap_closing_max_frame_count", 0)

    def __call__(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return ``detections`` with ``particle``; see `kilnflight.tracking.tracker.track`."""
        need("laptrack")
        return named(detections, self._link)

    def _link(self, table: pd.DataFrame) -> Any:
        import laptrack

        closed = self.gap_closing_cutoff > 0 and self.gap_closing_max_frame_count > 0
        build: Any = laptrack.LapTrack  # its arguments have defaults that mypy does not see
        tracker = build(
            cutoff=self.cutoff**2,
            gap_closing_cutoff=self.gap_closing_cutoff**2 if closed else False,
            gap_closing_max_frame_count=self.gap_closing_max_frame_count,
        )
        numbered = table.assign(at=table.index)
        linked = tracker.predict_dataframe(numbered, PLACE, only_coordinate_cols=False)[0]
        return linked.set_index("at")["track_id"].sort_index()
