"""The scenes of the thesis: five ground-truth subsets and eight campaigns, and variations.

``open_scene(name)`` gives the recording. Lengths and frame rates are published (sections
5.1.1, 5.2.3, appendix A.1). How many particles were fed is not; the rates follow from the
trajectories in the windows of Table 5.15 (`feed_rate`). Flight and ignition have the frozen
inputs of `kilnflight.twin.calibration`, the picture those of `kilnflight.twin.exposure`; the
scenario ``inputs-only`` has the untouched ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilnflight.checks import InputError
from kilnflight.twin.calibration import INPUTS_ONLY, calibrated
from kilnflight.twin.exposure import UNTOUCHED, exposed
from kilnflight.twin.feed import by_hand
from kilnflight.twin.flight import Flight
from kilnflight.twin.fractions import FRACTIONS
from kilnflight.twin.gas import Gas
from kilnflight.twin.mixture import SUBSETS, subset
from kilnflight.twin.optics import Optics
from kilnflight.twin.outcomes import PRESSURES_BAR
from kilnflight.twin.scene import Scene, Twin

# Handfuls found by `python -m kilnflight.twin.mixture` against Table 5.2, and their seed.
SIZES: dict[str, dict[str, int]] = {
    "V1": {"flying": 198, "unlit": 29, "landed": 123},
    "V2": {"flying": 108, "unlit": 12, "landed": 321},
    "V3": {"flying": 44, "unlit": 14, "landed": 243},
    "V4": {"flying": 339, "unlit": 5, "landed": 334},
    "V5": {"flying": 25, "unlit": 73, "landed": 86},
}

# Particles per second: trajectories of Table 5.15 over window and median dwell time (0.3 to
# 0.5 s, section 5.3.1; 0.4 s taken). A trajectory counts when any part lies in the window.
WINDOWS: dict[str, tuple[int, int]] = {  # trajectories, frames
    "wood chip": (7, 300),
    "confetti": (37, 300),
    "paper shred": (32, 100),
    "PE granule": (25, 300),
}
# First frames of these windows in the thesis's recordings.
STARTS = {"wood chip": 100, "confetti": 200, "paper shred": 550, "PE granule": 200}
DWELL_S = 0.4
# Frames at 4.5 and 5 bar (appendix A.1).
LENGTHS: dict[str, tuple[int, int]] = {
    "wood chip": (3102, 3234),
    "confetti": (3126, 3286),
    "paper shred": (3000, 3002),
    "PE granule": (3029, 3113),
}
PE_RATE_HZ = 153.85  # longer exposure for small transparent granules (sec. 5.2.3)
RATE_HZ = 330.0  # sec. 2.1.4


def frame_rate(fraction: str) -> float:
    """Return the frame rate in Hz at which a fraction was recorded."""
    return PE_RATE_HZ if fraction == "PE granule" else RATE_HZ


def feed_rate(fraction: str) -> float:
    """Return how many particles per second are fed."""
    trajectories, frames = WINDOWS[fraction]
    return trajectories / (frames / frame_rate(fraction) + DWELL_S)


def campaign(fraction: str, pressure_bar: float, seed: int = 0) -> Scene:
    """Return the recording of one fraction at one pressure, as long as the thesis's."""
    if fraction not in FRACTIONS or pressure_bar not in PRESSURES_BAR:
        raise InputError(
            f"no campaign with {fraction!r} at {pressure_bar} bar; there are "
            f"{', '.join(FRACTIONS)} at {' and '.join(map(str, PRESSURES_BAR))} bar."
        )
    place = (list(FRACTIONS).index(fraction), PRESSURES_BAR.index(pressure_bar))
    frames, rate = LENGTHS[fraction][place[1]], frame_rate(fraction)
    generator = np.random.default_rng([seed, 401, *place])
    duration = frames / rate
    count = round(feed_rate(fraction) * (duration + 1.0))
    optics = Optics() if rate == RATE_HZ else Optics(exposure_s=6.0e-3)
    flight, gas = calibrated().applied(Flight(), Gas(pressure_bar=pressure_bar))
    scene = Scene(
        name=f"{fraction.replace(' ', '-').lower()}-{pressure_bar:.1f}-bar",
        feed=by_hand(FRACTIONS[fraction], count, duration, generator),
        frames=frames,
        seed=1000 * seed + 10 * place[0] + place[1] + 100,
        frame_rate_hz=rate,
        fraction=fraction,
        gas=gas,
        flight=flight,
        optics=optics,
    )
    return exposed().applied(scene)


