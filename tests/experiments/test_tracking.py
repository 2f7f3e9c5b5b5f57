"""The tracking experiment on a made-up window."""

import numpy as np
import pandas as pd
import pytest

from kilnflight import tracklets
from kilnflight.checks import InputError
from kilnflight.experiments import post_processing, trackers, tracking, tracking_scores
from kilnflight.experiments.tracking_scores import Lance
from kilnflight.tracking.tracker import track
from kilnflight.twin.scenes import WINDOWS, tracking_window

FRAMES = range(30)
LANCE = Lance(row=160.0, col=20.0, depth_mm=6000.0)  # 100 px from both lanes


class Flat:
    """Frame differences: one everywhere."""

    shape = (400, 500)

    def __call__(self, first, last, top, left, bottom, right):
        return np.ones((bottom - top, right - left)) * (last - first + 1)


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


def test_windows_with_and_without_a_track(window):
    generator = np.random.default_rng(0)
    streaks, empty = post_processing.texture_boxes(window, 5, generator)
    assert all(image.shape == post_processing.BOX for image in [*streaks, *empty])
    assert all((image == post_processing.SPAN).all() for image in streaks)
    crowded = window._replace(truth=window.truth, differences=Flat())
    crowded.differences.shape = (130, 70)
    with pytest.raises(InputError, match="no place without a track"):
        post_processing.texture_boxes(crowded, 5, generator)


@pytest.mark.parametrize("fraction", WINDOWS)
def test_scored_are_frames_of_the_window_of_table_5_15(fraction, campaign_twin):
    twin = campaign_twin(fraction)
    window = tracking_window(twin)
    assert tracking.scored_frames(twin, "full") == window
    for scale, length in tracking.LENGTHS.items():
        part = tracking.scored_frames(twin, scale)
        assert set(part) <= set(window)
        assert len(part) == (length or len(window))


def test_each_step_is_measured_and_its_tracks_are_returned(window):
    table, after = post_processing.compare_steps([window])
    assert table["step"].tolist() == list(after["confetti"])
    assert table["step"].iloc[0] == "tracker"
    assert table["beta"].iloc[-1] > table["beta"].iloc[0]
    assert set(tracking.joined_tables(after, "step")["step"]) == set(after["confetti"])


def test_two_ways_of_matching_are_compared_by_fraction_and_on_average(window):
    table = post_processing.compare_matchings([window])
    assert table["fraction"].tolist() == ["confetti", "mean of fractions"]
    assert table["alpha"].between(-0.1, 0.1).all()
    assert table[["alpha_low", "alpha_high"]].isna().all(axis=None)  # two trajectories


def test_detections_of_no_particle_are_counted(window):
    """Six of sixty are 90 px off every true position."""
    table = tracking.window_table([window])
    assert table[["detections", "of_no_particle"]].to_numpy().tolist() == [[60, 6]]


def test_defaults_of_the_steps_are_those_of_table_5_16():
    elimination, outliers, connection, fusion = tracklets.STEPS
    assert elimination == tracklets.Elimination(duration=2, speed=1.0, regularity=0.9)
    assert (outliers.angle_deg, outliers.change) == (30.0, 18.0)
    assert (connection.gap, connection.overlap, connection.depth) == (15, 5, 1500.0)
    assert fusion.distance == 10.0
    assert tracklets.Costs() == tracklets.Costs(2.0, 2.0, 0.1, 1.0, 2.0, 1e11)


def test_settings_that_are_not_printed_come_from_a_table():
    gnn, jpda = (trackers.chosen(name).keywords for name in ("GNN", "JPDA"))
    assert (gnn["gate"].distance, gnn["motion"].acceleration_noise) == (3.0, 0.5)
    assert gnn["management"].invisible == 5
    assert jpda["gate"].distance < gnn["gate"].distance  # section 5.2.3
    assert type(jpda["associator"]).__name__ == "JPDA"
