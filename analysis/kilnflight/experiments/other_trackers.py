"""Other people's trackers, called as ours: detections in, the same rows with ``particle`` out.

=================  =========================  ==================================================
tracker            package                    how it links
=================  =========================  ==================================================
`Trackpy`          trackpy 0.6 and later      nearest positions, optimal in each small group
`LapTrack`         laptrack 0.16 and later    one assignment per frame, then one over the gaps
`StoneSoupGNN`     stonesoup 1.5 and later    Kalman filter, ``GNNWith2DAssignment``
`StoneSoupJPDA`    stonesoup 1.5 and later    Kalman filter, ``JPDAwithEHM2``
=================  =========================  ==================================================

They come with ``pip install kilnflight[peer]`` and are imported when called, so that the rest
does without. All look at frame, row and col only; none knows depth or size. Stone Soup has
no tracker for scenes in which anything may start anywhere, only parts to build one from: the
loop here starts a track at every detection that is left over and gives a track up when it
was not seen for some frames, as `kilnflight.tracking.tracker` does.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from kilnflight.checks import (
    InputError,
    check_at_least,
    check_columns,
    check_count,
    check_positive,
)
from kilnflight.tables import DETECTIONS, Table
from kilnflight.tracking.tracker import record

NEEDED = Table("detections to track", *DETECTIONS.columns[:3])  # frame, row, col
PLACE = ["row", "col"]
PACKAGES = ("laptrack", "stonesoup", "trackpy")


def available() -> tuple[str, ...]:
    """Return the packages that are installed, of `PACKAGES`."""
    return tuple(name for name in PACKAGES if find_spec(name) is not None)


def need(package: str) -> None:
    """Import a package, or raise an `InputError` if it is not installed."""
    if package not in available():
        raise InputError(f"{package} is not installed: pip install kilnflight[peer]")
    with warnings.catch_warnings():  # progress bars of theirs complain about notebooks
        warnings.simplefilter("ignore")
        import_module(package)


def with_particle(detections: pd.DataFrame, link: Callable[[pd.DataFrame], Any]) -> pd.DataFrame:
    """Return the table with the particles that a peer makes of it, as `tracking.track` does.

    ``link`` is given frame, row and col sorted, and returns one label per row.
    """
    check_columns(detections, NEEDED.names, NEEDED.name)
    particle = np.full(len(detections), -1, dtype=np.int64)
    rows = np.arange(len(detections))
    if "particle" in detections.columns:
        rows = np.flatnonzero(detections["particle"].to_numpy() != -1)
    if len(rows):
        table = NEEDED.check(detections.iloc[rows][NEEDED.names])
        order = np.lexsort(table[["col", "row", "frame"]].to_numpy().T)
        labels = np.asarray(link(table.iloc[order].reset_index(drop=True)))
        particle[rows[order]] = pd.factorize(labels)[0]
    return detections.assign(particle=particle)


@dataclass(frozen=True)
class Trackpy:
    """Linking of Crocker and Grier by trackpy.

    Notes
    -----
    With ``predict``, a particle is expected where it would be with the latest velocity of
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
        return with_particle(detections, self._link)

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
        return with_particle(detections, self._link)

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


START = datetime(2023, 1, 1)  # Stone Soup wants times of day; a frame is a second after another


class Parts(NamedTuple):
    """Stone Soup's filter."""

    predictor: Any
    updater: Any
    sensor: Any


class FrameDetections(NamedTuple):
    """The m detections of a frame."""

    detections: list[Any]  # Stone Soup's, metadata "at": row of the table
    places: npt.NDArray[np.float64]  # (m, 2), px
    time: datetime


class Gated(NamedTuple):
    """Hand a hypothesiser only what is in the gate: the same result in less time."""

    inner: Any
    parts: Parts
    frame: FrameDetections
    distance: float

    def hypothesise(self, track: Any, detections: Any, timestamp: Any, **more: Any) -> Any:
        """Return the hypotheses of a track, as Stone Soup's associators ask for them."""
        inside = np.flatnonzero(_inside(self.parts, track, self.frame, self.distance))
        near = [self.frame.detections[k] for k in inside]
        return self.inner.hypothesise(track, near, timestamp, **more)


