"""Trackers built from Stone Soup's associators and filter."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from kilnflight.checks import InputError, check_positive
from kilnflight.experiments.other_trackers.soup import (
    Gated,
    Parts,
    Seen,
    check_filter,
    followed,
    largest_group,
)
from kilnflight.experiments.other_trackers.table import named, need
from kilnflight.tracking.tracker import record


@dataclass(frozen=True)
class StoneSoupGNN:
    """Global nearest neighbour by Stone Soup; the filter is `motion`'s default."""

    distance: float = 4.0  # standard deviations: gate, and cost of a miss
    acceleration_noise: float = 1.0  # px/frame^1.5
    invisible: int = 5  # frames in a row that a track lives on unseen
    velocity_sd: float = 15.0  # px/frame, of a new track
    measurement_sd: float = 2.0  # px

    def __post_init__(self) -> None:
        """Refuse what is no distance and no number of frames."""
        check_filter(self)

    def __call__(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return ``detections`` with ``particle``; see `kilnflight.tracking.tracker.track`."""
        need("stonesoup")
        return named(detections, lambda table: followed(table, self, self._associated))

    def _associated(self, parts: Parts, tracks: list[Any], seen: Seen) -> Iterator[Any]:
        from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.measures import Mahalanobis

        filters = (parts.predictor, parts.updater)
        costs = DistanceHypothesiser(*filters, Mahalanobis(), missed_distance=self.distance)
        associator = GNNWith2DAssignment(Gated(costs, parts, seen, self.distance))
        for one, taken in associator.associate(tracks, seen.detections, seen.time).items():
            if taken:
                yield one, parts.updater.update(taken), taken.measurement
            else:
                yield one, taken.prediction, None


@dataclass(frozen=True)
class StoneSoupJPDA:
    """Joint probabilities by Stone Soup; where gates overlap much they take minutes per frame.

    Which detection a track is recorded with is not Stone Soup's affair; the rule is that of
    our own tracker, `kilnflight.tracking.tracker.record`.
    """

    distance: float = 4.0  # standard deviations: gate
    acceleration_noise: float = 1.0  # px/frame^1.5
    invisible: int = 5  # frames in a row that a track lives on unseen
    velocity_sd: float = 15.0  # px/frame, of a new track
    measurement_sd: float = 2.0  # px
    detection_probability: float = 0.9
    # Per px^2; None: Stone Soup's estimate in each gate. Picked by hand on two of the stretches
    # for settings (notebook 33); ten false detections in a frame of 1536 x 2048 are 3e-6.
    clutter_density: float | None = 1e-5
    # That share detections in a frame; with more, the table is refused. A bound of effort only:
    # stretches with 16 and 17 such tracks took seconds, with many more it would be minutes.
    most_tracks: int = 20

    def __post_init__(self) -> None:
        """Refuse what is no distance, no number of frames and no probability."""
        check_filter(self)
        if not 0 < self.detection_probability < 1:
            raise InputError(
                "StoneSoupJPDA: detection_probability must be between 0 and 1, got "
                f"{self.detection_probability}."
            )
        if self.clutter_density is not None:
            check_positive(self.clutter_density, "StoneSoupJPDA: clutter_density")

    def __call__(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return ``detections`` with ``particle``; see `kilnflight.tracking.tracker.track`."""
        need("stonesoup")
        return named(detections, lambda table: followed(table, self, self._associated))

    def _associated(self, parts: Parts, tracks: list[Any], seen: Seen) -> Iterator[Any]:
        from stonesoup.dataassociator.probability import JPDAwithEHM2
        from stonesoup.hypothesiser.probability import PDAHypothesiser
        from stonesoup.updater.probability import PDAUpdater

        inside = 1 - np.exp(-(self.distance**2) / 2)  # P_G in two dimensions
        chances = PDAHypothesiser(
            parts.predictor,
            parts.updater,
            self.clutter_density,
            prob_detect=self.detection_probability,
            prob_gate=inside,
        )
        associator = JPDAwithEHM2(Gated(chances, parts, seen, self.distance))
        largest = largest_group(parts, tracks, seen, self.distance)
        if largest > self.most_tracks:
            raise InputError(
                f"StoneSoupJPDA: {largest} tracks share detections in a frame, more than "
                f"most_tracks {self.most_tracks}. Narrow the gate or lower invisible."
            )
        found = associator.associate(tracks, seen.detections, seen.time)
        given, updater = _given(found, seen), PDAUpdater(parts.sensor)
        for one, hypotheses in found.items():
            any_inside = any(bool(single) for single in hypotheses)
            state = updater.update(hypotheses) if any_inside else hypotheses[0].prediction
            yield one, state, given.get(id(one))


def _given(found: dict[Any, Iterable[Any]], seen: Seen) -> dict[int, Any]:
    """Return the detection that each track, by `id`, gets, by the rule of our own tracker."""
    place = {id(one): k for k, one in enumerate(seen.detections)}
    tracks = list(found)
    weights = np.zeros((len(tracks), 1 + len(place)))
    for row, one in zip(weights, tracks, strict=True):
        for single in found[one]:
            column = 1 + place[id(single.measurement)] if single else 0
            row[column] += float(single.probability)
    owners = record(weights)
    return {id(tracks[i]): seen.detections[j] for j, i in enumerate(owners) if i >= 0}
