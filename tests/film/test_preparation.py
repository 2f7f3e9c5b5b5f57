"""Settings that are chosen for a film: background, enlargement, threshold, doubts."""

import pickle
import re
import warnings
from collections import Counter

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import gaussian_filter
from tests.definitions.films import film
from tools import films

import kilnflight
from kilnflight.film import preparation, prepared
from kilnflight.film.doubts import doubtful_links
from kilnflight.film.motion import shaken_px
from kilnflight.film.pictures import png
from kilnflight.film.settings import Options
from kilnflight.scores import score_detections

PIXEL = ["row", "col"]


class Counted:
    """Looks that show given numbers of spots of a radius at 1, 2 and 4 times."""

    def __init__(self, numbers, radius):
        self.numbers = dict(zip((1, 2, 4), numbers, strict=True))
        self.radius = radius

    def count(self, background, enlarge):
        return self.numbers[enlarge]

    def spots(self, background, enlarge):
        return [np.full((self.numbers[enlarge], 4), self.radius)]


@pytest.mark.parametrize(
    ("numbers", "radius", "enlarge"),
    [
        ((10, 10, 20), 9.0, 1),  # no more than twice as many
        ((10, 10, 21), 9.0, 4),
        ((10, 14, 20), 9.0, 1),  # no more than 1.4 times as many
        ((10, 15, 20), 9.0, 2),
        ((10, 15, 31), 9.0, 4),
        ((0, 0, 0), 0.0, 2),  # twice the size shows all that once shows
        ((0, 0, 2), 1.0, 2),  # two may be noise
        ((10, 15, 20), 1.5, 4),  # as narrow as the narrowest found: some are missed
        ((10, 10, 10), 3.0, 2),
    ],
)
def test_a_film_is_enlarged_where_that_shows_many_more_spots(numbers, radius, enlarge):
    looks = Counted(numbers, radius)
    chosen, reason = preparation.choose_enlargement(looks, "median")
    assert chosen == enlarge
    assert all(str(number) in reason for number in numbers)


def moving(number, sigma, peak, noise, smooth=0.0, size=(160, 160), base=100.0):
    """Return a film of 12 frames, 16 bits, of spots that drift, and the truth.

    The noise is normal and smoothed over ``smooth`` px; ``noise`` is what is left.
    """
    rng = np.random.default_rng(number)
    start = films.starts(number, size, 9.0, rng) - (0, 9)
    places = films.walked(start, 12, 0.0, (0.37, 1.73), rng)
    pictures = rng.normal(0.0, 1.0, (12, *size))
    pictures = gaussian_filter(pictures, (0, smooth, smooth))
    pictures *= noise / max(pictures.std(), 1e-9)
    for picture, now in zip(pictures, places, strict=True):
        for place in now:
            films.spot(picture, place, sigma, peak)
    whole = np.rint(pictures + base).astype(np.uint16)
    return whole, films.listed(places, size)


def matched(truth, found, gate=2.0):
    """Return recall, precision, and true and found places (n, 2) of the hits."""
    true_places, found_places = [], []
    for t, here in truth.groupby("frame"):
        at, seen = (
            table[PIXEL].to_numpy() for table in (here, found[found.frame == t])
        )
        pairs = score_detections(at, seen, gate).pairs
        true_places.append(at[pairs[:, 0]])
        found_places.append(seen[pairs[:, 1]])
    places = np.concatenate(true_places), np.concatenate(found_places)
    return len(places[0]) / len(truth), len(places[0]) / max(len(found), 1), *places


@pytest.mark.parametrize(
    ("noise", "smooth", "recall", "precision"),
    [
        (4.0, 0.0, 0.99, 1.0),
        (4.0, 1.0, 0.99, 0.98),
        (8.0, 1.0, 0.93, 0.97),
        (4.0, 1.5, 0.99, 0.98),
        (8.0, 1.5, 0.75, 0.97),
    ],
)
def test_noise_that_goes_together_in_neighbouring_pixels_is_not_detected(
    noise, smooth, recall, precision
):
    pictures, truth = moving(25, 1.8, 60.0, noise, smooth)
    with warnings.catch_warnings(action="ignore"):  # faint spots go at twice
        found = matched(truth, kilnflight.detect(pictures))
    assert found[0] >= recall
    assert found[1] >= precision


