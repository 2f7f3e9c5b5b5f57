"""Two materials told by size and shape, and what both errors cost."""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from scipy import ndimage

from kilnflight.belt.pictures import Spots
from kilnflight.belt.tracker import Followed
from kilnflight.belt.valves import ValveBar
from kilnflight.checks import InputError
from kilnflight.experiments import belt_2016, belt_camera, belt_mixture, belt_valves
from kilnflight.experiments.belt_camera import PictureTracks
from kilnflight.experiments.belt_mixture import MixedPictures, Setting, TimedSlide
from kilnflight.experiments.belt_valves import Entering
from kilnflight.sorter.machine import BULKS, Slide
from kilnflight.sorter.rendering import CameraView, Pictures
from kilnflight.tables import BELT_PREDICTED, BELT_TRACKS

VIEW = CameraView()


def resting(places, first=0):
    """One frame with particles at places."""
    x, y = np.array(places, dtype=np.float64).T
    number = first + np.arange(len(x))
    columns = {"frame": 0, "particle": number, "time_s": 0.0, "x": x, "y": y, "angle_rad": 0.7}
    return pd.DataFrame(columns)


def looks(area, elongation, count=20):
    rng = np.random.default_rng(0)
    values = rng.normal([area, elongation], [3.0, 0.03], (count, 2))
    return pd.DataFrame(values, columns=belt_mixture.FEATURES)


def entering(truth, particles=4):
    arrival = pd.DataFrame(
        {
            "particle": np.arange(particles),
            "time_s": 0.1 * np.arange(1.0, particles + 1),
            "y": 45.0,
        }
    )
    last = pd.DataFrame({"particle": np.arange(len(truth)), "time_s": 0.0})
    return Entering(last, np.array(truth), arrival, 788.0)


def test_materials_are_numbered_through():
    good, bad = resting([(500, 50), (520, 90)]), resting([(450, 100)])
    both, first_bad = belt_mixture.join_materials(good, bad)
    assert (first_bad, both["particle"].tolist()) == (2, [0, 1, 2])
    none, first_bad = belt_mixture.join_materials(BELT_TRACKS.empty(), bad)
    assert (first_bad, len(none)) == (0, 1)


def test_a_mixed_picture_is_that_of_each_material_where_it_is():
    good, bad = resting([(450, 50)]), resting([(600, 130)])
    both, _ = belt_mixture.join_materials(good, bad)
    mixed = MixedPictures(both, BULKS["cuboids"], 3, VIEW, bad=BULKS["cylinders"], first_bad=1)
    cuboid = Pictures(good, BULKS["cuboids"], 3, VIEW)[0]
    cylinder = Pictures(bad, BULKS["cylinders"], 3, VIEW)[0]
    np.testing.assert_array_equal(mixed[0][:, :500], cuboid[:, :500])
    np.testing.assert_array_equal(mixed[0][:, 500:], cylinder[:, 500:])


def test_spots_have_the_elongation_of_their_material():
    places = [(450.0, 50.0), (600.0, 130.0)]
    both, _ = belt_mixture.join_materials(resting(places[:1]), resting(places[1:]))
    mixed = MixedPictures(both, BULKS["cuboids"], 3, VIEW, bad=BULKS["cylinders"], first_bad=1)
    empty = Pictures(resting([(10.0, 10.0)]), BULKS["cuboids"], 3, VIEW)[0]
    pixels = VIEW.pixels(np.column_stack([np.array(places), [1.0, 1.5]]))
    spots = np.vstack([pixels, [20.0, 20.0]])  # nothing is at the last
    values = belt_mixture.elongations(mixed[0], empty, spots)
    assert values[:2] == pytest.approx([1.2, 3.0], rel=0.06)
    assert np.isnan(values[2])


