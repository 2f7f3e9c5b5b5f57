"""Hand-made tracklets and the plain definition of chapter 4.2."""

import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

PLAIN = Path(__file__).parents[2] / "benchmarks" / "plain_tracklets.py"


def make_table(*tracklets) -> pd.DataFrame:
    """Return the table of tracklets given as (frames, rows, cols) or (..., depths)."""
    parts = []
    for particle, (frame, row, col, *depth) in enumerate(tracklets):
        row, col = np.broadcast_to(row, len(frame)), np.broadcast_to(col, len(frame))
        z = np.broadcast_to(depth[0] if depth else np.nan, len(frame))
        part = {"frame": frame, "particle": particle, "row": row, "col": col, "z": z}
        parts.append(pd.DataFrame(part).astype({"row": float, "col": float, "z": float}))
    table = pd.concat(parts, ignore_index=True)
    return table.assign(gray=np.arange(len(table), dtype=float))


def make_flights(seed: int, flights: int, frames: int = 80) -> pd.DataFrame:
    """Return noisy flights cut into tracklets, with gaps, overlaps, duplicates and clutter."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(flights):
        t = np.arange(rng.integers(8, 50))
        place = rng.uniform(0, 150, (1, 2)) + rng.uniform(-9, 9, (1, 2)) * t[:, None]
        depth = rng.uniform(3e3, 4e3) + rng.normal(0, 300, len(t))
        start = rng.integers(0, frames)
        for first in range(0, len(t), 12):
            kept = np.arange(first, min(first + rng.integers(8, 18), len(t)))
            kept = kept[rng.random(len(kept)) < 0.85]
            wild = rng.normal(0, 40, (len(kept), 2)) * (rng.random((len(kept), 1)) < 0.04)
            row, col = (place[kept] + rng.normal(0, 1.5, (len(kept), 2)) + wild).T
            z = np.where(rng.random(len(kept)) < 0.3, np.nan, depth[kept])
            if len(kept):
                parts.append((start + kept, row, col, z))
    return make_table(*parts)


@pytest.fixture(scope="session")
def table():
    """Build a table of tracklets."""
    return make_table


@pytest.fixture(scope="session")
def flights():
    """Build a table of many tracklets from a seed."""
    return make_flights


@pytest.fixture(scope="session")
def plain():
    """The definition in plain code."""
    spec = importlib.util.spec_from_file_location("plain_tracklets", PLAIN)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def same_tracks(plain):
    """Raise unless a table holds the tracklets of the plain definition."""

    def compare(found, expected):
        found = plain.tracklets_of(found)
        expected = sorted(expected, key=lambda t: (min(t), t[min(t)][:2]))
        assert [sorted(t) for t in found] == [sorted(t) for t in expected]
        for first, other in zip(found, expected, strict=True):
            for frame, place in first.items():
                np.testing.assert_allclose(place, other[frame], rtol=1e-9, atol=1e-9)

    return compare
