import pytest

from kilnflight.checks import InputError
from kilnflight.project import paths


def test_the_project_is_found_from_a_folder_inside_it(monkeypatch):
    project = paths.root()
    monkeypatch.delenv("KILNFLIGHT_ROOT")
    monkeypatch.chdir(project / "notebooks")
    assert paths.root() == project


def test_a_named_root_without_a_project_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setenv("KILNFLIGHT_ROOT", str(tmp_path))
    with pytest.raises(InputError, match="KILNFLIGHT_ROOT"):
        paths.root()


def test_folders_follow_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("KILNFLIGHT_FIGURES", str(tmp_path / "f"))
    monkeypatch.setenv("KILNFLIGHT_EXTERNAL", str(tmp_path / "e"))
    assert paths.figures() == tmp_path / "f"
    assert paths.external() == tmp_path / "e"
