"""How the answers to the 2016 paper hang on what it does not print: friction, filter, corners.

bodies at another friction -> pictures -> tracking    (`vary_friction`)
spots -> filter with other noise                      (`vary_filter`)
spots -> corners of the belt off by a pixel           (`vary_corners`)

Each table has a row per setting: numbers behind the claims, and whether each criterion holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.camera import BELT, Corners, calibrate_camera
from kilnflight.belt.tracker import BELT_FRAME_S, BeltTracker, constant_velocity
from kilnflight.experiments import belt_2016, belt_claims
from kilnflight.experiments.belt_camera import PictureTracks, track_pictures
from kilnflight.experiments.belt_claims import (
    HOLDS,
    NOISE_FREE,
    SIM,
    STRAIGHT,
    TRACKING,
    Answer,
    digits,
    measures,
)
from kilnflight.project import claims
from kilnflight.sorter.machine import BULKS
from kilnflight.sorter.rendering import Pictures, at_rate

# The spheres of 2016 had another friction than those of 2020 (2020, section 4); neither is printed.
# From half of what fits those of 2020 up to wood on a rough belt; choice.
FRICTIONS = (0.10, 0.15, 0.20, 0.25, 0.30, 0.35)
FACTORS = (0.5, 1.0, 2.0)  # of both settings of the filter, which nobody prints; choice
CORNER_PX = 1.0  # standard deviation of a corner along each axis; choice
SPHERES = {"quick": 20, "standard": 60, "full": 300}  # at each friction, by scale
DRAWS = {"quick": 2, "standard": 4, "full": 20}  # of the corners' errors, by scale
MOST_DRAWS = 8  # of them at each friction
FOUND, PLACES = "found", "true places, no pictures"
SETTINGS = ("friction", "lateral_spread", "velocity_noise", "measurement_spread", "corners")
SHOWN = {  # numbers behind the claims, those that a reader needs
    "within_0.2_mm": "share within 0.2 mm",
    "straight_over_tracking": "Straight / Tracking",
    "images_straight_over_tracking": "Straight / Tracking, images",
    "images_over_straight": "images / Straight",
    "sim_bias_ms": "bias (ms)",
    "images_bias_ms": "bias, images (ms)",
    "images_lateral_bias_mm": "across, images (mm)",
}
LISTED = {"fails": "no", "open": "open"}

Setting = tuple[str | float, ...]


def vary_friction(scale: str, seed: int, jobs: int = 1) -> pd.DataFrame:
    """Return the answers for spheres of other friction on the belt, and twice the lateral spread.

    Returns
    -------
    DataFrame
        ``friction`` ("fitted" or a number), ``lateral_spread`` (times the fitted one), and the
        columns of `_tabulate`; with corners off, too.
    """
    parts: dict[Setting, pd.DataFrame] = {}
    traced: dict[Setting, dict[str, Answer]] = {}
    settings: list[tuple[float | None, float]] = [(None, 1.0), (None, 2.0)]
    settings += [(value, 1.0) for value in FRICTIONS[:: 5 if scale == "quick" else 1]]
    for friction, spread in settings:
        bodies = belt_2016.simulate_bodies("spheres", SPHERES[scale], seed, jobs, friction, spread)
        pictured = track_pictures(Pictures(bodies, BULKS["spheres"], seed))
        name = "fitted" if friction is None else f"{friction:.2f}"
        every = belt_2016.all_deviations({"spheres": pictured}, {"spheres": bodies})
        parts[name, spread] = every
        corners = vary_corners(pictured, bodies, min(DRAWS[scale], MOST_DRAWS), seed)
        traced[name, spread] = calibration_answers(corners)
    return _tabulate(parts, ["friction", "lateral_spread"], traced)


def vary_filter(pictured: PictureTracks, bodies: pd.DataFrame) -> pd.DataFrame:
    """Return the answers for other settings of the filter on the same spots.

    Returns
    -------
    DataFrame
        ``velocity_noise`` and ``measurement_spread`` (times the usual ones), and the columns of
        `_tabulate`.
    """
    usual = constant_velocity()
    parts: dict[Setting, PictureTracks] = {}
    for noise, spread in product(FACTORS, FACTORS):
        motion = replace(
            usual,
            acceleration_noise=noise * usual.acceleration_noise,
            measurement_sd=spread * usual.measurement_sd,
        )
        followed = BeltTracker(motion)(pictured.spots, belt_2016.count_frames(bodies))
        parts[noise, spread] = pictured._replace(followed=followed)
    table = _tabulate(_with_noise_free(parts, bodies), ["velocity_noise", "measurement_spread"])
    return table.drop(columns=list(NOISE_FREE))  # no picture takes part in them


def vary_corners(
    pictured: PictureTracks, bodies: pd.DataFrame, draws: int, seed: int
) -> pd.DataFrame:
    """Return the answers for corners of the belt as found and off by `CORNER_PX`.

    The spots are those of the same pictures. The last row has no pictures at all: true places at
    200 frames/s, followed by the filter of the images. It shows how slowly that filter adapts.

    Returns
    -------
    DataFrame
        ``corners``, and the columns of `_tabulate`.
    """
    generator, frames = np.random.default_rng(seed), belt_2016.count_frames(bodies)
    parts: dict[Setting, PictureTracks] = {(FOUND,): pictured}
    calibration = pictured.calibration
    corners = calibration.pixels(BELT.corners)
    pixels = calibration.pixels(pictured.spots[["x", "y"]].to_numpy(np.float64))
    for draw in range(draws):
        off = corners + CORNER_PX * generator.standard_normal((4, 2))
        other = calibrate_camera(Corners(off, np.full(4, CORNER_PX), np.zeros(4, dtype=bool)))
        x, y = other.millimetres(pixels).T
        spots = pictured.spots.assign(x=x, y=y)
        followed = BeltTracker()(spots, frames)
        name = f"off by {CORNER_PX:g} px, draw {draw + 1}"
        parts[(name,)] = pictured._replace(spots=spots, followed=followed)
    places = at_rate(bodies, 1 / BELT_FRAME_S).reset_index(drop=True)
    exact = pictured._replace(spots=places, followed=BeltTracker()(places, frames))
    parts[(PLACES,)] = exact
    table = _tabulate(_with_noise_free(parts, bodies), ["corners"])
    return table.drop(columns=list(NOISE_FREE))  # no picture takes part in them


def calibration_answers(corners: pd.DataFrame) -> dict[str, Answer]:
    """Return the answers to belt16-8 and -9; ``corners`` is from `vary_corners`."""
    names = ["tracking_bias_ms", "images_bias_ms", "images_lateral_bias_mm"]
    numbers = corners.set_index("corners")[names]
    found, places = (numbers.loc[key].to_numpy(np.float64) for key in (FOUND, PLACES))
    off = numbers.drop(index=[FOUND, PLACES]).to_numpy(np.float64)
    free = abs(found[0])
    parts = {"calibration": _root_mean_square(off[:, 1] - found[1]) / free}
    parts["adaptation"] = (abs(places[1]) - free) / free
    share = abs(found[2]) / _root_mean_square(off[:, 2])
    return {"belt16-8": pd.Series({"": share}), "belt16-9": pd.Series(parts)}


def shown(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table as it is shown: the settings, `SHOWN` that vary, claims that fail or are open.

    Draws of the corners share a row: median and range. Claims are listed by their numbers in
    "belt16-1" to "belt16-10", behind each of several draws how many it concerns.
    """
    names = {name: label for name, label in SHOWN.items() if name in table}
    varying = (table[list(names)] != table[list(names)].iloc[0]).any()
    names = {name: label for name, label in names.items() if varying[name]}
    settings = [name for name in SETTINGS if name in table]
    places = table[settings].replace(r", draw \d+$", "", regex=True)
    rows = []
    for _, part in table.groupby([places[name] for name in settings], sort=False):
        row = places.loc[part.index[0]].to_dict()
        if len(part) > 1:
            row["corners"] += f", {len(part)} draws"
        row |= {label: _median_and_range(part[name]) for name, label in names.items()}
        rows.append(row | {head: _list(part, word) for head, word in LISTED.items()})
    return pd.DataFrame(rows)


