"""Published trackers: a table of frame, row and col in, and each row's track out.

==============  =======================  ============================================
tracker         package                  how it links
==============  =======================  ============================================
`Trackpy`       trackpy 0.6 and later    nearest positions, optimal in small groups
`LapTrack`      laptrack 0.16 and later  one assignment per frame; gaps stay open
`StoneSoupGNN`  stonesoup 1.5 and later  Kalman filter, ``GNNWith2DAssignment``
==============  =======================  ============================================

They come with ``pip install kilnflight[peer]`` and are imported when called. None uses
depth or size. Stone Soup has only parts to build a tracker from. The loop here starts a
track at every detection that is left over and ends a track that was not detected for
some frames, as `kilnflight.tracking.tracker` does.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

PLACE = ["row", "col"]


@dataclass(frozen=True)
class Trackpy:
    """Linking of Crocker and Grier by trackpy."""

    search_range: float = 15.0  # px, largest step

    def link(self, table: pd.DataFrame) -> npt.NDArray[np.int64]:
        """Return the track of each row, (n,)."""
        import trackpy

        trackpy.quiet()
        with warnings.catch_warnings():  # trackpy 0.7 with pandas 3
            warnings.simplefilter("ignore")
            linked = trackpy.link(table, self.search_range, pos_columns=PLACE)
        return linked["particle"].sort_index().to_numpy()


@dataclass(frozen=True)
class LapTrack:
    """Linear assignment after Jaqaman by laptrack, without splitting and merging."""

    cutoff: float = 15.0  # px, largest step

    def link(self, table: pd.DataFrame) -> npt.NDArray[np.int32]:
        """Return the track of each row, (n,)."""
        import laptrack

        build: Any = (
            laptrack.LapTrack
        )  # its arguments have defaults that mypy does not see
        tracker = build(cutoff=self.cutoff**2, gap_closing_cutoff=False)
        # by arrays, as `predict_dataframe` takes longer for its table than for the
        # tracks
        frames = table["frame"].to_numpy()
        places = table[PLACE].to_numpy()
        first = np.searchsorted(frames, np.arange(frames[0], frames[-1] + 2))
        linked = tracker.predict(np.split(places, first[1:-1]))
        ends = np.array(linked.edges, dtype=np.intp).reshape(-1, 2, 2)
        rows = tuple((first[ends[..., 0]] + ends[..., 1]).T)
        graph = coo_array((np.ones(len(ends)), rows), shape=(len(table), len(table)))
        return connected_components(graph)[1]


START = datetime(
    2023, 1, 1
)  # Stone Soup wants times of day; a frame is a second after another


class StoneSoupFrame(NamedTuple):
    """The m detections of a frame, and Stone Soup's filter with its gate."""

    detections: list[Any]  # Stone Soup's, metadata "row": row of the table
    places: npt.NDArray[np.float64]  # (m, 2), px
    time: datetime
    predictor: Any
    updater: Any
    distance: float

    def inside(self, track: Any) -> npt.NDArray[np.bool_]:
        """Return which detections are in the gate of a track."""
        prediction = self.predictor.predict(track, timestamp=self.time)
        # asked as the hypothesisers ask, so that it is worked out once: Stone Soup
        # keeps it
        expected = self.updater.predict_measurement(
            prediction, self.updater.measurement_model
        )
        apart = self.places - np.asarray(expected.state_vector, dtype=np.float64).T
        inverse = np.linalg.inv(np.asarray(expected.covar, dtype=np.float64))
        return np.einsum("ij,jk,ik->i", apart, inverse, apart) < self.distance**2


def _remembered(make: Callable[..., Any]) -> Callable[..., Any]:
    """Return a matrix of a linear model that is made once for each step in time.

    Stone Soup builds them anew for every track and frame, in half of its time.
    """
    known: dict[timedelta | None, Any] = {}

    def matrix(*, time_interval: timedelta | None = None, **others: Any) -> Any:
        if time_interval not in known:
            known[time_interval] = make(time_interval=time_interval, **others)
            known[time_interval].setflags(write=False)
        return known[time_interval]

    return matrix


