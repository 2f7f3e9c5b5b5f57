"""The scenes of the thesis and variations.

There are five ground-truth subsets and eight campaigns.

``open_scene(name)`` gives the recording. Lengths and frame rates are published (sections 5.1.1,
5.2.3, appendix A.1). The number of fed particles is not. The rates of the campaigns follow from
the trajectories in the windows of Table 5.15, the handfuls of the subsets from the counts of
Table 5.2. Pose, flight, ignition and light have the inputs of `kilnflight.twin.fitted`.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError
from kilnflight.project import paths
from kilnflight.project.cache import code_hash, locked, write_whole
from kilnflight.twin.burning import VolatileIgnition
from kilnflight.twin.camera import Optics
from kilnflight.twin.fitted import second_depth, second_kiln, second_light
from kilnflight.twin.gas import Gas
from kilnflight.twin.particles import FRACTIONS, Burst, air_load, by_hand
from kilnflight.twin.scene import Scene, Twin

PRESSURES_BAR = (4.5, 5.0)  # sec. 5.2.1
SUBSETS = ("V1", "V2", "V3", "V4", "V5")  # section 5.1.1
FRAMES = 160  # of a subset
LABELLED = range(75, 85)  # ten frames of each, with 75 before and after for the backgrounds
RATE_HZ = 330.0  # sec. 2.1.4
PE_RATE_HZ = 153.85  # longer exposure for small transparent granules (sec. 5.2.3)

# The subsets differ in how many particles burn in the air, do not burn yet, and burn on the
# wall. All fractions are fed together; what differs is when the last handfuls were thrown in:
# sheets that have had time to ignite, chips and granules still on their way, and a mixture that
# has landed. Sheets of the subsets ignite within 0.1 s, and flame for as long: they were thrown in
# 0.1 to 0.4 s before.
# Fractions of each handful and their shares; start relative to the labelled frames, duration.
_MIXTURE = {"wood chip": 0.45, "PE granule": 0.45, "confetti": 0.06, "paper shred": 0.04}
_SHEETS = {"paper shred": 0.8, "confetti": 0.2}
HANDFULS: dict[str, tuple[dict[str, float], float, float]] = {
    "flying": (_SHEETS, -0.4, 0.3),
    "unlit": (_MIXTURE, -0.25, 0.25),
    "landed": (_MIXTURE, -0.85, 0.4),
}
# Particles of each, fitted to Table 5.2 (tag fits-2026-11).
SIZES: dict[str, dict[str, int]] = {
    "V1": {"flying": 126, "unlit": 34, "landed": 268},
    "V2": {"flying": 81, "unlit": 12, "landed": 645},
    "V3": {"flying": 22, "unlit": 14, "landed": 408},
    "V4": {"flying": 294, "unlit": 7, "landed": 788},
    "V5": {"flying": 1, "unlit": 84, "landed": 170},
}

# Windows of Table 5.15: trajectories, frames, and first frame in the thesis's recordings. A
# trajectory counts when any part lies in the window.
WINDOWS: dict[str, tuple[int, int]] = {
    "wood chip": (7, 300),
    "confetti": (37, 300),
    "paper shred": (32, 100),
    "PE granule": (25, 300),
}
STARTS = {"wood chip": 100, "confetti": 200, "paper shred": 550, "PE granule": 200}
DWELL_S = 0.4  # median, 0.3 to 0.5 s (sec. 5.3.1)
# Frames at 4.5 and 5 bar (appendix A.1).
LENGTHS: dict[str, tuple[int, int]] = {
    "wood chip": (3102, 3234),
    "confetti": (3126, 3286),
    "paper shred": (3000, 3002),
    "PE granule": (3029, 3113),
}


def handful(kind: str, count: int) -> tuple[Burst, ...]:
    """Return the bursts of one of the `HANDFULS` with ``count`` particles."""
    shares, start, duration = HANDFULS[kind]
    moment = LABELLED.start / RATE_HZ
    sizes = np.round(np.cumsum([0.0, *shares.values()]) * count).astype(int)
    return tuple(
        Burst(name, int(size), moment + start, duration)
        for name, size in zip(shares, np.diff(sizes), strict=True)
    )


def ground_truth(name: str, seed: int = 0) -> Scene:
    """Return a ground-truth subset, V1 to V5: 160 frames, of which 75 to 84 are labelled."""
    if name not in SUBSETS:
        raise InputError(f"no subset {name!r}; there are {', '.join(SUBSETS)}.")
    feed = sum((handful(kind, size) for kind, size in SIZES[name].items()), ())
    return second(Scene(name, feed, FRAMES, 1000 * seed + SUBSETS.index(name) + 1))


def campaign_name(fraction: str, pressure_bar: float) -> str:
    """Return the name of a campaign's scene."""
    return f"{fraction.replace(' ', '-').lower()}-{pressure_bar:.1f}-bar"


