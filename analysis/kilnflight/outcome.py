"""What came out of a recording, in a short table that a person reads."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight.detection import DoG
from kilnflight.flight import remaining
from kilnflight.ignition import BEFORE, SEEN, TOO_FEW
from kilnflight.kiln import KilnRun
from kilnflight.scores.intervals import Bootstrap, Interval, median, share
from kilnflight.tracklets import tracked

SEED = 0  # of the bootstrap


class Outcome(NamedTuple):
    """All tables of one recording."""

    name: str
    frames: int
    detections: pd.DataFrame
    tracks: pd.DataFrame
    trajectories: pd.DataFrame
    flights: pd.DataFrame
    slices: pd.DataFrame
    notes: tuple[str, ...]
    used: tuple[tuple[str, str], ...] = ()  # what and value: `used`

    @property
    def counted(self) -> pd.DataFrame:
        """The flights that start at the lance; only these count (section 5.3.1)."""
        return self.flights[self.flights["from_lance"]]


def outcome(
    run: KilnRun, notes: tuple[str, ...] = (), used: tuple[tuple[str, str], ...] = ()
) -> Outcome:
    """Return the tables of a recording, made where they are not there.

    Notes are added on what is missing, or not what it seems.
    """
    detection = run.detection
    found = Outcome(
        detection.source.name,
        len(run.frames),
        detection.detections(),
        run.table("tracks")(),
        run.table("trajectories")(),
        run.table("flights")(),
        run.table("slices")(),
        notes,
        used,
    )
    told = [_no_tracks(found), _none_from_lance(found), _behind_lance(found)]
    if not run.rules.above_background:
        told.append(_as_it_is(found))
    return found._replace(notes=(*notes, *filter(None, told)))


def _no_tracks(found: Outcome) -> str:
    """Return a note where nothing was tracked."""
    if len(tracked(found.tracks)):
        return ""
    if found.detections.empty:
        return "Nothing was detected: a lower --threshold may find more."
    return (
        f"No tracks: of {len(found.detections)} detections {len(found.tracks)} are in the air or "
        "without depth, and none of these follow each other. Do --threshold, --in-air and the "
        "kiln's wall fit the recording?"
    )


def _none_from_lance(found: Outcome) -> str:
    """Return a note where trajectories were fitted and none counts."""
    if found.flights.empty or len(found.counted):
        return ""
    fitted = found.trajectories["particle"].isin(found.flights["particle"])
    early = int((found.trajectories.loc[fitted, "t0_at_bound"] < 0).sum())
    way = f"; of {early} no way back to it was found (t0 is the earliest that was searched)"
    return (
        f"{len(found.flights)} trajectories were fitted, but none starts at the lance: the first "
        f"positions lie {found.flights['start_mm'].median():.0f} mm from it (median)"
        f"{way if early else ''}. Is the lance's outlet right (mm, as captured, before Eq. 2.4)? "
        "Dwell times, velocities and ignition are of flights from the lance only."
    )


def _behind_lance(found: Outcome) -> str:
    """Return a note where flights pass more metres behind the lance than in front of it."""
    behind = int((found.slices["slice_m"] < 0).sum())
    if 2 * behind <= len(found.slices):
        return ""
    return (
        f"{behind} of {len(found.slices)} metres that were passed lie behind the lance. Is its "
        "outlet right (mm, as captured, before Eq. 2.4)?"
    )


def _as_it_is(found: Outcome) -> str:
    """Return a note where ignition was seen in grey values as they are."""
    seen = int((found.counted["ignition"] == SEEN).sum())
    if not seen:
        return ""
    return (
        f"Ignition was seen in {seen} of {len(found.counted)} flights as a step of the grey "
        "values as they are, as the thesis does. A particle that flies from before a dark part of "
        "the kiln to before a bright one shows such a step without burning: compare "
        "--above-background."
    )


def used(run: KilnRun, given: Collection[str], jobs: str) -> tuple[tuple[str, str], ...]:
    """Return what a recording was worked on with, in rows of what and value.

    Parameters
    ----------
    run
        How it is worked on.
    given
        What the user gave, of "threshold" and "exit_point_mm".
    jobs
        Who does the work, in a few words.
    """
    lance, wall, dog = run.exit_point_mm, run.wall, run.detection.detector.detector
    rows = []
    if isinstance(dog, DoG):
        source = "given" if "threshold" in given else "not given, from the noise"
        rows.append(("threshold of DoG", f"{dog.threshold:g} grey values ({source})"))
    if lance is None:
        rows.append(("lance's outlet", "not used"))
    else:
        source = "given" if "exit_point_mm" in given else "as recorded"
        rows.append(("lance's outlet, after Eq. 2.4", f"{_listed(lance, 1)} mm ({source})"))
    if wall is None:
        rows.append(("kiln's wall", "not used"))
    else:
        axis = f"through {_listed(wall.centre_mm, 0)} mm along {_listed(wall.direction, 4)}"
        rows += [("kiln's axis", axis), ("kiln's radius", f"{wall.radius_mm:.0f} mm")]
        limit = f"up to {run.in_air.threshold_mm:g} mm from the axis"
        rows.append(("taken for in the air", limit))
        bright = run.rules.ignition.bright
        level = "not asked" if bright is None else f"from {bright:g} grey values on (given)"
        rows.append(("taken for alight when first seen", level))
        above = "above the background" if run.rules.above_background else "as they are"
        rows.append(("ignition", f"a step of the grey values {above}"))
    rows.append(("post-processing of tracks", "without the texture term of Eq. 4.24"))
    return (*rows, ("jobs", jobs))


def _listed(values: tuple[float, ...], digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)


def summary(found: Outcome) -> pd.DataFrame:
    """Return the outcome in rows of ``what`` and ``value``, both texts.

    In brackets: 95 % intervals, by bootstrap over particles and of shares by Wilson; none of
    fewer than six.
    """
    linked = tracked(found.tracks)
    rows = [
        ("recording", found.name),
        ("frames", str(found.frames)),
        *found.used,
        ("detections", f"{len(found.detections)}, with depth {_with_depth(found.detections)}"),
        ("detections in the air or without depth", str(len(found.tracks))),
        ("tracks", f"{linked['particle'].nunique()} with {len(linked)} detections"),
    ]
    ways = found.trajectories["outcome"].value_counts().sort_index()
    rows += [("trajectories fitted", str(int(ways.get("fitted", 0))))]
    rows += [(f"not fitted: {why}", str(n)) for why, n in ways.items() if why != "fitted"]
    rows += [*_flown(found), *_velocities(found), *_to_doubt(found)]
    return pd.DataFrame(rows, columns=["what", "value"])


def _with_depth(detections: pd.DataFrame) -> int:
    return int(detections["z"].notna().sum())


def _flown(found: Outcome) -> list[tuple[str, str]]:
    counted = found.counted
    rows = [
        ("flights from the lance", str(len(counted))),
        ("left out: not from the lance", str(len(found.flights) - len(counted))),
    ]
    endings = counted["ending"].value_counts().sort_index()
    rows += [(f"flights {ending}", str(n)) for ending, n in endings.items()]
    if counted.empty:
        return rows
    dwell = Bootstrap()(median, [counted["dwell_s"]], np.random.default_rng(SEED))
    rows.append(("dwell time, median", f"{_said(dwell, 3)} s"))
    return [*rows, *_ignited(counted)]


def _ignited(counted: pd.DataFrame) -> list[tuple[str, str]]:
    """Return the share that ignited; one more only where some were alight when first seen."""
    ways = counted["ignition"]
    asked = [("ignition seen", [SEEN])]
    if (ways == BEFORE).any():
        asked.append(("ignition seen, or alight when first seen", [SEEN, BEFORE]))
    lit = [(what, share(int(ways.isin(some).sum()), len(counted))) for what, some in asked]
    rows = [(what, f"{_said(interval, 0, 100)} %") for what, interval in lit]
    few = f"{int((ways == TOO_FEW).sum())} of {len(counted)}"
    return [*rows, ("too few points to judge ignition", few)]


def _said(interval: Interval, digits: int, factor: float = 1.0) -> str:
    """Return an estimate with its interval, or without one if the sample is too small."""
    estimate, low, high = (f"{factor * value:.{digits}f}" for value in interval[:3])
    return f"{estimate} [{low}, {high}]" if np.isfinite(interval[1:3]).all() else estimate


def _velocities(found: Outcome) -> list[tuple[str, str]]:
    """Return the median velocity in each metre, and which share of the flights passed it."""
    groups = found.slices.groupby("slice_m")["velocity_m_s"]
    rows = []
    for far, number in remaining(found.slices, len(found.counted))[
        ["slice_m", "number"]
    ].to_numpy():
        middle = Bootstrap()(median, [groups.get_group(far)], np.random.default_rng(SEED))
        passed = _said(share(int(number), len(found.counted)), 0, 100)
        said = f"median {_said(middle, 1)} m/s, {passed} % of the flights"
        rows.append((f"velocity in the metre up to {far:g} m", said))
    return rows


def _to_doubt(found: Outcome) -> list[tuple[str, str]]:
    """Return by what a reader sees that depths jumped, or that a flight is too fast to be true.

    Only told: nothing is left out for it. The thesis sets no limit either.
    """
    fitted = found.trajectories[found.trajectories["particle"].isin(found.counted["particle"])]
    fitted = fitted.dropna(subset=["rmse_z_mm"])
    rows = []
    if len(fitted):
        each = (f"{fitted[f'rmse_{axis}_mm'].median():.0f}" for axis in "xyz")
        rows.append(("RMSE of their fits in x, y, z, median", f"{', '.join(each)} mm"))
        worst = fitted.iloc[int(np.argmax(fitted["rmse_z_mm"]))]
        said = f"{worst['rmse_z_mm']:.0f} mm (particle {worst['particle']})"
        rows.append(("largest RMSE in depth", said))
    if len(found.slices):
        fast = found.slices.iloc[int(np.argmax(found.slices["velocity_m_s"].abs()))]
        said = f"{fast['velocity_m_s']:.1f} m/s (particle {fast['particle']}, "
        rows.append(("fastest metre", f"{said}up to {fast['slice_m']:g} m)"))
        unseen = f"{int((~found.slices['observed']).sum())} of {len(found.slices)}"
        rows.append(("metres passed before the particle was first seen", unseen))
    return rows


def text(table: pd.DataFrame) -> str:
    """Return a summary as lines of two columns."""
    width = int(table["what"].str.len().max())
    return "\n".join(f"{what:<{width}}  {value}" for what, value in table.to_numpy().tolist())
