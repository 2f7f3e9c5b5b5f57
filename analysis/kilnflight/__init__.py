"""kilnflight: how to see particles fly, as a package that can be checked.

In Python the steps on a recording of one's own are `kilnflight.open`, `detect`, `track`
and `plot_tracks` (see `kilnflight.film`), for example ``tracks =
kilnflight.track(detections)``.

One particle enters as light on a sensor and leaves as a number in a report::

    kiln:  recording -> background -> detection -> combination -> tracking
               -> tracklets -> regression -> flight --+
                                                      |
    belt:  pictures -> tracks -> prediction phase     +-> notebook -> figure -> site
               -> arrival and lateral models ---------+

The rooms:

===============  ===============================================================
room             what it does
===============  ===============================================================
recording        frames: films, pictures, arrays, manifests, Zarr; tables of tracks
camera           depth calibration, Eq. 2.4 of the thesis background       six
background models, section 2.2.1 of the thesis detection        Otsu, DoG; DBSCAN, MO,
QCC; combined 2D+3D detector; the wall association      gated pairs -> weights: NN, GNN,
PDA, exact JPDA tracking         detections -> tracks: predict, gate, associate, update
tracklets        tracklets -> trajectories, chapter 4.2 regression       trajectories ->
polynomials through the lance's outlet, chapter 4.3 flight           trajectories ->
flights: dwell time, velocity by metre, section 5.3 ignition         when a particle
ignites scores           detections, tracks and flights against the truth, with
intervals tables, checks   columns and units of every table; checks of input and their
error arrays           types of arrays chain            the whole way from a frame to a
flight film             a film of one's own: settings, detection, tracks, doubts,
report, pictures belt             the sorter of both papers: spots, tracker, models,
valves simulated.kiln   a kiln whose truth is known (the twin): flights as printed,
camera, scenes simulated.belt   what the belt's camera sees: rendered pictures, a small
model of the belt experiments      what two notebooks share, or is longer than a page
publication      figures, claims, choices, notebooks, fetched data; no physics store
files written whole: cached tables, folders, an index; processes
===============  ===============================================================
"""

import importlib
import os
import tempfile
from pathlib import Path

__version__ = "0.2.0"
# Module and name of each step that is imported on first use: that takes seconds.
STEPS = {
    "detect": ("kilnflight.film.run", "detect"),
    "open": ("kilnflight.recording.files", "open_any"),
    "plot_tracks": ("kilnflight.film.pictures", "plot_tracks"),
    "preview": ("kilnflight.film.pictures", "preview"),
    "run": ("kilnflight.film.run", "run_recording"),
    "track": ("kilnflight.film.run", "track_detections"),
}

os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(200_000_000))  # else 2^30
if not any(
    os.access(place, os.W_OK) for place in (*__path__, os.environ.get("HOME", "/"))
):
    # Compiled code has no other place. It is taken only from a folder that is this
    # user's own.
    own = Path(tempfile.gettempdir(), f"kilnflight-{os.getuid()}")
    own.mkdir(mode=0o700, exist_ok=True)
    os.environ.setdefault(
        "NUMBA_CACHE_DIR", f"{own}" * (own.lstat().st_uid == os.getuid())
    )


def __getattr__(name: str) -> object:
    """Return a step on a recording of one's own, imported on first use."""
    if name not in STEPS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, function = STEPS[name]
    return getattr(importlib.import_module(module), function)
