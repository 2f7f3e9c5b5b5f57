"""Find the recordings of a real belt."""

from pathlib import Path

from kilnflight.belt.recordings import list_recordings
from kilnflight.checks import InputError
from kilnflight.publication import data
from kilnflight.store import paths


def find_recordings() -> dict[str, list[Path]]:
    """Return the files of measured positions by material, empty if there are none.

    The folder is ``KILNFLIGHT_RECORDINGS``, else ``belt_recordings`` beside the
    authors' other data. Files in the latter must be the published ones (SHA-256), as
    ``make data`` puts them.

    Raises
    ------
    InputError
        If the folder of the variable has none, or a file beside the authors' other data
        is not the published one.
    """
    folder = paths.recordings()
    published = paths.external() / data.RECORDINGS_FOLDER
    files = list_recordings(folder)
    if folder != published and not files:
        raise InputError(f"KILNFLIGHT_RECORDINGS is {folder}, which has no recording.")
    if folder == published:
        for name in data.RECORDINGS:
            for path in (published.parent / name, published.parent / f"{name}.gz"):
                if path.is_file():
                    data.check(path, name)
    return files
