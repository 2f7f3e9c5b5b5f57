"""Bodies on the belt in MuJoCo.

Moving surface, two walls, particles of one material.

Units are millimetre, gram and second. MuJoCo comes with the extra ``sorter``; the rest of the
package works without it.

A `Batch` has a pool of bodies that wait above the belt. A particle that is fed takes a waiting body
and gives it back at the edge. In between MuJoCo moves the body by gravity and by contact with belt,
walls and other particles. Beyond the edge a particle keeps its velocity.

MuJoCo's friction model also pushes a sliding body away from the surface, at about
``mu slip b_t / b_n``. The rates ``b = 2 / time constant`` damp the motion along the surface (t)
and along its normal (n). With equal rates the belt of 1500 mm/s would push a particle of 1000 mm/s
off at up to 150 mm/s. It would hop by some tenths of a millimetre.

So friction has a slower time constant of its own here, ``slip_time_s``. MuJoCo allows that for
explicit pairs of bodies only (`_pairs`). A body laid on the belt stays within two hundredths of
a millimetre. The price: the last ``mu g / b_t`` of slip, some 5 mm/s, fades over ``1 / b_t``, 2 ms.
Where a particle lands, the push against the belt must last long enough for friction to reach its
limit. With ``belt_time_s`` as chosen it does, and the landing hardly depends on either time
(`kilnflight.sorter.machine.Contacts` has the bound).
"""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.sorter.machine import GRAVITY_MM_S2, Bulk, Contacts, Conveyor, Feed
from kilnflight.tables import BELT_BODIES

Array = npt.NDArray[np.float64]

SLOTS = 160  # bodies on the belt at once; one more waits at the feeder
# Bodies in the pool at first, and how many are added when all are taken. Each pair of bodies
# costs time in every step, wherever they are. From 10 bodies on the engine takes sparse matrices;
# then motion does not depend on how many others wait, to the last bit.
POOL, POOL_STEP = 96, 16


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
            "'kilnflight[sorter]'. kilnflight.sorter.friction works without it."
        ) from error
    if not hasattr(mujoco.MjModel, "geom_surfacevel"):
        raise InputError(
            f"The simulated sorter needs MuJoCo 4 (surfaces that move), this is "
            f"{mujoco.__version__}: pip install -U mujoco."
        )
    return mujoco


def missing_reason() -> str:
    """Return why the simulated sorter cannot run here; an empty text where it can."""
    try:
        engine()
    except InputError as error:
        return str(error)
    return ""


def is_installed() -> bool:
    """Return whether the simulated sorter can run: MuJoCo is here and not too old."""
    return not missing_reason()


