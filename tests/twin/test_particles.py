import numpy as np
import pytest

from kilnflight.twin.particles import (
    FRACTIONS,
    by_hand,
)


@pytest.mark.parametrize("kind", FRACTIONS.values(), ids=lambda kind: kind.name)
def test_particles_keep_the_limits_and_are_reproducible(kind):
    first, again = (kind.draw(200, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(first.dry_mass_kg, again.dry_mass_kg)
    for name in ("length_m", "thickness_m"):
        low, high = getattr(kind, name)
        assert ((getattr(first, name) >= low) & (getattr(first, name) <= high)).all()
    assert (first.surface_m2 >= 2 * first.broadside_m2 * 0.99).all()
    assert len(kind.draw(0, np.random.default_rng(1))) == 0


def test_feeding_by_hand_comes_in_bursts_and_loses_nobody():
    bursts = by_hand(FRACTIONS["confetti"], 300, 9.0, np.random.default_rng(1))
    assert sum(burst.count for burst in bursts) == 300
    assert 5 < len(bursts) < 100
    times = np.concatenate([b.release(np.random.default_rng(2))[1] for b in bursts])
    gaps = np.diff(np.sort(times))
    assert gaps.std() > 1.3 * gaps.mean()  # more uneven than a steady random feed (1.0)
    assert by_hand(FRACTIONS["confetti"], 0, 9.0, np.random.default_rng(1)) == ()
