"""The scenes of the thesis and variations: five labelled subsets and eight campaigns.

``open_scene(name)`` gives the recording. Lengths, frame rates and labelled particles
are published (sections 5.1.1, 5.2.3, appendix A.1, Tables 5.2 and 5.3). The number of
fed particles is not: that of the campaigns follows from the trajectories in the windows
of Table 5.15.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product

import numpy as np

from kilnflight.arrays import Facts, Index, Pair
from kilnflight.checks import InputError
from kilnflight.simulated.kiln.feeding import LEAD_S
from kilnflight.simulated.kiln.fuel import FRACTIONS
from kilnflight.simulated.kiln.inputs import VARIED, Scene, varied
from kilnflight.simulated.kiln.light import Optics
from kilnflight.simulated.kiln.scene import Twin
from kilnflight.tables import read_beside

PRESSURES_BAR = (4.5, 5.0)  # sec. 5.2.1
SUBSETS = ("V1", "V2", "V3", "V4", "V5")  # section 5.1.1
FRAMES = 160  # length of a subset
# labelled.csv has the labelled particles of each class in ten frames of a subset: all
# (Table 5.2), and those within the region of interest (Table 5.3).
COUNTS = read_beside(__file__, "labelled.csv", index_col="subset")

# scenes.csv has a fraction a row. Frame rate and exposure: small transparent granules
# need light (secs 2.1.4 and 5.2.3). Windows of Table 5.15: trajectories, frames, and
# the first frame in the thesis's recordings; a trajectory counts when any part lies in
# the window. Frames of the recordings at 4.5 and 5 bar (appendix A.1).
_TABLE = read_beside(__file__, "scenes.csv", index_col="fraction")
RECORDED: dict[str, Facts] = _TABLE.to_dict("index")
LASTING = 15  # frames, as `kilnflight.experiments.flights.track_scores.lasting` has
DWELL_S = 0.4  # median, 0.3 to 0.5 s (sec. 5.3.1)


def ground_truth(name: str, seed: int = 0) -> Scene:
    """Return a labelled subset, V1 to V5; its frames 75 to 84 are labelled."""
    counts = [
        (row.label, (row.within, row.everywhere - row.within))
        for row in COUNTS.loc[name].itertuples()
    ]
    return Scene(
        name=name,
        frames=FRAMES,
        seed=1000 * seed + SUBSETS.index(name) + 1,
        labelled=tuple(counts),
        calibration=seed,
    )


def campaign_name(fraction: str, pressure_bar: float) -> str:
    """Return the name of a campaign's scene."""
    return f"{fraction.replace(' ', '-').lower()}-{pressure_bar:.1f}-bar"


def campaign(fraction: str, pressure_bar: float, seed: int = 0) -> Scene:
    """Return the recording of one fraction at one pressure, as long as the thesis's.

    Particles per second are the trajectories of Table 5.15 over the time in which they
    can have begun: the window and a median dwell time.

    Parameters
    ----------
    fraction, pressure_bar
        As in the thesis: 4.5 or 5 bar.
    seed
        Another seed gives other particles in the same kiln.
    """
    row = list(FRACTIONS).index(fraction)
    column = PRESSURES_BAR.index(pressure_bar)
    recorded = RECORDED[fraction]
    rate = recorded["rate_hz"]
    frames = recorded[f"frames_{pressure_bar:.1f}_bar"]
    per_second = recorded["trajectories"] / (recorded["window"] / rate + DWELL_S)
    return Scene(
        name=campaign_name(fraction, pressure_bar),
        frames=frames,
        seed=1000 * seed + 10 * row + column + 100,
        frame_rate_hz=rate,
        fraction=fraction,
        pressure_bar=pressure_bar,
        count=round(per_second * (frames / rate + LEAD_S)),
        calibration=seed,
        optics=Optics(exposure_s=recorded["exposure_s"]),
    )


def flight_frames(twin: Twin) -> Pair:
    """Return when the true flights (n,) begin and end, in frames."""
    rate = twin.scene.frame_rate_hz
    begin = twin.life.release_s * rate
    return begin, begin + twin.life.flights.end_s * rate


def started_and_whole(twin: Twin, starts: Index, length: int) -> tuple[Index, Index]:
    """Count the flights that start within so many frames of each start, and whole ones.

    The lance releases both in these frames. The first fly for `LASTING` frames of
    them, the second end in them as well.

    Parameters
    ----------
    twin
        Its flights are counted.
    starts
        First frames of the windows (n,).
    length
        Frames of each window.

    Returns
    -------
    started, whole : array (n,)
        Flights that start in each window, and those of them that also end in it.
    """
    begin = starts[:, None]
    released, ended = flight_frames(twin)
    seen = np.minimum(ended, begin + length) - released
    started = (released >= begin) & (seen >= LASTING)
    whole = started & (ended < begin + length)
    return started.sum(axis=1), whole.sum(axis=1)


