"""The simulated sorter beside the authors', and its contact parameters' effect.

Its variants are compared with the authors' velocities (`velocity_misfits`).

MuJoCo's contacts are soft: time constants, damping and impedance are numerical settings, and no
paper prints any. The same particles are simulated with each of them halved and doubled; the
impedance is moved towards both of its ends. Friction values that were not fitted are set to both
ends of the range in handbooks. The step is 0.1 ms, half of the usual one: contacts half as soft
need it. Nothing is chosen by the outcome.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.figure import Figure

from kilnflight.belt.models import BELT_START_MM, BELT_WIDTH_MM
from kilnflight.checks import check_between, check_count
from kilnflight.experiments.belt_2020 import (
    AUTHORS,
    DATA_SETS,
    OWN,
    Key,
    profiles,
    tracks_by_source,
)
from kilnflight.experiments.belt_calibration import FIRST_FIT, SPIN_KNOWN
from kilnflight.experiments.belt_profile import motion_profile, step_velocities
from kilnflight.project.style import COLOURS, MARKERS, PAGE_MM, canvas, words
from kilnflight.sorter.bodies import Batch, build_model, engine, is_installed
from kilnflight.sorter.machine import BULKS, Contacts, Conveyor, Slide, check_material
from kilnflight.sorter.rendering import at_rate
from kilnflight.sorter.simulation import PLACES_MM, Sorter, calibrated_sorter, simulate_tracks
from kilnflight.tables import BELT_BODIES

Array = npt.NDArray[np.float64]

IMPEDANCE = 0.99  # MuJoCo's solimp in `kilnflight.sorter.bodies`
FINE_S = 0.0001  # the 2020 paper's step
CLOSING_MM_S = 100.0  # of two spheres that meet; any, since contacts are linear
REFERENCE, USUAL, OTHERS = "as used", "as used, steps of 0.2 ms", "as used, other particles"
QUANTITIES = ("mean_m_s", "gain_m_s", "std_m_s", "lateral_m_s", "lateral_std_m_s")
# Quantities by which a simulation resembles another one, each with the spread that is its unit.
SPREADS = {
    "median_m_s": "width_m_s",
    "iqr_m_s": "width_m_s",
    "lateral_iqr_m_s": "lateral_width_m_s",
}
LARGEST_SHARE = 0.5  # of that spread, from 5 to 95 %; choice, made before the present fit
# Ratios of widths, ours over the reference's: quartiles and 5 to 95 % along, 5 to 95 % across.
# Choice, set after the first table was seen: a range far too narrow had resembled before.
WIDTHS = ("iqr_m_s", "width_m_s", "lateral_width_m_s")
RATIOS = (0.5, 2.0)
WINDOWS_S = (0.01, 0.05, 0.2)
# Ranges in handbooks of the values that are not fitted; see `kilnflight.sorter.machine.Contacts`.
ASSUMED = {"particle_friction": (0.25, 0.5), "wall_friction": (0.2, 0.6)}


@dataclass(frozen=True)
class Setting:
    """A sorter whose contacts have an impedance of their own."""

    sorter: Sorter
    impedance: float = IMPEDANCE
    others: bool = False  # whether other particles are fed

    def __post_init__(self) -> None:
        """Refuse an impedance that MuJoCo would cut off."""
        check_between(self.impedance, 0.0001, 0.9999, "Setting: impedance")
        self.sorter.contacts.check_step(self.sorter.conveyor.step_s)


def variants(count: int | None, seed: int, jobs: int = 1) -> dict[Key, pd.DataFrame]:
    """Return our simulation before and after the fit of its free values, at 100 Hz.

    Returns
    -------
    dict
        Tracks by variant and data set. ``inputs only`` and ``first fit`` (values of the first look,
        in the present machine) have spheres. ``calibrated`` has all materials, with values fitted
        to spheres. ``along the belt`` has cylinders with axes within some 20 degrees of the belt's
        direction. Without MuJoCo there is ``friction model`` alone.
    """
    if not is_installed():
        own_tracks = tracks_by_source({}, seed)
        return {("friction model", name): own_tracks[OWN, name] for name in DATA_SETS}
    fitted = calibrated_sorter()
    sorters: dict[Key, Sorter] = {("inputs only", "spheres"): Sorter()}
    sorters["first fit", "spheres"] = FIRST_FIT.applied(Sorter())
    sorters |= {("calibrated", name): fitted for name in DATA_SETS}
    along = replace(fitted.slide, yaw_spread_deg=20.0)
    sorters["along the belt", "cylinders"] = replace(fitted, slide=along)
    return {
        key: at_rate(simulate_tracks(key[1], count, seed, jobs, used), 100.0)
        for key, used in sorters.items()
    }


def velocity_misfits(profiles: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return root mean square differences of velocity profiles over the belt.

    Parameters
    ----------
    profiles
        ``variant``, ``data_set`` and the columns of
        `kilnflight.experiments.belt_profile.motion_profile`.
    reference
        The variant that the others are compared with; without it the table is empty.
    """
    quantities = [name for name in profiles.columns if name.endswith("_m_s")]
    table = profiles.set_index(["data_set", "x_mm"])
    expected = table.loc[table["variant"] == reference, quantities]
    others = table[table["variant"] != reference]
    others = others[others.index.isin(expected.index)]
    squares = (others[quantities] - expected.reindex(others.index)) ** 2
    squares.insert(0, "variant", others["variant"])
    mean = squares.reset_index().groupby(["variant", "data_set"], sort=False)[quantities].mean()
    return mean.pow(0.5).reset_index()


