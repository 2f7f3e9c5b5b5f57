r"""The belt sorter: when and where a particle leaves the belt.

The 2016 and 2020 papers::

    pictures -> spots -> camera's calibration -> tracker -> last states            (2016)
    tracks -> PredictionPhase -> last observation -> arrival model -> lateral model
                              \-> observed arrival -----------------> deviation  (2020)
                                              predictions -> events of valves -> separation

`online` does the same picture by picture, as a running sorter.

Pictures and tracks (of `kilnflight.sorter`, or the authors' in `recordings`) are input. The
tracker takes filter, gate and assignment from the kiln's.

==========  ==========  ===========================================  ================
arrival     equation    parameter from calibration                   reference
==========  ==========  ===========================================  ================
`ID`        t_L + t_A   median delay (beside the models compared)    sec. 4.1
`IV`        Eq. 1       median velocity in the prediction phase      sec. 4.1
`CV`        Eq. 3       none                                         sec. 4.1
`CVBC`      Eq. 3       median delay of CV (bias)                    sec. 4.1
`CA`        Eqs 5, 6    none                                         sec. 4.1
`CALV`      Eqs 5, 6    none; limit 1500 mm/s (belt velocity)        sec. 4.1
`IA`        Eq. 5       median acceleration that would have fitted   sec. 4.1
==========  ==========  ===========================================  ================

==========  ==========  ===========================================  ================
lateral     equation    parameter from calibration                   reference
==========  ==========  ===========================================  ================
`Straight`  y = y_Last  none                                         sec. 4.2
`CV`        Eq. 3       none                                         sec. 4.2
`CA`        Eq. 7       none                                         sec. 4.2
`CADSC`     Eq. 7       none                                         sec. 4.2
`Ratio`     Eq. 7       median share of lateral velocity that stays  sec. 4.2
==========  ==========  ===========================================  ================

The room is over its plan of 1500 lines by some 35: what a running sorter must notice (another
light, a belt that stands or drifts, commands that are due) was not in the plan.
"""

from kilnflight.belt import models
from kilnflight.belt.models import ArrivalModel, LateralModel
from kilnflight.belt.phase import PredictionPhase

ARRIVAL_MODELS: tuple[ArrivalModel, ...] = (
    models.IV(),
    models.CV(),
    models.CVBC(),
    models.CA(),
    models.CALV(),
    models.IA(),
)
LATERAL_MODELS: tuple[LateralModel, ...] = (
    models.Straight(),
    models.LateralCV(),
    models.LateralCA(),
    models.CADSC(),
    models.Ratio(),
)
# The seven combinations of Fig. 10: name on the axis, arrival model, lateral model.
COMBINATIONS: tuple[tuple[str, ArrivalModel, LateralModel], ...] = (
    ("Straight", models.CV(), models.Straight()),
    ("CV-CV", models.CV(), models.LateralCV()),
    ("CA-CA", models.CA(), models.LateralCA()),
    ("LV-DSC", models.CALV(), models.CADSC()),
    ("IA-CV", models.IA(), models.LateralCV()),
    ("IA-CA", models.IA(), models.LateralCA()),
    ("IA-Ratio", models.IA(), models.Ratio()),
)

__all__ = ["ARRIVAL_MODELS", "COMBINATIONS", "LATERAL_MODELS", "PredictionPhase"]
