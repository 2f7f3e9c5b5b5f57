"""Connection of tracklets against its plain definition."""

from __future__ import annotations

import numpy as np
import pandas as pd
from measure import Row, compare
from tests.definitions import plain_tracklets

from kilnflight.tracklets import Connection

SIZE = 300  # tracklets; the plain definition judges every pair in every iteration


def tracklets(count: int) -> pd.DataFrame:
    """Return flights of 60 frames in four tracklets each, 30 at a time in every
    frame.
    """
    rng = np.random.default_rng(count)
    flights = count // 4
    parts = []
    for flight in range(flights):
        t = np.arange(60)
        start = int(rng.integers(0, max(2 * flights, 60)))
        place = (
            rng.uniform(0, (1500, 2000), (1, 2))
            + rng.uniform(-8, 8, (1, 2)) * t[:, None]
        )
        place += rng.normal(0, 1.0, place.shape)
        depth = np.where(rng.random(60) < 0.3, np.nan, rng.normal(5000, 200, 60))
        seen = rng.random(60) < 0.9
        part = {"frame": start + t, "particle": 4 * flight + t // 15, "z": depth}
        parts.append(pd.DataFrame(part).assign(row=place[:, 0], col=place[:, 1])[seen])
    return pd.concat(parts, ignore_index=True)


def check(tracks: pd.DataFrame) -> None:
    """Raise unless the connection of the package is that of the definition."""
    found = plain_tracklets.tracklets_of(Connection()(tracks))
    expected = plain_tracklets.join(plain_tracklets.tracklets_of(tracks))
    assert [sorted(t) for t in found] == [sorted(t) for t in expected]
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(
            list(dict(sorted(one.items())).values()),
            list(dict(sorted(other.items())).values()),
        )


def rows() -> list[Row]:
    """Return the comparison, the results checked to be equal."""
    tracks = tracklets(SIZE)
    check(tracks)
    what = (
        "connection, Eqs 4.21 to 4.24",
        "tracklets",
        SIZE,
        "the definition in Python",
    )
    peer = lambda: plain_tracklets.join(plain_tracklets.tracklets_of(tracks))  # noqa: E731
    return [compare(what, lambda: Connection()(tracks), peer)]
