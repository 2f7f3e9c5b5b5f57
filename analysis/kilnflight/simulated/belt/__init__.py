"""The camera of the belt sorter, and a small model of the belt.

::

    the authors' tracks, or the friction model -> pictures at 200 frames/s

`kilnflight.belt` measures and predicts; it never sees this room, and nothing here sees
a prediction.

==========  =====================================================================
module      content
==========  =====================================================================
bulk        particles: shapes, sizes and counts
friction    a model of the belt, where the authors' tracks are not at hand
rendering   the camera's pictures of tracks
==========  =====================================================================
"""
