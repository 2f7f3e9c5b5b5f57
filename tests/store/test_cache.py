"""Whole files, and tables that are made once for their arguments and code."""

import ast
import shutil
from itertools import pairwise

import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.simulated.kiln.scene import Twin
from kilnflight.store import cache
from kilnflight.store.cache import cached, make_whole


def test_a_write_that_is_interrupted_leaves_the_old_file(tmp_path):
    def full_disk(part):
        part.touch()
        raise OSError(28, "No space left on device")

    path = tmp_path / "a.csv"
    path.write_text("old")
    with pytest.raises(InputError, match=path.name):
        make_whole(path, full_disk)
    assert [(each.name, each.read_text()) for each in tmp_path.iterdir()] == [
        ("a.csv", "old")
    ]


class Numbers:
    """Two tables of which the second depends on the first; ``calls`` lists what was
    made.
    """

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
    for _ in range(2):
        assert numbers.second()["number"].tolist() == [6]
    assert numbers.calls == ["second", "first"]
    other = Numbers(tmp_path / "deep", 3, 5)
    assert other.second()["number"].tolist() == [15]
    assert other.calls == ["second"]
    assert numbers.second.path != Numbers(tmp_path / "deep", 4, 2).second.path
    assert Numbers(None, 3).first.path.parent == tmp_path / "derived"


def test_every_import_of_the_package_counts():
    """They are found by a pattern, which must miss none that Python's parser sees."""
    for file in cache.PACKAGE.rglob("*.py"):
        names = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                names |= {
                    node.module or "",
                    *(f"{node.module}.{each.name}" for each in node.names),
                }
            elif isinstance(node, ast.Import):
                names |= {each.name for each in node.names}
        assert {
            path for name in names for path in cache._module(name)
        } <= cache._imports(file.read_text())


TABLES = [
    "tables.csv",
    "simulated/kiln/laws.csv",
    "simulated/kiln/mixtures.csv",
    "simulated/kiln/labelled.csv",
]


def test_imported_code_counts(tmp_path, monkeypatch):
    copy = shutil.copytree(cache.PACKAGE, tmp_path / "kilnflight")
    hashes = [cache.code_hash(Twin)]
    monkeypatch.setattr(cache, "PACKAGE", copy)
    for name in ("__main__.py", "arrays.py", *TABLES):
        with (copy / name).open("a") as file:
            file.write("# changed\n")
        cache._closure_hash.cache_clear()
        hashes.append(cache.code_hash(Twin))
    cache._closure_hash.cache_clear()
    changed = [one != other for one, other in pairwise(hashes)]
    assert changed == [False, *[True] * (1 + len(TABLES))]
