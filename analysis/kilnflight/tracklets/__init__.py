r"""Post-processing: from tracklets to trajectories.

Section 4.2 of the thesis, with the values of Table 5.16.

    tracks -> Elimination -> OutlierRemoval -> Connection -> Fusion -> the same columns

================  =================  ============================================  ==========
step              equation           default                                       source
================  =================  ============================================  ==========
`Elimination`     Eqs 4.15 to 4.17   2 frames, 1 px/frame, correlation 0.9         sec. 4.2.1
`OutlierRemoval`  Eqs 4.18 to 4.20   30 degrees and 18 px/frame                    sec. 4.2.2
`Connection`      Eqs 4.21 to 4.25   gap 15, overlap 5 frames, 1500 mm/frame       sec. 4.2.3
`Fusion`          sec. 4.2.4         mean distance 10 px                           sec. 4.2.4
================  =================  ============================================  ==========

A track table has whole numbers ``frame`` and ``particle`` (-1: in no track), and ``row`` and
``col`` in px. It may have ``z``, with ``x`` and ``y``, in mm (NaN where unknown). Other columns
are carried through. Every row comes back, in its place. The rows of eliminated tracklets, outliers
and merged duplicates get particle -1; `tracked` leaves them out. Particles are numbered from 0 by
first frame, then first position. Each step alone, applied to what it returns, changes nothing. The
whole, applied again, may, as later steps make tracks that are new to the earlier ones. `Cutting`
is no step of the thesis; `kilnflight.kiln` cuts after the last one, before the regression.
"""

from collections.abc import Callable, Iterable, Iterator

import pandas as pd

from kilnflight.tracklets.eliminate import Elimination
from kilnflight.tracklets.joining import (
    Connection,
    Costs,
    DualNearest,
    Fusion,
    Hungarian,
    Matching,
    Pairs,
)
from kilnflight.tracklets.outliers import Cutting, OutlierRemoval
from kilnflight.tracklets.paths import read_paths, tracked, write_paths
from kilnflight.tracklets.texture import Differences, LevelEdge, energies

Step = Callable[[pd.DataFrame, Differences | None], pd.DataFrame]

STEPS: tuple[Step, ...] = (Elimination(), OutlierRemoval(), Connection(), Fusion())


def stages(
    tracks: pd.DataFrame,
    differences: Differences | None = None,
    steps: Iterable[Step] = STEPS,
) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield each step's name and the table after it (Figs 4.17 to 4.21)."""
    for step in steps:
        tracks = step(tracks, differences)
        yield type(step).__name__, tracks


def postprocess(
    tracks: pd.DataFrame,
    differences: Differences | None = None,
    steps: Iterable[Step] = STEPS,
) -> pd.DataFrame:
    """Return the table after all steps, with the same rows and columns.

    Parameters
    ----------
    tracks
        Track table, see `kilnflight.tracklets`.
    differences
        Sums of frame differences of the recording; None leaves the last term of Eq. 4.24 out.
    steps
        In the order of chapter 4.2.

    Raises
    ------
    InputError
        If the table is not a track table.
    """
    paths = read_paths(tracks, "postprocess: tracks")
    table = write_paths(tracks, paths, paths.names())
    for step in steps:
        table = step(table, differences)
    return table


__all__ = [
    "STEPS",
    "Connection",
    "Costs",
    "Cutting",
    "Differences",
    "DualNearest",
    "Elimination",
    "Fusion",
    "Hungarian",
    "LevelEdge",
    "Matching",
    "OutlierRemoval",
    "Pairs",
    "Step",
    "energies",
    "postprocess",
    "stages",
    "tracked",
]
