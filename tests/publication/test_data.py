import hashlib
import http.server
import threading
from functools import partial

import pytest
from tools import fetch

from kilnflight.checks import InputError
from kilnflight.publication import data

CONTENT = b"tracks"
NAME = "belt/t.zip"


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """The folder of the data; one small file is known, at the address that `offer`
    writes.
    """
    monkeypatch.setattr(
        "kilnflight.store.paths.external", lambda: tmp_path / "external"
    )
    monkeypatch.setattr(data, "REGISTRY", tmp_path / "registry.txt")
    monkeypatch.setitem(data.SHA256, NAME, hashlib.sha256(CONTENT).hexdigest())
    return tmp_path / "external"


def offer(address):
    data.REGISTRY.write_text(f"{NAME} {data.SHA256[NAME]} {address}\n")


@pytest.fixture
def server(tmp_path):
    """A server on this machine with a good file, a damaged one, and nothing else."""
    served = tmp_path / "served"
    served.mkdir()
    (served / "good.zip").write_bytes(CONTENT)
    (served / "damaged.zip").write_bytes(CONTENT[:3])

    handler = partial(http.server.SimpleHTTPRequestHandler, directory=str(served))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, args=[0.02], daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


def test_a_file_is_fetched_once(folder, server):
    offer(f"{server}/good.zip")
    assert fetch.fetch(NAME) == folder / NAME
    assert (folder / NAME).read_bytes() == CONTENT
    offer("http://127.0.0.1:1/gone")
    assert fetch.fetch(NAME) == data.find(NAME) == folder / NAME


@pytest.mark.parametrize(
    ("address", "error"),
    [
        ("{server}/damaged.zip", ValueError),
        ("{server}/nothing.zip", OSError),
        ("http://127.0.0.1:1/good.zip", OSError),
    ],
)
def test_what_cannot_be_fetched_whole_is_not_kept(folder, server, address, error):
    offer(address.format(server=server))
    with pytest.raises(error):
        fetch.fetch(NAME)
    assert not [path for path in folder.rglob("*") if path.is_file()]


def test_a_file_with_another_checksum_is_never_used(folder):
    (folder / "belt").mkdir(parents=True)
    (folder / NAME).write_bytes(b"other")
    for call in (data.find, fetch.fetch):
        with pytest.raises(InputError, match=NAME):
            call(NAME)


@pytest.mark.parametrize(("arguments", "code"), [([], 1), (["--optional"], 0)])
def test_make_goes_on_without_a_network_but_make_data_does_not(
    folder, monkeypatch, capsys, arguments, code
):
    def nothing(name):
        raise OSError(f"{name}: no connection")

    monkeypatch.setattr(fetch, "fetch", nothing)
    monkeypatch.setattr(fetch, "fetch_labelled", nothing)
    assert fetch.main(arguments) == code
    output = "".join(capsys.readouterr())
    assert "own simulation" in output
    assert len(output.splitlines()) == 1


def test_the_first_download_is_pinned_beside_the_file(tmp_path):
    path = tmp_path / "set.zip"
    path.write_bytes(CONTENT)
    assert fetch.pin(path) == fetch.pin(path) == hashlib.sha256(CONTENT).hexdigest()
    path.write_bytes(CONTENT[:3])
    with pytest.raises(InputError, match=r"set\.zip"):
        fetch.pin(path)


def test_labelled_frames_are_named_or_lie_where_they_were_unpacked(
    folder, monkeypatch, tmp_path
):
    monkeypatch.delenv("KILNFLIGHT_LABELLED", raising=False)
    assert data.labelled_manifest() is None
    unpacked = folder / "Data_Set_2D_3D_Particle_Detection" / "labelled.toml"
    unpacked.parent.mkdir(parents=True)
    unpacked.write_text("")
    assert data.labelled_manifest() == unpacked
    monkeypatch.setenv("KILNFLIGHT_LABELLED", str(tmp_path / "mine.toml"))
    with pytest.raises(InputError, match=r"mine\.toml"):
        data.labelled_manifest()
    (tmp_path / "mine.toml").write_text("")
    assert data.labelled_manifest() == tmp_path / "mine.toml"


def test_the_authors_archive_is_told_by_its_checksum(tmp_path, monkeypatch):
    folder = tmp_path / "set"
    folder.mkdir()
    assert not data.is_of_authors(folder / "labelled.toml")
    (tmp_path / "set.zip").write_bytes(CONTENT)
    assert not data.is_of_authors(folder / "labelled.toml")
    found = hashlib.md5(CONTENT).hexdigest()
    monkeypatch.setattr(data, "LABELLED_MD5", found[:8])
    assert data.is_of_authors(folder / "labelled.toml")


def test_without_one_server_the_other_is_asked(folder, monkeypatch, capsys):
    def nothing(name):
        raise OSError(f"{name}: no connection")

    asked = []
    monkeypatch.setattr(fetch, "fetch", nothing)
    monkeypatch.setattr(fetch, "fetch_labelled", asked.append)
    assert fetch.main([]) == 1
    assert asked == [False]
    assert data.LABELLED_ARCHIVE not in "".join(capsys.readouterr())


def test_the_pinned_files_are_the_authors(authors_data):
    for name in data.BELT_DEM.values():
        assert data.find(name) == authors_data / name


class Record:
    """A record of an archive with two files, in place of Zenodo."""

    def __init__(self, folder, base_url):
        self.folder = folder
        self.base_url = base_url
        self.registry_files = []

    def load_registry_from_doi(self):
        self.registry_files = [data.LABELLED_ARCHIVE, "part.zip"]

    def fetch(self, name, progressbar):
        assert name in self.registry_files
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / name
        path.write_bytes(CONTENT + self.base_url.encode())
        return str(path)


def test_labelled_frames_are_fetched_once_and_their_parts_when_asked(
    folder, monkeypatch, capsys
):
    asked = []

    def create(path, base_url):
        asked.append(base_url)
        return Record(path, base_url)

    monkeypatch.setattr("pooch.create", create)
    (archive,) = fetch.fetch_labelled(every=False)
    assert fetch.pin(archive) in capsys.readouterr().out
    assert fetch.fetch_labelled(every=False) == [archive]
    assert asked == [fetch.LABELLED_DOI]
    archive.with_name(f"{archive.name}.sha256").unlink()
    names = [path.name for path in fetch.fetch_labelled(every=True)]
    assert names == [data.LABELLED_ARCHIVE, "part.zip"]
    archive.write_bytes(b"other")
    with pytest.raises(InputError, match=archive.name):
        fetch.fetch_labelled(every=False)