@pytest.mark.parametrize("noise", [0.0, 0.3, 4.0])
@pytest.mark.parametrize("tilt", [0.0, 100.0])
def test_nothing_is_found_where_nothing_is(noise, tilt):
    pictures = moving(0, 1.0, 0.0, noise)[0] + np.linspace(0, tilt, 160).astype(int)
    assert kilnflight.detect(pictures).empty


@pytest.mark.parametrize("sigma", [0.6, 0.8, 1.0, 1.1, 1.5])
def test_spots_from_half_a_pixel_on_are_found_without_a_bias_by_phase(sigma):
    pictures, truth = moving(60, sigma, 100.0, 5.0)
    recall, precision, true, found = matched(truth, kilnflight.detect(pictures), 1.0)
    assert recall >= 0.98
    assert precision >= 0.98
    errors = pd.DataFrame(found - true).groupby(np.floor(true % 1 * 4)[:, 0]).mean()
    assert abs(errors.to_numpy()).max() < 0.05


@pytest.mark.parametrize("sigma", [0.7, 1.8])
def test_spots_that_rest_are_found(sigma):
    pictures, truth = film(size=sigma, drift=(0, 0), frames=12, cells=(3, 4))
    assert matched(truth, kilnflight.detect(pictures))[0] > 0.98


def rows_of(pictures, **options):
    """Return the rows of the settings by name."""
    rows = []
    preparation.choose(kilnflight.open(pictures), Options(**options), rows)
    return {name: [text for key, text in rows if key == name] for name, _ in rows}


def test_counts_at_several_thresholds_are_told_and_doubted():
    pictures, _ = moving(25, 1.8, 60.0, 2.0)
    (told,) = rows_of(pictures)["spots"]
    half, once, twice, four, *inverted = map(int, re.findall(r"\d+", told))
    assert half >= once == twice == four == preparation.LOOKS * 25
    assert sorted(inverted, reverse=True) == inverted
    assert inverted[1] < once / 10
    strength = 60.0 * 0.113  # of the difference of Gaussians, twice the size
    for threshold, doubted in ((strength / 3, False), (strength / 1.5, True)):
        rows = rows_of(pictures, threshold=threshold)
        assert (f" of {once} " in str(rows.get("warning"))) == doubted
    assert rows["spots"][0].startswith(f"{once},")


def test_settings_are_tried_on_the_middle(monkeypatch):
    pictures, _ = moving(60, 1.3, 60.0, 3.0, size=(200, 220))
    monkeypatch.setattr(preparation, "MIDDLE_PX", (100, 120))
    whole = rows_of(pictures)
    assert whole == rows_of(pictures[:, 50:150, 50:170])
    assert "(100, 120)" in whole["tried on"][0]
    monkeypatch.setattr(preparation, "MOST_PX", 100 * 120)
    small, _ = moving(60, 0.8, 60.0, 2.0)
    assert "--size 3" in rows_of(small)["warning"][0]
    assert "warning" not in rows_of(small[:, 30:130, 20:140])


class Read:
    """Pictures that count how often each is read."""

    def __init__(self, pictures):
        self.pictures = pictures
        self.times = Counter()

    def __len__(self):
        return len(self.pictures)

    def __getitem__(self, t):
        self.times[t] += 1
        return self.pictures[t]


def test_a_short_film_is_read_once_and_a_long_one_as_far_as_memory_goes(monkeypatch):
    pictures, _ = moving(25, 1.8, 60.0, 2.0)
    read = Read(pictures)
    recording = kilnflight.open(read)
    read.times.clear()
    found = kilnflight.detect(recording)
    few = prepared.spread(len(pictures), 5)  # have they depth?
    assert read.times == Counter([*range(len(pictures)), *few])
    kept = prepared.Kept(recording)
    kept.frame(0)
    assert pickle.loads(pickle.dumps(kept)).frame.cache_info().currsize == 0
    monkeypatch.setattr(prepared, "KEPT_PX", 3 * pictures[0].size + 1)
    kept = prepared.Kept(recording)
    read.times.clear()
    for t in (0, 1, 2, 0, 3, 0, 1):
        assert (kept.gray(t) == pictures[t]).all()
    assert read.times == {0: 1, 1: 2, 2: 1, 3: 1}
    pd.testing.assert_frame_equal(kilnflight.detect(recording), found)


