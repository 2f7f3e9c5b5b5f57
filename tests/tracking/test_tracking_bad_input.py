"""What a table of detections can hold that it should not, or that is rare."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.association import GNN
from kilnflight.checks import InputError
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.motion import ConstantVelocity
from kilnflight.tracking.tracker import Management, track


def table(**columns):
    return pd.DataFrame({"frame": [0, 1, 2], "row": [1.0, 2, 3], "col": [4.0, 5, 6], **columns})


def test_a_position_that_is_invalid_is_refused_with_its_row():
    with pytest.raises(InputError, match="column col is not finite in row 1"):
        track(table(col=[1.0, np.nan, 2.0]))
    with pytest.raises(InputError, match="column row is not finite in row b"):
        track(table(row=[1.0, np.inf, 2.0]).set_index(pd.Index(["a", "b", "c"])))


def test_columns_that_are_missing_are_refused():
    with pytest.raises(InputError, match=r"column\(s\) row, col missing"):
        track(pd.DataFrame({"frame": [1]}))
    with pytest.raises(InputError, match=r"column\(s\) frame missing"):
        track(pd.DataFrame({"row": [], "col": []}))
    with pytest.raises(InputError, match="ndarray is no table"):
        track(np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([0.0, 0.5, 2.0], "column frame: 0.5 in row 1 is no whole number"),
        ([0.0, np.nan, 2.0], "column frame holds float64 with gaps"),
        ([0.0, np.inf, 2.0], "column frame: 1 value.* not finite"),
        ([0.0, 1e300, 2.0], "column frame: 1e[+]300 in row 1"),
        (["0", "1", "2"], "column frame holds"),
        ([True, False, True], "column frame holds bool"),
        (pd.to_datetime(["2023", "2024", "2025"]), "column frame holds datetime64"),
    ],
)
def test_frames_that_are_no_integers_are_refused(frames, message):
    with pytest.raises(InputError, match=message):
        track(table(frame=frames))


def test_whole_frames_may_be_held_as_floats():
    """As a CSV gives them that had a gap; the column comes back as it was."""
    result = track(table(frame=[0.0, 1.0, 2.0], particle=[np.nan, 4.0, -1.0]))
    assert result["particle"].tolist() == [0, 0, -1]
    assert result["frame"].tolist() == [0.0, 1.0, 2.0]
    assert result["frame"].dtype == float
    twice = pd.array([0, 1, 2], dtype="Int64")
    result = track(table(frame=twice, particle=pd.array([1, None, -1], dtype="Int64")))
    assert result["particle"].tolist() == [0, 0, -1]


@pytest.mark.parametrize("bad", [None, [1, 2], {"frame": [1]}, "table"])
def test_an_argument_that_is_no_table_is_refused(bad):
    with pytest.raises(InputError, match="is no table"):
        track(bad)


@pytest.mark.parametrize("name", ["frame", "row", "z", "points", "particle"])
def test_a_column_that_is_there_twice_is_refused(name):
    whole = table(z=1.0, points=2, particle=0)
    with pytest.raises(InputError, match=f"more than one column {name}"):
        track(pd.concat([whole, whole[[name]]], axis=1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"row": [1j, 2, 3]}, "column row holds complex128"),
        ({"z": [1j, 2, 3]}, "column z is not made of numbers"),
        ({"z": pd.to_datetime(["2023", "2024", "2025"])}, "column z is not made of numbers"),
        ({"z": [True, False, True]}, "column z is not made of numbers"),
    ],
)
def test_a_column_without_real_numbers_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        track(table(**change))


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((GNN,), "associator: GNN is a class; pass an instance"),
        ((None,), "associator: None cannot be used"),
        (("GNN",), "associator: 'GNN' cannot be used"),
        ((GNN(), ConstantVelocity), "motion: ConstantVelocity is a class"),
        ((GNN(), GNN()), "motion: .* has no transition"),
        ((GNN(), ConstantVelocity(), 4.0), "gate: 4.0 cannot be used"),
        ((GNN(), ConstantVelocity(), Gate(), Management), "management: Management is a class"),
    ],
)
def test_parts_that_are_invalid_are_refused(parts, message):
    with pytest.raises(InputError, match=message):
        track(table(), *parts)


def test_depth_that_is_invalid_is_refused():
    with pytest.raises(InputError, match="z is infinite in row 2"):
        track(table(z=[1.0, np.nan, np.inf]))
    with pytest.raises(InputError, match="column points is not made of numbers"):
        track(table(points=["few", "many", "none"]))


def test_missing_numbers_of_pandas_are_taken():
    result = track(table(points=pd.array([3, None, 4], dtype="Int64"), z=[1.0, np.nan, 2.0]))
    assert result["particle"].tolist() == [0, 0, 0]


def test_two_detections_at_one_point_are_two_tracks():
    """Rows that are the same in everything, as a detector gives them that finds one twice."""
    twice = pd.concat([table(), table()])
    result = track(twice)
    assert result.groupby("particle").size().tolist() == [3, 3]
    assert not result.duplicated(["frame", "particle"]).any()


def test_a_track_that_starts_in_the_last_frame_is_a_track_of_one():
    late = pd.DataFrame({"frame": [2], "row": [900.0], "col": [900.0]})
    result = track(pd.concat([table(), late], ignore_index=True))
    assert result["particle"].tolist() == [0, 0, 0, 1]


def test_one_detection_is_one_track():
    assert track(table()[1:2])["particle"].tolist() == [0]


def test_rows_that_are_in_no_track_stay_out_of_all():
    """An input that asks for it: -1. Other particles are those of an earlier run."""
    result = track(table(particle=[7, -1, 7]))
    assert result["particle"].tolist() == [0, -1, 0]


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"visibility": 1.5}, "visibility: must be 0 to 1"),
        ({"visibility": np.nan}, "visibility: must be 0 to 1"),
        ({"visibility": "0.4"}, "visibility: must be 0 to 1"),
        ({"invisible": -1}, "invisible: must be a whole number from 0"),
        ({"invisible": 2.5}, "invisible: must be a whole number from 0"),
        ({"invisible": None}, "invisible: must be a whole number from 0"),
        ({"visibility_age": -1}, "visibility_age: must be a whole number from 0"),
    ],
)
def test_management_that_is_invalid_is_refused(bad, message):
    with pytest.raises(InputError, match=message):
        Management(**bad)
