import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.checks import InputError
from kilnflight.scores import rates

counts = st.integers(0, 10_000)


@given(counts, counts, counts)
def test_rates_are_their_definitions(tp, fp, fn):
    precision = tp / (tp + fp) if tp + fp else 0.0
    recall = tp / (tp + fn) if tp + fn else 0.0
    both = precision + recall
    f1 = 2 * precision * recall / both if both else 0.0
    assert rates(tp, fp, fn).loc[0].tolist() == pytest.approx([precision, recall, f1])


def test_rates_of_many_stand_one_per_row():
    table = rates([3256, 0], [76, 5], [1131, 7])
    assert table["f1"].round(4).tolist() == [0.8436, 0.0]


@pytest.mark.parametrize("bad", [-1, np.nan])
def test_counts_must_be_counts(bad):
    with pytest.raises(InputError, match="counts"):
        rates(bad, 1, 1)
