import hashlib
import http.server
import threading

import pytest

from kilnflight.checks import InputError
from kilnflight.project import data

CONTENT = b"tracks"
NAME = "belt/t.zip"


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr("kilnflight.project.paths.external", lambda: tmp_path / "external")
    return tmp_path / "external"


@pytest.fixture
def offered(monkeypatch, tmp_path):
    """Let one small file be at an address."""

    def offer(address):
        registry = tmp_path / "registry.txt"
        checksum = hashlib.sha256(CONTENT).hexdigest()
        registry.write_text(f"{NAME} {checksum} {address}\n")
        monkeypatch.setattr(data, "REGISTRY", registry)
        monkeypatch.setitem(data.SHA256, NAME, checksum)

    return offer


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
        threading.Thread(target=running.serve_forever, args=[0.02], daemon=True).start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()


def test_a_file_is_fetched_once(folder, server, offered):
    offered(f"{server}/good.zip")
    assert data.fetch(NAME) == folder / NAME
    assert (folder / NAME).read_bytes() == CONTENT
    offered("http://127.0.0.1:1/gone")
    assert data.fetch(NAME) == data.find(NAME) == folder / NAME


@pytest.mark.parametrize(
    ("address", "error"),
    [
        ("{server}/damaged.zip", ValueError),
        ("{server}/nothing.zip", OSError),
        ("http://127.0.0.1:1/good.zip", OSError),
    ],
)
def test_what_cannot_be_fetched_whole_is_not_kept(folder, server, offered, address, error):
    offered(address.format(server=server))
    with pytest.raises(error):
        data.fetch(NAME)
    assert not [path for path in folder.rglob("*") if path.is_file()]


def test_a_file_with_another_checksum_is_never_used(folder, offered):
    offered("http://127.0.0.1:1/good.zip")
    (folder / "belt").mkdir(parents=True)
    (folder / NAME).write_bytes(b"other")
    for call in (data.find, data.fetch):
        with pytest.raises(InputError, match=r"another version \(SHA-256\). Delete it"):
            call(NAME)


@pytest.mark.parametrize(("arguments", "code"), [([], 1), (["--optional"], 0)])
def test_make_goes_on_without_a_network_but_make_data_does_not(
    folder, monkeypatch, capsys, arguments, code
):
    def nothing(name):
        raise OSError(f"{name}: no connection")

    monkeypatch.setattr(data, "fetch", nothing)
    assert data.main(arguments) == code
    output = capsys.readouterr()
    assert "own simulation" in output.out + output.err
    assert len((output.out + output.err).strip().splitlines()) == 1


def test_the_pinned_files_are_the_authors(authors_data):
    for name in data.BELT_DEM.values():
        assert data.find(name) == authors_data / name
