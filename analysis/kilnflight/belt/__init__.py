r"""The belt sorter: when and where a particle leaves the belt (2016 and 2020 papers).

    pictures -> spots -> homography -> tracker -> crossing                      (2016)
    tracks -> PredictionPhase -> last observation -> arrival model -> lateral model
                              \-> what happened --------------------> deviation  (2020)
                                              predictions -> separation by valves

The camera's pictures (`pictures`, `view`) and bodies (`simulation`, `friction`, the authors'
`dem` and `recordings`) are input; `predictive` writes the evaluation of 2016 out, `sorting`
that of the valves. The tracker takes filter, gate and assignment from the kiln's.

==========  ==========  ==========================================  ================
arrival     equation    parameter from calibration                  reference
==========  ==========  ==========================================  ================
`IV`        Eq. 1       median velocity in the prediction phase     sec. 4.1
`CV`        Eq. 3       none                                        sec. 4.1
`CVBC`      Eq. 3       median delay of CV (bias)                   sec. 4.1
`CA`        Eqs 5, 6    none                                        sec. 4.1
`CALV`      Eqs 5, 6    none; limit 1500 mm/s (belt velocity)       sec. 4.1
`IA`        Eq. 5       median acceleration that would have fitted  sec. 4.1
==========  ==========  ==========================================  ================

==========  ==========  ==========================================  ================
lateral     equation    parameter from calibration                  reference
==========  ==========  ==========================================  ================
`Straight`  y = y_Last  none                                        sec. 4.2
`CV`        Eq. 3       none                                        sec. 4.2
`CA`        Eq. 7       none                                        sec. 4.2
`CADSC`     Eq. 7       none                                        sec. 4.2
`Ratio`     Eq. 7       median share of lateral velocity that stays  sec. 4.2
==========  ==========  ==========================================  ================

Where tracks come from: `dem` reads the authors', `simulation` makes our own (MuJoCo: `bulk`
and `slide` and `conveyor` say what, `physics` how it touches, `batch` runs it, `machine` joins
them, `calibration` found the `friction_values`, `contact_study` varies the rest), `friction` is
the model without contacts that needs nothing installed. `sampling` thins tracks, `columns` are
what models take of them, checked once, `answers` puts the claims to them, `touching` counts who
was seen as one with another.
"""

from kilnflight.belt import arrival, lateral
from kilnflight.belt.arrival import ArrivalModel
from kilnflight.belt.lateral import LateralModel
from kilnflight.belt.phase import PredictionPhase

ARRIVAL_MODELS: tuple[ArrivalModel, ...] = (
    arrival.IV(),
    arrival.CV(),
    arrival.CVBC(),
    arrival.CA(),
    arrival.CALV(),
    arrival.IA(),
)
LATERAL_MODELS: tuple[LateralModel, ...] = (
    lateral.Straight(),
    lateral.CV(),
    lateral.CA(),
    lateral.CADSC(),
    lateral.Ratio(),
)
# The seven combinations of Fig. 10: name on the axis, arrival model, lateral model.
COMBINATIONS: tuple[tuple[str, ArrivalModel, LateralModel], ...] = (
    ("Straight", arrival.CV(), lateral.Straight()),
    ("CV-CV", arrival.CV(), lateral.CV()),
    ("CA-CA", arrival.CA(), lateral.CA()),
    ("LV-DSC", arrival.CALV(), lateral.CADSC()),
    ("IA-CV", arrival.IA(), lateral.CV()),
    ("IA-CA", arrival.IA(), lateral.CA()),
    ("IA-Ratio", arrival.IA(), lateral.Ratio()),
)

__all__ = ["ARRIVAL_MODELS", "COMBINATIONS", "LATERAL_MODELS", "PredictionPhase"]
