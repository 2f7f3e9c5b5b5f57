"""Space-sliced velocities of polynomials with known crossings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilnflight.flight import reaching, slices, space_sliced_velocity
from kilnflight.tables import SLICES


@given(
    st.floats(3_000.0, 20_000.0),  # mm/s
    st.floats(-30_000.0, 30_000.0),
    st.floats(-60_000.0, 60_000.0),
    st.floats(-5.0, 5.0),
    st.sampled_from([0.3, 1.0, 2.0]),
)
def test_the_times_are_those_of_dense_sampling(
    polynomials, speed, bend, third, start, slice_m
):
    fit = polynomials(((), (), (-speed, bend, third)), start, start, start + 0.4)
    table = space_sliced_velocity(fit, slice_m)
    front = table[table["slice_m"] > 0]
    marks = slice_m * np.arange(1, int(6.5 / slice_m) + 1)
    assert front["slice_m"].tolist() == marks.tolist()
    time = np.linspace(start, start + 0.4, 4001)
    gone = (fit.exit_point_mm[2] - fit(time)[:, 2]) / 1000
    expected = [
        time[np.argmax(gone >= far)] for far in marks if gone.max() >= far + 1e-9
    ]
    ends = front.loc[front["reached"], "end_s"].to_numpy()
    assert len(ends) - len(expected) in (
        0,
        1,
    )  # a turn between two samples may be missed
    assert (np.abs(ends[: len(expected)] - expected) <= 1.01e-4).all()
    velocity = front["velocity_m_s"].to_numpy()
    np.testing.assert_allclose(velocity[: len(ends)], slice_m / np.diff([start, *ends]))
    assert np.isnan(velocity[len(ends) :]).all()


def test_slices_behind_the_lance_have_negative_velocities(polynomials):
    backwards = polynomials(((), (), (5_000.0, 0.0)), last_s=0.5)
    table = space_sliced_velocity(backwards)
    assert list(table["slice_m"]) == [-2.0, -1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert list(table["reached"]) == 2 * [True] + 6 * [False]
    np.testing.assert_allclose(table["velocity_m_s"][:2], -5.0)


def test_only_the_observed_span_counts(polynomials):
    fit = polynomials(((), (), (-10_000.0,)), first_s=0.15, last_s=0.25)
    table = space_sliced_velocity(fit)
    assert list(table["reached"]) == 2 * [True] + 4 * [False]
    assert list(table["observed"]) == [False, True, False, False, False, False]
    assert space_sliced_velocity(fit, until_s=0.15)["reached"].sum() == 1
    assert space_sliced_velocity(fit, until_s=9.0)["reached"].sum() == 2
    assert not space_sliced_velocity(polynomials(((), (), (0.0, 0.0))))["reached"].any()


def test_many_flights_and_their_share_in_each_slice(polynomials):
    fits = {
        4: polynomials(((), (), (-10_000.0,)), last_s=0.35),
        9: polynomials(((), (), (-5_000.0,))),
        2: polynomials(((), (), (3_000.0,))),  # backwards
    }
    table = slices(fits)
    assert list(table["particle"]) == [4, 4, 4, 9, 9, 2]
    left = reaching(table, 4).set_index("slice_m")
    assert dict(left["number"]) == {-1.0: 1, 1.0: 2, 2.0: 2, 3.0: 1}
    assert dict(left["share"]) == {-1.0: 0.25, 1.0: 0.5, 2.0: 0.5, 3.0: 0.25}
    assert left["median_m_s"][1.0] == pytest.approx(7.5)
    assert len(slices(fits, {4: 0.15, 9: 9.0})) == 4
    assert list(slices({}).columns) == SLICES.names
    assert len(reaching(slices({}), 0)) == 0
