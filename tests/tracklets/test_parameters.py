"""The defaults of the post-processing are those of Table 5.16."""

import pytest

from kilnflight import tracklets
from kilnflight.project import claims


def test_the_defaults_are_the_printed_values_in_their_order():
    said = claims.published("table_5.16", as_printed=True)["value"].tolist()
    printed = [1e11 if value == "$10^{11}$" else float(value) for value in said]
    assert list(tracklets.parameters().values()) == pytest.approx(printed)
