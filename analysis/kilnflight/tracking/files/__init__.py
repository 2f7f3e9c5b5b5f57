"""Files of tracks: what other programs write can be scored, and what we track can be seen there.

==========================  =======================  ==========================================
read                        write                    format
==========================  =======================  ==========================================
`read_challenge`            `write_challenge`        XML of the particle tracking challenge
                                                     (Chenouard et al. 2014; Icy, TrackMate)
`read_trackpy`              `write_trackpy`          CSV of a trackpy table: (z,) y, x, frame,
                                                     particle
`from_trackpy`              `to_trackpy`             the same table in memory
`read_trackmate`            `write_trackmate`        TrackMate's table of spots, CSV
`read_napari`               `write_napari`           CSV of a napari tracks layer: ID, T, (Z,)
                                                     Y, X
`from_napari`               `to_napari`              the same as the layer's array
`read_manual`               `write_manual`           the thesis's ground truth, Fig. 5.11: a
                                                     folder of texts, one per trajectory
==========================  =======================  ==========================================

Every reader returns a table with ``frame``, ``particle``, ``row``, ``col`` and, where the format
has a third axis, ``plane``, sorted by particle and frame; ``row`` is y and ``col`` is x, in the
units of the file and counted from 0 as the file does. Every writer takes such a table, leaves out
rows in no track (particle -1; TrackMate alone has a place for them), and writes numbers so that
they are read back to the last digit. A file is there whole or not at all.
"""

from kilnflight.tracking.files.challenge import read_challenge, write_challenge
from kilnflight.tracking.files.manual import read_manual, write_manual
from kilnflight.tracking.files.napari import from_napari, read_napari, to_napari, write_napari
from kilnflight.tracking.files.trackmate import read_trackmate, write_trackmate
from kilnflight.tracking.files.trackpy import from_trackpy, read_trackpy, to_trackpy, write_trackpy

__all__ = [
    "from_napari",
    "from_trackpy",
    "read_challenge",
    "read_manual",
    "read_napari",
    "read_trackmate",
    "read_trackpy",
    "to_napari",
    "to_trackpy",
    "write_challenge",
    "write_manual",
    "write_napari",
    "write_trackmate",
    "write_trackpy",
]
