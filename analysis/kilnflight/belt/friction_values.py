"""What the papers do not print of slide and friction: seven values, frozen.

They were found with the spheres of the authors' tracks (`kilnflight.belt.calibration`).
Cylinders and cuboids get the same values, so what they do is a prediction. What came out is
effective: the slide stands for a feeder and a chute of unknown shape, and the friction for
whatever contact law the authors' DEM has.

The search stopped at its budget (`kilnflight.belt.calibration.ROUNDS`: 8 rounds, 57 evaluations),
not because it had converged. So these values are the best that were met, no proven optimum, and
nothing is said of whether others would do as well. Their cost is that of the same 300 particles
that they were found with.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from kilnflight.belt.machine import Sorter
from kilnflight.belt.physics import Contacts
from kilnflight.belt.slide import Slide
from kilnflight.project import cache, data

FILE = Path(__file__).with_name("friction_values.json")
PLACES_MM = np.arange(425.0, 751.0, 25.0)  # along the belt, where all are seen
SCALES = {"mean_m_s": 0.01, "std_m_s": 0.01, "lateral_m_s": 0.002}  # what counts as one misfit


@dataclass(frozen=True)
class FreeValues:
    """The free values; the defaults are those of `Contacts` and `Slide`, untouched."""

    belt_friction: float = Contacts.belt_friction
    rolling_friction: float = Contacts.rolling_friction
    drop_mm: float = Slide.drop_mm
    rolling_share: float = Slide.rolling_share
    exit_deg: float = Slide.exit_deg
    speed_spread: float = Slide.speed_spread
    lateral_spread_mm_s: float = Slide.lateral_spread_mm_s

    def applied(self, sorter: Sorter) -> Sorter:
        """Return a sorter with these values, all others as they were."""
        values = asdict(self)
        touch = {name: values.pop(name) for name in ("belt_friction", "rolling_friction")}
        contacts = replace(sorter.contacts, **touch)
        return replace(sorter, contacts=contacts, slide=replace(sorter.slide, **values))


INPUTS_ONLY = FreeValues()
# What is conceivable, fixed before the search.
LIMITS = {
    "belt_friction": (0.05, 0.8),
    "rolling_friction": (0.001, 0.1),
    "drop_mm": (20.0, 300.0),
    "rolling_share": (0.0, 1.0),
    "exit_deg": (0.0, 30.0),
    "speed_spread": (0.0, 0.2),
    "lateral_spread_mm_s": (0.0, 100.0),
}
# All that is not fitted, and where it comes from; names of the slide begin with ``slide_``.
_SOFT = "numerical: of a contact, see notebook 43"
ASSUMED = {
    "particle_friction": "assumed: wood on wood, handbooks give 0.25 to 0.5",
    "wall_friction": "assumed: wood on metal, handbooks give 0.2 to 0.6",
    "spinning_mm": "assumed",
    "belt_time_s": _SOFT,
    "slip_time_s": _SOFT,
    "body_time_s": _SOFT,
    "body_damping": _SOFT,
    "slide_angle_deg": "assumed",
    "slide_friction": "assumed: wood on steel, handbooks give 0.2 to 0.6",
    "slide_width_mm": "read off the authors' tracks",
    "slide_rate_1_s": "read off the authors' tracks",
}


def all_values(found: FreeValues) -> pd.DataFrame:
    """Return every value of contacts and slide: ``value``, before and after the fit, ``source``.

    The direction of what lies on the slide is left out: it is any.
    """
    rows = [
        (name, value, getattr(found, name), "fitted to the authors' spheres")
        for name, value in asdict(INPUTS_ONLY).items()
    ]
    contacts, slide = Contacts(), Slide()
    for name, source in ASSUMED.items():
        part = slide if name.startswith("slide_") else contacts
        value = getattr(part, name.removeprefix("slide_"))
        rows.append((name, value, value, source))
    return pd.DataFrame(rows, columns=["value", "inputs_only", "found_with_spheres", "source"])


def targets() -> dict[str, object]:
    """Return what the fit is held against, as it is hashed: the file, the places, the scales."""
    spheres = data.BELT_DEM["spheres"]
    return {"sha256": data.SHA256[spheres], "places_mm": PLACES_MM.tolist(), "scales": SCALES}


def record(path: Path = FILE) -> dict[str, Any]:
    """Return the content of the frozen file; see `cache.read_calibration` for what is refused."""
    return cache.read_calibration(path, targets(), "kilnflight.belt.calibration")


@lru_cache(maxsize=8)
def calibrated(path: Path = FILE) -> FreeValues:
    """Return the frozen values; see `record` for what is refused."""
    return cache.calibrated(FreeValues, path, record(path))


def calibrated_sorter() -> Sorter:
    """Return the sorter with the frozen values."""
    return calibrated().applied(Sorter())