def _median_and_range(values: pd.Series) -> str:
    low, middle, high = map(digits, (values.min(), values.median(), values.max()))
    return middle if len(values) == 1 else f"{middle} ({low} to {high})"


def _list(part: pd.DataFrame, word: str) -> str:
    """Return the numbers of the claims of which the criterion is ``word``; in how many draws."""
    counts = (part.filter(like="belt16-") == word).sum()
    each = {str(id).removeprefix("belt16-"): count for id, count in counts[counts > 0].items()}
    several = len(part) > 1
    return ", ".join(f"{id} (in {count})" if several else id for id, count in each.items())


def settle(verdict: claims.Verdict, varied: Mapping[str, pd.DataFrame]) -> claims.Verdict:
    """Return a verdict that tells in how many settings its criterion holds, fails, or is open.

    Where settings differ it is not decidable: because of the twin if friction or lateral spread
    decide, else because of the method.

    Parameters
    ----------
    verdict
        Of a claim.
    varied
        Tables by the name of what varies, the one on friction as "friction".
    """
    told, differ = [], []
    for name, table in varied.items():
        if verdict.id in table:
            counts = table[verdict.id].value_counts().to_dict()
            each = ", ".join(f"{word} {counts.get(word, 0)}" for word in HOLDS.values())
            told.append(f"{name}, {len(table)} settings: {each}")
            if verdict.id == "belt16-1" and "lateral_spread" in table:
                told.append(_by_lateral_spread(table))
            differ += [name] if set(counts) != {HOLDS[verdict.verdict]} else []
    reason = "; ".join([verdict.reason, *told]).removeprefix("; ")
    if verdict.verdict == claims.NOT_DECIDABLE or not differ:
        return replace(verdict, reason=reason)
    because = "twin" if "friction" in differ else "method"
    return replace(verdict, verdict=claims.NOT_DECIDABLE, reason=reason, because=because)