def _inside(
    parts: Parts, track: Any, frame: FrameDetections, distance: float
) -> npt.NDArray[np.bool_]:
    """Return which detections of a frame are in the gate of a track."""
    prediction = parts.predictor.predict(track, timestamp=frame.time)
    expected = parts.updater.predict_measurement(prediction, parts.sensor)
    apart = frame.places - np.asarray(expected.state_vector, dtype=np.float64).T
    inverse = np.linalg.inv(np.asarray(expected.covar, dtype=np.float64))
    return np.einsum("ij,jk,ik->i", apart, inverse, apart) < distance**2


def largest_group(parts: Parts, tracks: list[Any], frame: FrameDetections, distance: float) -> int:
    """Return how many tracks share detections, directly or by others, at most."""
    if not tracks:
        return 0
    inside = np.array([_inside(parts, one, frame, distance) for one in tracks], dtype=np.int64)
    group = connected_components(csr_array(inside @ inside.T))[1]
    return int(np.bincount(group).max())


def _parts(settings: Any) -> Parts:
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import (
        CombinedLinearGaussianTransitionModel,
        ConstantVelocity,
    )
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.updater.kalman import KalmanUpdater

    axis = ConstantVelocity(settings.acceleration_noise**2)
    sensor = LinearGaussian(4, (0, 2), settings.measurement_sd**2 * np.eye(2))
    motion = CombinedLinearGaussianTransitionModel([axis, axis])
    return Parts(KalmanPredictor(motion), KalmanUpdater(sensor), sensor)


def followed(table: pd.DataFrame, settings: Any, associate: Callable[..., Iterator[Any]]) -> Any:
    """Return the track of each row: associate, update, start, give up, frame by frame."""
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track

    parts, label = _parts(settings), np.empty(len(table), dtype=np.int64)
    spread = np.diag([settings.measurement_sd**2, settings.velocity_sd**2] * 2)
    alive: dict[int, tuple[Any, int]] = {}  # track's number: track, frame it was last seen in
    started = 0
    frames, where = table["frame"].to_numpy(), table[PLACE].to_numpy()
    for frame in map(int, np.unique(frames)):
        rows = np.flatnonzero(frames == frame)
        now, places = START + timedelta(seconds=frame), where[rows]
        found = [
            Detection(place[:, None], now, metadata={"at": at}, measurement_model=parts.sensor)
            for at, place in zip(rows, places, strict=True)
        ]
        alive = {k: v for k, v in alive.items() if frame - 1 - v[1] <= settings.invisible}
        number, alone = {id(one): k for k, (one, _) in alive.items()}, set(rows)
        tracks = [one for one, _ in alive.values()]
        for one, state, taken in associate(parts, tracks, FrameDetections(found, places, now)):
            one.append(state)
            if taken is not None:
                at, mine = taken.metadata["at"], number[id(one)]
                alive[mine], label[at] = (one, frame), mine
                alone.discard(at)
        for at in sorted(alone):
            row, col = where[at]
            state = GaussianState(np.array([[row], [0.0], [col], [0.0]]), spread, now)
            alive[started], label[at] = (Track([state]), frame), started
            started += 1
    return label


