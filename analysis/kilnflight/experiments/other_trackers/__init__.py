"""Other people's trackers, called as ours: detections in, the same rows with ``particle`` out.

=================  =========================  ==================================================
tracker            package                    how it links
=================  =========================  ==================================================
`Trackpy`          trackpy 0.6 and later      nearest positions, optimal in each small group
`LapTrack`         laptrack 0.16 and later    one assignment per frame, then one over the gaps
`StoneSoupGNN`     stonesoup 1.5 and later    Kalman filter, ``GNNWith2DAssignment``
`StoneSoupJPDA`    stonesoup 1.5 and later    Kalman filter, ``JPDAwithEHM2``
=================  =========================  ==================================================

They come with ``pip install kilnflight[peer]`` and are imported when called, so that the rest
does without. All look at frame, row and col only; none knows depth or size. Stone Soup has
no tracker for scenes in which anything may start anywhere, only parts to build one from: the
loop here starts a track at every detection that is left over and gives a track up when it
was not seen for some frames, as `kilnflight.tracking.tracker` does.
"""

from typing import Protocol

import pandas as pd

from kilnflight.experiments.other_trackers.linkers import LapTrack, Trackpy
from kilnflight.experiments.other_trackers.stone_soup import StoneSoupGNN, StoneSoupJPDA
from kilnflight.experiments.other_trackers.table import PACKAGES, available


class Peer(Protocol):
    """Someone else's tracker."""

    def __call__(self, detections: pd.DataFrame) -> pd.DataFrame:
        """Return the same rows with ``particle``."""


PEERS: tuple[Peer, ...] = (Trackpy(), LapTrack(), StoneSoupGNN(), StoneSoupJPDA())

__all__ = [
    "PACKAGES",
    "PEERS",
    "LapTrack",
    "Peer",
    "StoneSoupGNN",
    "StoneSoupJPDA",
    "Trackpy",
    "available",
]
