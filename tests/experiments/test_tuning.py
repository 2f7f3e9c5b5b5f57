"""On which frames settings are chosen, and that no chosen one lies at an edge."""

import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from kilnflight.association import JPDA
from kilnflight.checks import InputError
from kilnflight.experiments import jpda_ablation, tracker_ranks, tracking, tracking_scores, tuning
from kilnflight.experiments.tracking_scores import ALL, FROM_LANCE, Lance
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.motion import ConstantVelocity
from kilnflight.tracking.tracker import Management, track
from kilnflight.twin.scenes import WINDOWS, tracking_window

FIGURES = Path(__file__).resolve().parents[2] / "figures"
FRAMES = range(40)
LANCE = Lance(60.0, 20.0, 6000.0)


@pytest.fixture
def window():
    """Eight particles: four start at the lance one after the other, four far away."""
    parts = []
    for k in range(8):
        frame = np.arange(2 * k, 2 * k + 20)
        col = 20.0 + 9.0 * np.arange(20) + (0 if k % 2 else 900.0)
        row = 60.0 + (6.0 * k - 20.0) * np.arange(20)
        path = {"frame": frame, "particle": k, "row": row, "col": col}
        parts.append(pd.DataFrame(path).assign(x=0.0, y=0.0, z=6000.0))
    truth = pd.concat(parts, ignore_index=True)
    seen = truth.drop(columns="particle").assign(points=40).sort_values("frame", ignore_index=True)
    return tracking.Window("confetti", "made up", FRAMES, seen, truth, None, LANCE)


@pytest.mark.parametrize("fraction", WINDOWS)
def test_settings_are_chosen_where_nothing_is_reported(fraction, campaign_twin):
    twin = campaign_twin(fraction)
    window = tracking_window(twin)
    for scale, length in tuning.LENGTHS.items():
        frames = tuning.tuning_frames(twin, scale)
        assert len(frames) == length
        assert 0 <= frames.start < frames.stop <= len(twin)
        near = range(window.start - tracking.MARGIN, window.stop + tracking.MARGIN)
        assert not set(frames) & set(near)
    assert tuning.LENGTHS["full"] > 100


def test_what_is_reported_decides(window):
    """After post-processing, tracks from the lance: what is lost elsewhere costs nothing."""

    def right(seen):
        return seen.merge(window.truth[["frame", "row", "col", "particle"]])

    def elsewhere_lost(seen):
        return right(seen).assign(
            particle=lambda t: t["particle"].where(t["particle"] % 2 == 1, -1)
        )

    worth = tuning.Reported([window])
    assert worth(right)["beta"] == pytest.approx(1.0)
    assert worth(elsewhere_lost)["beta"] == pytest.approx(1.0)
    far = window._replace(lance=Lance(1500.0, 1900.0, 1000.0))  # no particle from there
    assert tuning.Reported([far])(right)["beta"] == pytest.approx(1.0)
    assert tuning.Reported([far])(elsewhere_lost)["beta"] == pytest.approx(0.5)


def test_a_tracker_that_refuses_has_no_measures(window):
    def refuses(seen):
        raise InputError("too dense.")

    row = tuning.Reported([window])(refuses)
    assert np.isnan(row["beta"])
    assert row["note"] == "not run: too dense."


def tried_settings():
    rows = [(1.0, 0.5, 3, 0.3, False), (2.0, 0.5, 3, 0.5, True), (2.0, 1.0, 3, 0.4, False)]
    table = pd.DataFrame(rows, columns=["gate", "noise", "missed_frames", "beta", "chosen"])
    table = table.assign(setting="x", at_end="", untried=np.where(table["chosen"], 2, 0))
    return table.assign(tracker="GNN, ours")


def test_the_curve_has_the_largest_beta_at_each_value():
    axes = tracker_ranks.draw_curves(tried_settings()).axes
    assert len(axes) == 3
    tried, largest, best = axes[0].lines  # the gate
    assert tried.get_xydata().tolist() == [[1.0, 0.3], [2.0, 0.5], [2.0, 0.4]]
    assert largest.get_xydata().tolist() == [[1.0, 0.3], [2.0, 0.5]]
    assert best.get_xydata().tolist() == [[2.0, 0.5]]
    told = tuning.describe_chosen(tried_settings())
    assert told == "GNN, ours x (beta 0.500, 2 neighbours not tried)"


