import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.tracklets import Fusion, tracked

T = np.arange(40)


def number(tracks):
    return tracked(Fusion()(tracks))["particle"].nunique()


@pytest.mark.parametrize(
    ("one", "other", "fused"),
    [
        ((T, 5.0 * T, 0.0), (T + 5, 5.0 * T + 25, 8.0), True),  # Fig. 4.15 right
        ((T, 5.0 * T, 0.0), (T + 5, 5.0 * T + 25, 10.0), True),
        ((T, 5.0 * T, 0.0), (T + 5, 5.0 * T + 25, 11.0), False),
        ((T, 5.0 * T, 0.0), (T, 5.0 * T, 3.0), True),  # the same frames
        ((T, 5.0 * T, 0.0), (T[9:20], 5.0 * T[9:20], 3.0), True),  # within
        ((T, 5.0 * T, 0.0), (T + 40, 5.0 * T + 200, 0.0), False),  # no overlap
        ((T[::2], 5.0 * T[::2], 0.0), (T[1::2], 5.0 * T[1::2], 0.0), False),  # none in common
    ],
)
def test_what_runs_side_by_side_is_fused(table, one, other, fused):
    assert number(table(one, other)) == (1 if fused else 2)


def test_fused_places_are_means_and_three_become_one(table):
    result = Fusion()(table(*((T, 5.0 * T, col) for col in (0.0, 2.0, 7.0))))
    assert (tracked(result)["col"] == (1.0 + 7.0) / 2).all()  # of the cheapest pair, then the third
    assert (result["particle"] == -1).sum() == 80


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_it_is_the_plain_definition(table, plain, same_tracks, seed):
    rng = np.random.default_rng(seed)
    tracklets = []
    for _ in range(6):
        frame = np.arange(*np.sort(rng.choice(30, 2, replace=False)))
        row, col = 6.0 * frame + rng.normal(0, 4, (2, len(frame)))
        tracklets.append((frame, row, col, rng.normal(3000, 500, len(frame))))
    tracks = table(*tracklets)
    same_tracks(Fusion()(tracks), plain.join(plain.tracklets_of(tracks), fusion=True))


def test_what_is_no_limit_is_refused():
    for bad in (-1.0, np.nan, "a", None):
        with pytest.raises(InputError, match="Fusion: distance: must be 0 or above"):
            Fusion(distance=bad)
