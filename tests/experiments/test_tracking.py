"""The tracking experiment on a made-up window."""

import numpy as np
import pandas as pd
import pytest

from kilnflight import tracklets
from kilnflight.experiments import tracking, tracking_scores
from kilnflight.experiments.tracking_scores import Lance
from kilnflight.tracking.tracker import track

FRAMES = range(30)
LANCE = Lance(row=160.0, col=20.0, depth_mm=6000.0)  # 100 px from both lanes


class Flat:
    """Frame differences: one everywhere."""

    shape = (999, 400, 500)

    def __getitem__(self, box):
        return np.ones([side.stop - side.start for side in box])


@pytest.fixture
def window():
    frame = np.repeat(FRAMES, 2)
    lane = np.tile([0, 1], len(FRAMES))
    truth = pd.DataFrame({"frame": frame, "particle": lane + 7, "row": 60.0 + 200 * lane})
    truth = truth.assign(col=20.0 + 9.0 * frame, x=0.0, y=0.0, z=6000.0)
    seen = truth.drop(columns="particle")[truth["frame"] % 10 != 5].assign(points=40)
    clutter = seen.iloc[::9].assign(row=lambda t: t["row"] + 90.0)
    seen = pd.concat([seen, clutter], ignore_index=True).sort_values("frame", ignore_index=True)
    return tracking.Window("confetti", FRAMES, seen, truth, Flat(), LANCE)


def test_a_window_is_followed_without_and_with_post_processing(window):
    tracked = tracking.follow_all([window], {"GNN": track})
    table = tracking_scores.tabulate(tracking.cells([window], tracked).values())
    before, after = (table.set_index("postprocessing").loc[name] for name in ("without", "with"))
    assert after["alpha"] >= before["alpha"] > 0.85
    assert after["tp_tracks"] == 2


def test_each_part_is_replaced_by_the_truth(window):
    owner = tracking.true_particles(window.detections, window.truth)
    assert set(owner) == {-1, 7, 8}
    assert (owner == -1).sum() == 6
    table = tracking.ablate([window], {"GNN": track})
    unprocessed = table[table["postprocessing"] == "without"].set_index(["input", "tracker"])
    assert unprocessed.loc[("true positions", "GNN"), "alpha"] == pytest.approx(1.0)
    links = unprocessed.loc[("detections", "links by the truth")]
    assert links["jsc_theta"] == 1.0
    assert links["alpha"] == pytest.approx(54 / 60)
    right, every = (
        unprocessed.loc[("right detections only", "GNN")],
        unprocessed.loc[("detections", "GNN")],
    )
    assert right["beta"] >= every["beta"]
    assert right["fp_tracks"] == 0


def test_defaults_of_the_steps_are_those_of_table_5_16():
    elimination, outliers, connection, fusion = tracklets.STEPS
    assert elimination == tracklets.Elimination(duration=2, speed=1.0, regularity=0.9)
    assert (outliers.angle_deg, outliers.change) == (30.0, 18.0)
    assert (connection.gap, connection.overlap, connection.depth) == (15, 5, 1500.0)
    assert fusion.distance == 10.0
    assert tuple(vars(connection.costs).values()) == (2.0, 2.0, 0.1, 1.0, 2.0, 1e11)