@pytest.mark.published
@pytest.mark.parametrize("name", ["tracking-settings", "peers-settings"])
def test_no_published_setting_lies_at_an_edge_of_its_grid(name):
    tried = pd.read_csv(FIGURES / f"{name}.csv", keep_default_na=False)
    assert len(set(tried["tracker"].value_counts())) == 1  # the same number of trials
    for tracker, table in tried.groupby("tracker"):
        grid = tuning.all_grids()[tracker]
        best = table[table["chosen"].astype(str) == "True"].iloc[0]
        setting = tuple(float(best[parameter]) for parameter in grid.parameters)
        assert grid.at_end(setting) == "", tracker
        assert float(best["beta"]) == table["beta"].replace("", np.nan).astype(float).max()


def chosen(associator_gate, noise, **parts):
    management = Management(invisible=3)
    motion = ConstantVelocity(acceleration_noise=noise)
    return partial(track, gate=Gate(associator_gate), motion=motion, management=management, **parts)


def test_one_part_of_jpda_is_exchanged_at_a_time(window):
    gnn, jpda = chosen(4.0, 1.0), chosen(2.0, 2.0, associator=JPDA())
    made = jpda_ablation.variants(jpda, gnn, jpda)
    assert made["JPDA"] is jpda
    assert made["GNN"] is gnn
    assert made["gate of GNN"].keywords == jpda.keywords | {"gate": Gate(4.0)}
    assert "missed frames of GNN" not in made  # both have 3
    assert made["what is used starts tracks"].keywords["management"].used == 1.0
    seen = window.detections
    kept = made["recorded at the heaviest detection"](seen)
    pd.testing.assert_frame_equal(kept.drop(columns="particle"), seen)
    assert kept["particle"].equals(jpda(seen)["particle"])


def test_a_filter_that_takes_one_detection_has_weights_of_0_and_1():
    two = np.array([[1.0, 4.0]])
    pairs = Gate(3.0)(*_two_detections())
    assert ((JPDA()(pairs) > 0.1).sum(), two.size) == (2, 2)
    assert jpda_ablation.Heaviest()(pairs).tolist() == [[0.0, 1.0, 0.0]]
    denser = jpda_ablation.Clutter(10.0)(pairs)
    assert denser[0, 0] > JPDA()(pairs)[0, 0]


def _two_detections():
    from kilnflight.tracking.gate import Detected, Predicted

    at = Predicted(np.zeros((1, 2)), 25.0 * np.eye(2)[None])
    return at, Detected(np.array([[0.0, 2.0], [0.0, 6.0]]))


def test_gains_are_paired_and_lie_in_their_intervals(window):
    def right(window):
        return window.truth

    def worse(window):
        return window.truth[window.truth["frame"] % 3 > 0]

    table = tracking.compare([window], {"right": right, "same": right, "worse": worse})
    assert set(table["reading"]) == {ALL, FROM_LANCE}
    whole = table[(table["fraction"] == tracking_scores.MEAN) & (table["reading"] == ALL)]
    rows = whole.set_index("variant")
    assert rows.loc["same", ["alpha_gain", "alpha_gain_low", "alpha_gain_high"]].tolist() == [
        0.0,
        0.0,
        0.0,
    ]
    lost = rows.loc["worse"]
    assert lost["alpha_gain"] == pytest.approx(lost["alpha"] - rows.loc["right", "alpha"])
    assert lost["alpha_gain_low"] <= lost["alpha_gain"] <= lost["alpha_gain_high"] < 0
    assert lost["true_tracks"] == 8
    lance = table[(table["fraction"] == "confetti") & (table["reading"] == FROM_LANCE)]
    assert (lance["true_tracks"] == 4).all()  # too few for an interval
    assert np.isnan(lance.set_index("variant").loc["worse", "alpha_gain_low"])


def test_the_ablation_is_drawn_and_told(window):
    gnn, jpda = chosen(4.0, 1.0), chosen(2.0, 2.0, associator=JPDA())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = jpda_ablation.ablate([window], jpda_ablation.variants(jpda, gnn, jpda))
    assert len(jpda_ablation.draw(table).axes) == 2
    assert "GNN has" in jpda_ablation.describe(table)
