"""The twin: a kiln whose truth is known, in which particles fly and burn as printed.

::

    inputs, fuel, laws -> feeding -> life -> picture, background, lenses -> scene, truth

It never sees a method, and no method sees it. Every input has unit and source:
published, handbook, fitted or assumption. data/reference/twin_inputs.csv lists the main
ones. Flights were fitted to printed numbers, the light to Otsu's row of Table 5.5, the
depth to Tables 5.2 and 5.18, and nothing to the outcome of any other method.

==========  =====================================================================
module      content
==========  =====================================================================
geometry    kiln, lance and camera: where things are, and where they are seen
fuel        sizes of the particles of four fractions
laws        paths, landing and ignition as formulas of time
inputs      `Scene`: everything that determines a recording
feeding     handfuls of a campaign, chosen particles of a labelled subset
life        all particles of a recording at any moment
light       grey values of wall, particles and flames, and noise
background  the picture without particles
picture     particles as ellipses in the picture, marked as by a person
lenses      depth, made from the picture on the grid of micro-lenses
scene       `Twin`, the recording of a scene
scenes      the five subsets, the eight campaigns, the scenarios
truth       tables of the truth; true velocities and dwell times of flights
==========  =====================================================================
"""