def tracking_window(twin: Twin, by_starts: bool = False) -> range:
    """Return the frames of a campaign on which its tracking is scored (Table 5.15).

    The thesis marks "complete" trajectories that start at the lance (section 5.2.1,
    Fig. 5.12), and prints their number and the frames. Fed in bursts, the same frames
    of another recording hold another number. So of all windows of that length the one
    is taken whose number of whole flights is nearest. Among equals come those that cut
    the fewest flights, then the one that starts nearest to the published frame. Windows
    start at every tenth frame. Only the truth is used, no picture: of those counted, a
    few may be too faint to be followed by hand.

    In a window shorter than a median flight few can be whole. That is so for the 100
    frames of paper shreds, or 0.3 s. There all flights that start count.

    Parameters
    ----------
    twin
        A campaign.
    by_starts
        All flights that start count in all windows, cut or not.
    """
    recorded = RECORDED[twin.scene.fraction]
    length = recorded["window"]
    starts = np.arange(0, len(twin) - length + 1, 10)
    started, whole = started_and_whole(twin, starts, length)
    counted = whole
    cut = started - whole
    if by_starts or length < DWELL_S * twin.scene.frame_rate_hz:
        counted = started
    if by_starts:
        cut = np.zeros_like(started)
    far = np.abs(starts - recorded["start"])
    best = np.lexsort((far, cut, np.abs(counted - recorded["trajectories"])))[0]
    start = int(starts[best])
    return range(start, start + length)


def downscaled(scene: Scene) -> Scene:
    """Return a scene for trials: a camera with a quarter of the rows and columns."""
    place = scene.geometry
    row, column = place.lance_pixel
    top, bottom, left, right = scene.interior.flame_roi
    geometry = replace(
        place,
        lance_pixel=(row / 4, column / 4),
        focal_length_px=place.focal_length_px / 4,
        rows=place.rows // 4,
        columns=place.columns // 4,
    )
    interior = replace(
        scene.interior,
        flame_roi=(top // 4, bottom // 4, left // 4, right // 4),
        edge_px=scene.interior.edge_px // 4,
    )
    depth = replace(scene.depth, wall_points=scene.depth.wall_points // 16)
    return replace(scene, geometry=geometry, interior=interior, depth=depth)


# Functions of a scene that change its inputs, by name.
SCENARIOS: dict[str, Callable[[Scene], Scene]] = {
    "base": lambda scene: scene,
    "small": downscaled,
    "own-calibration": lambda scene: replace(scene, calibration=scene.seed),
    **{name: partial(varied, scenario=name) for name in VARIED},
}


def scene_name(plain: str, scenario: str) -> str:
    """Return the name of a subset or campaign under a scenario."""
    if scenario == "base":
        return plain
    return f"{plain}@{scenario}"


def open_scene(name: str, seed: int | None = None) -> Twin:
    """Open the recording of a scene.

    Parameters
    ----------
    name
        A subset or campaign; ``name@scenario`` varies it, ``+`` joins scenarios.
    seed
        Another seed gives other particles in the same kiln; None: 0.

    Raises
    ------
    InputError
        If there is no such scene or scenario, or the seed is negative.

    Examples
    --------
    >>> len(open_scene("V1@no-clutter+small"))
    160
    """
    plain, _, joined = name.partition("@")
    scenarios = joined.split("+") if joined else []
    campaigns = {campaign_name(*run): run for run in product(FRACTIONS, PRESSURES_BAR)}
    known = (*SUBSETS, *campaigns)
    if plain not in known or not SCENARIOS.keys() >= set(scenarios):
        raise InputError(
            f"no scene {name!r}; there are {', '.join(known)}, each also with variants "
            f"behind @, such as V1@no-clutter+small: {', '.join(SCENARIOS)}."
        )
    number = seed or 0
    if not 0 <= number < 2**63:
        raise InputError(f"scene {name}: seed is {number}, expected 0 to 2^63.")
    if plain in campaigns:
        scene = campaign(*campaigns[plain], number)
    else:
        scene = ground_truth(plain, number)
    for scenario in scenarios:
        scene = SCENARIOS[scenario](scene)
    return Twin(replace(scene, name=scene_name(plain, joined or "base")))


@dataclass(frozen=True)
class TwinSource:
    """A simulated recording by name and seed, opened by each process for itself."""

    name: str
    seed: int = 0

    def recording(self) -> Twin:
        """Return the recording with its truth; the last two stay in memory."""
        return _scene(self.name, self.seed)


_scene = lru_cache(maxsize=2)(open_scene)  # a scene takes a second
