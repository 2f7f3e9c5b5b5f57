"""The twin: a kiln whose truth is known.

::

    fractions, feed -> flight (gas, forces, burning, state) -> life
        -> appearance, background, optics -> drawing, depth -> scene (a recording) -> truth

It never sees a method, and no method sees it. Every coefficient is a field with unit and
source: published, handbook, or assumption. Six of flight and ignition are fitted to two of the
eight cells (`calibration`), seven of the picture to Otsu's row of Table 5.5 (`exposure`). Nothing
is tuned to the outcome of any other measuring method.

===========  =====================================================================
module       what it holds
===========  =====================================================================
geometry     kiln, lance and camera; pixel <-> mm <-> kiln coordinates
gas          stream and jet: velocity and temperature
fractions    what is fed: sizes, masses, material
feed         when it is fed: handfuls
forces       drag, heat transfer, conduction
state        what a particle is while it flies
burning      heating, ignition, burning
flight       from the lance to the end
life         every particle of a scene at any moment
optics       light, exposure, noise
background   the picture without particles
appearance   particles as ellipses in the picture
drawing      ellipses into pixels; what a person would mark
depth        who has depth, and how wrong it is
scene        `Scene` and `Twin`, its recording
truth        tables of what is true
outcomes     what flights come to: velocities, dwell times, ignition
statements   the published sentences that an outcome answers
calibration  the few free inputs, fitted to two cells and frozen (calibrated.json)
exposure     the few free inputs of the picture, fitted to Otsu's row and frozen (exposure.json)
mixture      how much to feed to see what Table 5.2 counts
scenes       the five subsets, the eight campaigns, the scenarios
===========  =====================================================================
"""
