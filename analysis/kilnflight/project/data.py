"""The authors' public data: fetch, check, find.

The files are not ours to ship (their repository names no licence): ``make data`` fetches
them where there is a network, and everything works without them. If
``KILNFLIGHT_EXTERNAL`` is set, they are read from the folder that it names. No file of
either is used before its SHA-256 is right. A folder of recordings that
``KILNFLIGHT_RECORDINGS`` names is not looked at here: its files are the user's, taken as
they are.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import os
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path

from kilnflight.checks import InputError
from kilnflight.project import paths

# Name, SHA-256 and address of each file: the repository of the 2020 paper's authors at a
# pinned commit, in pooch's format.
REGISTRY = Path(__file__).with_name("external_files.txt")
SHA256 = dict(line.split()[:2] for line in REGISTRY.read_text("utf-8").splitlines())
# Tracks at 100 Hz of 3713 wooden spheres, 4357 cuboids and 4427 cylinders, simulated by the
# authors with the discrete element method (DEM)
BELT_DEM = {
    "spheres": "DEM_spheres_115.zip",
    "cuboids": "DEM_cuboids_115.zip",
    "cylinders": "DEM_Cylinder_115.zip",
}
RECORDINGS_FOLDER = "belt_recordings"  # Kugeln (spheres), Weizen (wheat), Zylinder (cylinders)
RECORDINGS = tuple(name for name in SHA256 if name.startswith(RECORDINGS_FOLDER))
FOLDERS = ("KILNFLIGHT_EXTERNAL", "KILNFLIGHT_RECORDINGS")


def find(name: str) -> Path | None:
    """Return where a file is, its checksum verified; None where it was never fetched.

    Raises
    ------
    InputError
        If the file is there but not the published one, or ``KILNFLIGHT_EXTERNAL`` is set
        to a folder without it.
    """
    path = paths.external() / name
    if path.is_file():
        check(path, name)
        return path
    if os.environ.get("KILNFLIGHT_EXTERNAL"):
        raise InputError(
            f"KILNFLIGHT_EXTERNAL is {paths.external()}, which has no {name}. Put the file "
            "there or unset the variable."
        )
    return None


def check(path: Path, name: str) -> None:
    """Raise an `InputError` unless a file is the published one.

    Of a .gz file, what is packed in it is checked.
    """
    content = path.read_bytes()
    if path.suffix == ".gz":
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error):
            content = b""  # no checksum of it is right
    checksum, advice = hashlib.sha256(content).hexdigest(), "Delete it and run make data."
    if os.environ.get("KILNFLIGHT_EXTERNAL"):
        advice = "Put a good copy there, or unset KILNFLIGHT_EXTERNAL."
    if checksum != SHA256[name]:
        raise InputError(
            f"{path}: SHA-256 {checksum[:12]}..., expected {SHA256[name][:12]}...; the file is "
            f"damaged or another version. {advice}"
        )


def fetch(name: str) -> Path:
    """Return where a file is, fetched if it is not there yet.

    Raises
    ------
    InputError
        If what arrives has another checksum.
    ConnectionError
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
    try:
        bar = pooch.HTTPDownloader(progressbar=sys.stderr.isatty(), timeout=30)
        return Path(store.fetch(name, downloader=bar))
    except OSError as error:
        answered = getattr(error, "response", None) is not None
        fault = "no longer offered at" if answered else "no connection to"
        raise ConnectionError(f"{name}: {fault} {store.get_url(name)}") from error
    except ValueError as error:
        raise InputError(
            f"{name}: what {store.get_url(name)} delivers has another SHA-256 than the published "
            "file; nothing was kept. Try again later, or set KILNFLIGHT_EXTERNAL to a good copy."
        ) from error


def main(arguments: Sequence[str] | None = None) -> int:
    """Fetch every file (``make data``).

    With ``--optional`` a missing network is no error.
    """
    parser = argparse.ArgumentParser(
        prog="python -m kilnflight.project.data", description=main.__doc__
    )
    parser.add_argument("--optional", action="store_true")
    optional = parser.parse_args(arguments).optional
    # a folder that the user sets is used as it is
    recordings = () if any(map(os.environ.get, FOLDERS)) else RECORDINGS
    try:
        for name in (*BELT_DEM.values(), *recordings):
            fetch(name)
    except ConnectionError as error:
        print(
            f"no authors' data: {error}. The notebooks use what is here, and our own simulation; "
            "with a network run make data, or set KILNFLIGHT_EXTERNAL to a folder that has the "
            "files.",
            file=sys.stdout if optional else sys.stderr,
        )
        return 0 if optional else 1
    except InputError as error:
        print(f"authors' data: {error}", file=sys.stderr)
        return 1
    print(f"authors' data: have {len(BELT_DEM)} DEM tracks and {len(recordings)} recordings")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