def campaign(fraction: str, pressure_bar: float, seed: int = 0) -> Scene:
    """Return the recording of one fraction at one pressure, as long as the thesis's.

    Particles per second are the trajectories of Table 5.15 over the time in which they can have
    begun: the window and a median dwell time.
    """
    if fraction not in FRACTIONS or pressure_bar not in PRESSURES_BAR:
        raise InputError(
            f"no campaign with {fraction!r} at {pressure_bar} bar; there are "
            f"{', '.join(FRACTIONS)} at {' and '.join(map(str, PRESSURES_BAR))} bar."
        )
    place = (list(FRACTIONS).index(fraction), PRESSURES_BAR.index(pressure_bar))
    granules = fraction == "PE granule"
    frames, rate = LENGTHS[fraction][place[1]], PE_RATE_HZ if granules else RATE_HZ
    generator = np.random.default_rng([seed, 401, *place])
    duration = frames / rate
    trajectories, window = WINDOWS[fraction]
    count = round(trajectories / (window / rate + DWELL_S) * (duration + 1.0))
    scene = Scene(
        name=campaign_name(fraction, pressure_bar),
        feed=by_hand(FRACTIONS[fraction], count, duration, generator),
        frames=frames,
        seed=1000 * seed + 10 * place[0] + place[1] + 100,
        frame_rate_hz=rate,
        fraction=fraction,
        gas=Gas(pressure_bar=pressure_bar),
        optics=Optics(exposure_s=6.0e-3) if granules else Optics(),
    )
    return second(scene)


def starting_and_lasting(
    twin: Twin, starts: npt.ArrayLike, length: int, lasting: int = 15
) -> npt.NDArray[np.intp]:
    """Return how many leave the lance and fly on in so many frames from each start.

    A particle counts if the lance releases it in them and it flies for ``lasting`` frames of them.
    15 is the time of `kilnflight.experiments.tracking_scores.from_lance`.
    """
    begin = np.asarray(starts)[:, None]
    table, rate = twin.life.table, twin.scene.frame_rate_hz
    released = table["release_s"].to_numpy() * rate
    ended = np.minimum(released + table["end_s"].to_numpy() * rate, begin + length)
    counted = (released >= begin) & (ended - released >= lasting)
    return np.asarray(counted.sum(axis=1), dtype=np.intp)


def tracking_window(twin: Twin) -> range:
    """Return the frames of a campaign on which its tracking is scored (Table 5.15).

    The thesis counts the trajectories "that originate from the lance and continue for some time"
    (section 5.2.1) and prints the frames. Fed in bursts, the same frames of another recording hold
    another number. So the window of the same length is taken in which the number that starts at
    the lance and lasts is nearest; among equals, the one that starts nearest to the published
    frame. Windows start at every tenth frame. Only the truth is used, no picture: of those
    counted, a few may be too faint to be followed by hand.
    """
    fraction = twin.scene.fraction
    if fraction not in WINDOWS:
        raise InputError(f"{twin.scene.name}: Table 5.15 has no {fraction!r}; open a campaign.")
    trajectories, length = WINDOWS[fraction]
    starts = np.arange(0, len(twin) - length + 1, 10)
    off = np.abs(starting_and_lasting(twin, starts, length) - trajectories)
    best = int(starts[np.lexsort((np.abs(starts - STARTS[fraction]), off))[0]])
    return range(best, best + length)


# Table 5.2 shows 87 % of V4's particles in air burning, where a quarter of the confetti and seven
# in ten of the shreds ignite at all (sec. 5.3.2): no one chemical time gives both. Subsets have
# one of their own, the lower limit of the fit: only there does a handful of sheets burn so. Table
# 5.2 alone, an input, decides it.
SUBSET_CHEMICAL_TIME_S = 1e-4
POSED = ("axis_far_mm", "inlet_depth_mm", "axis_height_mm", "lance_depth_mm")
# Lower edge of the region of interest, share of the rows: fitted with the pose, to Table 5.3
ROI_BOTTOM = 0.70


def second(scene: Scene) -> Scene:
    """Return a scene with the fitted flight, ignition, pose, light and depth."""
    flight, gas, place = second_kiln()
    if scene.name in SUBSETS:
        volatiles = VolatileIgnition(chemical_time_s=SUBSET_CHEMICAL_TIME_S)
        flight = replace(flight, volatiles=volatiles)
    posed = {name: getattr(place, name) for name in POSED}
    scene = second_light(
        replace(
            scene,
            flight=flight,
            gas=replace(gas, pressure_bar=scene.gas.pressure_bar),
            geometry=replace(scene.geometry, **posed),
        )
    )
    edge = [(min(row, ROI_BOTTOM), column) for row, column in scene.surroundings.roi]
    around = replace(scene.surroundings, roi=tuple(edge))
    return replace(scene, surroundings=around, depth=second_depth())


DUMP_S = 0.1  # a dumped handful is half a metre of lance at 5 m/s; assumption


def dumped(scene: Scene) -> Scene:
    """Return a scene whose handfuls are dumped into the lance, so that they load its air."""
    feed = tuple(replace(burst, duration_s=DUMP_S) for burst in scene.feed)
    return replace(
        scene, feed=feed, gas=replace(scene.gas, load=air_load(feed, scene.gas.air_kg_s))
    )


