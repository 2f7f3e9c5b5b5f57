"""The belt's velocity from measurements, on hand-made recordings."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.camera import Area
from kilnflight.belt.recordings import compare_links, join_recordings
from kilnflight.belt.tracker import Appearance, BeltTracker
from kilnflight.belt.velocity import estimate_velocity, join_followed
from kilnflight.checks import InputError
from kilnflight.tracking.motion import ConstantVelocity


def recording(step=62.0, particles=40, spread=1.0, seed=0, every=7):
    """Particles one after the other, each seen 12 times, at places across the belt by chance."""
    generator = np.random.default_rng(seed)
    rows = [
        (start * every + k, 30.0 + step * k + generator.normal(0, spread), across, start)
        for start, across in enumerate(generator.uniform(100, 2000, particles))
        for k in range(12)
    ]
    return pd.DataFrame(rows, columns=["frame", "x", "y", "author_track"])


@pytest.mark.parametrize("step", [12.0, 62.0, 92.0, 240.0])
def test_the_velocity_is_that_of_the_particles(step):
    found = estimate_velocity(recording(step))
    assert found.px_per_frame == pytest.approx(step, abs=0.3)
    assert found.spread_px == pytest.approx(np.sqrt(2), rel=0.2)  # two measurements of 1 px
    assert found.pairs == 40 * 11


def test_many_particles_at_once_and_order_of_rows_do_not_matter():
    dense = recording(particles=400, every=1)
    shuffled = dense.sample(frac=1, random_state=1)
    assert estimate_velocity(dense).px_per_frame == pytest.approx(62, abs=0.5)
    assert estimate_velocity(shuffled) == estimate_velocity(dense)


def test_dirt_that_lies_still_and_false_measurements_do_not_matter():
    moving, generator = recording(), np.random.default_rng(3)
    frames = np.arange(280)
    dirt = pd.DataFrame({"frame": frames, "x": 500.0, "y": 300.0, "author_track": -1})
    chance = pd.DataFrame(
        {
            "frame": generator.integers(0, 280, 300),
            "x": generator.uniform(0, 1700, 300),
            "y": generator.uniform(0, 2250, 300),
            "author_track": -1,
        }
    )
    found = estimate_velocity(pd.concat([moving, dirt, chance]))
    assert found.px_per_frame == pytest.approx(62, abs=0.3)


def test_a_few_fast_particles_do_not_move_the_estimate():
    mixed = pd.concat([recording(80.0), recording(88.0, particles=6, seed=5)])
    assert estimate_velocity(mixed).px_per_frame == pytest.approx(80, abs=0.8)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (recording().iloc[:0], "weizen.*only 0 pairs"),
        (recording().iloc[:1], "only 0 pairs"),
        (recording(particles=1), "only 11 pairs"),
        (recording().assign(x=500.0), "only 0 pairs"),
        (recording().query("frame % 2 == 0"), "only 0 pairs"),
        (pd.concat([recording(60.0), recording(90.0, seed=4)]), "by .* or by .* nothing tells"),
    ],
)
def test_a_velocity_that_cannot_be_told_is_refused(table, message):
    with pytest.raises(InputError, match=f"{message}.*by hand|{message}"):
        estimate_velocity(table, "weizen")


def test_each_recording_is_followed_at_its_own_velocity():
    slow, fast = recording(62.0), recording(92.0, seed=2)
    parts = []
    for table in (slow, fast):
        step = estimate_velocity(table).px_per_frame
        motion = ConstantVelocity((step, 0.0), 8.0, measurement_sd=1.0)
        appearance = Appearance(Area(0, 1700, 2250), 0.5, step, 10.0)
        parts.append((table, BeltTracker(motion, appearance, frame_s=1.0)(table)))
    joined = join_followed(parts)
    compared = compare_links(join_recordings([slow, fast]), joined)
    assert compared["recall_percent"] == compared["agreed_percent"] == 100.0
    assert compared["measurements"] == len(slow) + len(fast)
    assert joined.ends["particle"].is_unique


def test_nothing_cannot_be_joined():
    with pytest.raises(InputError, match="no recording"):
        join_followed([])
