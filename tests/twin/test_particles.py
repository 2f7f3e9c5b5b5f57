import numpy as np
import pytest

from kilnflight.checks import InputError
from kilnflight.twin.particles import (
    FRACTIONS,
    PE_GRANULES,
    Burst,
    air_load,
    by_hand,
    find_fraction,
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


def test_areal_density_of_paper_is_paper():
    for name in ("confetti", "paper shred"):
        particles = find_fraction(name).draw(500, np.random.default_rng(1))
        grams = 1000 * particles.dry_mass_kg / particles.broadside_m2
        assert 68 < grams.min() < grams.max() < 92


def test_granules_are_spheres():
    particles = PE_GRANULES.draw(10, np.random.default_rng(1))
    volume = np.pi / 6 * particles.length_m**3
    ratio = particles.dry_mass_kg / volume
    assert ((ratio > 914) & (ratio < 951)).all()
    np.testing.assert_allclose(particles.surface_m2, np.pi * particles.length_m**2)


def test_unknown_fractions_and_negative_counts_are_told():
    with pytest.raises(InputError, match="unknown fraction 'coal'; there are wood chip"):
        find_fraction("coal")
    with pytest.raises(InputError, match="-1 particles"):
        find_fraction("confetti").draw(-1, np.random.default_rng(1))


def test_joining_keeps_everyone():
    kind = find_fraction("wood chip")
    parts = [kind.draw(n, np.random.default_rng(n)) for n in (3, 0, 2)]
    whole = parts[0].joined(parts[1:])
    assert len(whole) == 5
    np.testing.assert_array_equal(whole.length_m[3:], parts[2].length_m)
    assert whole.table()["fraction"].tolist() == ["wood chip"] * 5


def test_feeding_by_hand_comes_in_bursts_and_loses_nobody():
    bursts = by_hand(FRACTIONS["confetti"], 300, 9.0, np.random.default_rng(1))
    assert sum(burst.count for burst in bursts) == 300
    assert 5 < len(bursts) < 100
    times = np.concatenate([b.release(np.random.default_rng(2))[1] for b in bursts])
    gaps = np.diff(np.sort(times))
    assert gaps.std() > 1.3 * gaps.mean()  # more uneven than a steady random feed (1.0)
    assert by_hand(FRACTIONS["confetti"], 0, 9.0, np.random.default_rng(1)) == ()


def test_impossible_bursts_are_told():
    for wrong in ({"fraction": "coal"}, {"count": -1}, {"duration_s": 0.0}):
        with pytest.raises(InputError):
            Burst(**{"fraction": "confetti", "count": 1, "start_s": 0.0, **wrong})


def test_a_handful_that_is_dumped_loads_the_air_a_few_times_more():
    thrown = [Burst("paper shred", 6, 0.0, 0.4), Burst("paper shred", 2, 5.0, 0.4)]
    dumped = [Burst("paper shred", 6, 0.0, 0.05), Burst("paper shred", 2, 5.0, 0.05)]
    shred = 32.5e-3 * 6e-3 * 0.1e-3 * 800.0 * 1.06
    flow = (6 * 6 + 2 * 2) / 8 * shred / 0.4
    assert air_load(thrown, 0.02) == pytest.approx(flow / 0.02)
    assert air_load(dumped, 0.02) == pytest.approx(8 * air_load(thrown, 0.02))
    assert air_load([], 0.02) == 0.0


@pytest.mark.parametrize("kind", FRACTIONS.values(), ids=lambda kind: kind.name)
def test_the_middle_mass_lies_among_the_drawn_ones(kind):
    drawn = kind.draw(2000, np.random.default_rng(1))
    masses = drawn.dry_mass_kg * (1 + kind.moisture)
    assert kind.middle_mass_kg == pytest.approx(np.mean(masses), rel=0.08)
