"""Bodies on the belt in MuJoCo: a surface that moves, two walls, particles of one material.

Units are millimetre, gram and second. MuJoCo comes with the extra ``sorter``; without it
everything else in this package works.

Surfaces that slip fast ask for care. MuJoCo's friction is convex: what slides is also pushed
away, with about ``mu slip b_t / b_n``, the damping rates ``b = 2 / time constant`` being
those along the surfaces and the normal. With equal rates that is 150 mm/s at most where 1000 mm/s
meet the belt, and particles hop by some tenths of a millimetre. Here friction has a slower
time constant of its own (which only explicit pairs of bodies can have), so that the push is
below 12 mm/s and what is laid on the belt stays within a hundredth of a millimetre. The
price: the last ``mu g / b_t`` of slip, 12 mm/s, fades over ``1 / b_t``, 4 ms.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.belt.machine import GRAVITY_MM_S2, Bulk, Contacts, Conveyor, Fed
from kilnflight.checks import InputError
from kilnflight.tables import BELT_BODIES

Array = npt.NDArray[np.float64]

SLOTS = 160  # bodies on the belt at once; one more waits at the feeder
# Bodies at first, and how many more are made when they are not enough: each pair of bodies costs
# time in every step, wherever they are. What bodies do does not depend on how many others wait,
# to the last bit from 10 on, when the engine takes sparse matrices.
FIRST, MORE = 96, 16


def engine() -> ModuleType:
    """Return MuJoCo.

    Raises
    ------
    InputError
        If it is not installed, or too old for a surface that moves.
    """
    try:
        import mujoco
    except ImportError as error:
        raise InputError(
            "The simulated sorter needs MuJoCo, which is not installed: pip install "
            "'kilnflight[sorter]'. kilnflight.belt.friction works without it."
        ) from error
    if not hasattr(mujoco.MjModel, "geom_surfacevel"):
        raise InputError(
            f"The simulated sorter needs MuJoCo 4 (surfaces that move), this is "
            f"{mujoco.__version__}: pip install -U mujoco."
        )
    return mujoco


def missing() -> str:
    """Return why the simulated sorter cannot run here; an empty text where it can."""
    try:
        engine()
    except InputError as error:
        return str(error)
    return ""


def is_installed() -> bool:
    """Return whether the simulated sorter can run: MuJoCo is here and not too old."""
    return not missing()


def compiled(bulk: Bulk, contacts: Contacts, bodies: int, conveyor: Conveyor) -> Any:
    """Return a `mujoco.MjModel`: the belt is the plane z = 0, walls stand along its sides.

    Parameters
    ----------
    bulk, contacts
        What moves, and how it touches.
    bodies
        How many can be on the belt at once; they wait 1 m above it, apart from each other.
    conveyor
        Width and velocity of the belt, time step.
    """
    size = " ".join(f"{length!r}" for length in bulk.half_mm)
    near = [
        f"""<body pos="{-100.0 - 20.0 * n} 90 1000.0"><freejoint/>
<geom name="g{n}" type="{bulk.shape}" size="{size}" density="{bulk.density_g_mm3!r}"/></body>"""
        for n in range(bodies)
    ]
    step, speed = conveyor.step_s, conveyor.speed_mm_s
    text = f"""<mujoco>
<option timestep="{step!r}" gravity="0 0 {-GRAVITY_MM_S2!r}" cone="elliptic"/>
<default>
<geom contype="0" conaffinity="0"/>
<pair condim="3" solimp="0.99 0.99 0.01" solreffriction="{contacts.slip_time_s!r} 1"
 solref="{contacts.body_time_s!r} {contacts.body_damping!r}"/>