def test_a_track_has_the_median_of_its_spots_and_marked_ones_do_not_count():
    spots = pd.DataFrame(
        {
            "area_px": [100.0, 110.0, 300.0, 120.0, 290.0, 150.0],
            "elongation": [1.0, 1.2, 2.0, 1.1, 2.2, np.nan],
            "touching": [0, 0, 1, 0, 1, 0],
        }
    )
    states = pd.DataFrame({"particle": [3, 3, 3, 3, 5, 6, 3], "row": [0, 1, 2, 3, 4, 5, -1]})
    looks = spots.pop("elongation").to_numpy()
    pictured = PictureTracks(np.zeros((1, 1)), None, spots, Followed(states, states), looks)
    table = belt_mixture.features(pictured)
    assert table.index.tolist() == [3, 5]  # track 6 has no elongation
    assert table.loc[3].tolist() == [110.0, 1.1]
    assert table.loc[5].tolist() == [290.0, 2.2]


def test_classes_are_told_apart_and_what_has_none_has_even_odds():
    rule = belt_mixture.fit_classes(looks(164, 1.2), looks(150, 2.9))
    odds = belt_mixture.odds_bad(rule, pd.concat([looks(164, 1.2, 5), looks(150, 2.9, 5)]))
    assert (odds.to_numpy()[:5] < 0).all()
    assert (odds.to_numpy()[5:] > 0).all()
    same = belt_mixture.fit_classes(looks(164, 1.2), looks(164, 1.2))
    assert belt_mixture.odds_bad(same, looks(164, 1.2)).to_numpy() == pytest.approx(0.0, abs=1e-9)
    none = belt_mixture.odds_bad(rule, looks(1, 1, 0))
    assert belt_mixture.decide(entering([0, 1]), none).tolist() == [True, True]
    assert belt_mixture.decide(entering([0, 1]), none, 0.1).tolist() == [False, False]


def test_a_class_without_labelled_tracks_is_refused():
    with pytest.raises(InputError, match="2 tracks of the bad material"):
        belt_mixture.fit_classes(looks(164, 1.2), looks(150, 2.9, 2))


def test_confusion_counts_particles_missed_doubled_and_none():
    tracks = entering([0, 0, 2, -1, -1])  # particle 0 twice, 1 and 3 missed, two tracks of none
    blow = np.array([False, True, False, True, False])
    table = belt_mixture.confusion(tracks, 2, blow)
    assert table.loc["good"].tolist() == [0, 1, 1, 50.0]
    assert table.loc["bad"].tolist() == [1, 0, 1, 0.0]
    assert table.loc["no particle"].tolist() == [1, 1, 0, 50.0]
    absent = belt_mixture.confusion(tracks, 4, blow)  # no bad particle at all
    assert absent.loc["bad", ["left", "blown out", "missed"]].tolist() == [0, 0, 0]
    assert np.isnan(absent.loc["bad", "correct_percent"])


def test_the_threshold_of_bayes_has_the_least_expected_cost():
    assert belt_mixture.bayes_threshold(1.0, 0.5) == 0.0
    assert belt_mixture.bayes_threshold(4.0, 0.2) == pytest.approx(0.0)
    for ratio, share in ((1.0, 0.2), (25.0, 0.2)):
        log_odds = belt_mixture.bayes_threshold(ratio, share)
        bad, good = share * np.exp(log_odds), (1 - share) * 1.0
        assert ratio * bad == pytest.approx(good)  # both errors cost the same there
    with pytest.raises(InputError, match="ratio"):
        belt_mixture.bayes_threshold(0.0, 0.5)


def by_hand(first_bad):
    tracks = entering([0, 1, 2, 3])
    columns = (np.arange(4), tracks.arrival["time_s"].to_numpy(), np.full(4, 45.0))
    predicted = pd.DataFrame(dict(zip(BELT_PREDICTED.names, columns, strict=True)))
    setting = Setting("exact", ValveBar(), predicted, tracks)
    odds = pd.Series([-5.0, 1.0, 2.0, -1.0])
    bars = [setting.bar, replace(setting.bar, open_s=0.25)]  # the second hits neighbours as well
    return belt_mixture.costs(setting, first_bad, odds, bars, [0.0, 9.0], [1.0, 10.0])


def test_costs_by_hand():
    table = by_hand(2).set_index(["open_ms", "log_odds", "ratio"])
    # Tracks 1 and 2 are blown out: a good one is lost, the bad particle 3 is left.
    assert table.loc[(5.0, 0.0, 1.0), ["bad_left", "good_blown_out"]].tolist() == [1, 1]
    assert table.loc[(5.0, 0.0, 10.0), "cost_per_particle"] == 11 / 4
    assert table.loc[(250.0, 0.0, 1.0), ["bad_left", "good_blown_out"]].tolist() == [0, 2]
    assert table.loc[(5.0, 9.0, 10.0), ["bad_left", "good_blown_out"]].tolist() == [2, 0]


