import numpy as np
import pytest

from kilnflight.checks import (
    InputError,
    check_number,
)


@pytest.mark.parametrize(
    "value", [0.0, 1.0, 1.5, -1, True, "0.5", None, np.nan, np.inf, 10**400]
)
def test_what_is_no_number_within_the_limits_is_refused(value):
    with pytest.raises(InputError, match="share: "):
        check_number(value, "share", above=0, below=1)


def test_limits_may_be_allowed_and_whole_numbers_asked_for():
    check_number(0.5, "share", above=0, below=1)
    check_number(1, "share", least=1, most=1)
    check_number(np.int64(2), "count", least=1, whole=True)
    check_number(2.0, "count", least=1, whole=True)
    for value in (2.5, 0, True):
        with pytest.raises(InputError, match="count: "):
            check_number(value, "count", least=1, whole=True)
