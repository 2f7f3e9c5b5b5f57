import hashlib
import http.server
import threading

import pytest

from kilnflight.checks import InputError
from kilnflight.project import data

CONTENT = b"tracks"
FILE = data.ExternalFile("t.zip", hashlib.sha256(CONTENT).hexdigest(), "some tracks")


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr("kilnflight.project.paths.external", lambda: tmp_path / "external")
    return tmp_path / "external"


@pytest.fixture
def server(tmp_path):
    """A server on this machine with a good file, a damaged one, and nothing else."""
    served = tmp_path / "served"
    served.mkdir()
    (served / "good.zip").write_bytes(CONTENT)
    (served / "damaged.zip").write_bytes(CONTENT[:3])

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *arguments):
            super().__init__(*arguments, directory=str(served))

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Quiet) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


def test_a_file_is_fetched_once(folder, server):
    path = data.fetch(FILE, [f"{server}/good.zip"])
    assert path.read_bytes() == CONTENT
    assert data.fetch(FILE, ["http://127.0.0.1:1/gone"]) == path


def test_the_next_address_is_tried(folder, server):
    urls = [f"{server}/nothing.zip", f"{server}/good.zip"]
    assert data.fetch(FILE, urls).read_bytes() == CONTENT


def test_the_recordings_have_a_place_and_an_address_each():
    names = [file.name for file in data.RECORDINGS]
    assert len(set(names)) == len(names) == 32
    tracked = [file for file in data.RECORDINGS if "trackHistory" in file.name]
    assert len(tracked) == 16
    for file in data.RECORDINGS:
        part, name = file.name.split("/")[1:]
        beside = f"trackSortResult{part}/" if file in tracked else ""
        assert file.address == f"{part}/{beside}{name}"
        assert len(file.sha256) == 64


def test_a_file_with_an_address_of_its_own_is_fetched_to_its_place(folder, server, monkeypatch):
    monkeypatch.setattr(data, "REPOSITORY", server)
    monkeypatch.setattr(data, "COMMITS", ("nowhere", "../."))
    one = data.ExternalFile("belt/a/t.zip", FILE.sha256, "tracks", "../good.zip")
    assert data.fetch(one) == folder / "belt" / "a" / "t.zip"
    assert data.find(one).read_bytes() == CONTENT


@pytest.mark.parametrize("named", [None, *data.NAMED])
def test_recordings_are_fetched_unless_a_folder_is_named(folder, monkeypatch, capsys, named):
    fetched = []

    def fetch(file):
        fetched.append(file)
        return folder / file.name

    monkeypatch.setattr(data, "fetch", fetch)
    for name in data.NAMED:
        monkeypatch.delenv(name, raising=False)
    if named:
        monkeypatch.setenv(named, str(folder))
    assert data.main([]) == 0
    wanted = [*data.FILES] if named else [*data.FILES, *data.RECORDINGS]
    assert fetched == wanted
    assert ("belt_recordings: 32 files" in capsys.readouterr().out) == (named is None)


def test_a_damaged_download_is_told_and_not_kept(folder, server):
    with pytest.raises(InputError, match=r"t\.zip: what .* another SHA-256.*nothing was kept"):
        data.fetch(FILE, [f"{server}/damaged.zip"])
    assert list(folder.iterdir()) == []


def test_no_network_is_told(folder):
    with pytest.raises(ConnectionError, match=r"t\.zip: no connection"):
        data.fetch(FILE, ["http://127.0.0.1:1/good.zip"])
    assert list(folder.iterdir()) == []


def test_a_file_that_is_gone_everywhere_is_told(folder, server):
    with pytest.raises(ConnectionError, match="does not offer it any more"):
        data.fetch(FILE, [f"{server}/nothing.zip"])


def test_a_file_with_another_checksum_is_never_used(folder):
    folder.mkdir()
    (folder / "t.zip").write_bytes(b"other")
    for call in (data.find, data.fetch):
        with pytest.raises(InputError, match=r"SHA-256 .* expected .*Delete it and run make data"):
            call(FILE)


def test_who_names_a_folder_means_it(monkeypatch, tmp_path):
    monkeypatch.setenv("KILNFLIGHT_EXTERNAL", str(tmp_path))
    with pytest.raises(InputError, match=r"which has no t\.zip"):
        data.find(FILE)


def test_what_was_never_fetched_is_none(folder):
    assert data.find(FILE) is None


@pytest.mark.parametrize(("arguments", "code"), [([], 1), (["--optional"], 0)])
def test_make_goes_on_without_a_network_but_make_data_does_not(
    folder, monkeypatch, capsys, arguments, code
):
    def nothing(file, urls=None):
        raise ConnectionError(f"{file.name}: no connection")

    monkeypatch.setattr(data, "fetch", nothing)
    assert data.main(arguments) == code
    output = capsys.readouterr()
    assert "own simulation" in output.out + output.err
    assert len((output.out + output.err).strip().splitlines()) == 1


@pytest.mark.parametrize("arguments", [[], ["--optional"]])
def test_a_damaged_file_stops_both(folder, capsys, arguments):
    folder.mkdir()
    (folder / data.FILES[0].name).write_bytes(b"other")
    assert data.main(arguments) == 1
    assert "SHA-256" in capsys.readouterr().err


def test_the_pinned_files_are_the_authors(authors_data):
    for file in data.FILES:
        assert data.find(file) == authors_data / file.name