def test_without_bad_particles_only_good_ones_can_be_lost():
    table = by_hand(4)
    assert (table["bad"] == 0).all()
    assert (table["bad_left"] == 0).all()
    assert table["good_blown_out"].tolist() == [2, 2, 0, 0, 4, 4, 0, 0]


def test_model_and_bar_are_set_by_the_first_half(monkeypatch):
    monkeypatch.setattr(belt_valves, "PITCHES", (1.0, 2.0))
    monkeypatch.setattr(belt_valves, "SHIFTS_MS", (0.0,))
    rng = np.random.default_rng(1)
    count, bad = 80, np.arange(80) >= 60
    start = rng.permutation(count) / 20.0
    speed = np.where(bad, rng.uniform(700, 1200, count), 1200.0)
    y = rng.uniform(20, 160, count)
    last = pd.DataFrame({"particle": np.arange(count), "time_s": start, "x": 688.0, "y": y})
    last = last.assign(velocity_x_mm_s=speed, velocity_y_mm_s=np.where(bad, 30.0, 1.0))
    last = last.assign(acceleration_x_mm_s2=0.0, acceleration_y_mm_s2=0.0)
    arrival = pd.DataFrame({"particle": np.arange(count), "time_s": start + 100 / speed})
    arrival = arrival.assign(y=y + last["velocity_y_mm_s"] * 100 / speed, velocity_y_mm_s=1.0)
    mixture = Entering(last, np.arange(count), arrival, 788.0)
    odds = pd.Series(np.where(bad, 5.0, -5.0))
    setting = belt_mixture.set_up(mixture, mixture, odds, 60, ValveBar(), limit=0.05)
    assert setting.model != "IV-Straight"  # it would miss the slower ones
    assert len(setting.entering.arrival) == 40
    (row,) = belt_mixture.costs(setting, 60, odds, [setting.bar], [0.0], [1.0]).to_dict("records")
    assert row["bad_left"] == 0
    assert row["good_blown_out"] <= 3
    nothing = belt_mixture.set_up(mixture, mixture, odds - 9, 99, ValveBar())
    assert np.isfinite(nothing.bar.delay_s)


def without_contacts(monkeypatch):
    monkeypatch.setattr(belt_mixture, "is_installed", lambda: False)
    monkeypatch.setattr(belt_2016, "is_installed", lambda: False)


def test_both_materials_come_interleaved_and_each_half_has_the_share(monkeypatch):
    without_contacts(monkeypatch)
    monkeypatch.setattr(belt_mixture.simulation, "BATCH", 70)  # several batches, as at full scale
    mixed, first_bad = belt_mixture.simulate_mixture("cuboids", "cylinders", 200, 0.2, 3)
    starts = mixed.groupby("particle")["time_s"].min().sort_values()
    bad = (starts.index >= first_bad).astype(float)
    assert mixed["particle"].nunique() == 200
    assert len(mixed) == len(mixed.drop_duplicates(["particle", "frame"]))
    np.testing.assert_allclose(mixed["time_s"], mixed["frame"] / 1000.0)
    for half in (bad[:100], bad[100:]):  # four standard errors of a share of 0.2
        assert half.mean() == pytest.approx(0.2, abs=4 * np.sqrt(0.2 * 0.8 / 100))
    arrival = belt_valves.of_bodies(mixed)
    parts = [belt_mixture.are_bad(half, first_bad).mean() for half in arrival.halves()]
    assert parts == pytest.approx([0.2, 0.2], abs=4 * np.sqrt(0.2 * 0.8 / 100))
    order = np.flatnonzero(bad)
    assert np.diff(order).max() < 60  # no long pause of the bad ones
    again, _ = belt_mixture.simulate_mixture("cuboids", "cylinders", 200, 0.2, 3, jobs=2)
    pd.testing.assert_frame_equal(mixed, again)


