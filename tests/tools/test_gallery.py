"""Films of eight kinds with known truth, and how runs on them are scored."""

import numpy as np
import pandas as pd
import pytest
from tools import films, gallery


@pytest.mark.parametrize("kind", films.KINDS)
def test_a_film_shows_its_truth(kind):
    film = films.made(kind)
    sign = -1.0 if film.options.get("dark") else 1.0
    light = sign * film.pictures.astype(float)
    frames, rows, cols = light.shape
    assert film.truth["frame"].between(0, frames - 1).all()
    places = film.truth[["row", "col"]].round().astype(int).to_numpy()
    assert (places >= 0).all()
    assert (places < (rows, cols)).all()
    at = light[film.truth["frame"], places[:, 0], places[:, 1]]
    ground = np.median(light, axis=(1, 2))[film.truth["frame"]]
    assert np.mean(at > ground) > 0.95
    assert not film.truth.duplicated(["frame", "particle"]).any()
    np.testing.assert_array_equal(films.made(kind).pictures, film.pictures)
    assert (films.made(kind, seed=1).pictures != film.pictures).any()


def test_a_spot_has_its_light_and_its_place():
    picture = np.zeros((40, 40))
    films.spot(picture, np.array([20.3, 15.8]), sigma=2.0, light=9.0)
    assert picture.sum() == pytest.approx(9.0 * 2 * np.pi * 2.0**2, rel=1e-5)
    row, col = np.indices(picture.shape)
    middle = [(picture * each).sum() / picture.sum() for each in (row, col)]
    np.testing.assert_allclose(middle, [20.3, 15.8], atol=1e-5)


def test_recall_precision_and_links_are_those_of_a_hand_made_film():
    frame = np.arange(5)
    truth = pd.DataFrame(
        {"frame": frame, "particle": 0, "row": 9.0, "col": 5.0 + frame}
    )
    film = films.Film(np.zeros((5, 20, 20)), truth, "", {})
    tracks = truth.assign(particle=[3, 3, 4, 4, 4])  # one of four links is broken
    false = tracks.head(1).assign(row=15.0, particle=-1)
    row = gallery.scored(film, pd.concat([tracks, false]))
    assert row == {"recall": 1.0, "precision": 5 / 6, "links": 0.75}
    row = gallery.scored(film, tracks[tracks["frame"] != 2])
    assert row == {"recall": 0.8, "precision": 1.0, "links": 0.5}
