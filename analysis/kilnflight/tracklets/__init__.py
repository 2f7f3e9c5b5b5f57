"""Post-processing: from tracklets to trajectories.

Section 4.2 of the thesis, with the values of Table 5.16.

    tracks -> Elimination -> OutlierRemoval -> Connection -> Fusion -> the same columns

================  ================  ==========================================
step              equation          default (Table 5.16)
================  ================  ==========================================
`Elimination`     Eqs 4.15 to 4.17  2 frames, 1 px/frame, correlation 0.9
`OutlierRemoval`  Eqs 4.18 to 4.20  30 degrees and 18 px/frame
`Connection`      Eqs 4.21 to 4.25  gap 15, overlap 5 frames, 1500 mm/frame
`Fusion`          sec. 4.2.4        mean distance 10 px
================  ================  ==========================================

A track is called a tracklet before these steps and a trajectory after them (section
4.2). A path is a tracklet in arrays. A track table has whole numbers ``frame`` and
``particle`` (-1: in no track), and ``row`` and ``col`` (or ``y`` and ``x``) in px. It
may have ``z``, with ``x`` and ``y``, in mm (NaN where unknown). Other columns are
carried through. Every row comes back, in its place. The rows of eliminated tracklets,
outliers and merged duplicates get particle -1; `tracked` leaves them out. Particles are
numbered from 0 by first frame, then first position. Each step is idempotent; the whole
chain is not. `Cutting` is no step of the thesis; `kilnflight.chain` cuts after the last
one, before the regression.
"""

from collections.abc import Iterable
from typing import Any

from pandas import DataFrame

from kilnflight.tracklets.eliminate import Elimination
from kilnflight.tracklets.joining import Connection, Fusion
from kilnflight.tracklets.outliers import Cutting, OutlierRemoval
from kilnflight.tracklets.paths import PathStep, read_paths, tracked, write_paths

STEPS: tuple[PathStep, ...] = (Elimination(), OutlierRemoval(), Connection(), Fusion())


def postprocess(
    tracks: DataFrame, differences: Any = None, steps: Iterable[PathStep] = STEPS
) -> DataFrame:
    """Return the table after all steps, with the same rows and columns.

    Parameters
    ----------
    tracks
        Track table, see `kilnflight.tracklets`.
    differences
        (frames, rows, cols) differences of the recording's frames and their background,
        in grey values; ``differences[frame]`` is that of a frame of ``tracks``. Any
        object with ``shape`` that is sliced like an array will do. They show a moving
        particle as a streak, the last term of Eq. 4.24. None leaves that term out.
    steps
        In the order of section 4.2.

    Returns
    -------
    DataFrame
        The same rows and columns with new numbers of particles; in frames that two
        tracklets share, the places are means.

    Raises
    ------
    InputError
        If the table is not a track table.

    Examples
    --------
    A particle is missed in three frames, so its track has two parts.

    >>> tracks = DataFrame({"frame": [*range(9), *range(12, 20)], "col": 7.0})
    >>> tracks["row"] = 5.0 * tracks["frame"]
    >>> tracks["particle"] = (tracks["frame"] > 9).astype(int)
    >>> postprocess(tracks)["particle"].unique().tolist()
    [0]
    """
    paths = read_paths(tracks, "postprocess: tracks")
    for step in steps:
        paths = step.apply(paths, differences)
    return write_paths(tracks, paths)
