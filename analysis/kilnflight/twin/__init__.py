"""The twin: a kiln whose truth is known.

::

    particles -> flight (gas, burning) -> life -> picture, background, camera
        -> scene (a recording) -> truth

It never sees a method, and no method sees it. Every coefficient is a field with unit and
source: published, handbook, or assumption. Six of flight and ignition are fitted to two of the
eight campaigns, seven of the picture to Otsu's row of Table 5.5 (`fitted`). Nothing is tuned to
the outcome of any other measuring method.

==========  =====================================================================
module      content
==========  =====================================================================
camera      kiln, lance and camera; light into grey values; depth and its error
gas         stream and jet; drag, heat transfer, conduction
particles   the feed: sizes, masses, material, handfuls and their times
burning     the state of a particle in flight: heating, ignition, burning
flight      from the lance to the end
life        all particles of a scene at any moment
background  the picture without particles
picture     particles as ellipses in the picture, marked as by a person
scene       `Scene` and `Twin`, its recording
scenes      the five subsets, the eight campaigns, the scenarios
truth       tables of the truth; true velocities and dwell times of flights
fitted      the few fitted inputs (calibrated.json, exposure.json)
==========  =====================================================================
"""
