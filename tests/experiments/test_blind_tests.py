"""Blind tests of the second look, on tables made by hand."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import blind_tests
from kilnflight.project import claims, paths

MO = next(test for test in blind_tests.TESTS if test.table == "5.9")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Saved tables in which all is as the first twin had it, but one F1 as printed."""
    first = pd.read_csv(paths.reference() / "first_twin_tables.csv", dtype={"table": str})
    rows = [{"R": 100, "subset": "Total"}, {"R": 150, "subset": "Total"}]
    table = pd.DataFrame([*rows, {"R": 100, "subset": "V1"}])
    for quantity in MO.quantities:
        known = first.query("table == '5.9' and quantity == @quantity").set_index("case")
        values = [known.loc[f"R {radius}", "first_twin"] for radius in (100, 150)]
        table[quantity] = [*values, 0.99]
        table[quantity + blind_tests.SUFFIX] = [0.5, 0.5, np.nan]
    table.loc[1, "f1"] = 0.5
    table.to_csv(tmp_path / f"{MO.file}.csv", index=False)
    monkeypatch.setattr(blind_tests, "TESTS", (MO,))
    return tmp_path


def test_ours_stands_beside_print_and_the_first_twin(folder):
    numbers = blind_tests.compare(folder)
    assert numbers["case"].tolist() == ["R 100", "R 150"] * 3  # of the total alone
    assert numbers["nearer"].tolist() == ["alike"] * 5 + ["second look"]
    summary = blind_tests.by_table(numbers).set_index("quantity")
    assert summary["second_look_nearer"].to_dict() == {"precision": 0, "recall": 0, "f1": 1}
    apart = (numbers.loc[4, "first_twin"] - 0.5, numbers.loc[5, "first_twin"] - 0.5)
    assert summary.loc["f1", "first_twin_apart"] == pytest.approx(np.median(np.abs(apart)))
    assert summary.loc["f1", "second_look_apart"] == pytest.approx(abs(apart[0]) / 2)
    clusters = pd.DataFrame({"epsilon_mm": [50.0, 50.0, 70.0], "over_print": [1.0, 2.0, 2.0]})
    words = (
        "Nearer to print than the first twin: 1 of 6 (Table 5.9). Farther in the median: nothing."
    )
    words += " False clusters of DBSCAN over print, median by epsilon: 1.5 at 50 mm, 2.0 at 70 mm."
    assert blind_tests.describe(summary.reset_index(), clusters) == words
    worse = summary.reset_index().assign(second_look_apart=0.5, first_twin_apart=0.25)
    assert "Farther in the median: precision of Table 5.9 (0.250, now 0.500), recall" in (
        blind_tests.describe(worse, clusters)
    )


def test_false_clusters_are_counted_per_labelled_frame():
    """Print: 2436 in 50 frames at 50 mm and 10 points; the saved table is at full scale."""
    table = blind_tests.false_clusters(paths.root() / "figures")
    assert len(table) == len(claims.published("table_5.8"))
    row = table.set_index(["minPts", "epsilon_mm"]).loc[(10, 50)]
    saved = pd.read_csv(paths.root() / "figures" / "table-5-8-dbscan.csv")
    saved = saved[saved["subset"] == "Total"].set_index(["minPts", "epsilon_mm"]).loc[(10, 50)]
    assert row["published"] == pytest.approx(48.72)
    assert row["first_twin"] == pytest.approx(252.78)
    assert row["second_look"] == pytest.approx(saved["fp"] / 50)
    assert row["over_print"] == pytest.approx(saved["fp"] / 2436)
    assert table["first_twin"].notna().all()


def test_what_gets_worse_is_told_and_what_has_no_first_value_is_neither(folder):
    path = folder / f"{MO.file}.csv"
    table = pd.read_csv(path)
    table.loc[0, "f1"], table.loc[1, "R"] = 9.0, 151
    table.to_csv(path, index=False)
    numbers = blind_tests.compare(folder).query("quantity == 'f1'").fillna({"nearer": ""})
    assert numbers["nearer"].tolist() == ["first twin", ""]


def test_every_table_is_drawn(folder):
    numbers = blind_tests.compare(folder)
    numbers.loc[0, "second_look"] = -0.4  # as R2 may be
    picture = blind_tests.draw(numbers)
    assert picture.axes[0].get_title() == "Table 5.9\nprecision, recall, F1"
    assert picture.axes[0].get_ylim()[0] < -0.4
    assert picture.axes[0].get_xlabel() == "published (1)"


def test_a_table_that_was_not_saved_is_an_error(tmp_path):
    with pytest.raises(InputError, match=r"missing; run the notebook of Table 5\.8"):
        blind_tests.compare(tmp_path)


def test_the_first_twins_numbers_are_complete_and_once():
    first = pd.read_csv(paths.reference() / "first_twin_tables.csv", dtype={"table": str})
    assert not first.duplicated(["table", "case", "quantity"]).any()
    clusters = first["quantity"] == blind_tests.FALSE
    assert set(first.loc[clusters, "table"]) == {"5.8"}
    assert clusters.sum() == len(claims.published("table_5.8"))
    first = first[~clusters]
    assert first["first_twin"].between(0, 1).all()
    printed = {"5.8": 30, "5.9": 21, "5.10": 21, "5.11": 30, "5.17": 64, "5.18": 12}
    assert first.groupby("table").size().to_dict() == printed
    for table, fitted in {"5.8": 0, "5.9": 0, "5.10": 0, "5.11": 1}.items():
        assert (len(claims.published(f"table_{table}")) - fitted) * 3 == printed[table]


def test_what_the_light_was_fitted_to_is_no_blind_test():
    """Otsu's row of Table 5.11 is printed as the total of Table 5.5."""
    total = claims.published("table_5.5").set_index("subset").loc["Total"]
    row = claims.published("table_5.11").set_index("method").loc["2D-OTSU"]
    assert total[["precision", "recall"]].tolist() == row[["precision", "recall"]].tolist()
    (test,) = (one for one in blind_tests.TESTS if one.table == "5.11")
    cases = blind_tests.measured(test, paths.root() / "figures")["case"]
    assert "2D-SIFT" in set(cases)
    assert "2D-OTSU" not in set(cases)