DARK = {
    "resting": {"drift": (0, 0)},
    "drifting": {},
    "diffusing": {"drift": (0, 0), "diffusion": 1.0},
    "discs": {"kind": "disc", "size": 5},
}


@pytest.mark.parametrize("kind", DARK)
def test_darker_particles_are_asked_about(kind):
    for amplitude in (-60, 60):
        pictures, _ = film(amplitude=amplitude, frames=12, cells=(3, 4), **DARK[kind])
        for dark in (False, True):
            rows = rows_of(pictures, dark=dark)
            warned = str(rows.get("warning"))
            assert ("--dark" in warned) == (dark != (amplitude < 0))
            # no other number of spots than the counts
            counts = re.findall(r"\d+", rows["spots"][0])
            assert {*re.findall(r"(\d+) spots", warned)} <= {*counts}


@pytest.mark.parametrize("shake", [0.0, 1.0, 6.0])
def test_a_ground_that_shakes_is_noticed(shake):
    pictures, _ = film(texture=10, shake=shake, cells=(5, 6))
    assert (shaken_px(kilnflight.open(pictures)) > 0.5) == (shake > 0)


def test_particles_that_swing_together_are_no_ground():
    rng = np.random.default_rng(2)
    start = films.starts(30, (160, 160), 12.0, rng)
    swing = np.sin(0.5 * np.arange(14))[:, None, None] * (0.0, 6.0)
    pictures = films.spots(start + swing, (160, 160), 1.8, 60.0, rng)
    assert shaken_px(kilnflight.open(pictures)) == 0


def test_the_frame_in_which_the_picture_jumps_is_named():
    pictures, _ = film(cells=(5, 6), frames=20, drift=(0, 1), diffusion=0.2)
    still = kilnflight.track(kilnflight.detect(pictures))
    assert not list(doubtful_links(still))
    jumped = [np.roll(each, 12 * (t >= 9), 0) for t, each in enumerate(pictures)]
    with pytest.warns(UserWarning, match="frame 9:"):
        kilnflight.track(kilnflight.detect(jumped))


def test_warnings_above_a_preview_are_not_cut():
    pictures, _ = film(frames=6, kind="rod", size=(16, 4), amplitude=-60)
    figure = kilnflight.preview(pictures)
    png(figure)
    (told,) = figure.texts
    assert len(told.get_text()) > 150
    inside = told.get_window_extent()
    assert inside.x0 >= 0
    assert inside.x1 <= figure.bbox.x1
    assert inside.y1 <= figure.bbox.y1


def test_a_preview_goes_up_to_eight_times_the_threshold():
    pictures, _ = moving(9, 1.8, 60.0, 2.0)
    titles = [axes.get_title() for axes in kilnflight.preview(pictures).axes]
    shown = [re.findall(r"threshold (\S+): (\d+)", each)[0] for each in titles]
    thresholds, counts = np.array(shown, float).reshape(-1, 3, 2).transpose(2, 0, 1)
    np.testing.assert_allclose(
        thresholds[:, 0] / thresholds[1, 0], [0.5, 1, 2, 4, 8], 1e-2
    )
    assert (np.diff(counts, axis=0) <= 0).all()
    assert (counts[1] == 9).all()


@pytest.mark.parametrize(
    ("frames", "workers", "chunk"),
    [
        (3000, 1, 375),  # eight, to show progress
        (3000, 2, 375),
        (3000, 3, 334),  # three each, of at most 500
        (3000, 16, 188),
        (3000, 64, 47),
        (100_000, 64, 391),  # four each
        (70, 8, 32),
        (1, 1, 32),
    ],
)
def test_each_worker_gets_as_many_chunks(frames, workers, chunk):
    found = preparation.chunk_frames(frames, kilnflight.Workers(workers))
    assert found["frames"].tolist() == [chunk]
