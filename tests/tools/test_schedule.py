"""Which notebooks run, in what order, with a stand-in that only writes down its
call.
"""

import sys
from pathlib import Path

import pytest
from tools import schedule

STAND_IN = """#!/bin/sh
stem=$(basename "$2" .py)
echo "$stem $*" >> asked
[ -e "fail-$stem" ] && exit 7
mkdir -p "$4" && touch "$4/$stem.ipynb" "$stem.csv"
echo "$PWD/$stem.csv" > "$4/$stem.saved"
"""
STEMS = ["00_claims", "02_one", "26_two"]
CAMPAIGNS = ["23_compiles", "45_belt", "50_campaigns", "52_late", "60_early"]


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A folder with three notebooks, in which nothing has run."""
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "data" / "reference").mkdir(parents=True)
    (tmp_path / "data" / "reference" / "claims.csv").write_text("id\n")
    stands_for = tmp_path / "python"
    stands_for.write_text(STAND_IN)
    stands_for.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "executable", str(stands_for))
    for name in ("ROOT", "EXTERNAL", "RECORDINGS", "FIGURES"):
        monkeypatch.delenv(f"KILNFLIGHT_{name}", raising=False)
    write(*STEMS)
    return tmp_path


def write(*stems):
    for stem in stems:
        Path("notebooks", f"{stem}.py").write_text(f"# {stem}\n")


def calls():
    """Return what was asked of the stand-in, one line a notebook, and forget it."""
    asked = Path("asked")
    lines = asked.read_text().splitlines() if asked.exists() else []
    asked.unlink(missing_ok=True)
    return lines


def ran(*arguments):
    assert schedule.main(list(arguments or ["standard"])) == 0
    return [line.split()[0] for line in calls()]


def test_what_is_unchanged_does_not_run_again(project, monkeypatch):
    assert ran() == ["02_one", "26_two", "00_claims"]
    assert ran() == []
    Path("notebooks", "26_two.py").write_text("# another\n")
    assert ran() == ["26_two", "00_claims"]
    Path("02_one.csv").unlink()
    assert ran() == ["02_one", "00_claims"]
    assert ran("standard", "--parameters", "02.seed=5") == ["02_one", "00_claims"]
    assert ran("standard", "--parameters", "02.seed=5") == []
    assert ran("standard", "--build", "build/else", "--only", "02") == ["02_one"]
    assert Path("build/else/02_one.stamp").is_file()
    assert ran() == ["02_one", "00_claims"]
    Path("data", "reference", "claims.csv").write_text("id\nbg-1\n")
    assert sorted(ran()) == STEMS
    monkeypatch.setenv("KILNFLIGHT_EXTERNAL", "elsewhere")
    assert sorted(ran()) == STEMS
    assert sorted(ran("quick")) == STEMS


def test_each_gets_scale_and_parameters(project):
    assert schedule.main(["quick", "--parameters", "seed=3", "26.draws=9"]) == 0
    expected = "--build build/quick -p scale=quick -p seed=3 -p 26.draws=9"
    assert all(line.endswith(expected) for line in calls())


def test_the_first_failure_stops_what_has_not_begun(project, capfd):
    Path("fail-02_one").touch()
    assert schedule.main(["standard"]) == 7
    assert [line.split()[0] for line in calls()] == ["02_one"]
    Path("fail-02_one").unlink()
    assert ran() == ["02_one", "26_two", "00_claims"]
    assert "3 of 3 notebooks" in capfd.readouterr().out


def test_those_that_run_beside_a_failure_end(project):
    write(*CAMPAIGNS)
    Path("fail-23_compiles").touch()
    Path("fail-45_belt").touch()
    assert schedule.main(["standard", "--jobs", "2"]) == 7
    assert {line.split()[0] for line in calls()} == {"23_compiles", "45_belt"}


def test_a_wrong_parameter_is_told_in_one_line(project, capfd):
    assert schedule.main(["standard", "--parameters", "77.seed=1"]) == 1
    assert "77.seed=1" in capfd.readouterr().err
    assert calls() == []


@pytest.mark.parametrize("scale", ["standard", "full"])
def test_campaigns_come_before_those_that_take_their_tables(project, scale):
    write(*CAMPAIGNS)
    assert schedule.main([scale, "--jobs", "2"]) == 0
    lines = calls()
    order = [line.split()[0] for line in lines]
    assert sorted(order) == sorted([*STEMS, *CAMPAIGNS])
    assert set(order[:2]) == {"23_compiles", "45_belt"}  # the belt shares no such code
    assert order.index("50_campaigns") < order.index("52_late")
    assert order[-1] == "00_claims"
    many = [line.split()[0] for line in lines if "50.jobs=2" in line]
    assert many == (["50_campaigns"] if scale == "full" else [])
    if scale == "full":  # nothing runs beside the campaigns
        assert order[-3:] == ["50_campaigns", "52_late", "00_claims"]
    saved = project / "figures" / "full-run.csv"  # only of a full run
    assert saved.is_file() == (scale == "full")


def test_a_few_can_be_asked_for(project):
    write(*CAMPAIGNS)
    assert ran("standard", "--only", "52", "60") == ["60_early", "52_late"]


def test_the_time_that_is_left_is_told_by_the_last_run(project, capsys):
    assert ran() == ["02_one", "26_two", "00_claims"]
    first, *others = capsys.readouterr().out.splitlines()
    assert first == "3 notebooks"  # nothing is known yet
    assert others[-1] == "3 of 3 notebooks done"
    for stem, seconds in zip(STEMS, (60, 240, 300), strict=True):
        Path("build", "standard", f"{stem}.seconds").write_text(f"{seconds}")
        Path("build", "standard", f"{stem}.stamp").unlink()
    ran()
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "3 notebooks, about 10 minutes left"
    assert told[1] == "1 of 3 notebooks done, about 6 minutes left"
