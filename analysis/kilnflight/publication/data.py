"""The authors' public data: fetch, check, find.

The files are not ours to ship (their repository names no licence): ``make data``
fetches them where there is a network, and everything works without them. If
``KILNFLIGHT_EXTERNAL`` is set, they are read from that folder. No file is used before
its SHA-256 is right. A folder that ``KILNFLIGHT_RECORDINGS`` names holds the user's
recordings and is not looked at here.
"""

import gzip
import hashlib
import os
import sys
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from kilnflight.checks import InputError
from kilnflight.store import paths
from kilnflight.store.cache import write_whole

# Name, SHA-256 and address of each file: the repository of the 2020 paper's authors at
# a pinned commit, in pooch's format.
REGISTRY = Path(__file__).with_name("external_files.txt")
SHA256 = dict(line.split()[:2] for line in REGISTRY.read_text("utf-8").splitlines())
# Tracks at 100 Hz of 3713 wooden spheres, 4357 cuboids and 4427 cylinders, simulated by
# the authors with the discrete element method (DEM)
BELT_DEM = {
    "spheres": "DEM_spheres_115.zip",
    "cuboids": "DEM_cuboids_115.zip",
    "cylinders": "DEM_Cylinder_115.zip",
}
# The labelled frames of section 5.1.1 of the thesis ([116] there): a record with them
# alone, and a later version with further parts of 2.5 GB.
LABELLED_ARCHIVE = "Data_Set_2D_3D_Particle_Detection.zip"
LABELLED_MD5 = "3724c4a0"  # its first digits, as Zenodo states them
LABELLED_DOI = "doi:10.5281/zenodo.6334678"
ALL_PARTS_DOI = "doi:10.5281/zenodo.6358536"
# Kugeln are spheres, Weizen is wheat, Zylinder are cylinders.
RECORDINGS_FOLDER = "belt_recordings"
RECORDINGS = tuple(name for name in SHA256 if name.startswith(RECORDINGS_FOLDER))
FOLDERS = ("KILNFLIGHT_EXTERNAL", "KILNFLIGHT_RECORDINGS")


def labelled_manifest() -> Path | None:
    """Return the manifest of the authors' labelled frames; None if they are not here.

    It is what ``KILNFLIGHT_LABELLED`` names, or labelled.toml in the unpacked archive
    that ``make data`` fetched.

    Raises
    ------
    InputError
        If ``KILNFLIGHT_LABELLED`` names no file.
    """
    named = os.environ.get("KILNFLIGHT_LABELLED")
    if named:
        path = Path(named)
        if not path.is_file():
            raise InputError(f"KILNFLIGHT_LABELLED is {path}: no such manifest.")
        return path
    path = paths.external() / Path(LABELLED_ARCHIVE).stem / "labelled.toml"
    return path if path.is_file() else None


def is_of_authors(manifest: Path) -> bool:
    """Return whether a manifest lies in the authors' unpacked archive.

    The archive has to be beside its folder, and to have the MD5 that Zenodo states.
    """
    archive = manifest.parent.with_suffix(".zip")
    if not archive.is_file():
        return False
    with archive.open("rb") as file:
        found = hashlib.file_digest(file, "md5").hexdigest()
    return found.startswith(LABELLED_MD5)


def find(name: str) -> Path | None:
    """Return the path of a file of `REGISTRY`, checked; None if never fetched.

    Raises
    ------
    InputError
        If its checksum is wrong, or ``KILNFLIGHT_EXTERNAL`` is set and does not have
        it.
    """
    path = paths.external() / name
    if path.is_file():
        check(path, name)
        return path
    if os.environ.get("KILNFLIGHT_EXTERNAL"):
        raise InputError(f"KILNFLIGHT_EXTERNAL is {path.parent}, which has no {name}.")
    return None


def check(path: Path, name: str) -> None:
    """Raise an `InputError` unless a file has the SHA-256 of ``name``.

    The checksums are those of `REGISTRY`. Of a .gz file the uncompressed content
    counts.
    """
    content = path.read_bytes()
    if path.suffix == ".gz":
        with suppress(OSError, EOFError, zlib.error):  # damaged: its checksum is wrong
            content = gzip.decompress(content)
    if hashlib.sha256(content).hexdigest() != SHA256[name]:
        raise InputError(
            f"{path}: damaged or another version (SHA-256). Delete it: make data."
        )


