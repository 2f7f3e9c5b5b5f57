"""kilnflight: how to see particles fly, as a package that can be checked.

The public names are `__all__`: ``tracks = kilnflight.track(detections)``. A first try::

    film = kilnflight.sample_film()
    tracks = kilnflight.track(kilnflight.detect(film.frames))
    kilnflight.plot_tracks(film.frames, tracks).savefig("tracks.png")

One particle enters as light on a sensor and leaves as a number in a report::

    kiln:  recording -> background -> detection -> combination -> tracking
               -> tracklets -> regression -> flight --+
                                                      |
    belt:  pictures -> tracks -> prediction phase     +-> notebook -> figure -> site
               -> arrival and lateral models ---------+

The rooms:

==============  ====================================================================
room            what it does
==============  ====================================================================
recording       frames: films, pictures, arrays, manifests, Zarr; tables of tracks
camera          depth calibration, Eq. 2.4 of the thesis
background      six background models, section 2.2.1 of the thesis
detection       Otsu, DoG; DBSCAN, MO, QCC; combined 2D+3D detector; the wall
association     gated pairs -> weights: NN, GNN, PDA, exact JPDA
tracking        detections -> tracks: predict, gate, associate, update
tracklets       tracklets -> trajectories, chapter 4.2
regression      trajectories -> polynomials through the lance's outlet, chapter 4.3
flight          trajectories -> flights: dwell time, velocity by metre, section 5.3
ignition        when a particle ignites
scores          detections, tracks and flights against the truth, with intervals
tables, checks  columns and units of every table; checks of input and their error
arrays          types of arrays
chain           the whole way from a frame to a flight
film            a film of one's own: settings, detection, tracks, doubts, report
simulated.kiln  a kiln whose truth is known (the twin): flights, camera, scenes
simulated.belt  what the belt's camera sees: pictures, a small model of the belt
belt            the sorter of both papers: spots, tracker, models, valves
experiments     protocols of detection, flights and belt, which notebooks share
publication     figures, claims, choices, notebooks, fetched data; no physics
store           files written whole: cached tables, folders, an index; processes
==============  ====================================================================
"""

import importlib
import os
import tempfile
import tomllib
from pathlib import Path
from typing import Any

__version__ = "0.2.0"
# Public names by task, with the module that each is imported from on first use.
PUBLIC = tomllib.loads(Path(__file__).with_name("public.toml").read_text("utf-8"))
__all__ = [*PUBLIC]

os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(200_000_000))  # else 2^30
HOMES = (*__path__, os.environ.get("HOME", "/"))
if not any(os.access(place, os.W_OK) for place in HOMES):
    # Compiled code has no other place. It is taken only from a folder of this user.
    own = Path(tempfile.gettempdir(), f"kilnflight-{os.getuid()}")
    own.mkdir(mode=0o700, exist_ok=True)
    trusted = own.lstat().st_uid == os.getuid()
    os.environ.setdefault("NUMBA_CACHE_DIR", f"{own}" if trusted else "")


def __getattr__(name: str) -> Any:
    """Return a public name, imported on first use: that takes seconds."""
    if name not in PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, renamed = PUBLIC[name].partition(":")
    return getattr(importlib.import_module(f"{__name__}.{module}"), renamed or name)


def __dir__() -> list[str]:
    """Return the public names; they are imported on first use."""
    return [*__all__, "__version__"]
