r"""Flights: their start, end, dwell time and velocity (section 5.3.1).

::

    track + fitted trajectory -> from the lance? -> landing -> can it be? -> ignition -> dwell time
                              \-> space-sliced velocity
"""

from kilnflight.flight.criteria import (
    BEHIND,
    LEAVES,
    TOO_FAST,
    FlightEnd,
    Landing,
    Plausible,
    StartsAtLance,
    straight_on,
)
from kilnflight.flight.table import (
    BURNT_OUT,
    LANDED,
    LOST,
    FieldOfView,
    Rules,
    flights,
    kept,
)
from kilnflight.flight.velocity import remaining, slices, space_sliced_velocity

__all__ = [
    "BEHIND",
    "BURNT_OUT",
    "LANDED",
    "LEAVES",
    "LOST",
    "TOO_FAST",
    "FieldOfView",
    "FlightEnd",
    "Landing",
    "Plausible",
    "Rules",
    "StartsAtLance",
    "flights",
    "kept",
    "remaining",
    "slices",
    "space_sliced_velocity",
    "straight_on",
]
