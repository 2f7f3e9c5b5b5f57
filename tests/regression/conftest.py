import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

PLAIN = Path(__file__).parents[2] / "benchmarks" / "plain_regression.py"
EXIT = np.array([120.0, 60.0, 6500.0])
RATE = 330.0
FACTORS = ((400.0, -300.0), (900.0, -4900.0), (-11_000.0, 6000.0))  # mm/s, mm/s^2


@pytest.fixture(scope="session")
def flight():
    """Return a maker of one track with known t0: a frame rate of 330 Hz, t0 in s."""

    def make(t0=0.1, points=60, lead=12, scatter=(0.0, 0.0, 0.0), factors=FACTORS, seed=0):
        frame = int(np.ceil(t0 * RATE)) + lead + np.arange(points)
        since = frame / RATE - t0
        places = np.stack([np.polyval([*axis[::-1], 0.0], since) for axis in factors], axis=1)
        places += EXIT + np.random.default_rng(seed).normal(size=(points, 3)) * scatter
        return pd.DataFrame(
            {"frame": frame, "particle": 0} | dict(zip("xyz", places.T, strict=True))
        )

    return make


@pytest.fixture(scope="session")
def plain():
    """Return the module with the plain definition, as the benchmark uses it."""
    spec = importlib.util.spec_from_file_location("plain_regression", PLAIN)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
