"""One batch of particles on its way over the belt, in MuJoCo."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.bulk import Bulk
from kilnflight.belt.conveyor import Conveyor
from kilnflight.belt.physics import Contacts, compiled, engine
from kilnflight.belt.slide import Fed
from kilnflight.checks import InputError
from kilnflight.tables import BELT_BODIES

Array = npt.NDArray[np.float64]

SLOTS = 160  # bodies on the belt at once; one more waits at the feeder
# Bodies at first, and how many more are made when they are not enough: each pair of bodies costs
# time in every step, wherever they are. What bodies do does not depend on how many others wait,
# to the last bit from 10 on, when the engine takes sparse matrices.
FIRST, MORE = 96, 16


class Batch:
    """One batch on its way; bodies are taken from a pool and given back at the edge."""

    def __init__(
        self, conveyor: Conveyor, contacts: Contacts, bulk: Bulk, fed: Fed, start: Array
    ) -> None:
        self.conveyor, self.contacts, self.bulk, self.fed = conveyor, contacts, bulk, fed
        self.mujoco = engine()
        self.most = min(len(start), SLOTS)
        self._allot(min(self.most, FIRST))
        # Where within the first millisecond a particle comes shifts it along the belt.
        self.first = conveyor.start_mm + start * fed.velocity_mm_s[:, 0] / conveyor.sampling_hz
        self.fed_at = np.zeros(len(start), dtype=np.int64)  # frame
        self.left = np.zeros(len(start), dtype=bool)

    def _allot(self, bodies: int) -> None:
        """Make the engine's state for so many bodies, all of them waiting."""
        self.model = compiled(self.bulk, self.contacts, bodies, self.conveyor)
        self.data: Any = self.mujoco.MjData(self.model)
        self.place: Array = self.data.qpos.reshape(bodies, 7)  # views into the engine's state
        self.speed: Array = self.data.qvel.reshape(bodies, 6)
        self.waiting: Array = self.place.copy()
        self.particle = np.full(bodies, -1)  # which one a body is; -1: waits above the belt

    def _grow(self) -> None:
        """Make more bodies; those that are there go on as if nothing had happened."""
        bodies, model, data, particle = len(self.particle), self.model, self.data, self.particle
        self._allot(min(bodies + MORE, self.most))
        self.model.pair_solimp[:] = model.pair_solimp[0]  # may have been set from outside
        self.data.qpos[: 7 * bodies] = data.qpos
        self.data.qvel[: 6 * bodies] = data.qvel
        self.data.qacc_warmstart[: 6 * bodies] = data.qacc_warmstart
        self.data.warning.number[:] = data.warning.number
        self.data.time = data.time
        self.particle[:bodies] = particle

    def table(self) -> pd.DataFrame:
        """Run to the end and return all rows, particle by particle."""
        parts, flights, frame, upcoming = [], [], 0, 0
        while not self.left.all():
            upcoming = self._feed(frame, upcoming)
            rows = self._rows(frame)
            parts.append(rows)
            flights.append(self._let_go(rows))
            self._check(frame)
            self.mujoco.mj_step(self.model, self.data, self.conveyor.steps)
            self._park()
            frame += 1
        rows = np.concatenate(parts + [self._flight(one) for one in flights if len(one)])
        rows = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
        table = pd.DataFrame(rows, columns=["frame", "particle", *BELT_BODIES.names[3:]])
        table = table.astype({"frame": np.int64, "particle": np.int64})
        table["time_s"] = table["frame"] / self.conveyor.sampling_hz
        return table[BELT_BODIES.names]

    def _feed(self, frame: int, upcoming: int) -> int:
        """Put particles on the belt whose time has come, if their place and a body are free."""
        while upcoming < len(self.left):
            if self.fed.time_s[upcoming] * self.conveyor.sampling_hz > frame:
                break
            spare = np.flatnonzero(self.particle < 0)
            place = np.array([self.first[upcoming], self.fed.y[upcoming]])
            there = self.place[self.particle >= 0, :2]
            near = np.linalg.norm(there - place, axis=1) < 2.0 * self.bulk.reach_mm
            if near.any() or (not len(spare) and len(self.particle) == self.most):
                break
            if not len(spare):
                self._grow()
                continue
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
        gone = rows[rows[:, 2] >= self.conveyor.edge_mm]
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
        step = 1.0 / self.conveyor.sampling_hz
        length = (self.conveyor.end_mm - gone[:, 2]) / (gone[:, 6] * step)
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
        late = on[frame - self.fed_at[on] > self.conveyor.patience_s * self.conveyor.sampling_hz]
        if len(late):
            raise InputError(
                f"particle {late[0]} has not left the belt after {self.conveyor.patience_s} s; "
                "with more friction, or a faster belt, it would."
            )
        if self.data.warning.number.any():
            raise InputError(
                f"the simulation became unstable in frame {frame}; take a smaller step_s or "
                "softer contacts."
            )
