"""Motion, spreading and warnings of tracks whose steps are known."""

import numpy as np
import pandas as pd
import pytest
from tests.definitions.films import film

import kilnflight
from kilnflight.checks import InputError
from kilnflight.film.doubts import doubtful_links
from kilnflight.film.motion import motion_of
from kilnflight.film.spreading import (
    fit_spreading,
    speeds,
    square_displacements,
)

WALK = 0.5  # D of a walk, px^2 a frame


def walks(
    count=60,
    frames=80,
    drift=(0.3, -1.0),
    diffusing=WALK,
    error=0.0,
    apart=90.0,
    draws=1,
    seen=1.0,
):
    """Random walks on a grid, with a common drift and an error of each position
    (px). Draws follow each other after a pause; a share of the positions is seen.
    """
    rng = np.random.default_rng(3)
    size = (draws, frames, count, 2)
    places = rng.normal(drift, np.sqrt(2 * diffusing), size).cumsum(axis=1)
    places += apart * np.stack(np.divmod(np.arange(count), 10), axis=1)
    places += rng.normal(0, error, places.shape)
    draw, frame, particle = np.indices(size[:3]).reshape(3, -1)
    row, col = places.reshape(-1, 2).T
    table = pd.DataFrame({"frame": frame + 2 * frames * draw})
    table = table.assign(particle=particle + count * draw, row=row, col=col)
    return table[rng.random(len(table)) < seen]


@pytest.mark.parametrize("error", [0.0, 1.0])
def test_diffusion_is_recovered_without_the_drift(error):
    tracks = walks(error=error).sample(frac=1, random_state=0)
    holes = tracks[tracks["frame"] % 7 != 3]  # a gap takes no displacement off
    for table in (tracks, holes):
        found, square = fit_spreading(square_displacements(table))[:2]
        assert found == pytest.approx(WALK, rel=0.1)
        assert square == pytest.approx(error**2, abs=0.2)
    for few in (
        tracks.head(0),
        pd.DataFrame({"frame": [3, 10**9], "particle": 0, "row": 0, "col": 0}),
    ):
        assert square_displacements(few).empty
        with pytest.raises(InputError):
            fit_spreading(square_displacements(few))


@pytest.mark.parametrize("count", [2, 5, 10, 100])
@pytest.mark.parametrize("drift", [(0.0, 0.0), (0.3, -1.0)])
@pytest.mark.parametrize("seen", [1.0, 0.7])
def test_diffusion_of_few_particles_is_right_within_5_percent(count, drift, seen):
    """One draw of 5 particles scatters by 12 %: enough draws are taken together."""
    draws = 300 // count
    tracks = walks(count, 60, drift, draws=draws, seen=seen)
    fit = fit_spreading(square_displacements(tracks))
    assert fit.diffusion == pytest.approx(WALK, rel=0.05)
    assert abs(fit.diffusion - WALK) < 3 * fit.diffusion_error < 0.1
    assert fit.exponent == pytest.approx(1.0, abs=0.1)
    assert fit.position_error_px2 == pytest.approx(0.0, abs=0.05)


def test_the_errors_are_the_scatter_between_walks():
    """Pairs overlap: the error of a lag grows faster than its pairs get fewer."""
    each = square_displacements(walks(300, 60, error=0.5), each=True)
    for lag in (1, 4, 12):
        one = each[each["lag"] == lag]
        assert len(one) == 300
        assert one["pairs"].eq(60 - lag).all()
        assert one["error_px2"].mean() == pytest.approx(
            one["square_px2"].std(), rel=0.2
        )
    fits = [fit_spreading(one) for _, one in each.groupby("particle")]
    found = pd.DataFrame(fits)
    assert found["diffusion"].mean() == pytest.approx(WALK, rel=0.05)
    scatter = found["diffusion"].std()
    assert found["diffusion_error"].mean() == pytest.approx(scatter, rel=0.25)
    assert found["position_error_px2"].mean() == pytest.approx(0.25, abs=0.05)