</default>
<worldbody>
<geom name="belt" type="plane" size="0 0 1" surfacevel="{speed!r} 0 0"/>
<geom name="near" type="plane" size="0 0 1" zaxis="0 1 0"/>
<geom name="far" type="plane" size="0 0 1" pos="0 {conveyor.width_mm!r} 0" zaxis="0 -1 0"/>
{"".join(near)}
</worldbody>
<contact>{"".join(_pairs(bulk, contacts, bodies))}</contact>
</mujoco>"""
    return engine().MjModel.from_xml_string(text)


def _pairs(bulk: Bulk, contacts: Contacts, bodies: int) -> Iterator[str]:
    """Return every pair of bodies that can touch; only pairs have a slip time of their own."""
    wall, body, mu = contacts.wall_friction, contacts.particle_friction, contacts.belt_friction
    spin = max(contacts.spinning_mm, 1e-5)  # MuJoCo needs more than none
    arm = max(contacts.rolling_friction * bulk.half_mm[0], 1e-5)
    # A box has corners against rolling; six dimensions would cost twice and change nothing.
    rolling = 3 if bulk.shape == "box" else 6
    on_belt = f"""condim="{rolling}" solref="{contacts.belt_time_s!r} 1" """
    on_belt += f"""friction="{mu!r} {mu!r} {spin!r} {arm!r} {arm!r}\""""
    for n in range(bodies):
        yield f"""<pair geom1="belt" geom2="g{n}" {on_belt}/>"""
        for side in ("near", "far"):
            yield f"""<pair geom1="{side}" geom2="g{n}" friction="{wall!r} {wall!r}"/>"""
        for other in range(n):
            yield f"""<pair geom1="g{other}" geom2="g{n}" friction="{body!r} {body!r}"/>"""


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
        """Run to the end and return `kilnflight.tables.BELT_BODIES`, particle by particle."""
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
        rows = np.concatenate(parts + [self._flight(gone) for gone in flights if len(gone)])
        rows = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
        table = pd.DataFrame(rows, columns=["frame", "particle", *BELT_BODIES.names[3:]])
        table = table.astype({"frame": np.int64, "particle": np.int64})
        table["time_s"] = table["frame"] / self.conveyor.sampling_hz
        return table[BELT_BODIES.names]

    def _feed(self, frame: int, upcoming: int) -> int:
        """Put particles on the belt whose time has come, if their place and a body are free."""
        due = np.searchsorted(self.fed.time_s * self.conveyor.sampling_hz, frame, side="right")
        while upcoming < due:
            place = np.array([self.first[upcoming], self.fed.y[upcoming]])
            others = self.place[self.particle >= 0, :2]
            if (np.linalg.norm(others - place, axis=1) < 2.0 * self.bulk.reach_mm).any():
                break
            if (self.particle >= 0).all():
                if len(self.particle) == self.most:
                    break
                self._grow()
            self._start(int(np.argmin(self.particle)), upcoming, frame)
            upcoming += 1
        return upcoming

    def _start(self, body: int, particle: int, frame: int) -> None:
        yaw = self.fed.yaw_rad[particle]
        turn = np.array([np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)])  # about the vertical
        if self.bulk.shape == "cylinder":  # MuJoCo's stands: lay it down first, along x
            turn = np.sqrt(0.5) * np.array([turn[0], -turn[3], turn[0], turn[3]])
        height = self.bulk.rest_mm + 0.2  # mm of air: what starts inside is thrown up
        self.place[body] = [self.first[particle], self.fed.y[particle], height, *turn]
        self.speed[body] = 0.0
        self.speed[body, :3] = self.fed.velocity_mm_s[particle]
        # MuJoCo has the spin of a free body in the body's own axes; only spheres have one.
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
        count = np.maximum(length, 0.0).astype(np.int64)
        rows = np.repeat(gone, count, axis=0)
        after = np.concatenate([np.arange(1, n + 1) for n in count])
        rows[:, 0] += after
        rows[:, 2:4] += (after * step)[:, None] * rows[:, 6:8]
        return rows

    def _check(self, frame: int) -> None:
        """Raise for a particle that does not leave, or a state that MuJoCo gave up."""
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
