"""The simulated sorter: a belt, its feed and its camera, of which everything is known.

::

    feeder and slide -> bodies on the belt -> tracks at 1000 Hz -> pictures at 200 frames/s

It stands for the sorter that both papers simulate. `kilnflight.belt` measures and predicts; it
never sees this room, and nothing here sees a prediction.

==========  =====================================================================
module      content
==========  =====================================================================
machine     particles, slide, belt and contacts: sizes, counts, coefficients
bodies      bodies on the belt, moved by MuJoCo
simulation  the sorter with its fitted values (friction_values.json); cached tracks
friction    a small model without contacts, where MuJoCo is not installed
rendering   the camera's pictures of tracks
==========  =====================================================================
"""
