"""The simulated sorter: what a simulated second costs, and what the time step changes.

It needs MuJoCo (the extra ``sorter``); without it, or with an older one, `save` says so and saves
nothing. What the contacts change is in notebook 43 (`kilnflight.experiments.belt_sorter`).

Beside it the usual way to a conveyor, a heavy body that moves: it costs less, because its
particles hop and are in contact for a part of the time only.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from measure import Row

from kilnflight.experiments.belt_profile import motion_profile, step_velocities
from kilnflight.project import figures
from kilnflight.sorter.bodies import build_model, engine, missing_reason
from kilnflight.sorter.machine import BULKS, Bulk, Conveyor
from kilnflight.sorter.simulation import calibrated_sorter

SIZES = (20, 60, 120)
SECONDS = 0.1
START_MM_S = 1000.0
STEPS_S = (0.0002, 0.0001, 0.00005)
MOVING = """<mujoco><option timestep="{step}" gravity="0 0 -9810" cone="elliptic"/>
<default><geom condim="3" friction="{mu} 0.001 0" solref="{time} 1" solimp="0.99 0.99 0.01"/>
</default><worldbody>
<body name="belt"><joint type="slide" axis="1 0 0"/>
<geom type="box" size="2000 200 10" pos="0 0 -10" mass="1e9"/></body>{bodies}
</worldbody></mujoco>"""


def places(count: int, bulk: Bulk) -> np.ndarray:
    """Return places of particles that lie apart, (n, 3)."""
    k = np.arange(count)
    return np.column_stack([15.0 * (k // 10), 20.0 + 14.0 * (k % 10), np.full(count, bulk.rest_mm)])


def surface(count: int, bulk: Bulk) -> tuple[Any, Any]:
    """Return particles on our belt, a plane at rest whose surface moves."""
    model = build_model(bulk, calibrated_sorter().contacts, count, Conveyor())
    data = engine().MjData(model)
    data.qpos.reshape(-1, 7)[:, :3] = places(count, bulk)
    data.qvel.reshape(-1, 6)[:, 0] = START_MM_S
    return model, data


def moving_body(count: int, bulk: Bulk) -> tuple[Any, Any]:
    """Return the same on a heavy body that moves."""
    size = " ".join(map(str, bulk.half_mm))
    one = '<body pos="{} {} {}"><freejoint/><geom type="{}" size="{}" density="{}"/></body>'
    bodies = "".join(
        one.format(*place, bulk.shape, size, bulk.density_g_mm3) for place in places(count, bulk)
    )
    touch = calibrated_sorter().contacts
    text = MOVING.format(
        step=Conveyor.step_s, mu=touch.belt_friction, time=touch.belt_time_s, bodies=bodies
    )
    model = engine().MjModel.from_xml_string(text)
    data = engine().MjData(model)
    data.qvel[0], data.qvel[1:].reshape(-1, 6)[:, 0] = Conveyor.speed_mm_s, START_MM_S
    return model, data


def rows() -> list[Row]:
    """Return nothing: there is no peer with the same result; see `save`."""
    return []


def costs() -> pd.DataFrame:
    """Return seconds of computing per simulated second, and how well cuboids lie."""
    bulk, parts = BULKS["cuboids"], []
    friction = calibrated_sorter().contacts.belt_friction
    known = START_MM_S + 9810.0 * friction * SECONDS
    for count in SIZES:
        for build in (surface, moving_body):
            (model, data), mujoco = build(count, bulk), engine()
            highest, start = 0.0, time.process_time()
            for _ in range(round(SECONDS / model.opt.timestep)):
                mujoco.mj_step(model, data)
                highest = max(highest, float(data.xpos[-count:, 2].max()) - bulk.rest_mm)
            spent = (time.process_time() - start) / SECONDS
            off = float(data.qvel.reshape(-1)[-6 * count :: 6].mean()) - known
            parts.append((count, build.__name__, spent, highest, off))
    columns = ["particles", "belt", "s_per_simulated_s", "highest_mm", "velocity_off_mm_s"]
    return pd.DataFrame(parts, columns=columns)


def convergence(count: int = 150, seed: int = 1) -> pd.DataFrame:
    """Return mean and spread of the velocity along the belt by time step."""
    parts = []
    for name, bulk in BULKS.items():
        for step in STEPS_S:
            sorter = replace(calibrated_sorter(name), conveyor=Conveyor(step_s=step))
            start = time.process_time()
            tracks = sorter(bulk, count, np.random.default_rng(seed))
            spent = (time.process_time() - start) / tracks["time_s"].max()
            one = motion_profile(step_velocities(tracks), np.array([450.0, 550.0, 650.0, 750.0]))
            one = one[["x_mm", "mean_m_s", "std_m_s", "particles"]]
            one.insert(0, "data_set", name)
            one.insert(1, "step_ms", 1000.0 * step)
            parts.append(one.assign(s_per_simulated_s=spent))
    return pd.concat(parts, ignore_index=True)


def save() -> None:
    """Save what a simulated second costs, and what the time step changes, if MuJoCo is here."""
    if missing_reason():
        print(f"bench_sorter: skipped. {missing_reason()}", flush=True)
        return
    origin = figures.trace("benchmarks/bench_sorter", {"scale": "full"}, mark="")
    caption = (
        "Seconds of computing per simulated second of cuboids on the belt, one process; how high "
        "above it they get, and mean velocity minus what mechanics gives. Surface: ours; moving "
        "body: a heavy body under them, with the same friction."
    )
    figures.save("benchmark-sorter", costs(), caption=caption, provenance=origin)
    caption = (
        "Mean and standard deviation of the velocity along the belt for the same 150 particles "
        "with three time steps, and seconds of computing per simulated second in one process."
    )
    figures.save("benchmark-sorter-step", convergence(), caption=caption, provenance=origin)
