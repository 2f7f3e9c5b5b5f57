"""kilnflight: how to see particles fly, as a package that can be checked.

One particle enters as light on a sensor and leaves as a number in a report::

    kiln:  recording -> background -> detection -> combination -> tracking
               -> tracklets -> regression -> flight --+
                                                      |
    belt:  pictures -> tracks -> prediction phase     +-> notebook -> figure -> site
               -> arrival and lateral models ---------+

What each module does:

==============  ================================================================
module          step
==============  ================================================================
frames          what a plenoptic camera delivers: frames, attributes, recordings
recording       recordings on disk: write, go on after a kill, open
storage         how a recording lies on disk
importing       your own recordings, by a manifest
sources         the kinds of files a manifest names
readers         one file of any format -> one array
report          what a recording holds, in numbers
__main__        the command line: import, export, info, detect, track, run
twin            a kiln whose truth is known: flights, combustion, camera, scenes
background      six background models, section 2.2.1 of the thesis: what moves stays
detection       a foreground or a cloud -> particles: Otsu, DoG; DBSCAN, MO, QCC
camera          depth calibration, Eq. 2.4 of the thesis, and the fit that leads to it
thermography    temperature profile of the wall, Fig. 2.4 of the thesis
flame           the burner's flame, found and taken out (chapter 3.1)
combination     pictures against clouds: the five cases of chapter 3.1
motion          how a particle moves: constant velocity, constant acceleration
kalman          predict and update of all tracks at once
gating          which detections a track may take: the 2.5D gate, Eq. 4.8
association     gated pairs -> weights: NN, GNN, PDA, exact JPDA, sections 2.3 and 4.1.3
tracklist       which tracks are alive, Eq. 4.14
tracking        detections -> tracks: predict, gate, associate, update, start, stop
tracklets       tracklets -> trajectories, chapter 4.2: eliminate, outliers, connect, fuse
regression      trajectories -> polynomials through the lance's exit at one t0, chapter 4.3
slicing         space-sliced velocity, Eq. 5.8: how fast over each metre from the lance
landing         when a trajectory meets the wall
ignition        when a particle ignites: an abrupt, lasting rise of its grey values
ignition_power  how probably such a rise is seen
steps           one step in a course of values, and whether chance makes it
flight          tracks and trajectories -> flights: start, ending, dwell time, section 5.3
intervals       confidence intervals: bootstrap over particles, shares
kiln            the whole life of a frame, written out once
keeping         tables that are made once and kept, under the hash of what went in
origins         where a recording comes from: the twin, a folder
workers         processes of this machine, or a Dask cluster
stages          detections of long recordings, chunk by chunk
backdrop        grey values of what is behind a detection
pipeline        a whole recording from its detections to its flights
campaigns       the thesis's eight campaigns on the twin
own             a recording of one's own, made ready for the whole way
outcome         what came out of it, in a short table
outcome_page    and as a page
differences     sums of frame differences in small boxes
pursuit         trackers on stretches of campaigns, scored
survey          what campaigns come to, beside printed and true numbers
trust           flights with one step after the other replaced by the truth
deviations      measured minus true: bias, spread, what is found and resolved
certainty       an interval for every kind of number, and what it can tell apart
flight_drawing  boxes, velocity by metre, curves in space
definitions     dwell time and space-sliced velocity drawn on flights
contest         settings of trackers, chosen on stretches of campaigns
ladders         values of their parameters that may be tried
lessons         what the labelled frames teach for recordings without labels
trial           detectors on labelled frames, counted
contenders      the detectors that are compared, with their parameters
tallies         counts summed over frames: rates, recall by class, intervals
peaks           grey-value peaks in small areas
evidence        what the grey values of an area say about a detection
correspondence  which keypoints and clusters are one potential particle
cylinder        the kiln's wall, distance to its axis, in air or on the wall
mlesac          robust fit of a cylinder to points
matching        pairs of places within a gate, by the Hungarian method
belt            the sorter of both papers: simulation, pictures, tracker, motion models,
                deviations, separation
sorter          the belt experiment, from tracks to deviations
findings        what many flights come to: the numbers of section 5.3
scores          detections and tracks against the truth: precision, recall, F1; alpha,
                beta, JSC
peers           trackpy, laptrack and Stone Soup, called as our tracker
track_files     tracks as other programs write and read them
reference       published values and claims: load, compare, verdict
errata          the published tables recomputed
figures         the one way to save a figure or table
drawing         how a figure looks
provenance      where a figure comes from
gallery         the page of figures/, with captions and citations
chain           a notebook's text -> an executed notebook
pages           executed notebooks -> a site that needs no network
external        the authors' public data: fetch, check, find
tables          columns, units and checks of every table that is handed on
checks          how input is looked at: columns, shapes, numbers
errors          the one kind of error about input
files           files that are there whole or not at all
frozen          what a calibration wrote once: with a hash, read only whole
places          where the project's folders are
==============  ================================================================
"""

__version__ = "0.1.0"
