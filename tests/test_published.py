"""What stands in figures/ and README.md is of one cast (make check; not part of make test)."""

from pathlib import Path

import pandas as pd
import pytest
from PIL import Image

from kilnflight.project import claims, figures, site

PROJECT = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.published


@pytest.fixture
def published(monkeypatch):
    """The tracked figures."""
    monkeypatch.setenv("KILNFLIGHT_FIGURES", str(PROJECT / "figures"))
    return PROJECT / "figures"


def test_every_figure_comes_from_make_full_and_a_clean_tree(published):
    found = figures.entries(published)
    assert found, "figures/ is empty; run make full"
    for entry in found:
        hint = f"{entry.identifier}: run make full (or git checkout figures README.md)"
        assert entry.provenance["parameters"]["scale"] == "full", hint
        assert "+changes" not in entry.provenance["commit"], hint


def test_every_picture_has_its_table_and_the_gallery_shows_it(published):
    for path in published.glob("*.png"):
        assert path.with_suffix(".csv").is_file(), path.name
    assert (published / "README.md").read_text() == figures.gallery(published)


def test_no_file_is_large_and_no_two_pictures_show_the_same(published):
    seen = {}
    for path in sorted(published.glob("*.png")):
        assert path.stat().st_size <= figures.LARGEST_PNG, path.name
        if not figures.is_empty(published, path.stem):
            with Image.open(path) as image:
                pixels = image.size, image.convert("RGB").tobytes()
            assert seen.setdefault(hash(pixels), path.name) == path.name


def test_every_picture_says_inside_what_its_data_are(published):
    for entry in figures.entries(published):
        if not entry.provenance["notebook"].startswith(("00_claims", "benchmarks")):
            mark = entry.provenance.get("mark")
            assert mark in {"simulated", "example", "recorded"}, f"{entry.identifier}: {mark}"


def test_no_table_holds_an_impossible_number(published):
    assert figures.absurdities(published) == []


def test_every_saved_table_of_the_thesis_has_published_values_beside_ours(published):
    # Table 5.4 lists what is used, as printed; Table 5.7 names the print in its own words.
    printed = {"table-5-4-parameters": "window", "table-5-7-sift-time": "computation_time_s"}
    for path in sorted(published.glob("table-[0-9]-*.csv")):
        columns = list(pd.read_csv(path))
        if path.stem == "table-5-2-ground-truth":  # rows
            assert "published" in set(pd.read_csv(path)["source"])
        elif path.stem in printed:
            assert printed[path.stem] in columns
        else:
            assert any("published" in name or name == "printed" for name in columns), path.name


def test_the_claims_are_those_of_the_notebooks(published):
    tables = [pd.read_csv(path) for path in figures.concluded(published).values()]
    collected = claims.collect(tables)
    shown = pd.read_csv(published / "claims.csv", keep_default_na=False)
    pd.testing.assert_frame_equal(shown, collected, check_dtype=False)


def test_what_is_not_reproduced_says_because_of_what(published):
    shown = pd.read_csv(published / "claims.csv", keep_default_na=False)
    hint = "pass because= or truth= to claims.judge, because= to claims.undecidable"
    assert claims.without_cause(shown) == [], hint


def test_the_readme_shows_the_results(published):
    assert site.results_block() in (PROJECT / "README.md").read_text()


def test_the_belt_results_are_those_on_the_authors_data(published):
    table = pd.read_csv(published / "belt-arrival.csv")
    hint = "run make full where the authors' data are (make data, or KILNFLIGHT_EXTERNAL)"
    assert "authors-dem" in set(table["source"]), hint


def test_the_limits_state_the_latency_of_the_benchmark(published):
    text = " ".join((PROJECT / "docs" / "limits.md").read_text().split())
    table = pd.read_csv(published / "benchmark-belt-online.csv").set_index(["way", "clock"])
    whole, split = (table.loc[f"whole, {way}", "elapsed"] for way in ("as published", "split"))
    assert (
        f"{whole.median_ms:.1f} ms in the median and {whole.q999_ms:.1f} ms in 99.9 % of the frames"
        in text
    )
    assert f"{whole.late:.0f} of {whole.frames:,.0f} is late" in text
    assert f"worst takes {split.worst_ms:.0f} ms and {split.late:.0f} are late" in text