def build_model(bulk: Bulk, contacts: Contacts, bodies: int, conveyor: Conveyor) -> Any:
    """Return a `mujoco.MjModel` of the belt with its walls.

    The belt is the plane z = 0, walls stand along its sides.

    Parameters
    ----------
    bulk, contacts
        Shape of the bodies, and parameters of their contacts.
    bodies
        How many can be on the belt at once; they wait 1 m above it, apart from each other.
    conveyor
        Width and velocity of the belt, time step.
    """
    size = " ".join(f"{length!r}" for length in bulk.half_mm)
    body_elements = [
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
{"".join(body_elements)}
</worldbody>
<contact>{"".join(_pairs(bulk, contacts, bodies))}</contact>
</mujoco>"""
    return engine().MjModel.from_xml_string(text)


def _pairs(bulk: Bulk, contacts: Contacts, bodies: int) -> Iterator[str]:
    """Yield each pair of bodies that can touch, with its friction."""
    wall, body, mu = contacts.wall_friction, contacts.particle_friction, contacts.belt_friction
    spinning = max(contacts.spinning_mm, 1e-5)  # mm; MuJoCo refuses 0
    rolling = max(contacts.rolling_friction * bulk.half_mm[0], 1e-5)  # mm
    # A box has corners against rolling; six dimensions would cost twice and change nothing.
    dimensions = 3 if bulk.shape == "box" else 6
    on_belt = f"""condim="{dimensions}" solref="{contacts.belt_time_s!r} 1" """
    on_belt += f"""friction="{mu!r} {mu!r} {spinning!r} {rolling!r} {rolling!r}\""""
    for n in range(bodies):
        yield f"""<pair geom1="belt" geom2="g{n}" {on_belt}/>"""
        for side in ("near", "far"):
            yield f"""<pair geom1="{side}" geom2="g{n}" friction="{wall!r} {wall!r}"/>"""
        for other in range(n):
            yield f"""<pair geom1="g{other}" geom2="g{n}" friction="{body!r} {body!r}"/>"""


class Batch:
    """Particles that are simulated together, with bodies from a pool."""

    def __init__(
        self, conveyor: Conveyor, contacts: Contacts, bulk: Bulk, fed: Feed, start: Array
    ) -> None:
        self.conveyor, self.contacts, self.bulk, self.fed = conveyor, contacts, bulk, fed
        self.mujoco = engine()
        self.largest_pool = min(len(start), SLOTS)
        self._make_pool(min(self.largest_pool, POOL))
        # A particle that comes later within the first sample has moved less far.
        self.first_x = conveyor.start_mm + start * fed.velocity_mm_s[:, 0] / conveyor.sampling_hz
        self.fed_at = np.zeros(len(start), dtype=np.int64)  # frame
        self.has_left = np.zeros(len(start), dtype=bool)
        self.due: list[int] = []  # particles that wait for a free place

    def _make_pool(self, bodies: int) -> None:
        """Make the engine's state for a number of bodies, all of them waiting."""
        self.model = build_model(self.bulk, self.contacts, bodies, self.conveyor)
        self.data: Any = self.mujoco.MjData(self.model)
        self.pose: Array = self.data.qpos.reshape(bodies, 7)  # position, quaternion
        self.velocity: Array = self.data.qvel.reshape(bodies, 6)
        self.waiting: Array = self.pose.copy()
        self.particle = np.full(bodies, -1)  # of each body; -1: the body waits above the belt

    def _grow(self) -> None:
        """Add bodies to the pool; the present ones keep their state."""
        bodies, model, data, particle = len(self.particle), self.model, self.data, self.particle
        self._make_pool(min(bodies + POOL_STEP, self.largest_pool))
        self.model.pair_solimp[:] = model.pair_solimp[0]  # set from outside in a study of contacts
        self.data.qpos[: 7 * bodies] = data.qpos
        self.data.qvel[: 6 * bodies] = data.qvel
        self.data.qacc_warmstart[: 6 * bodies] = data.qacc_warmstart
        self.data.warning.number[:] = data.warning.number
        self.data.time = data.time
        self.particle[:bodies] = particle

    def table(self) -> pd.DataFrame:
        """Return `kilnflight.tables.BELT_BODIES` by particle.

        The simulation runs until all have left.
        """
        parts, frame, upcoming = [], 0, 0
        while not self.has_left.all():
            upcoming = self._feed(frame, upcoming)
            rows = self._rows(frame)
            parts += [rows, self._flight(self._release(rows))]
            self._check(frame)
            self.mujoco.mj_step(self.model, self.data, self.conveyor.steps)
            self._park()
            frame += 1
        rows = np.concatenate(parts)
        rows = rows[np.lexsort((rows[:, 0], rows[:, 1]))]
        table = pd.DataFrame(rows, columns=["frame", "particle", *BELT_BODIES.names[3:]])
        table = table.astype({"frame": np.int64, "particle": np.int64})
        table["time_s"] = table["frame"] / self.conveyor.sampling_hz
        return table[BELT_BODIES.names]

    def _feed(self, frame: int, upcoming: int) -> int:
        """Put the particles that are due on the belt, if their place and a body are free.

        The others wait and may be passed. Returns the number of the next particle.
        """
        due = int(np.searchsorted(self.fed.time_s * self.conveyor.sampling_hz, frame, side="right"))
        self.due = [n for n in [*self.due, *range(upcoming, due)] if not self._lay(n, frame)]
        return due

    def _lay(self, particle: int, frame: int) -> bool:
        """Lay a particle on the belt and return True, if its place and a body are free."""
        if (self.particle >= 0).all():
            if len(self.particle) == self.largest_pool:
                return False
            self._grow()
        body = int(np.argmin(self.particle))
        self._start(body, particle, frame)
        if self._overlaps(body):
            self.particle[body] = -1
            self._park()
            return False
        return True

    def _overlaps(self, body: int) -> bool:
        """Return whether a body lies inside another on the belt; touching is no overlap."""
        away = np.linalg.norm(self.pose[:, :3] - self.pose[body, :3], axis=1)
        near = np.flatnonzero((self.particle >= 0) & (away < 2.0 * self.bulk.reach_mm))
        if len(near) < 2:  # itself alone
            return False
        self.mujoco.mj_kinematics(self.model, self.data)
        first = self.model.ngeom - len(self.particle)  # after the belt and its walls
        return any(
            self.mujoco.mj_geomDistance(
                self.model, self.data, first + body, first + other, 1.0, None
            )
            < 0.0
            for other in near[near != body]
        )

    def _start(self, body: int, particle: int, frame: int) -> None:
        """Lay a body on the belt as a particle leaves the slide."""
        yaw = self.fed.yaw_rad[particle]
        turn = np.array([np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)])  # about the vertical
        if self.bulk.shape == "cylinder":  # MuJoCo's cylinder stands; lay it along x first
            turn = np.sqrt(0.5) * np.array([turn[0], -turn[3], turn[0], turn[3]])
        height = self.bulk.rest_mm + 0.2  # mm of air: a body inside the belt would be thrown up
        self.pose[body] = [self.first_x[particle], self.fed.y[particle], height, *turn]
        self.velocity[body] = 0.0
        self.velocity[body, :3] = self.fed.velocity_mm_s[particle]
        # MuJoCo has a free body's angular velocity in the body's own axes; only spheres spin.
        spin = self.fed.spin_1_s[particle]
        self.velocity[body, 3:5] = spin * np.array([np.sin(yaw), np.cos(yaw)])
        self.particle[body], self.fed_at[particle] = particle, frame

    def _rows(self, frame: int) -> Array:
        """Return one row a body: frame, particle, x, y, z, angle, tilt and two velocities.

        The velocities are along and across.
        """
        fed = self.particle >= 0
        matrix = self.data.xmat[1:].reshape(-1, 3, 3)
        self.mujoco.mj_kinematics(self.model, self.data)
        axis = matrix[fed, :, 2 if self.bulk.shape == "cylinder" else 0]
        angle = np.arctan2(axis[:, 1], axis[:, 0])
        tilt = np.arcsin(axis[:, 2].clip(-1.0, 1.0))
        rows = [np.full(fed.sum(), frame), self.particle[fed], *self.pose[fed, :3].T, angle, tilt]
        return np.column_stack([*rows, *self.velocity[fed, :2].T])

    def _release(self, rows: Array) -> Array:
        """Give the bodies beyond the edge back to the pool and return their rows.

        A body is beyond the edge when its centre is.
        """
        leaving = rows[rows[:, 2] >= self.conveyor.edge_mm]
        particles = leaving[:, 1].astype(np.int64)
        self.has_left[particles] = True
        self.particle[np.isin(self.particle, particles)] = -1
        self._park()
        return leaving

    def _park(self) -> None:
        """Hold the waiting bodies above the belt."""
        idle = self.particle < 0
        self.pose[idle], self.velocity[idle] = self.waiting[idle], 0.0

    def _flight(self, leaving: Array) -> Array:
        """Return the rows after the edge: in the air, with constant velocity."""
        if not len(leaving):
            return leaving
        step = 1.0 / self.conveyor.sampling_hz
        length = (self.conveyor.end_mm - leaving[:, 2]) / (leaving[:, 7] * step)
        count = np.maximum(length, 0.0).astype(np.int64)
        rows = np.repeat(leaving, count, axis=0)
        after = np.concatenate([np.arange(1, n + 1) for n in count])
        rows[:, 0] += after
        rows[:, 2:4] += (after * step)[:, None] * rows[:, 7:9]
        return rows

    def _check(self, frame: int) -> None:
        """Raise for a particle that does not leave, or a state in which MuJoCo warned."""
        particles = self.particle[self.particle >= 0]
        longest = self.conveyor.patience_s * self.conveyor.sampling_hz  # frames
        late = particles[frame - self.fed_at[particles] > longest]
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
