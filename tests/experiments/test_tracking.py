"""The tracking experiment on a made-up window."""

import numpy as np
import pandas as pd
import pytest

from kilnflight import tracklets
from kilnflight.checks import InputError
from kilnflight.experiments import post_processing, tracking, tracking_claims, tracking_scores
from kilnflight.experiments.tracking_scores import ALL, Lance
from kilnflight.project import claims
from kilnflight.tracking.tracker import track
from kilnflight.twin.scenes import WINDOWS, tracking_window

FRAMES = range(30)
LANCE = Lance(row=160.0, col=20.0, depth_mm=6000.0)


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
    return tracking.Window("confetti", "made up", FRAMES, seen, truth, Flat(), LANCE)


def test_post_processing_and_truth_make_it_better(window):
    tracked = tracking.follow_all([window], {"GNN": track})
    table = tracking_scores.tabulate(tracking.cells([window], tracked, [ALL]))
    before, after = (table.set_index("postprocessing").loc[name] for name in ("without", "with"))
    assert after["beta"] > before["beta"]
    assert after["alpha"] > 0.85


def test_each_part_is_replaced_by_the_truth(window):
    owner = tracking.true_particles(window.detections, window.truth)
    assert set(owner) == {-1, 7, 8}
    assert (owner == -1).sum() == 6
    table = tracking.ablate([window], {"GNN": track}, ALL)
    unprocessed = table[table["postprocessing"] == "without"].set_index(["input", "tracker"])
    assert unprocessed.loc[("true positions", "GNN"), "alpha"] == pytest.approx(1.0)
    links = unprocessed.loc[("detections", "links by the truth")]
    assert links["jsc_theta"] == 1.0
    assert links["alpha"] == pytest.approx(54 / 60)
    right, every = (
        unprocessed.loc[("right detections only", "GNN")],
        unprocessed.loc[("detections", "GNN")],
    )
    assert right["beta"] > every["beta"]
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
    picture = post_processing.draw_steps([window], after)
    assert len(picture.axes) == 1 + len(after["confetti"])
    assert set(tracking.joined_tables(after, "step")["step"]) == set(after["confetti"])


def test_variants_are_steps_and_the_first_is_as_printed(window):
    variants = {"none": (), **post_processing.variants()}
    table = post_processing.compare_variants([window], variants)
    table = table[(table["reading"] == ALL) & (table["fraction"] == "confetti")]
    table = table.set_index("variant")
    assert list(table.index) == list(variants)
    steps, _ = post_processing.compare_steps([window])
    assert table.loc["none", "alpha"] == steps["alpha"].iloc[0]
    assert table.loc["default", "alpha"] == steps["alpha"].iloc[-1]
    without = tracklets.postprocess(track(window.detections))  # no differences, no texture
    measures = tracking_scores.measure_tracks(window.truth, without)
    assert table.loc["no texture", "alpha"] == measures["alpha"]


def test_the_texture_that_tells_most_comes_first(window):
    rng = np.random.default_rng(0)
    streaks = [100.0 * np.eye(*post_processing.BOX) * k for k in range(1, 8)]
    empty = [rng.random(post_processing.BOX) for _ in range(7)]
    table = post_processing.texture_table(streaks, empty)
    assert table["ratio"].is_monotonic_decreasing
    assert len(table) == 15
    first = table.iloc[0]
    assert first["with_track"] == tracklets.energies(streaks[3])[first["masks"]]
    assert first["f"] == tracklets.energies(empty[0])[first["masks"]]
    assert first["ratio_10"] == pytest.approx(first["ratio"] * 1.6 / 4)


@pytest.mark.parametrize(
    ("low", "high", "verdict", "because"),
    [
        (0.01, 0.05, claims.NOT_REPRODUCED, "method"),
        (-0.05, -0.01, claims.REPRODUCED, ""),
        (-0.05, 0.01, claims.NOT_DECIDABLE, "criterion"),
        (np.nan, np.nan, claims.NOT_DECIDABLE, "chain"),  # too few trajectories
    ],
)
def test_the_interval_decides_between_the_methods_of_fig_4_14(low, high, verdict, because):
    """`low` and `high` are of the Hungarian method's gain, so dual nearest leads below 0."""
    row = {"variant": "Hungarian", "fraction": "mean of fractions", "reading": "from the lance"}
    row |= {"alpha_gain": 0.01, "alpha_gain_low": low, "alpha_gain_high": high}
    texture = pd.DataFrame({"masks": ["LE", "EE"], "ratio": [8.0, 2.0]})
    judged = post_processing.verdicts(pd.DataFrame([row]), texture)
    verdicts = {one.id: one for one in judged}
    assert set(verdicts) == {"track-7", "track-8"}
    assert verdicts["track-7"].verdict == verdict
    assert verdicts["track-7"].because == because
    assert "nan" not in verdicts["track-7"].measured
    assert "print: one made-up instance" in verdicts["track-7"].reason


def test_tracks_of_each_stage_stand_beside_the_truth(window):
    tracked = tracking.follow_all([window], {"GNN": track, "JPDA": track})
    tables = tracking.beside_truth([window], tracked, ["GNN"])["confetti"]
    assert list(tables) == ["truth", "GNN without steps", "GNN with steps"]
    assert tables["truth"] is window.truth
    assert tables["GNN without steps"].equals(track(window.detections))


def test_the_defaults_are_the_printed_values_in_their_order():
    table = post_processing.table_5_16()
    assert table["used"].tolist() == pytest.approx(table["printed"].tolist())
    assert len(table) == 16


def test_detections_of_no_particle_are_counted(window):
    """Six of sixty are 90 px off every true position."""
    table = tracking_claims.window_table([window])
    assert table[["detections", "of_no_particle"]].to_numpy().tolist() == [[60, 6]]
    said = tracking_claims.describe_windows(table)
    assert said == "Detections of no particle: confetti 6 of 60."
