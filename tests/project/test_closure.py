"""What a cached table depends on: files changed in a copy of the package."""

import shutil
from functools import partial

import pytest

from kilnflight import kiln
from kilnflight.flight import Rules
from kilnflight.project import closure
from kilnflight.project.cache import CachedTable
from kilnflight.twin.scene import Twin


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A copy of the package, which the hashes are taken of."""
    ignored = shutil.ignore_patterns("__pycache__")
    copy = shutil.copytree(closure.ROOT, tmp_path / closure.PACKAGE, ignore=ignored)
    monkeypatch.setattr(closure, "ROOT", copy)
    forget()
    yield copy
    forget()


def forget():
    closure._module.cache_clear()
    closure._closure_hash.cache_clear()


@pytest.fixture
def tables():
    """One chunk of detections and all later tables of the same run."""
    source = kiln.TwinSource("confetti-4.5-bar@small")
    run = kiln.KilnRun(kiln.DetectionRun(source, 0, 4, kiln.Combination()))

    def names():
        forget()
        found = {step: run.table(step).path.name for step in kiln.KILN_STEPS}
        return {"detections": run.detection.table(range(4)).path.name, **found}

    return names


def change(package, name, old="", new="\n# changed\n"):
    file = package / name
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new) if old else text + new)


def test_a_change_deep_in_the_closure_makes_every_table_anew(package, tables):
    before = tables()
    for deep in ("detection/combination.py", "camera.py", "twin/gas.py", "twin/calibrated.json"):
        change(package, deep)
        after = tables()
        assert not set(before.values()) & set(after.values()), deep
        before = after


def test_a_change_outside_leaves_all_tables(package, tables):
    before = tables()
    for outside in ("experiments/errata.py", "belt/phase.py", "__main__.py"):
        change(package, outside)
    assert tables() == before


def test_a_later_step_leaves_earlier_tables(package, tables):
    before = tables()
    change(package, "ignition.py")
    after = tables()
    kept = {name for name in before if before[name] == after[name]}
    assert kept >= {"detections", "tracks", "trajectories"}
    assert "flights" not in kept
    # the page of all steps is followed name by name
    change(package, "kiln.py", "FRAMES = 21", "FRAMES = 23")
    again = tables()
    assert {name for name in after if after[name] == again[name]} == kept
    change(package, "kiln.py", "(postprocess(", "((0, postprocess)[1](")
    later = tables()
    assert {name for name in again if later[name] == again[name]} == {"detections"}


def test_the_table_itself_is_made_anew_and_kept(package):
    made = []

    def table():
        def make():
            made.append(len(made))
            return kiln.DETECTIONS.empty()

        # as if the detector made it
        make.__module__, make.__qualname__ = "kilnflight.detection.combination", "Combination"
        return CachedTable("detections", partial(make), {"frames": [0, 4]})()

    table()
    table()
    assert made == [0]
    change(package, "detection/peaks.py")
    forget()
    table()
    assert made == [0, 1]
    change(package, "flight/table.py")
    forget()
    table()
    assert made == [0, 1]


def test_instances_functions_and_their_parts_count():
    one = closure.code_hash(kiln.detect)
    assert closure.code_hash(partial(kiln.detect, None)) == one
    assert closure.code_hash(Twin) != closure.code_hash(Rules)
    detector = kiln.Combination()
    assert closure.code_hash(detector) == closure.code_hash([detector])
    assert closure.code_hash(1, "a", None) == closure.code_hash()