def _by_lateral_spread(friction: pd.DataFrame) -> str:
    """Return in words what the lateral spread alone does to belt16-1; it is not printed."""
    fitted = friction[friction["friction"] == "fitted"]
    pairs = zip(fitted["lateral_spread"], fitted["within_0.2_mm"], strict=True)
    shares = ", ".join(f"{spread:g} times {share:.2f}" for spread, share in pairs)
    return f"share by the lateral spread (not printed; fewer spheres than above): {shares}"


def _with_noise_free(
    parts: Mapping[Setting, PictureTracks], bodies: pd.DataFrame
) -> dict[Setting, pd.DataFrame]:
    """Return deviations from images by setting, each beside those without noise."""
    free = belt_2016.noise_free(bodies).assign(data="noise-free")
    images = {key: belt_2016.from_images(part, bodies) for key, part in parts.items()}
    return {key: pd.concat([free, part.assign(data="images")]) for key, part in images.items()}


def _tabulate(
    parts: Mapping[Setting, pd.DataFrame],
    names: list[str],
    traced: Mapping[Setting, dict[str, Answer]] | None = None,
) -> pd.DataFrame:
    """Return the numbers behind the claims, and by id whether each criterion holds, by setting.

    Returns
    -------
    DataFrame
        ``names``; shares within 0.2 mm (simulated velocity) and 1.5 mm (images); ratios of spreads
        across the belt without noise (Straight over Tracking) and of mean absolute errors (Tracking
        from images over Straight without noise, Straight over Tracking from images); biases in ms
        of the simulated velocity, of Tracking and from images, across in mm from images; ratio of
        temporal spreads (images over noise-free); where traced, what calibration and adaptation add
        to the bias, over it; a column per claim: yes, no or open.
    """
    rows = []
    for setting, table in parts.items():
        row: dict[str, str | float] = dict(zip(names, setting, strict=True))
        row |= _numbers(table.groupby(["data", "approach"]))
        others = (traced or {}).get(setting, {})
        if "belt16-9" in others:
            shares = pd.Series(others["belt16-9"])
            row |= {f"{name}_over_bias": float(value) for name, value in shares.items()}
        for claim, answer in (belt_claims.tracking_answers(table) | others).items():
            row[claim] = HOLDS[belt_claims.judge(claim, answer, because="twin").verdict]
        if "belt16-9" in others and row["belt16-5"] == "no":
            row["belt16-9"] = "open"  # there is no larger bias to explain
        rows.append(row)
    return pd.DataFrame(rows)


def _numbers(grouped: pd.api.typing.DataFrameGroupBy) -> dict[str, float]:
    across, late = (
        {key: part.dropna().to_numpy()[:, None] for key, part in grouped[name]}
        for name in ("lateral_mm", "temporal_ms")
    )
    sim, free, images = ("noise-free", SIM), ("noise-free", TRACKING), ("images", TRACKING)
    straight, seen = ("noise-free", STRAIGHT), ("images", STRAIGHT)
    (mae, iqr) = ({key: measures(part)[k, 0] for key, part in across.items()} for k in (0, 1))
    spread = {key: measures(late[key])[1, 0] for key in (free, images)}
    return {
        "within_0.2_mm": float((np.abs(across[sim]) < 0.2).mean()),
        "straight_over_tracking": iqr[straight] / iqr[free],
        "images_within_1.5_mm": float((np.abs(across[images]) < 1.5).mean()),
        "sim_bias_ms": float(np.median(late[sim])),
        "tracking_bias_ms": float(np.median(late[free])),
        "images_bias_ms": float(np.median(late[images])),
        "images_spread_over_noise_free": spread[images] / spread[free],
        "images_over_straight": mae[images] / mae[straight],
        "images_straight_over_tracking": mae[seen] / mae[images],
        "images_lateral_bias_mm": float(np.median(across[images])),
    }


def _root_mean_square(values: npt.NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
