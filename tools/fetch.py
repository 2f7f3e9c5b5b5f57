"""Fetching of the authors' public data: ``python tools/fetch.py``, by ``make data``.

With ``--optional`` a missing network is no error; with ``--all`` further parts come.
"""

import hashlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pooch

from kilnflight.checks import InputError
from kilnflight.publication import data
from kilnflight.publication.data import BELT_DEM, LABELLED_ARCHIVE, RECORDINGS
from kilnflight.store import paths
from kilnflight.store.cache import write_whole

# A record with the labelled frames alone, and a later version with further parts of
# 2.5 GB.
LABELLED_DOI = "doi:10.5281/zenodo.6334678"
ALL_PARTS_DOI = "doi:10.5281/zenodo.6358536"
FOLDERS = ("KILNFLIGHT_EXTERNAL", "KILNFLIGHT_RECORDINGS")


def fetch(name: str) -> Path:
    """Return the path of a file of the registry, downloaded if it is missing.

    Raises
    ------
    ValueError
        If the checksum is wrong, of the download or of the file that is there
        (`InputError`).
    OSError
        If its repository cannot be reached or does not have the file.
    """
    path = data.find(name)
    if path:
        return path
    store = pooch.create(paths.external(), base_url="")
    store.load_registry(data.REGISTRY)
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
    told = f"have {len(BELT_DEM)} DEM tracks and {len(RECORDINGS)} recordings"
    if any(map(os.environ.get, FOLDERS)):
        recordings = ()
        told = f"have {len(BELT_DEM)} DEM tracks (recordings: those of your folder)"
    groups: list[tuple[Sequence[str], Callable[[str], object]]]
    groups = [((*BELT_DEM.values(), *recordings), fetch)]
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
