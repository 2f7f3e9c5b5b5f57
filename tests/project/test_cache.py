"""Whole files, and tables that are made once for their arguments and code."""

import shutil
from functools import partial

import pandas as pd
import pytest

from kilnflight import camera, kiln
from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.project.cache import CachedTable, write_whole
from kilnflight.twin.scene import Twin


def test_a_write_that_is_interrupted_leaves_the_old_file(monkeypatch, tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"old")

    def full(self, content):
        raise OSError("no space left")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(OSError, match="no space"):
        write_whole(path, b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]
    assert path.read_bytes() == b"old"


@pytest.fixture
def calls():
    return []


def table(calls, folder, number=1, **options):
    def make():
        calls.append(number)
        return pd.DataFrame({"number": [number]})

    return CachedTable("numbers", partial(make), {"number": number}, folder, **options)


def test_a_table_is_made_once_for_each_argument(calls, tmp_path):
    for number in (1, 1, 2, 1):
        made = table(calls, tmp_path / "deep" / "er", number)()
        assert made["number"].tolist() == [number]
    assert calls == [1, 2]
    assert len(list(tmp_path.glob("deep/er/numbers-*.parquet"))) == 2


def test_a_table_whose_companion_is_lost_is_made_again(calls, tmp_path):
    table(calls, tmp_path)()
    table(calls, tmp_path, whole=lambda: False)()
    assert calls == [1, 1]


def test_a_table_goes_to_data_derived(calls, tmp_path):
    assert table(calls, None).path.parent == tmp_path / "derived"


def test_a_damaged_table_and_a_full_disk_are_told(calls, tmp_path, monkeypatch):
    table(calls, tmp_path)()
    table(calls, tmp_path).path.write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"cannot be read .* Delete it to go on"):
        table(calls, tmp_path)()

    def full(path, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache, "write_whole", full)
    with pytest.raises(InputError, match=r"cannot be written \(No space left .* to go on"):
        table(calls, tmp_path, 2)()


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A copy of the package, which the hashes are taken of."""
    ignored = shutil.ignore_patterns("__pycache__")
    copy = shutil.copytree(cache.PACKAGE, tmp_path / "kilnflight", ignore=ignored)
    monkeypatch.setattr(cache, "PACKAGE", copy)
    cache._closure_hash.cache_clear()
    yield copy
    cache._closure_hash.cache_clear()


def test_the_same_code_elsewhere_has_the_same_hash(tmp_path, request):
    here = cache.code_hash(kiln.detect)
    request.getfixturevalue("package")
    assert cache.code_hash(kiln.detect) == here


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("detection/combination.py", True),
        ("camera.py", True),
        ("ignition.py", True),
        ("experiments/errata.py", False),
        ("project/figures.py", False),
        ("__main__.py", False),
    ],
)
def test_what_is_imported_counts_and_nothing_else(package, name, counts):
    before = cache.code_hash(kiln.detect)
    (package / name).write_text((package / name).read_text() + "\n# changed\n")
    cache._closure_hash.cache_clear()
    assert (cache.code_hash(kiln.detect) != before) == counts


def test_data_beside_a_module_counts(package):
    before = cache.code_hash(Twin)
    (package / "twin" / "new.csv").write_text("a\n")
    cache._closure_hash.cache_clear()
    assert cache.code_hash(Twin) != before


def test_instances_and_functions_count():
    one = cache.code_hash(kiln.detect)
    assert cache.code_hash(partial(kiln.detect, None)) == one
    assert cache.code_hash(Twin) != cache.code_hash(camera.calibrate_depth)
    detector = kiln.Combination()
    assert cache.code_hash(detector) != cache.code_hash()
    assert cache.code_hash(1, "a", None) == cache.code_hash()