def resemblance(profiles: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return how far velocity profiles are from a reference, relative to its spread.

    Parameters
    ----------
    profiles, reference
        As in `velocity_misfits`.

    Returns
    -------
    DataFrame
        ``variant``, ``data_set`` and `SPREADS`: root mean square difference over the belt of a
        quantity, over that of the reference's range from 5 to 95 %. Then `WIDTHS` over the
        reference's, each as root mean square over the belt. ``resembles``: whether all shares are
        at most `LARGEST_SHARE` and all ratios within `RATIOS`.
    """
    table = velocity_misfits(profiles, reference)
    names = sorted({*SPREADS.values(), *WIDTHS})
    squares = (profiles.set_index(["variant", "data_set"])[names] ** 2).astype(np.float64)
    width = squares.groupby(level=[0, 1]).mean().pow(0.5)
    expected = width.loc[reference] if len(table) else width.iloc[:0].droplevel(0)
    ours = width.reindex(pd.MultiIndex.from_frame(table[["variant", "data_set"]]))
    units = expected.reindex(table["data_set"])
    result = table[["variant", "data_set"]].copy()
    for name, spread in SPREADS.items():
        share = table[name].to_numpy(np.float64) / units[spread].to_numpy()
        result[name.replace("_m_s", "_share")] = share
    shares = result.iloc[:, 2:]
    ratios = pd.DataFrame(ours[list(WIDTHS)].to_numpy() / units[list(WIDTHS)].to_numpy())
    ratios.columns = pd.Index([name.replace("_m_s", "_ratio") for name in WIDTHS])
    within = (ratios >= RATIOS[0]) & (ratios <= RATIOS[1])
    alike = (shares <= LARGEST_SHARE).all(axis=1) & within.all(axis=1)
    result = result.join(ratios).assign(resembles=alike)
    return result


def resembles(tracks: Mapping[Key, pd.DataFrame]) -> dict[str, bool]:
    """Return by data set whether our simulation resembles the authors' tracks.

    Parameters
    ----------
    tracks
        From `kilnflight.experiments.belt_2020.tracks_by_source`, at any rate that is a multiple of
        100 Hz. Data sets without the authors' tracks have no entry: nobody knows.
    """
    thinned = {key: at_rate(table, 100.0) for key, table in tracks.items()}
    table = resemblance(profiles(thinned, PLACES_MM, "variant"), AUTHORS)
    return {
        str(name): bool(value)
        for name, value in zip(table["data_set"], table["resembles"], strict=True)
    }


def describe_unlike(tracks: Mapping[Key, pd.DataFrame]) -> str:
    """Describe for captions what of our own simulation is no result; empty without theirs.

    That is what does not resemble the authors' tracks, and spheres in the prediction phase.
    ``tracks`` are as for `resembles`.
    """
    alike = resembles(tracks)
    unlike = [name for name in alike if not alike[name]]
    text = f" Own {' and '.join(unlike)} do not resemble the authors' (notebook 43): no result."
    return (text if unlike else "") + (f" {SPIN_KNOWN}" if alike.get("spheres") else "")


def entry_times(tracks: pd.DataFrame) -> Array:
    """Return when particles came to the start of the belt, ascending, in s.

    The first velocity of each is taken back from its first place.
    """
    first = tracks.groupby("particle")[["time_s", "x"]].first()
    speed = step_velocities(tracks).groupby("particle")["velocity_x_mm_s"].first()
    return np.sort((first["time_s"] - (first["x"] - BELT_START_MM) / speed).dropna().to_numpy())


def burst_table(tracks: Mapping[Key, pd.DataFrame], slide: Slide, seed: int) -> pd.DataFrame:
    """Return how much the counts of particles vary, the authors' and our feed's.

    Returns
    -------
    DataFrame
        By ``data_set`` and ``window_ms``: mean count and variance over mean; 1 for a constant rate.
        Ours is the feed of as many particles as published, as the slide gives it with each
        material's entry times.
    """
    rows = []
    for number, (name, bulk) in enumerate(BULKS.items()):
        generator = np.random.default_rng([seed, number])
        fed = slide.feeding(name)(bulk, bulk.count, BELT_WIDTH_MM, generator)
        times = {"own": fed.time_s}
        if (AUTHORS, name) in tracks:
            times["authors"] = entry_times(tracks[AUTHORS, name])
        for window_s in WINDOWS_S:
            row: dict[str, Any] = {"data_set": name, "window_ms": 1000.0 * window_s}
            for source, time_s in times.items():
                edges = np.arange(time_s[0], time_s[-1], window_s)
                counts = np.histogram(time_s, edges)[0]
                row[f"{source}_mean"] = counts.mean()
                row[f"{source}_dispersion"] = counts.var() / counts.mean()
            rows.append(row)
    return pd.DataFrame(rows)


def contact_settings(sorter: Sorter) -> dict[str, Setting]:
    """Return a sorter at steps of 0.1 ms, and the same with one value changed each."""
    fine = replace(sorter, conveyor=replace(sorter.conveyor, step_s=FINE_S))
    settings = {
        REFERENCE: Setting(fine),
        USUAL: Setting(sorter),
        OTHERS: Setting(fine, others=True),
    }
    for name in ("belt_time_s", "slip_time_s", "body_time_s", "body_damping"):
        value = getattr(sorter.contacts, name)
        settings |= {
            f"{name} {part:g}": _changed(fine, name, part) for part in (value / 2, value * 2)
        }
    for impedance in (0.95, 0.998):
        settings[f"impedance {impedance:g}"] = Setting(fine, impedance)
    for name, ends in ASSUMED.items():
        settings |= {f"{name} {end:g}": _changed(fine, name, end) for end in ends}
    return settings


def vary_contacts(
    sorter: Sorter, count: int, seed: int, materials: Iterable[str] = tuple(BULKS)
) -> pd.DataFrame:
    """Return how particles move with each of the `contact_settings`.

    Parameters
    ----------
    sorter
        The sorter to change.
    count
        Particles of each material, the same for all settings but `OTHERS`.
    seed
        Of the particles.
    materials
        Names of `BULKS`.

    Returns
    -------
    DataFrame
        ``setting``, ``data_set``, and means over the belt of velocities at 100 Hz. Along the belt:
        mean ``mean_m_s``, standard deviation ``std_m_s``. Across it: median of its size
        ``lateral_m_s``, standard deviation ``lateral_std_m_s``. Then ``gain_m_s``, the gain of the
        mean from 425 to 750 mm; ``restitution_least`` and ``restitution_most``.

    Raises
    ------
    InputError
        If there are too few particles, or no such material.
    """
    check_count(count, "vary_contacts: count", least=2)
    rows = []
    for name, setting in contact_settings(sorter).items():
        least, most = restitution(setting)
        for material in materials:
            row = {
                "setting": name,
                "data_set": material,
                **_mean_motion(setting, material, count, seed),
            }
            rows.append(row | {"restitution_least": least, "restitution_most": most})
    return pd.DataFrame(rows)


def changes(table: pd.DataFrame) -> pd.DataFrame:
    """Return the difference of each setting from the reference in mm/s."""
    reference_rows = table[table["setting"] == REFERENCE].set_index("data_set")
    result = table[["setting", "data_set"]].copy()
    for name in QUANTITIES:
        reference = table["data_set"].map(reference_rows[name])
        result[name.replace("_m_s", "_mm_s")] = 1000.0 * (table[name] - reference)
    return result[result["setting"] != REFERENCE].reset_index(drop=True)


def plot_changes(differences: pd.DataFrame) -> Figure:
    """Draw the `changes`: panels are quantities, lines settings, marks materials.

    Chance alone (`OTHERS`) is in the table only; it would squeeze the axes.
    """
    differences = differences[differences["setting"] != OTHERS]
    labels = ("mean along", "gain along", "spread along", "median across")
    size: dict[str, Any] = {"width_mm": PAGE_MM, "height_mm": 95, "sharey": True}
    picture, (panels,) = canvas(1, len(labels), **size)
    for axes, name, label in zip(panels, differences.columns[2:], labels, strict=False):
        for k, (data_set, table) in enumerate(differences.groupby("data_set", sort=False)):
            look: dict[str, Any] = {"marker": MARKERS[k], "color": COLOURS[k], "ls": "", "ms": 4}
            axes.plot(table[name], table["setting"].map(words), label=data_set, mfc="none", **look)
        axes.axvline(0, color="0.6", lw=0.8, ls="-")
        axes.set(title=label, xlabel="change (mm/s)")
    panels[0].invert_yaxis()
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return picture


def restitution(setting: Setting) -> tuple[float, float]:
    """Return least and largest speed at which two spheres part, over that of closing.

    They meet head-on in the air without friction, at five parts of a time step.
    """
    mujoco, step = engine(), setting.sorter.conveyor.step_s
    contacts = replace(setting.sorter.contacts, particle_friction=0.0)
    bulk = BULKS["spheres"]
    model = build_model(bulk, contacts, 2, Conveyor(step_s=step))
    model.pair_solimp[:, :2] = setting.impedance
    model.opt.gravity[:] = 0.0
    shares = []
    for part in np.linspace(0.0, 1.0, 5):
        data = mujoco.MjData(model)
        apart = 2.0 * bulk.half_mm[0] + (5.0 + part) * CLOSING_MM_S * step
        data.qpos.reshape(2, 7)[:, :3] = [[0.0, 90.0, 500.0], [apart, 90.0, 500.0]]
        data.qvel[0] = CLOSING_MM_S
        mujoco.mj_step(model, data, round(0.02 / step))
        shares.append(float(data.qvel[6] - data.qvel[0]) / CLOSING_MM_S)
    return min(shares), max(shares)


def _changed(sorter: Sorter, name: str, value: float) -> Setting:
    """Return a setting with one value of the contacts changed."""
    contacts: Contacts = replace(sorter.contacts, **{name: value})
    return Setting(replace(sorter, contacts=contacts))


def _mean_motion(setting: Setting, material: str, count: int, seed: int) -> dict[str, float]:
    """Return the means over the belt of the profile of one simulation."""
    bodies = simulate_setting(setting, material, count, seed)
    profile = motion_profile(step_velocities(at_rate(bodies, 100.0)), PLACES_MM)
    along = profile["mean_m_s"]
    means = {"mean_m_s": along.mean(), "gain_m_s": along.iloc[-1] - along.iloc[0]}
    means |= {name: profile[name].mean() for name in QUANTITIES[2:]}
    return {name: float(value) for name, value in means.items()}


def simulate_setting(setting: Setting, material: str, count: int, seed: int) -> pd.DataFrame:
    """Simulate one setting; return `kilnflight.tables.BELT_BODIES`."""
    check_material(material)
    sorter, bulk = setting.sorter, BULKS[material]
    generator = np.random.default_rng([seed, int(setting.others)])
    slide = sorter.slide.feeding(material)
    fed = slide(bulk, count, sorter.conveyor.width_mm, generator)
    batch = Batch(sorter.conveyor, sorter.contacts, bulk, fed, generator.random(count))
    batch.model.pair_solimp[:, :2] = setting.impedance
    return BELT_BODIES.check(batch.table())
