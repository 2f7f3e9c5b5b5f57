import numpy as np
import pytest

from kilnflight.twin.camera import Geometry
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas
from kilnflight.twin.life import OnTheWall, live
from kilnflight.twin.particles import Burst

KILN = (Gas(), Geometry(), Flight(), OnTheWall())
FEED = (Burst("confetti", 40, -0.5), Burst("wood chip", 20, -0.3), Burst("PE granule", 0, 0.0))


@pytest.fixture(scope="module")
def life():
    return live(FEED, *KILN, seed=3)


def test_everyone_fed_has_a_row_and_an_end(life):
    assert life.table["fraction"].value_counts().to_dict() == {"confetti": 40, "wood chip": 20}
    assert life.table["particle"].tolist() == list(range(60))
    assert life.table["end_s"].notna().all()
    assert (life.over_s >= life.release_s + life.table["end_s"]).all()


def test_a_moment_lies_on_the_flight(life):
    """At a sampled age the position is the sample; between two, the line."""
    for age in (0.0, 0.1, 0.101):
        particle = 45
        moment = life.at(float(life.release_s[particle]) + age + 1e-12)
        row = int(np.flatnonzero(moment.particle == particle)[0])
        step = life.flights.age_s[1]
        low = int(age / step + 1e-9)
        before, after = life.flights.position_m[particle, low : low + 2].astype(float)
        expected = before + (age / step - low) * (after - before)
        np.testing.assert_allclose(moment.position_m[row], expected, atol=1e-5)
        assert not moment.landed[row]
