r"""Sort on a belt: when and where a particle leaves it.

The 2016 and 2020 papers::

    pictures -> spots -> camera's calibration -> tracker -> last states  (2016)
    tracks -> PredictionPhase -> last observation -> arrival, lateral model
                              \-> observed arrival -> deviation         (2020)
                                              predictions -> events of valves ->
                                              separation

`online` takes the same steps picture by picture, as a running sorter.

Pictures and tracks are input: those of `kilnflight.simulated.belt`, or the authors'
(`recordings`). Filter, gate and assignment are the kiln's.

==========  ==========  ===========================================  ================
arrival     equation    parameter from calibration                   reference
==========  ==========  ===========================================  ================
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
"""

from kilnflight.belt.models import ARRIVAL_MODELS, COMBINATIONS, LATERAL_MODELS
from kilnflight.belt.phase import PredictionPhase
