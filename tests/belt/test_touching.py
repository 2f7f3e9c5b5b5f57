import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.touching import place_errors, seen_together
from kilnflight.checks import InputError

SPOTS = pd.DataFrame(
    {
        "frame": [0, 0, 1, 1, 2],
        "x": [400.0, 450.0, 405.0, 455.0, 410.0],
        "y": [90.0, 50.0, 90.0, 50.0, 90.0],
        "touching": [0, 0, 1, 0, 0],
    }
)


def truth(*rows):
    return pd.DataFrame(rows, columns=["frame", "particle", "x", "y"])


def test_who_shares_a_spot_in_any_frame_is_told():
    apart = [(0, 3, 400.0, 90.0), (2, 3, 410.0, 90.0), (0, 8, 450.0, 50.0)]
    together = [(1, 3, 405.0, 92.5), (1, 5, 405.0, 87.5), (1, 8, 455.0, 50.0)]
    table = truth(*apart, *together)
    np.testing.assert_array_equal(seen_together(SPOTS, table), [3, 5])
    mixed = table.sample(frac=1.0, random_state=1)
    np.testing.assert_array_equal(seen_together(SPOTS, mixed), [3, 5])
    assert len(seen_together(SPOTS, truth(*apart))) == 0


def test_other_frames_and_places_do_not_count():
    assert len(seen_together(SPOTS, truth((7, 1, 405.0, 90.0)))) == 0  # no spot in that frame
    assert len(seen_together(SPOTS, truth((1, 1, 405.0, 300.0)))) == 0  # beside the belt


def test_nothing_gives_nobody_and_a_missing_column_is_told():
    assert len(seen_together(SPOTS[:0], truth((1, 1, 405.0, 90.0)))) == 0
    assert len(seen_together(SPOTS, truth())) == 0
    with pytest.raises(InputError, match="touching"):
        seen_together(SPOTS.drop(columns="touching"), truth())


def test_errors_of_places_are_those_of_single_spots():
    """Spots 0.3 mm too far along and 0.1 mm across, give or take 0.4 mm; the marked one is off."""
    off = np.array([0.4, -0.4, 50.0, 0.4, -0.4])
    known = SPOTS.assign(x=SPOTS["x"] - 0.3 - off, y=SPOTS["y"] - 0.1).drop(columns="touching")
    found = place_errors(SPOTS, known.sample(frac=1.0, random_state=1))
    assert found["bias_along_mm"] == pytest.approx(0.3)
    assert found["rms_along_mm"] == pytest.approx(0.5)  # root of 0.3^2 + 0.4^2
    assert found["bias_across_mm"] == pytest.approx(0.1)
    assert found["rms_across_mm"] == pytest.approx(0.1)
    less = place_errors(SPOTS, known[known["frame"] < 2])  # frame 2 has no truth
    assert less["bias_along_mm"] == pytest.approx(0.3 + 0.4 / 3)


def test_without_spots_there_is_no_error_to_tell():
    for spots in (SPOTS[:0], SPOTS.assign(touching=1), SPOTS.assign(frame=9)):
        assert np.isnan(list(place_errors(spots, SPOTS).values())).all()
    with pytest.raises(InputError, match="touching"):
        place_errors(SPOTS.drop(columns="touching"), SPOTS)