WIDE_BORE_M = 0.10  # of the lance, if the printed volumes of air are at the pressure of the feed


def with_wide_lance(scene: Scene) -> Scene:
    """Return a scene whose lance has the bore that the printed volumes of air would give.

    The thesis prints 40 mm for the lance of the combustion chamber (sec. 2.1.1), none for the
    kiln's. The velocity of the air is printed, so the jet has six times the momentum.
    """
    around, burner, radius_mm = scene.surroundings, scene.surroundings.burner, 500.0 * WIDE_BORE_M
    outside = burner.lance_mm + (radius_mm - burner.lance_bore_mm)
    burner = replace(burner, lance_bore_mm=radius_mm, lance_mm=outside)
    gas = replace(scene.gas, lance_diameter_m=WIDE_BORE_M)
    return replace(scene, gas=gas, surroundings=replace(around, burner=burner))


def downscaled(scene: Scene) -> Scene:
    """Return a scene for trials: a camera with a quarter of the rows and columns."""
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
            around, flame_roi=(top, bottom, left, right), edge_px=around.edge_px // 4
        ),
        depth=replace(depth, wall_points=depth.wall_points // 16),
    )


# Inputs that the publications only bound, at other values.
SCENARIOS: dict[str, Callable[[Scene], Scene]] = {
    "base": lambda scene: scene,
    "small": downscaled,
    "no-jet": lambda s: replace(s, gas=replace(s.gas, jet_persistence=0.0)),
    "dumped": dumped,
    "wide-lance": with_wide_lance,
    # 200 K over the length of the kiln; Fig. 2.4 has no axis that can be read
    "wall-profile": lambda s: replace(s, gas=replace(s.gas, wall_fall_k_m=24.0)),
}


def scene_name(plain: str, scenario: str = "base") -> str:
    """Return the name of a subset or campaign under a scenario."""
    return plain if scenario == "base" else f"{plain}@{scenario}"


def open_scene(name: str, seed: int | None = None) -> Twin:
    """Return the recording of a scene; ``name@scenario`` varies it, ``+`` joins scenarios.

    Raises
    ------
    InputError
        If there is no such scene or scenario, or the seed is negative.

    Examples
    --------
    >>> len(open_scene("V1@no-jet+small"))
    160
    """
    plain, _, joined = name.partition("@")
    scenarios = joined.split("+") if joined else []
    runs = product(FRACTIONS, PRESSURES_BAR)
    campaigns = {campaign_name(fraction, bar): (fraction, bar) for fraction, bar in runs}
    if plain not in (*SUBSETS, *campaigns) or not SCENARIOS.keys() >= set(scenarios):
        raise InputError(
            f"no scene {name!r}; there are {', '.join((*SUBSETS, *campaigns))}, each also "
            f"with variants behind @, such as V1@no-jet+small: {', '.join(SCENARIOS)}."
        )
    number = seed or 0
    if number < 0:
        raise InputError(f"scene {name}: seed is {number}, expected 0 or more.")
    run = campaigns.get(plain)
    scene = campaign(*run, number) if run else ground_truth(plain, number)
    for scenario in scenarios:
        scene = SCENARIOS[scenario](scene)
    return Twin(replace(scene, name=plain if joined in ("", "base") else name))


CACHED = ("life", "_bodies", "_wall")  # of the recording
CACHED_BEHIND = ("level", "solid_mm")  # of its background


def cached_scene(name: str, seed: int | None = None) -> Twin:
    """Return the recording of a scene as `open_scene` does, sooner.

    Flights, walls, tubes and the pixels with depth depend on the scene alone and take some
    seconds. They are kept in data/derived under the hash of the scene and of the twin's code; with
    them a frame is the same to the bit.

    Raises
    ------
    InputError
        As `open_scene`, or if the kept file cannot be read.
    """
    twin = open_scene(name, seed)
    path = cache_file(twin)
    path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path.with_suffix(".lock")):
        if not path.is_file():
            content = (
                {part: getattr(twin, part) for part in CACHED},
                {part: getattr(twin._background, part) for part in CACHED_BEHIND},
            )
            write_whole(path, pickle.dumps(content, pickle.HIGHEST_PROTOCOL))
            return twin
    try:
        parts, behind_parts = pickle.loads(path.read_bytes())
    except (pickle.UnpicklingError, EOFError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read ({error}). Delete it; it is made again."
        ) from error
    twin.__dict__.update(parts)
    twin._background.__dict__.update(behind_parts)
    return twin


def cache_file(twin: Twin) -> Path:
    """Return the file in which a scene's flights and walls are kept."""
    kept = (*CACHED, *CACHED_BEHIND)
    text = f"{twin.scene!r} {np.__version__} {code_hash(Twin)} {kept}"
    return paths.derived() / f"scene-{hashlib.sha256(text.encode()).hexdigest()[:12]}.pickle"
