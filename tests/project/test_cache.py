"""Whole files, cached tables and calibrations on disk."""

import json
from dataclasses import dataclass
from functools import partial

import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.project.cache import CachedTable, write_whole


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
    with pytest.raises(InputError, match=r"cannot be read .* Delete it; it is made again"):
        table(calls, tmp_path)()

    def full(path, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache, "write_whole", full)
    with pytest.raises(InputError, match=r"cannot be written \(No space left .* goes on"):
        table(calls, tmp_path, 2)()


@dataclass
class Inputs:
    mass: float


def test_a_calibration_comes_back_or_says_why_not(tmp_path):
    path, targets = tmp_path / "fit.json", [1, 2.5]
    hashed = cache.content_hash(targets)
    content = {"inputs": {"mass": 2.0}, "cost_inputs_only": 3, "cost_calibrated": 1}
    content |= {"evaluations": 9, "targets_sha256": hashed}
    assert "cost_calibrated: 1" in cache.write_calibration(path, content)
    read = cache.read_calibration(path, targets, "kilnflight.fit")
    assert read == content
    assert cache.calibrated(Inputs, path, read) == Inputs(2.0)
    with pytest.raises(InputError, match="other inputs than here"):
        cache.calibrated(Inputs, path, {"inputs": {"weight": 2.0}})
    with pytest.raises(InputError, match="made for other targets"):
        cache.read_calibration(path, [1], "kilnflight.fit")
    path.write_text(json.dumps({**json.loads(path.read_text()), "evaluations": 10}))
    with pytest.raises(InputError, match="damaged, its SHA-256 does not fit"):
        cache.read_calibration(path, targets, "kilnflight.fit")
    path.unlink()
    with pytest.raises(InputError, match=r"cannot be read .* Run `python -m kilnflight.fit`"):
        cache.read_calibration(path, targets, "kilnflight.fit")
