"""Motion, spreading and warnings of tracks whose steps are known."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.film.doubts import doubtful_links
from kilnflight.film.motion import motion_of
from kilnflight.film.spreading import diffusion, speeds, square_displacements


def walks(count=60, frames=80, drift=(0.3, -1.0), diffusing=0.5, error=0.0, apart=90.0):
    """Random walks on a grid, with a common drift and an error of each position
    (px).
    """
    rng = np.random.default_rng(3)
    places = rng.normal(drift, np.sqrt(2 * diffusing), (frames, count, 2)).cumsum(
        axis=0
    )
    places += apart * np.stack(np.divmod(np.arange(count), 10), axis=1)
    places += rng.normal(0, error, places.shape)
    frame, particle = np.divmod(np.arange(frames * count), count)
    row, col = places.reshape(-1, 2).T
    return pd.DataFrame({"frame": frame, "particle": particle, "row": row, "col": col})


@pytest.mark.parametrize("error", [0.0, 1.0])
def test_diffusion_is_recovered_without_the_drift(error):
    tracks = walks(error=error).sample(frac=1, random_state=0)
    holes = tracks[tracks["frame"] % 7 != 3]  # a gap takes no displacement off
    for table in (tracks, holes):
        found, square = diffusion(square_displacements(table))
        assert found == pytest.approx(0.5, rel=0.1)
        assert square == pytest.approx(error**2, abs=0.2)
    for few in (
        tracks.head(0),
        pd.DataFrame({"frame": [3, 10**9], "particle": 0, "row": 0, "col": 0}),
    ):
        assert square_displacements(few).empty


def test_speeds_are_steps_by_frames():
    table = pd.DataFrame(
        {"particle": [1, 0, 0], "frame": [0, 2, 0], "row": 0.0, "col": 0.0}
    )
    assert speeds(table.assign(row=[0.0, 4.0, 1.0], col=[0.0, 7.0, 3.0])).tolist() == [
        2.5
    ]


def test_the_motion_of_detections_is_that_of_their_links():
    table = walks(drift=(2.0, 9.0), diffusing=0.125).drop(columns="particle")
    motion = motion_of(table)
    assert motion.velocity == pytest.approx((2, 9), abs=0.1)
    # Steps do not depend on each other: no step tells of the next one's velocity.
    assert motion.noise == pytest.approx(0.5, rel=0.1)
    assert motion.spreads[1] < 0.01 * motion.noise
    assert motion_of(table, max_step=12.0).noise == pytest.approx(3)
    with pytest.raises(InputError, match="max_step"):
        motion_of(table, max_step=0)
    for few in (table.head(0), table.head(1), table[table["frame"] % 2 == 0]):
        assert motion_of(few).velocity == (0, 0)


def test_doubtful_links_are_warned_about():
    tracks = walks(count=20, drift=(0.0, 3.0))
    assert not list(doubtful_links(tracks))
    lost = tracks.assign(particle=tracks["particle"].where(tracks["particle"] < 9, -1))
    crowd = walks(count=20, drift=(0.0, 3.0), apart=5.0)
    cases = ((lost, "720 of 1600"), (crowd, "neighbours"), (tracks.head(0), "detected"))
    for table, named in cases:
        (warning,) = doubtful_links(table)
        assert named in warning