@dataclass(frozen=True)
class _StoneSoup(ABC):
    """A filter, a gate and the loop over frames, for an associator of Stone Soup."""

    distance: float = 4.0  # standard deviations: gate, and cost of a miss
    acceleration_noise: float = 1.0  # px/frame^1.5
    invisible: int = 5  # frames in a row that a track lives on unseen
    velocity_sd: float = 15.0  # px/frame, of a new track
    measurement_sd: float = 2.0  # px

    def __post_init__(self) -> None:
        """Refuse numbers that are no distance and no number of frames."""
        where = type(self).__name__
        for name in ("distance", "acceleration_noise", "velocity_sd", "measurement_sd"):
            check_positive(getattr(self, name), f"{where}: {name}")
        check_count(self.invisible, f"{where}: invisible", 0)

    def __call__(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return ``detections`` with ``particle``; see `kilnflight.tracking.tracker.track`."""
        need("stonesoup")
        return with_particle(detections, lambda table: followed(table, self, self._associated))

    @abstractmethod
    def _associated(self, parts: Parts, tracks: list[Any], frame: FrameDetections) -> Iterator[Any]:
        """Yield each track, its new state and its detection or None."""


@dataclass(frozen=True)
class StoneSoupGNN(_StoneSoup):
    """Global nearest neighbour by Stone Soup; the filter is `motion`'s default."""

    def _associated(self, parts: Parts, tracks: list[Any], frame: FrameDetections) -> Iterator[Any]:
        from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.measures import Mahalanobis

        filters = (parts.predictor, parts.updater)
        costs = DistanceHypothesiser(*filters, Mahalanobis(), missed_distance=self.distance)
        associator = GNNWith2DAssignment(Gated(costs, parts, frame, self.distance))
        for one, taken in associator.associate(tracks, frame.detections, frame.time).items():
            if taken:
                yield one, parts.updater.update(taken), taken.measurement
            else:
                yield one, taken.prediction, None


@dataclass(frozen=True)
class StoneSoupJPDA(_StoneSoup):
    """Joint probabilities by Stone Soup; where gates overlap much they take minutes per frame.

    Which detection a track is recorded with is not Stone Soup's affair; the rule is that of
    our own tracker, `kilnflight.tracking.tracker.record`.
    """

    detection_probability: float = 0.9
    # Per px^2; None: Stone Soup's estimate in each gate. Picked by hand on two of the stretches
    # for settings (notebook 33); ten false detections in a frame of 1536 x 2048 are 3e-6.
    clutter_density: float | None = 1e-5
    # That share detections in a frame; with more, the table is refused. A bound of effort only:
    # stretches with 16 and 17 such tracks took seconds, with many more it would be minutes.
    most_tracks: int = 20

    def __post_init__(self) -> None:
        """Refuse what is no distance, no number of frames and no probability."""
        super().__post_init__()
        if not 0 < self.detection_probability < 1:
            raise InputError(
                "StoneSoupJPDA: detection_probability must be between 0 and 1, got "
                f"{self.detection_probability}."
            )
        if self.clutter_density is not None:
            check_positive(self.clutter_density, "StoneSoupJPDA: clutter_density")

    def _associated(self, parts: Parts, tracks: list[Any], frame: FrameDetections) -> Iterator[Any]:
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
        associator = JPDAwithEHM2(Gated(chances, parts, frame, self.distance))
        largest = largest_group(parts, tracks, frame, self.distance)
        if largest > self.most_tracks:
            raise InputError(
                f"StoneSoupJPDA: {largest} tracks share detections in a frame, more than "
                f"most_tracks {self.most_tracks}. Narrow the gate or lower invisible."
            )
        found = associator.associate(tracks, frame.detections, frame.time)
        given, updater = _given(found, frame), PDAUpdater(parts.sensor)
        for one, hypotheses in found.items():
            any_inside = any(bool(single) for single in hypotheses)
            state = updater.update(hypotheses) if any_inside else hypotheses[0].prediction
            yield one, state, given.get(id(one))


def _given(found: dict[Any, Iterable[Any]], frame: FrameDetections) -> dict[int, Any]:
    """Return the detection that each track, by `id`, gets, by the rule of our own tracker."""
    place = {id(one): k for k, one in enumerate(frame.detections)}
    tracks = list(found)
    weights = np.zeros((len(tracks), 1 + len(place)))
    for row, one in zip(weights, tracks, strict=True):
        for single in found[one]:
            column = 1 + place[id(single.measurement)] if single else 0
            row[column] += float(single.probability)
    owners = record(weights)
    return {id(tracks[i]): frame.detections[j] for j, i in enumerate(owners) if i >= 0}


PEERS = (Trackpy(), LapTrack(), StoneSoupGNN(), StoneSoupJPDA())