class Gated(NamedTuple):
    """Hand a hypothesiser only what is in the gate: the same result in less time."""

    inner: Any
    frame: StoneSoupFrame

    def hypothesise(
        self, track: Any, detections: Any, timestamp: Any, **more: Any
    ) -> Any:
        """Return the hypotheses of a track, as Stone Soup's associators ask for
        them.
        """
        near = [
            self.frame.detections[k] for k in np.flatnonzero(self.frame.inside(track))
        ]
        return self.inner.hypothesise(track, near, timestamp, **more)


@dataclass(frozen=True)
class StoneSoupGNN:
    """Global nearest neighbour by Stone Soup; the filter is `motion`'s default."""

    distance: float = 4.0  # standard deviations: gate, and cost of a miss; assumption
    acceleration_noise: float = 1.0  # px/frame^1.5; assumption
    missed_frames: int = 5  # in a row, before a track ends; assumption
    velocity_sd: float = 15.0  # px/frame, of a new track; assumption
    measurement_sd: float = 2.0  # px; assumption

    def link(self, table: pd.DataFrame) -> npt.NDArray[np.int64]:
        """Return the track of each row, (n,): associate, update, start, give up, frame
        by frame.
        """
        from stonesoup.models.measurement.linear import LinearGaussian
        from stonesoup.models.transition import linear
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.types.detection import Detection
        from stonesoup.types.state import GaussianState
        from stonesoup.types.track import Track
        from stonesoup.updater.kalman import KalmanUpdater

        axis = linear.ConstantVelocity(self.acceleration_noise**2)
        sensor = LinearGaussian(4, (0, 2), self.measurement_sd**2 * np.eye(2))
        motion = linear.CombinedLinearGaussianTransitionModel([axis, axis])
        for model in (motion, sensor):
            model.matrix = _remembered(model.matrix)
            model.covar = _remembered(model.covar)
        parts = KalmanPredictor(motion), KalmanUpdater(sensor), self.distance
        spread = np.diag([self.measurement_sd**2, self.velocity_sd**2] * 2)
        label = np.empty(len(table), dtype=np.int64)
        alive: dict[
            int, tuple[Any, int]
        ] = {}  # number: track, frame of its last detection
        started = 0
        frames = table["frame"].to_numpy()
        places = table[PLACE].to_numpy()
        for frame in map(int, np.unique(frames)):
            rows = np.flatnonzero(frames == frame)
            now = START + timedelta(seconds=frame)
            detections = [
                Detection(
                    places[row][:, None],
                    now,
                    metadata={"row": row},
                    measurement_model=sensor,
                )
                for row in rows
            ]
            alive = {
                k: v for k, v in alive.items() if frame - 1 - v[1] <= self.missed_frames
            }
            number = {id(track): k for k, (track, _) in alive.items()}
            alone = set(rows)
            tracks = [track for track, _ in alive.values()]
            view = StoneSoupFrame(detections, places[rows], now, *parts)
            for track, state, detection in self._associated(view, tracks):
                track.append(state)
                if detection is not None:
                    row = detection.metadata["row"]
                    k = number[id(track)]
                    alive[k], label[row] = (track, frame), k
                    alone.discard(row)
            for row in sorted(alone):
                y, x = places[row]
                state = GaussianState(np.array([[y], [0.0], [x], [0.0]]), spread, now)
                alive[started], label[row] = (Track([state]), frame), started
                started += 1
        return label

    def _associated(self, frame: StoneSoupFrame, tracks: list[Any]) -> Iterator[Any]:
        """Yield each track, its new state and its detection or None."""
        from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
        from stonesoup.hypothesiser.distance import DistanceHypothesiser
        from stonesoup.measures import Mahalanobis

        filters = (frame.predictor, frame.updater)
        costs = DistanceHypothesiser(
            *filters, Mahalanobis(), missed_distance=self.distance
        )
        associator = GNNWith2DAssignment(Gated(costs, frame))
        for track, best in associator.associate(
            tracks, frame.detections, frame.time
        ).items():
            if best:
                yield track, frame.updater.update(best), best.measurement
            else:
                yield track, best.prediction, None
