import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.touching import seen_together
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
