"""Whole files, and tables that are made once for their arguments and code."""

import shutil
from pathlib import Path

import pandas as pd
import pytest

from kilnflight import kiln
from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.project.cache import cached, write_whole
from kilnflight.twin.scene import Twin


def full_disk(self, content):
    self.open("wb").close()
    raise OSError(28, "No space left on device")


def test_a_write_that_is_interrupted_leaves_the_old_file(monkeypatch, tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"old")
    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(InputError, match=r"a\.csv: .*No space"):
        write_whole(path, b"new")
    assert [each.name for each in tmp_path.iterdir()] == ["a.csv"]
    assert path.read_text() == "old"


class Numbers:
    """Two tables of which the second depends on the first; ``calls`` lists what was made."""

    def __init__(self, folder, number, factor=1):
        self.folder, self.number, self.factor, self.calls = folder, number, factor, []

    @cached("number")
    def first(self):
        self.calls.append("first")
        return pd.DataFrame({"number": [self.number]})

    @cached("first", "factor")
    def second(self):
        self.calls.append("second")
        return self.factor * self.first()


def test_a_table_is_made_once_for_each_argument(tmp_path):
    numbers = Numbers(tmp_path / "deep", 3, 2)
    assert numbers.second()["number"].tolist() == [6]
    assert numbers.second()["number"].tolist() == [6]
    assert numbers.calls == ["second", "first"]
    other = Numbers(tmp_path / "deep", 3, 5)
    assert other.second()["number"].tolist() == [15]
    assert other.calls == ["second"]
    assert numbers.second.path != Numbers(tmp_path / "deep", 4, 2).second.path
    assert Numbers(None, 3).first.path.parent == tmp_path / "derived"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A copy of the package, which the hashes are taken of."""
    ignored = shutil.ignore_patterns("__pycache__")
    copy = shutil.copytree(cache.PACKAGE, tmp_path / "kilnflight", ignore=ignored)
    monkeypatch.setattr(cache, "PACKAGE", copy)
    cache._closure_hash.cache_clear()
    yield copy
    cache._closure_hash.cache_clear()


def test_imported_code_and_data_beside_it_count(request):
    here = cache.code_hash(kiln.detect_frames)
    package = request.getfixturevalue("package")
    assert cache.code_hash(kiln.detect_frames) == here
    twin = cache.code_hash(Twin)
    for name, counts in (("camera.py", True), ("__main__.py", False)):
        before = cache.code_hash(kiln.detect_frames)
        (package / name).write_text((package / name).read_text() + "\n# changed\n")
        cache._closure_hash.cache_clear()
        assert (cache.code_hash(kiln.detect_frames) != before) == counts
    (package / "twin" / "new.csv").write_text("a\n")
    assert cache.code_hash(Twin) != twin