def test_a_timed_slide_has_the_given_times_and_is_the_usual_one_otherwise():
    times = (0.0, 0.5, 0.7)
    timed = TimedSlide(time_s=times)(BULKS["cuboids"], 3, 180.0, np.random.default_rng(2))
    usual = Slide()(BULKS["cuboids"], 3, 180.0, np.random.default_rng(2))
    assert timed.time_s.tolist() == list(times)
    np.testing.assert_array_equal(timed.velocity_mm_s, usual.velocity_mm_s)


def test_a_mixture_without_share_is_refused():
    with pytest.raises(InputError, match="bad_share"):
        belt_mixture.simulate_mixture("cuboids", "cylinders", 10, 1.0, 3)


def test_confusion_counts_particles_that_shared_a_spot_apart():
    tracks = entering([0, 0, 2, -1, -1])
    blow = np.array([False, True, False, True, False])
    table = belt_mixture.confusion_by_touch(tracks, 2, blow, np.array([0, 3]))
    counts = table.set_index(["particle", "shared_spot"])[["left", "blown out", "missed"]]
    assert counts.loc[("good", "ever")].tolist() == [0, 1, 0]
    assert counts.loc[("good", "never")].tolist() == [0, 0, 1]
    assert counts.loc[("bad", "ever")].tolist() == [0, 0, 1]
    assert counts.loc[("bad", "never")].tolist() == [1, 0, 0]
    assert counts.loc[("no particle", "")].tolist() == [1, 1, 0]


def test_the_cheapest_names_all_places_of_equal_cost():
    costs = pd.DataFrame(
        {
            "ratio": [1, 1, 1, 5, 5, 5],
            "open_ms": [2.0, 3.0, 4.0] * 2,
            "cost_per_particle": [0.2, 0.1, 0.1, 0.3, 0.2, 0.4],
        }
    )
    assert belt_mixture.cheapest(costs, "open_ms") == {1.0: "3 to 4", 5.0: "3"}


def test_recordings_tracked_together_are_those_tracked_alone():
    rng = np.random.default_rng(2)
    frame = np.arange(0, 200, 5)
    parts = [
        pd.DataFrame({"frame": frame, "particle": k, "time_s": frame / 1000, "x": x, "y": y})
        for k, (x, y) in enumerate(
            zip(400 + 1.4 * frame + rng.uniform(0, 40, (3, 1)), (40.0, 46.0, 120.0), strict=True)
        )
    ]
    films = [Pictures(pd.concat(parts[:n], ignore_index=True), BULKS["cuboids"], 3) for n in (2, 3)]
    ways = [Spots(), Spots(split=True)]
    together = belt_camera.track_together(films, 20, ways, belt_mixture.elongations)
    for film, found in zip(films, together, strict=True):
        for way, one in zip(ways, found, strict=True):
            alone = belt_camera.track_pictures(film, 20, way)
            np.testing.assert_array_equal(one.background, alone.background)
            pd.testing.assert_frame_equal(one.spots, alone.spots, check_exact=True)
            states = one.followed.states, alone.followed.states
            pd.testing.assert_frame_equal(*states, check_exact=True)
        plain = plain_elongations(film, found[0])
        np.testing.assert_array_equal(found[0].looks, plain)


def plain_elongations(pictures, pictured):
    """The plain definition: each spot cut out of the mask of its picture."""
    values, reach = [], belt_mixture.REACH_PX
    for spot in pictured.spots.itertuples():
        differs = cv2.absdiff(pictures[spot.frame], pictured.background) > Spots().threshold
        labels, _ = ndimage.label(differs, np.ones((3, 3)))
        row, col = round(spot.row), round(spot.col)
        near = labels[max(0, row - reach) : row + reach + 1]
        near = near[:, max(0, col - reach) : col + reach + 1]
        own = near == labels[row, col] if labels[row, col] else np.zeros((1, 1))
        pixels = np.argwhere(own).astype(np.float64)
        if len(pixels):
            square = np.linalg.eigvalsh(np.cov(pixels.T, bias=True) + np.eye(2) / 12.0)
        values.append(np.sqrt(square[1] / square[0]) if len(pixels) else np.nan)
    return np.array(values)
