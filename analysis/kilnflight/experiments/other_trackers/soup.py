"""What Stone Soup leaves to its user: filter, gate, and the loop over frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from kilnflight.checks import check_count, check_positive
from kilnflight.experiments.other_trackers.table import PLACE

START = datetime(2023, 1, 1)  # Stone Soup wants times of day; a frame is a second after another


def check_filter(settings: Any) -> None:
    """Raise an `InputError` unless a filter, a gate and ``invisible`` can be made of this."""
    where = type(settings).__name__
    for name in ("distance", "acceleration_noise", "velocity_sd", "measurement_sd"):
        check_positive(getattr(settings, name), f"{where}: {name}")
    check_count(settings.invisible, f"{where}: invisible", 0)


class Parts(NamedTuple):
    """Stone Soup's filter."""

    predictor: Any
    updater: Any
    sensor: Any


class Seen(NamedTuple):
    """The m detections of a frame."""

    detections: list[Any]  # Stone Soup's, metadata "at": row of the table
    places: npt.NDArray[np.float64]  # (m, 2), px
    time: datetime


class Gated(NamedTuple):
    """Hand a hypothesiser only what is in the gate: the same result in less time."""

    inner: Any
    parts: Parts
    seen: Seen
    distance: float

    def hypothesise(self, track: Any, detections: Any, timestamp: Any, **more: Any) -> Any:
        """Return the hypotheses of a track, as Stone Soup's associators ask for them."""
        inside = np.flatnonzero(_inside(self.parts, track, self.seen, self.distance))
        near = [self.seen.detections[k] for k in inside]
        return self.inner.hypothesise(track, near, timestamp, **more)


def _inside(parts: Parts, track: Any, seen: Seen, distance: float) -> npt.NDArray[np.bool_]:
    """Return which detections of a frame are in the gate of a track."""
    prediction = parts.predictor.predict(track, timestamp=seen.time)
    expected = parts.updater.predict_measurement(prediction, parts.sensor)
    apart = seen.places - np.asarray(expected.state_vector, dtype=np.float64).T
    inverse = np.linalg.inv(np.asarray(expected.covar, dtype=np.float64))
    return np.einsum("ij,jk,ik->i", apart, inverse, apart) < distance**2


def largest_group(parts: Parts, tracks: list[Any], seen: Seen, distance: float) -> int:
    """Return how many tracks share detections, directly or by others, at most."""
    if not tracks:
        return 0
    inside = np.array([_inside(parts, one, seen, distance) for one in tracks], dtype=np.int64)
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
        for one, state, taken in associate(parts, tracks, Seen(found, places, now)):
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