def fetch(name: str) -> Path:
    """Return the path of a file of `REGISTRY`, downloaded if it is missing.

    Raises
    ------
    ValueError
        If the checksum is wrong, of the download or of the file that is there
        (`InputError`).
    OSError
        If its repository cannot be reached or does not have the file.
    """
    path = find(name)
    if path:
        return path
    import pooch  # here: reading the data needs no downloader

    store = pooch.create(paths.external(), base_url="")
    store.load_registry(REGISTRY)
    pooch.get_logger().setLevel("WARNING")  # its progress lines repeat ours
    print(f"fetching {name}", flush=True)
    bar = pooch.HTTPDownloader(progressbar=sys.stderr.isatty(), timeout=30)
    return Path(store.fetch(name, downloader=bar))


def fetch_labelled(every: bool) -> list[Path]:
    """Return the paths of the labelled frames, downloaded if they are missing.

    Zenodo states the MD5 of each file, which pooch checks. No SHA-256 is published:
    that of the first download is kept beside the file, and checked from then on.
    ``every``: also the further parts, 5 GB.

    Raises
    ------
    ValueError
        If a checksum is wrong (`InputError` that of a file that is there).
    OSError
        If the record cannot be reached.
    """
    import pooch

    folder = paths.external()
    kept = folder / LABELLED_ARCHIVE
    if kept.is_file() and not every:
        pin(kept)
        return [kept]
    store = pooch.create(folder, base_url=ALL_PARTS_DOI if every else LABELLED_DOI)
    store.load_registry_from_doi()
    pooch.get_logger().setLevel("WARNING")
    fetched = []
    for name in store.registry_files if every else [LABELLED_ARCHIVE]:
        print(f"fetching {name}", flush=True)
        fetched.append(Path(store.fetch(name, progressbar=sys.stderr.isatty())))
        print(f"SHA-256 {pin(fetched[-1])}", flush=True)
    return fetched


def pin(path: Path) -> str:
    """Return the SHA-256 of a file, kept beside it at first and then checked.

    Raises
    ------
    InputError
        If it is not the one that was kept.
    """
    with path.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    beside = path.with_name(f"{path.name}.sha256")
    if not beside.is_file():
        write_whole(beside, f"{found}  {path.name}\n".encode())
    elif beside.read_text().split()[:1] != [found]:
        raise InputError(
            f"{path}: is not what was fetched first. Delete it: make data."
        )
    return found


def main(arguments: Sequence[str]) -> int:
    """Fetch every file (``make data``) and return the exit status.

    With ``--optional`` a missing network is no error, and the labelled frames are left
    out; with ``--all`` their further parts come, too. Recordings are not fetched if the
    user names a folder in one of `FOLDERS`.
    """
    recordings = RECORDINGS
    if any(map(os.environ.get, FOLDERS)):  # the user's folder is used as it is
        recordings = ()
    groups: list[tuple[Sequence[str], Callable[[str], object]]]
    groups = [((*BELT_DEM.values(), *recordings), fetch)]
    told = f"have {len(BELT_DEM)} DEM tracks and {len(recordings)} recordings"
    if "--optional" not in arguments:
        every = "--all" in arguments
        groups.append(((LABELLED_ARCHIVE,), lambda _: fetch_labelled(every)))
        told += ", and the labelled frames: kilnflight import drafts their manifest"
    failed = []
    code = 0
    for names, get in groups:  # of two servers
        try:
            for name in names:
                get(name)
        except OSError:
            failed.append(name)
        except ValueError as error:
            told = f"{name}: {error}"
            code = 1
    if failed:
        told = (
            f"{' and '.join(failed)} cannot be fetched. Our own simulation stands in; "
            f"or set {FOLDERS[0]}."
        )
        code = "--optional" not in arguments
    print(f"authors' data: {told}", file=sys.stderr if code else sys.stdout)
    return code


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