def test_the_exponent_is_that_of_the_motion_and_not_of_the_error():
    noisy = square_displacements(walks(200, 60, error=1.0))
    assert fit_spreading(noisy).exponent == pytest.approx(1.0, abs=0.1)
    rng = np.random.default_rng(0)
    flight = walks(200, 60, diffusing=0.0, error=0.1)
    speed = rng.normal(size=(200, 2))[flight["particle"]]
    flight[["row", "col"]] += speed * flight[["frame"]].to_numpy()
    assert fit_spreading(square_displacements(flight)).exponent == pytest.approx(
        2, abs=0.001
    )
    resting = fit_spreading(square_displacements(walks(9, 60, diffusing=0, error=0.1)))
    assert np.isnan(resting.exponent)
    assert abs(resting.diffusion) < 2 * resting.diffusion_error


def test_pairs_count_by_their_own_lag_and_a_lone_particle_keeps_its_drift():
    frame = np.arange(0, 82, 2)
    lone = pd.DataFrame({"frame": frame, "particle": 5, "row": 1.0, "col": 3.0 * frame})
    false = pd.DataFrame({"frame": [8, 10], "particle": 7, "row": 40.0, "col": 9.0})
    for table in (lone, pd.concat([lone, false, false.assign(particle=-1)])):
        found = square_displacements(table, each=True)
        assert found["particle"].eq(5).all()
        assert found["lag"].tolist() == [2, 4, 6, 8, 10]
        assert found["square_px2"].tolist() == [9.0 * lag**2 for lag in found["lag"]]
        assert found["pairs"].tolist() == [40, 39, 38, 37, 36]
    both = pd.concat([lone, lone.assign(particle=6, row=70.0)])
    assert square_displacements(both)["square_px2"].eq(0).all()
    kept = square_displacements(both, drift=False)["square_px2"]
    assert kept.tolist() == found["square_px2"].tolist()


@pytest.mark.filterwarnings("ignore")  # trackpy's own
def test_without_drift_the_means_are_those_of_trackpy():
    trackpy = pytest.importorskip("trackpy")
    tracks = walks(5, 60)
    theirs = tracks.rename(columns={"row": "y", "col": "x"})
    expected = trackpy.emsd(theirs, mpp=1, fps=1, max_lagtime=15)
    found = square_displacements(tracks, drift=False)
    np.testing.assert_allclose(found["square_px2"], expected, rtol=1e-9)
    # with its drift taken off, its squares are a fifth too small: a mean of 5 has part
    # of each
    still = trackpy.subtract_drift(theirs.set_index("frame", drop=False)).droplevel(0)
    lost = trackpy.emsd(still, mpp=1, fps=1, max_lagtime=15)
    found = square_displacements(tracks)
    np.testing.assert_allclose(0.8 * found["square_px2"], lost, rtol=1e-9)


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


@pytest.mark.parametrize("wrong", ["no", "", 0, 1.0, None, [True]], ids=str)
@pytest.mark.parametrize("name", ["each", "drift"])
def test_yes_and_no_are_no_words_or_numbers(name, wrong):
    with pytest.raises(InputError, match=name):
        square_displacements(walks(2, 9), **{name: wrong})


@pytest.mark.parametrize("lags", [-1, 0, 2, 3.5, np.nan, "4", None, True])
def test_lags_are_counted(lags):
    displacements = square_displacements(walks(9, 40))
    assert fit_spreading(displacements, 99) == fit_spreading(displacements, 10.0)
    with pytest.raises(InputError, match="lags"):
        fit_spreading(displacements, lags)


def test_diffusion_of_a_film_is_that_of_its_walks():
    """A median over slow particles would push their positions away from its own."""
    pictures, truth = film(
        diffusion=0.1, frames=60, drift=(0.0, 0.0), pitch=32, noise=3.0
    )
    tracks = kilnflight.track(kilnflight.detect(pictures))
    right, found = (
        fit_spreading(square_displacements(each)).diffusion for each in (truth, tracks)
    )
    assert found == pytest.approx(right, rel=0.05)


def test_a_rare_turn_widens_the_gate_and_a_usual_one_does_not():
    frame = np.arange(200)
    rng = np.random.default_rng(5)
    noise = rng.normal(0, 0.05, (2, 200))
    col = np.where(frame < 100, 2.0 * frame, 398.0 - 2.0 * frame)
    usual, rare = (
        motion_of(pd.DataFrame({"frame": frame, "row": noise[0], "col": along}))
        for along in (2.0 * frame + noise[1], col + noise[1])
    )
    assert usual.noise < 0.2
    assert 4 * rare.noise > 2.0  # gate of four deviations, turns of 2 px
