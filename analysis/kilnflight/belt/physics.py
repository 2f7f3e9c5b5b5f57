"""The sorter in MuJoCo: a belt whose surface moves, two walls, bodies of one material.

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
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from kilnflight.belt.bulk import Bulk
from kilnflight.belt.conveyor import Conveyor
from kilnflight.belt.friction import GRAVITY_MM_S2
from kilnflight.checks import InputError, check_at_least, check_positive


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


@dataclass(frozen=True)
class Contacts:
    """How bodies touch. The papers say "determined experimentally" and print no value."""

    belt_friction: float = 0.3  # wood on a plastic belt; handbooks give 0.2 to 0.4
    rolling_friction: float = 0.01  # arm over radius; assumption for wood on a belt
    particle_friction: float = 0.4  # wood on wood; handbooks give 0.25 to 0.5
    wall_friction: float = 0.4  # wood on metal; handbooks give 0.2 to 0.6
    spinning_mm: float = 0.01  # arm of the friction against turning on the spot; assumption
    belt_time_s: float = 0.0006  # of the normal contact with the belt, critically damped
    slip_time_s: float = 0.008  # of friction; see above
    body_time_s: float = 0.0012  # of contacts between bodies and with walls
    # Share of critical damping. Spheres part with 0.22 to 0.34 of their closing speed at steps
    # of 0.2 ms, by where within a step they meet; with 0.28 to 0.31 of it at 0.05 ms.
    body_damping: float = 0.5

    def __post_init__(self) -> None:
        """Refuse what is no contact."""
        for name in ("belt_friction", "belt_time_s", "slip_time_s", "body_time_s", "body_damping"):
            check_positive(getattr(self, name), f"Contacts: {name}")
        names = ("rolling_friction", "particle_friction", "wall_friction", "spinning_mm")
        for name in names:
            check_at_least(getattr(self, name), 0.0, f"Contacts: {name}")


def compiled(bulk: Bulk, contacts: Contacts, bodies: int, conveyor: Conveyor) -> Any:
    """Return a `mujoco.MjModel`: the belt is the plane z = 0, walls stand along its sides.

    Parameters
    ----------
    bulk, contacts
        What moves, and how it touches.
    bodies
        How many can be on the belt at once.
    conveyor
        Width and velocity of the belt, time step.
    """
    size = " ".join(f"{one!r}" for one in bulk.half_mm)
    near = [
        f"""<body pos="{parked(n)} 90 {PARKED_MM}"><freejoint/>
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
    spin = max(contacts.spinning_mm, 1e-5)  # MuJoCo wants some
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


PARKED_MM = 1000.0  # above the belt: where bodies wait that are not on it


def parked(body: int) -> float:
    """Return where along the belt a body waits, apart from all others."""
    return -100.0 - 20.0 * body


def check_step(contacts: Contacts, step_s: float) -> None:
    """Raise an `InputError` if contacts are too stiff for a time step."""
    shortest = min(contacts.belt_time_s, contacts.body_time_s * contacts.body_damping)
    if not step_s <= shortest / 2.0:
        raise InputError(
            f"Sorter: step_s {step_s!r} is too long for contacts of {shortest} s; take at most "
            f"half of that, or softer contacts."
        )
