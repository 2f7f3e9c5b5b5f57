"""The authors' public data: fetch, check, find.

The files are not ours to ship (their repository names no licence), so whoever has a
network fetches them once (``make data``) and everything works without them. Where
there is no network, ``KILNFLIGHT_EXTERNAL`` names a folder that already holds them.
No file of either is used before its SHA-256 is right. A folder of recordings that
``KILNFLIGHT_RECORDINGS`` names is not looked at here: its files are the user's, taken as they are.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import json
import os
import sys
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kilnflight.checks import InputError
from kilnflight.project import paths

# The repository of the 2020 paper's authors at the pinned commit. The abbreviated hash
# is the one our copy was taken at; the full one is a later commit with the same files.
REPOSITORY = "https://github.com/KIT-ISAS/TrackSort_Neural_Public/raw"
COMMITS = ("7fff1e5", "8de8d3a904884c804ef38cb552012b4b4619e2f2")


@dataclass(frozen=True)
class ExternalFile:
    """One file of the authors' repository."""

    name: str  # where it lies in the folder of the authors' data
    sha256: str
    meaning: str
    address: str = ""  # where it lies in the data folder of the repository; empty: its name


BELT_DEM = {
    "spheres": ExternalFile(
        "DEM_spheres_115.zip",
        "9a94314b28632601625e72c0ff571c1ea96f60a878239e2e6a4ee434adafe650",
        "DEM tracks of 3713 wooden spheres, 100 Hz",
    ),
    "cuboids": ExternalFile(
        "DEM_cuboids_115.zip",
        "a612422c027c8d67f5e66cbd2c0e5ee767ef7e870c3ce33b2fab334cd0d766b3",
        "DEM tracks of 4357 wooden cuboids, 100 Hz",
    ),
    "cylinders": ExternalFile(
        "DEM_Cylinder_115.zip",
        "dfca4d5fc4dc694f75754a6b94bd51205ac32e1dae704a4590fae14a4a49270d",
        "DEM tracks of 4427 wooden cylinders, 100 Hz",
    ),
}
FILES: tuple[ExternalFile, ...] = tuple(BELT_DEM.values())


def _recordings() -> tuple[ExternalFile, ...]:
    """Return the files of the real sorter, from address and SHA-256 in the file beside this."""
    listed = Path(__file__).with_name("external_recordings.json").read_text("utf-8")
    return tuple(
        ExternalFile(
            f"{RECORDINGS_FOLDER}/{address.split('/')[0]}/{address.split('/')[-1]}",
            sha256,
            "measured on the authors' real sorter",
            address,
        )
        for address, sha256 in json.loads(listed).items()
    )


RECORDINGS_FOLDER = "belt_recordings"  # Kugeln (spheres), Weizen (wheat), Zylinder (cylinders)
RECORDINGS = _recordings()
NAMED = ("KILNFLIGHT_EXTERNAL", "KILNFLIGHT_RECORDINGS")


def find(file: ExternalFile) -> Path | None:
    """Return where a file is, its checksum verified; None where it was never fetched.

    Raises
    ------
    InputError
        If the file is there but not the published one, or ``KILNFLIGHT_EXTERNAL`` names
        a folder without it (who names a folder means it).
    """
    path = paths.external() / file.name
    if path.is_file():
        check(path, file)
        return path
    if os.environ.get("KILNFLIGHT_EXTERNAL"):
        raise InputError(
            f"KILNFLIGHT_EXTERNAL is {paths.external()}, which has no {file.name}. Put the file "
            "there or unset the variable."
        )
    return None


def check(path: Path, file: ExternalFile) -> None:
    """Raise an `InputError` unless a file, or what is packed in it (.gz), is the published one."""
    content = path.read_bytes()
    if path.suffix == ".gz" and not file.name.endswith(".gz"):
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error):
            content = b""  # no checksum of it is right
    found = hashlib.sha256(content).hexdigest()
    if found != file.sha256:
        raise InputError(
            f"{path}: SHA-256 {found[:12]}..., expected {file.sha256[:12]}...; the file is "
            "damaged or another version. "
            + (
                "Put a good copy there, or unset KILNFLIGHT_EXTERNAL."
                if os.environ.get("KILNFLIGHT_EXTERNAL")
                else "Delete it and run make data."
            )
        )


def fetch(file: ExternalFile, urls: Sequence[str] | None = None) -> Path:
    """Return where a file is, fetched if it is not there yet.

    The download goes to a temporary name and is renamed when its checksum is right.

    Raises
    ------
    InputError
        If what arrives has another checksum.
    ConnectionError
        If no address could be reached.
    """
    here = find(file)
    if here:
        return here
    import pooch  # here: whoever only reads the data needs no downloader
    import requests

    pooch.get_logger().setLevel("WARNING")  # its progress lines repeat ours
    path = paths.external() / file.name
    path.parent.mkdir(parents=True, exist_ok=True)
    address = file.address or file.name
    for url in urls or [f"{REPOSITORY}/{commit}/data/{address}" for commit in COMMITS]:
        print(f"fetching {file.name} ({file.meaning})", flush=True)
        try:
            pooch.retrieve(
                url,
                known_hash=f"sha256:{file.sha256}",
                fname=path.name,
                path=path.parent,
                downloader=pooch.HTTPDownloader(progressbar=sys.stderr.isatty(), timeout=30),
            )
            return path
        except requests.exceptions.HTTPError:
            continue  # this address does not have it; the next may
        except (requests.exceptions.RequestException, OSError) as error:
            raise ConnectionError(f"{file.name}: no connection to its repository") from error
        except ValueError as error:
            raise InputError(
                f"{file.name}: what {url} delivers has another SHA-256 than the published file; "
                "nothing was kept. Try again later, or set KILNFLIGHT_EXTERNAL to a good copy."
            ) from error
    raise ConnectionError(f"{file.name}: its repository does not offer it any more")


def main(arguments: Sequence[str] | None = None) -> int:
    """Fetch every file (``make data``); with ``--optional`` a missing network is no error."""
    parser = argparse.ArgumentParser(
        prog="python -m kilnflight.project.data", description=main.__doc__
    )
    parser.add_argument("--optional", action="store_true")
    optional = parser.parse_args(arguments).optional
    try:
        for file in FILES:
            print(f"have {fetch(file).name}: {file.meaning}")
        if not any(map(os.environ.get, NAMED)):  # who names a folder has what there is in it
            for file in RECORDINGS:
                fetch(file)
            print(f"have {RECORDINGS_FOLDER}: {len(RECORDINGS)} files, {RECORDINGS[0].meaning}")
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
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
