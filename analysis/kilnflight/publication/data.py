"""The authors' public data: find and check.

The files are not ours to ship (their repository names no licence): ``make data``
fetches them (tools/fetch.py) where there is a network, and everything works without. If
``KILNFLIGHT_EXTERNAL`` is set, they are read from that folder. No file is used before
its SHA-256 is right. A folder that ``KILNFLIGHT_RECORDINGS`` names holds the user's
recordings and is not looked at here.
"""

import gzip
import hashlib
import os
import zlib
from contextlib import suppress
from pathlib import Path

from kilnflight.checks import InputError
from kilnflight.store import paths

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
# The labelled frames of section 5.1.1 of the thesis ([116] there)
LABELLED_ARCHIVE = "Data_Set_2D_3D_Particle_Detection.zip"
LABELLED_MD5 = "3724c4a0"  # its first digits, as Zenodo states them
# Kugeln are spheres, Weizen is wheat, Zylinder are cylinders.
RECORDINGS_FOLDER = "belt_recordings"
RECORDINGS = tuple(name for name in SHA256 if name.startswith(RECORDINGS_FOLDER))


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
