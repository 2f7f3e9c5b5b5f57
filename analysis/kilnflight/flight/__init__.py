"""Flights: start, end, dwell time and velocity (section 5.3.1).

A track and its fitted trajectory give the start at the lance, the end on the wall or in
the air, the ignition, the dwell time (`flights`), and the velocity in each metre
(`space_sliced_velocity`).
"""

from kilnflight.flight.criteria import BEHIND, LEAVES, TOO_FAST, Plausible, straight_on
from kilnflight.flight.table import (
    BURNT_OUT,
    LANDED,
    LEFT,
    LOST,
    FieldOfView,
    Rules,
    flights,
    kept,
)
from kilnflight.flight.velocity import reaching, slices, space_sliced_velocity
