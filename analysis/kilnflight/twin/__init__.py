"""The twin: a kiln whose truth is known.

::

    particles -> flight (gas, burning) -> life -> picture, background, camera
        -> scene (a recording) -> truth

It never sees a method, and no method sees it. Every coefficient is a field with unit and
source: published, handbook, or assumption. A few are fitted (`fitted`). Nothing is tuned to the
outcome of any other measuring method. data/reference/twin_inputs.csv lists all of them.

==========  =====================================================================
module      content
==========  =====================================================================
camera      kiln, lance and camera; light into grey values; the depth of a plate
lenses      depth, made from the picture on the grid of micro-lenses
compiled    what laws share with numba: written once, for arrays and single particles
gas         stream and jet; drag, heat transfer, conduction
particles   the feed: sizes, masses, material, handfuls and their times
burning     the state of a particle in flight: heating, ignition, burning
plates      sheets that turn: normal, spin, force and heat
flight      from the lance to the end
life        all particles of a scene at any moment
light       Planck in the camera's band, flames that flicker
burner      lance and burner as bodies, and the burner's flame
background  the picture without particles
picture     particles as ellipses in the picture, marked as by a person
scene       `Scene` and `Twin`, its recording
scenes      the five subsets, the eight campaigns, the scenarios
truth       tables of the truth; true velocities and dwell times of flights
fitted      the few fitted inputs, and the kiln, light and depth camera made of them
==========  =====================================================================
"""
