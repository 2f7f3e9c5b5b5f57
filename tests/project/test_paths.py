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
