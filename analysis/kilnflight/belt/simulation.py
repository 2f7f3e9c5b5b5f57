"""The simulated sorter: bulk material on a belt, every contact calculated (2016 and 2020).

feed -> bodies on the belt, 0.2 ms at a time -> positions 1000 times a second -> table

Batches of particles are independent of each other, each with a seed of its own, so that the
tracks do not depend on the number of processes; finished batches are kept on disk.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import joblib
import numpy as np
import numpy.typing as npt
import pandas as pd
from tqdm import tqdm

from kilnflight.belt import keeping
from kilnflight.belt.arrival import BELT_VELOCITY_MM_S
from kilnflight.belt.bulk import BULKS, Bulk
from kilnflight.belt.physics import Contacts, check_step, compiled, engine
from kilnflight.belt.slide import Fed, Slide
from kilnflight.checks import InputError, check_count, check_positive
from kilnflight.tables import BELT_BODIES

Array = npt.NDArray[np.float64]

BATCH = 500  # particles that are simulated together: about two seconds of feed
SLOTS = 220  # bodies on the belt at once; one more waits at the feeder


@dataclass(frozen=True)
class Sorter:
    """A belt between two walls, fed by a slide.

    Beyond the edge a particle flies on with the velocity it left with; nothing touches it
    there. Coordinates are those of the authors' files: the belt runs from 388 to 788 mm.
    """

    contacts: Contacts = field(default_factory=Contacts)
    slide: Slide = field(default_factory=Slide)
    belt_mm_s: float = BELT_VELOCITY_MM_S  # sec. IV (2016), sec. 4 (2020)
    width_mm: float = 180.0  # sec. 3 (2020)
    start_mm: float = 388.0  # the authors' files
    edge_mm: float = 788.0  # 40 cm further (sec. IV, 2016)
    end_mm: float = 800.0  # of the tracks, so that observations follow the edge
    sampling_hz: float = 1000.0  # both papers
    step_s: float = 0.0002  # the 2020 paper's DEM: 0.0001; `benchmarks/bench_sorter.py`
    patience_s: float = 3.0  # a particle that takes longer to the edge is told

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        for name in ("belt_mm_s", "width_mm", "sampling_hz", "step_s", "patience_s"):
            check_positive(getattr(self, name), f"Sorter: {name}")
        if not self.start_mm < self.edge_mm <= self.end_mm:
            raise InputError(
                f"Sorter: the belt runs from {self.start_mm} to {self.edge_mm} mm and tracks end "
                f"at {self.end_mm} mm; these must ascend."
            )
        steps = 1.0 / (self.sampling_hz * self.step_s)
        if abs(steps - round(steps)) > 1e-6 or steps < 0.5:
            raise InputError(
                f"Sorter: {self.sampling_hz} Hz is no whole number of steps of {self.step_s} s."
            )
        check_step(self.contacts, self.step_s)

    def __call__(self, bulk: Bulk, count: int, generator: np.random.Generator) -> pd.DataFrame:
        """Simulate ``count`` particles; `kilnflight.tables.BELT_BODIES` from frame 0.

        Raises
        ------
        InputError
            If a particle does not reach the edge, or the simulation becomes unstable.
        """
        check_count(count, "Sorter: count", least=0)
        if not count:
            return BELT_BODIES.empty()
        fed = self.slide(bulk, count, self.width_mm, generator)
        return _Run(self, bulk, fed, generator.random(count)).table()


class _Run:
    """One batch on its way; bodies are taken from a pool and given back at the edge."""

    def __init__(self, sorter: Sorter, bulk: Bulk, fed: Fed, start: Array) -> None:
        self.sorter, self.bulk, self.fed = sorter, bulk, fed
        self.mujoco = engine()
        bodies = min(len(start), SLOTS)
        self.model = compiled(
            bulk, sorter.contacts, bodies, sorter.width_mm, sorter.belt_mm_s, sorter.step_s
        )
        self.data: Any = self.mujoco.MjData(self.model)
        self.place: Array = self.data.qpos.reshape(bodies, 7)  # views into the engine's state
        self.speed: Array = self.data.qvel.reshape(bodies, 6)
        self.waiting: Array = self.place.copy()
        self.particle = np.full(bodies, -1)  # which one a body is; -1: waits above the belt
        # Where within the first millisecond a particle comes shifts it along the belt.
        self.first = sorter.start_mm + start * fed.velocity_mm_s[:, 0] / sorter.sampling_hz
        self.fed_at = np.zeros(len(start), dtype=np.int64)  # frame
        self.left = np.zeros(len(start), dtype=bool)

    def table(self) -> pd.DataFrame:
        """Run to the end and return all rows, particle by particle."""
        parts, flights, frame, upcoming = [], [], 0, 0
        steps = round(1.0 / (self.sorter.sampling_hz * self.sorter.step_s))
        while not self.left.all():
            upcoming = self._feed(frame, upcoming)
            rows = self._rows(frame)
            parts.append(rows)
            flights.append(self._let_go(rows))
            self._check(frame)
            self.mujoco.mj_step(self.model, self.data, steps)
            self._park()
            frame += 1
        rows = np.concatenate(parts + [self._flight(one) for one in flights if len(one)])
        rows = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
        table = pd.DataFrame(rows, columns=["frame", "particle", *BELT_BODIES.names[3:]])
        table = table.astype({"frame": np.int64, "particle": np.int64})
        table["time_s"] = table["frame"] / self.sorter.sampling_hz
        return table[BELT_BODIES.names]

    def _feed(self, frame: int, upcoming: int) -> int:
        """Put particles on the belt whose time has come, if their place and a body are free."""
        while upcoming < len(self.left):
            if self.fed.time_s[upcoming] * self.sorter.sampling_hz > frame:
                break
            spare = np.flatnonzero(self.particle < 0)
            place = np.array([self.first[upcoming], self.fed.y[upcoming]])
            there = self.place[self.particle >= 0, :2]
            near = np.linalg.norm(there - place, axis=1) < 2.0 * self.bulk.reach_mm
            if not len(spare) or near.any():
                break
            self._start(int(spare[0]), upcoming, frame)
            upcoming += 1
        return upcoming

    def _start(self, body: int, particle: int, frame: int) -> None:
        half = self.fed.yaw_rad[particle] / 2.0
        turn = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])  # about the vertical
        if self.bulk.shape == "cylinder":  # MuJoCo's stands: lay it down first, along x
            down = np.sqrt(0.5)
            turn = down * np.array([turn[0], -turn[3], turn[0], turn[3]])
        height = self.bulk.rest_mm + 0.2  # mm of air: what starts inside is thrown up
        self.place[body] = [self.first[particle], self.fed.y[particle], height, *turn]
        self.speed[body] = 0.0
        self.speed[body, :3] = self.fed.velocity_mm_s[particle]
        # MuJoCo has the spin of a free body in the body's own axes; only spheres have one.
        yaw = self.fed.yaw_rad[particle]
        self.speed[body, 3:5] = self.fed.spin_1_s[particle] * np.array([np.sin(yaw), np.cos(yaw)])
        self.particle[body], self.fed_at[particle] = particle, frame

    def _rows(self, frame: int) -> Array:
        """Return frame, particle, x, y, z, angle, velocity along and across; one row a body."""
        on = self.particle >= 0
        matrix = self.data.xmat[1:].reshape(-1, 3, 3)
        self.mujoco.mj_kinematics(self.model, self.data)
        axis = matrix[on, :, 2 if self.bulk.shape == "cylinder" else 0]
        angle = np.arctan2(axis[:, 1], axis[:, 0])
        rows = [np.full(on.sum(), frame), self.particle[on], *self.place[on, :3].T, angle]
        return np.column_stack([*rows, *self.speed[on, :2].T])

    def _let_go(self, rows: Array) -> Array:
        """Free the bodies whose centre is beyond the edge; return their rows."""
        gone = rows[rows[:, 2] >= self.sorter.edge_mm]
        leaving = gone[:, 1].astype(np.int64)
        self.left[leaving] = True
        self.particle[np.isin(self.particle, leaving)] = -1
        self._park()
        return gone

    def _park(self) -> None:
        """Hold the bodies above the belt that are not on it."""
        idle = self.particle < 0
        self.place[idle], self.speed[idle] = self.waiting[idle], 0.0

    def _flight(self, gone: Array) -> Array:
        """Return the rows after the edge: in the air, with constant velocity."""
        step = 1.0 / self.sorter.sampling_hz
        length = (self.sorter.end_mm - gone[:, 2]) / (gone[:, 6] * step)
        parts = [np.empty((0, gone.shape[1]))]
        for k in range(1, int(max(length.max(), 0.0)) + 1):
            later = gone[length >= k].copy()
            later[:, 0] += k
            later[:, 2:4] += k * step * later[:, 6:8]
            parts.append(later)
        return np.concatenate(parts)

    def _check(self, frame: int) -> None:
        """Tell of a particle that does not leave, and of a state that MuJoCo gave up."""
        on = self.particle[self.particle >= 0]
        late = on[frame - self.fed_at[on] > self.sorter.patience_s * self.sorter.sampling_hz]
        if len(late):
            raise InputError(
                f"particle {late[0]} has not left the belt after {self.sorter.patience_s} s; "
                "with more friction, or a faster belt, it would."
            )
        if any(one.number for one in self.data.warning):
            raise InputError(
                f"the simulation became unstable in frame {frame}; take a smaller step_s or "
                "softer contacts."
            )


def batches(count: int) -> list[int]:
    """Return how many particles each batch has."""
    check_count(count, "simulation: count", least=0)
    return [min(BATCH, count - first) for first in range(0, count, BATCH)]


def tracks(
    material: str,
    count: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    sorter: Sorter | None = None,
) -> pd.DataFrame:
    """Return the bodies of one material on the belt, batch after batch, from disk if kept.

    Parameters
    ----------
    material
        ``spheres``, ``cuboids`` or ``cylinders``.
    count
        Particles; as many as in the paper unless told.
    seed
        Of all chances. The first particles of a longer run are not those of a shorter one
        unless both fill their batches.
    jobs
        Processes on this machine; the result does not depend on it.
    sorter
        The calibrated one unless told.

    Returns
    -------
    DataFrame
        `kilnflight.tables.BELT_BODIES`, which holds the columns of ``BELT_TRACKS``. A batch
        begins when the belt is empty again.
    """
    if material not in BULKS:
        raise InputError(f"no material {material!r}; there are {', '.join(BULKS)}.")
    engine()
    sorter = Sorter() if sorter is None else sorter
    sizes = batches(BULKS[material].count if count is None else count)
    one = joblib.delayed(partial(_batch, sorter, material, seed))
    run = joblib.Parallel(n_jobs=min(jobs, len(sizes)) or 1, return_as="generator")
    made = run(one(number, size) for number, size in enumerate(sizes))
    bar = tqdm(made, desc=f"belt with {material}", total=len(sizes), unit="batch", disable=None)
    parts, frame, particle = [BELT_BODIES.empty()], 0, 0
    for part, size in zip(bar, sizes, strict=True):
        part["frame"] += frame
        part["particle"] += particle
        part["time_s"] = part["frame"] / sorter.sampling_hz
        frame, particle = int(part["frame"].max()) + 1, particle + size
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def _batch(sorter: Sorter, material: str, seed: int, number: int, size: int) -> pd.DataFrame:
    bulk = BULKS[material]
    went_in = {"sorter": repr(sorter), "bulk": repr(bulk), "seed": [seed, number], "size": size}
    went_in["mujoco"] = engine().__version__
    order = list(BULKS).index(material)
    make = partial(sorter, bulk, size, np.random.default_rng([seed, order, number]))
    return keeping.kept(went_in, make)
