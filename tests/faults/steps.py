"""Public steps, each with arguments that are right, and faults that are documented as
allowed.
"""

import warnings
from functools import partial

import numpy as np
import pandas as pd
from tests.recording.test_files import FILM, KINDS
from tests.test_contracts import (
    CLUSTERERS,
    DETECTORS,
    EXIT,
    blobs,
    cloud,
    flights,
    one_flight,
)

import kilnflight
from kilnflight import background, belt, camera, flight
from kilnflight.association import joint_probabilities
from kilnflight.belt.camera import BeltCorners, calibrate_camera
from kilnflight.belt.phase import Observed, PredictionPhase
from kilnflight.belt.tracker import BeltTracker
from kilnflight.checks import InputError
from kilnflight.detection import wall
from kilnflight.detection.region import inside
from kilnflight.ignition import Ignition
from kilnflight.recording.files import open_any
from kilnflight.recording.store import write_recording
from kilnflight.recording.track_files import read_table, write_table
from kilnflight.regression import fits, regress, regress_all
from kilnflight.scores import intervals, rates, score_detections, score_tracks
from kilnflight.tracking import track
from kilnflight.tracklets import STEPS, Cutting, postprocess


def on_belt():
    """Five particles on the belt at 100 Hz, which all reach the valves."""
    frame, particle = np.divmod(np.arange(200), 5)
    time = frame / 100
    x, y = 400 + (1200 + 20 * particle) * time, 20 + 30.0 * particle + 15 * time
    table = pd.DataFrame(
        {"frame": frame, "particle": particle, "time_s": time, "x": x, "y": y}
    )
    return table[x < 900].reset_index(drop=True)


def models(last, arrival):
    """Return what every model of the belt predicts after its calibration."""
    arrives = [
        m.calibrated(last, arrival, 788.0)(last, 788.0) for m in belt.ARRIVAL_MODELS
    ]
    left = arrives[2] - np.asarray(last["time_s"], float)
    return arrives + [
        m.calibrated(last, arrival)(last, left) for m in belt.LATERAL_MODELS
    ]


def scored(axes, truth, candidate, gate):
    """Return the four measures of tracks."""
    score = score_tracks(truth, candidate, gate, axes)
    return score.alpha, score.beta, score.jsc, score.jsc_theta


RNG = np.random.default_rng(0)
TRACKS = flights()
PIXELS = TRACKS[["frame", "particle", "row", "col"]]
FLOWN = one_flight().assign(particle=0)
KILN = wall.Cylinder((0.0, 0.0, 5000.0), (0.0, 0.0, 1.0), 2000.0)
PHASE = PredictionPhase(target_mm=788.0)
SEEN = PHASE.observe(on_belt())
MANY = np.arange(30.0)
CORNERS = np.array([[50.0, 40.0], [50.0, 500.0], [250.0, 500.0], [250.0, 40.0]])
ANGLE = RNG.random(200) * 6
PIPE = np.stack(
    [2000 * np.cos(ANGLE), 2000 * np.sin(ANGLE), 5000 + 3000 * RNG.random(200)], 1
)
LIT, FIT = 500.0 + (np.arange(40) > 20) * 900.0, regress(FLOWN, EXIT, 100.0)
FITTED = regress_all(FLOWN, EXIT, 100.0)
FILE = TRACKS.assign(gray=500.0)[["frame", "particle", "row", "col", "gray", *"xyz"]]
GAPS = "x:nan y:nan z:nan"
DEPTH = (
    "z:missing points:nan points:missing points:below points:far+below "
    f"points:a+fraction points:beyond {GAPS}"
)

