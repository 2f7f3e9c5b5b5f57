import numpy as np
import pytest
from PIL import Image

from kilnflight.checks import InputError
from kilnflight.experiments import twin_film


@pytest.fixture(scope="module")
def twin(kept_scene):
    return kept_scene("V3@small")


def test_a_film_shows_the_frames_in_order(twin, tmp_path):
    path = tmp_path / "film.gif"
    size = twin_film.write_film(twin, path, 70, frames=4)
    assert size == path.stat().st_size < twin_film.LARGEST_BYTES
    with Image.open(path) as film:
        assert film.n_frames == 4
        assert film.info["loop"] == 0
        for k in range(4):
            film.seek(k)
            shown = np.asarray(film.convert("L"), dtype=float)
            small = np.asarray(twin_film._shown(twin.gray(70 + k)).convert("L"), dtype=float)
            assert np.abs(shown - small).max() <= 1
    again = tmp_path / "again.gif"
    twin_film.write_film(twin, again, 70, frames=4)
    assert again.read_bytes() == path.read_bytes()


def test_fractions_are_drawn_with_what_is_visible(twin):
    picture, table = twin_film.draw_fractions({"mixed": twin})
    t = twin_film.busiest(twin)
    assert table["frame"].unique().tolist() == [t]
    assert table["fraction"].unique().tolist() == ["mixed"]
    assert len(picture.axes) == 2
    assert picture.axes[0].get_title() == f"mixed, frame {t}"


def test_films_that_cannot_be_are_refused(twin, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="frames"):
        twin_film.write_film(twin, tmp_path / "none.gif", 70, frames=0)
    with pytest.raises(InputError):
        twin_film.write_film(twin, tmp_path / "long.gif", len(twin) - 1, frames=2)
    monkeypatch.setattr(twin_film, "LARGEST_BYTES", 1000)
    with pytest.raises(InputError, match="ask for fewer"):
        twin_film.write_film(twin, tmp_path / "large.gif", 70, frames=2)
    assert not list(tmp_path.iterdir())
