import pandas as pd
import pytest

from kilnflight.belt.sampling import thinned
from kilnflight.checks import InputError


def test_every_tenth_frame_stays_with_its_time():
    tracks = pd.DataFrame({"frame": range(7, 35), "time_s": [k / 1000 for k in range(7, 35)]})
    less = thinned(tracks, 10)
    assert less["frame"].tolist() == [1, 2, 3]
    assert less["time_s"].tolist() == [0.01, 0.02, 0.03]
    pd.testing.assert_frame_equal(thinned(tracks, 1), tracks)


def test_no_rate_is_told():
    with pytest.raises(InputError, match="every"):
        thinned(pd.DataFrame({"frame": [1]}), 0)