# call, arguments, faults that change nothing or are documented
STEPS_AND_INPUT = {
    "score_tracks": (partial(scored, ["row", "col"]), {"truth": PIXELS, "candidate": PIXELS, "gate": 5.0}, "frame:below"),
    "score in mm": (partial(scored, ["x", "y", "z"]), {"truth": FLOWN, "candidate": FLOWN, "gate": 5.0}, "frame:below"),
    "score_detections": (score_detections, {"truth": cloud()[:9, :2], "detected": cloud()[:8, :2], "gate": 9.0}, ""),
    "rates": (rates, {"true_positives": MANY, "false_positives": MANY, "false_negatives": MANY}, "*:deeper"),
    "percentiles": (intervals.percentiles, {"values": MANY}, ""),
    "median": (lambda values: intervals.median_interval(values, np.random.default_rng(0)), {"values": MANY}, ""),
    **{f"cluster {k}": (each, {"points": cloud()}, "") for k, each in enumerate(CLUSTERERS)},
    **{f"detect {k}": (each, {"foreground": blobs([(30, 40), (60, 90)])}, "") for k, each in enumerate(DETECTORS)},
    **{
        f"background {k}": (lambda frames, each=each: list(each(frames, range(5))), {"frames": FILM}, "frames:truths")
        for k, each in enumerate(background.MODELS)
    },
    "joint": (joint_probabilities, {"likelihood": RNG.random((4, 5)), "nonassignment": np.ones(4)}, "*:huge"),
    "track": (track, {"detections": TRACKS.drop(columns="particle")}, f"{DEPTH} x:* y:*"),
    "kilnflight.track": (partial(kilnflight.track, post_processing=False), {"detections": TRACKS.drop(columns="particle")}, f"{DEPTH} x:* y:*"),
    "postprocess": (postprocess, {"tracks": PIXELS}, "frame:below"),
    **{f"step {k}": (each, {"tracks": PIXELS}, "frame:below") for k, each in enumerate(STEPS)},
    "cutting": (Cutting(), {"tracks": TRACKS.drop(columns="points"), "frame_rate_hz": 100.0}, f"{GAPS} frame:below x:missing y:missing z:missing"),
    "regress": (regress, {"track": FLOWN, "exit_point": np.array(EXIT), "frame_rate_hz": 100.0}, f"{GAPS} frame:below particle:* frame_rate_hz:none"),
    "regress_all": (regress_all, {"tracks": FLOWN, "exit_point": np.array(EXIT), "frame_rate_hz": 100.0}, f"{GAPS} frame:below frame_rate_hz:none"),
    "fits": (fits, {"trajectories": FITTED}, " ".join(f"{name}:nan" for name in FITTED.columns[-12:])),
    "Fit": (FIT, {"time_s": np.linspace(0, 0.1, 9)}, "*:deeper"),
    "flights": (
        lambda tracks, frame_rate_hz: flight.flights(tracks, {0: FIT}, KILN, wall.InAir(), frame_rate_hz),
        {"tracks": FILE[FILE["particle"] == 0], "frame_rate_hz": 100.0}, f"{GAPS} frame:below",
    ),
    "space_sliced_velocity": (partial(flight.space_sliced_velocity, FIT), {"slice_m": 1.0}, ""),
    "ignition": (Ignition(), {"time_s": np.arange(40) / 100, "gray": LIT, "background": LIT - 100}, "background:none"),
    "calibrate_depth": (camera.calibrate_depth, {"z": MANY + 3500}, "*:deeper"),
    "calibrate_points": (partial(camera.calibrate_points, calibration=camera.EQUATION_2_4), {"captured_mm": PIPE}, ""),
    "invert_depth": (camera.invert_depth, {"true_mm": MANY[:3] + 4000}, "*:deeper"),
    "from_table": (camera.DepthCalibration.from_table, {"pairs": np.array([[1000.0, 1100.0], [5000.0, 5200.0]])}, ""),
    "inside": (inside, {"polygon": np.array([[0.0, 0], [0, 9], [9, 0]]), "row": MANY, "col": MANY}, "row:deeper col:deeper"),
    "fit_cylinder": (wall.fit_cylinder, {"points_mm": PIPE}, ""),
    "distance": (partial(wall.distance_to_axis, cylinder=KILN), {"points_mm": PIPE}, ""),
    "InAir": (partial(wall.InAir(), cylinder=KILN), {"points_mm": PIPE}, ""),
    "crossing": (wall.crossing, {"in_air_mm": RNG.random(30) * 700, "wall_mm": 700 + 300 * RNG.random(30)}, ""),
    "belt models": (models, {"last": SEEN.last, "arrival": SEEN.arrival.drop(columns="y")}, ""),
    "observe": (lambda tracks: [*PHASE.observe(tracks)][:2], {"tracks": on_belt()}, ""),
    "carry": (lambda last: PHASE.carry(Observed(last, SEEN.arrival, {})).last, {"last": SEEN.last}, "*:a+row+twice"),
    "belt tracker": (lambda measured: BeltTracker()(measured).states, {"measured": on_belt()[["frame", "x", "y"]]}, ""),
    "calibrate_camera": (lambda corners: calibrate_camera(BeltCorners(corners, np.ones(4))).matrix, {"corners": CORNERS}, ""),
    "square_displacements": (kilnflight.square_displacements, {"tracks": PIXELS}, "frame:below"),
    "plot_tracks": (lambda tracks: len(kilnflight.plot_tracks(FILM, tracks).axes[0].lines), {"tracks": PIXELS}, "frame:below"),
    "detect": (kilnflight.detect, {"source": blobs([(30, 40), (60, 90)])[None]}, "source:truths source:huge source:nan"),
}  # fmt: skip


def film(path):
    """Return all frames of a film; missing ones are said, which is as good as an error."""
    recording = open_any(path)
    if "missing" in str(recording.attributes.notes):
        raise InputError("frames are missing")
    recording.content()
    return [recording.gray(t) for t in range(len(recording))]


def stored(path):
    """Write a recording of another film."""
    write_recording(open_any(FILM), path)


def tracked(path):
    """Return the tracks of a table in a file; a doubt about its end is a refusal."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        table = read_table(path)
    if said:
        raise InputError(f"{said[0].message}")
    return kilnflight.track(table, post_processing=False)


FILES = {  # file or folder, what makes it, what reads it
    **{name: (kind[0], film) for name, kind in KINDS.items()},
    "s.zarr": (stored, film),
    "t.csv": (lambda path: write_table(FILE, path), tracked),
    "t.parquet": (lambda path: write_table(FILE, path), tracked),
    "t.xml": (lambda path: write_table(TRACKS, path, "challenge"), tracked),
}