def tracking_window(twin: Twin, step: int = 10) -> range:
    """Return the frames of a campaign on which its tracking is scored (Table 5.15).

    The thesis followed the trajectories of a stretch by hand and prints its frames and their
    number. Fed in bursts, the same frames of another recording hold another number, so the
    stretch of the same length is taken in which nearest to as many particles fly, the one
    that starts nearest to the published frame among equals. The truth is asked, no picture.

    Parameters
    ----------
    twin
        A campaign.
    step
        Stretches start at its multiples.
    """
    fraction = twin.scene.fraction
    if fraction not in WINDOWS:
        raise InputError(f"{twin.scene.name}: Table 5.15 has no {fraction!r}; open a campaign.")
    wanted, length = WINDOWS[fraction]
    starts = np.arange(0, len(twin) - length + 1, step)
    table, rate = twin.life.table, twin.scene.frame_rate_hz
    released = table["release_s"].to_numpy() * rate
    ended = released + table["end_s"].to_numpy() * rate
    flying = (released < starts[:, None] + length) & (ended > starts[:, None])
    off = np.abs(flying.sum(axis=1) - wanted)
    best = np.lexsort((np.abs(starts - STARTS[fraction]), off))[0]
    return range(int(starts[best]), int(starts[best]) + length)


def ground_truth(name: str, seed: int = 0) -> Scene:
    """Return a ground-truth subset, V1 to V5: 160 frames, of which 75 to 84 are labelled."""
    if name not in SUBSETS:
        raise InputError(f"no subset {name!r}; there are {', '.join(SUBSETS)}.")
    number = SUBSETS.index(name) + 1
    return subset(name, SIZES[name], 1000 * seed + number)


def _untouched(scene: Scene) -> Scene:
    flight, gas = INPUTS_ONLY.applied(scene.flight, scene.gas)
    return UNTOUCHED.applied(replace(scene, flight=flight, gas=gas))


def small(scene: Scene) -> Scene:
    """Return a scene seen by a camera with a quarter of the rows and columns: for trying out."""
    place, around, depth = scene.geometry, scene.surroundings, scene.depth
    pixel = (place.lance_pixel[0] / 4, place.lance_pixel[1] / 4)
    top, bottom, left, right = (edge // 4 for edge in around.flame_roi)
    return replace(
        scene,
        geometry=replace(
            place,
            lance_pixel=pixel,
            focal_length_px=place.focal_length_px / 4,
            rows=place.rows // 4,
            columns=place.columns // 4,
        ),
        surroundings=replace(
            around,
            flame_roi=(top, bottom, left, right),
            edge_px=around.edge_px // 4,
        ),
        depth=replace(depth, wall_points=depth.wall_points // 16, patch_px=depth.patch_px // 4),
    )


# One line each: what is only bounded by what was published, at other values.
SCENARIOS = {
    "base": lambda scene: scene,
    "small": small,
    "inputs-only": _untouched,
    "axis-0": lambda s: replace(s, geometry=replace(s.geometry, axis_height_mm=0.0)),
    "axis-400": lambda s: replace(s, geometry=replace(s.geometry, axis_height_mm=400.0)),
    "lance-6000": lambda s: replace(s, geometry=replace(s.geometry, lance_depth_mm=6000.0)),
    "lance-7500": lambda s: replace(s, geometry=replace(s.geometry, lance_depth_mm=7500.0)),
    "depth-error-half": lambda s: replace(s, depth=replace(s.depth, scale=0.5)),
    "depth-error-double": lambda s: replace(s, depth=replace(s.depth, scale=2.0)),
    "depth-bias": lambda s: replace(s, depth=replace(s.depth, static_bias=0.03)),
    "no-jet": lambda s: replace(s, gas=replace(s.gas, jet_persistence=0.0)),
    "full-jet": lambda s: replace(s, gas=replace(s.gas, jet_persistence=1.0)),
    "flames-hold": lambda s: replace(s, flight=replace(s.flight, extinction_1_s=np.inf)),
    # the calibrated value is near 280; half of it
    "flames-blow-off": lambda s: replace(s, flight=replace(s.flight, extinction_1_s=140.0)),
}


def names() -> tuple[str, ...]:
    """Return the names of all scenes."""
    runs = [campaign(one, bar).name for one in FRACTIONS for bar in PRESSURES_BAR]
    return (*SUBSETS, *runs)


def open_scene(name: str, seed: int | None = None) -> Twin:
    """Return the recording of a scene; ``name@scenario`` varies it.

    Raises
    ------
    InputError
        If there is no such scene or scenario, or the seed is negative.

    Examples
    --------
    >>> len(open_scene("V1@no-jet"))
    160
    """
    plain, _, scenario = name.partition("@")
    scenario = scenario or "base"
    if plain not in names() or scenario not in SCENARIOS:
        raise InputError(
            f"no scene {name!r}; there are {', '.join(names())}, each with @ and one of "
            f"{', '.join(SCENARIOS)}."
        )
    number = seed or 0
    if number < 0:
        raise InputError(f"scene {name}: seed is {number}, expected 0 or more.")
    if plain in SUBSETS:
        scene = ground_truth(plain, number)
    else:
        runs = {campaign(one, bar).name: (one, bar) for one in FRACTIONS for bar in PRESSURES_BAR}
        scene = campaign(*runs[plain], number)
    varied = SCENARIOS[scenario](scene)
    return Twin(varied if scenario == "base" else replace(varied, name=name))
