"""The belt's velocity from measurements, on hand-made recordings."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.camera import Area
from kilnflight.belt.tracker import Appearance, BeltTracker
from kilnflight.belt.velocity import WatchVelocity, estimate_velocity
from kilnflight.checks import InputError
from kilnflight.experiments.belt_real import compare_links, join_followed, join_recordings
from kilnflight.tracking.filter import ConstantVelocity


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
    assert joined.ends["particle"].is_unique


def fed(watch, table):
    for frame in range(int(table["frame"].max()) + 1):
        watch.add(frame, table.loc[table["frame"] == frame, ["x", "y"]].to_numpy() * 0.5)
    return watch


def test_a_belt_that_runs_faster_or_not_at_all_is_noticed():
    step = estimate_velocity(recording()).px_per_frame
    settings = {"px_per_frame": step, "mm_per_px": 0.5, "from_mm": 0.0}
    same = fed(WatchVelocity(**settings), recording(seed=3))
    assert same.change() == pytest.approx(0, abs=0.01)
    assert not same.has_drifted()
    faster = fed(same, recording(68.0, seed=4))  # the slower ones are forgotten after 200 frames
    assert faster.change() == pytest.approx(6 / 62, abs=0.01)
    assert faster.has_drifted()
    for table in (recording(particles=1), recording().assign(x=500.0)):
        untold = fed(WatchVelocity(**settings), table)
        assert np.isnan(untold.change())
        assert untold.has_drifted() is None
    for wrong in (
        {"px_per_frame": 0.0},
        {"from_mm": np.nan},
        {"mm_per_px": -1.0},
        {"frames": 1},
        {"limit": 0.0},
    ):
        with pytest.raises(InputError, match=f"WatchVelocity: {next(iter(wrong))}"):
            WatchVelocity(**settings | wrong)


def test_a_belt_that_fills_is_none_that_has_drifted():
    """Particles speed up along the belt; at first only the slow ones at its start are there."""
    whole = recording(every=1, particles=120)
    whole["x"] = 776 + whole["x"] * (1 + whole["x"] / 3000)  # px; up to 1000 mm at 0.8 mm/px
    spots = whole.assign(x=0.8 * whole["x"], y=0.8 * whole["y"])
    watch = WatchVelocity.of_spots(spots, 0.8, from_mm=900.0)
    changes = []
    for frame in range(60):
        watch.add(frame, spots.loc[spots["frame"] == frame, ["x", "y"]].to_numpy())
        changes.append(watch.change())
    assert np.isnan(changes[8])
    known = np.array(changes)[~np.isnan(changes)]
    assert len(known) > 20
    assert np.abs(known).max() < watch.limit
    with pytest.raises(InputError, match="WatchVelocity: spots"):
        WatchVelocity.of_spots(spots[["x"]], 0.8, 0.0)


def test_every_second_frame_lost_leaves_the_velocity_unknown():
    watch = fed(WatchVelocity(62.0, 0.5, 0.0), recording().query("frame % 2 == 0"))
    assert np.isnan(watch.change())
    assert watch.has_drifted() is None
