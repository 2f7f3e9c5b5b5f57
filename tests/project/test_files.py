import pytest

from kilnflight.project.cache import write_whole


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
