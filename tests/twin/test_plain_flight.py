"""Compiled flights are those of the plain definition."""

from dataclasses import replace

import numpy as np
import pytest
from tests.definitions.flight import fly_plainly

from kilnflight.twin.camera import Geometry
from kilnflight.twin.fitted import second_kiln
from kilnflight.twin.flight import ENDS, Flight, fly
from kilnflight.twin.gas import Gas
from kilnflight.twin.particles import FRACTIONS

SECOND = second_kiln()
CASES = {
    "fitted": (SECOND.flight, SECOND.gas),
    "loaded, cooler wall": (
        Flight(volatiles=SECOND.flight.volatiles),
        Gas(lance_stream_m_s=-0.6, wall_fall_k_m=24.0, load=0.1),
    ),
}


@pytest.mark.parametrize("kind", FRACTIONS.values(), ids=lambda kind: kind.name)
@pytest.mark.parametrize("case", CASES)
def test_compiled_flights_are_the_plain_ones(kind, case):
    settings, gas = CASES[case]
    settings, particles = replace(settings, longest_s=0.6), kind.draw(60, np.random.default_rng(1))
    compiled, plain = (
        each(particles, gas, Geometry(), np.random.default_rng(2), settings)
        for each in (fly, fly_plainly)
    )
    for name in ("end", "cause", "end_s", "ignition_s", "state"):
        np.testing.assert_array_equal(getattr(compiled, name), getattr(plain, name), name)
    np.testing.assert_allclose(compiled.end_position_m, plain.end_position_m, rtol=1e-8, atol=1e-8)
    for name in ("position_m", "velocity_m_s", "surface_k", "area", "normal", "along"):
        one, other = getattr(compiled, name), getattr(plain, name)
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5, err_msg=name)
    assert (plain.end == ENDS.index("landed")).any()
    assert np.isfinite(plain.ignition_s).any() or not kind.sheet
