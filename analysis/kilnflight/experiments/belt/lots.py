"""A bar of valves driven by exact positions and by pictures, and what it separates.

tracks or pictures -> Entering -> fitted models -> predictions -> valves -> shares that
are hit

Neither paper evaluates valves. The first half of the particles calibrates the models,
the second half is reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight.arrays import Flags, Integers
from kilnflight.belt import COMBINATIONS
from kilnflight.belt.models import (
    CA,
    CALV,
    CVBC,
    IV,
    ArrivalModel,
    LateralCA,
    LateralCV,
    LateralModel,
    Straight,
)
from kilnflight.belt.online import predict_arrivals
from kilnflight.belt.phase import PredictionPhase
from kilnflight.experiments.belt.paper_2016 import PictureTracks, followed_particles

Models = Sequence[tuple[str, ArrivalModel, LateralModel]]

# Fig. 10 of 2020 and two more: what a line-scan camera implies (one velocity for all,
# straight), and constant velocity without its bias. Fig. 10 shows spreads, but a valve
# suffers from a bias.
VALVE_MODELS = (
    ("IV-Straight", IV(), Straight()),
    *COMBINATIONS,
    ("CVBC-CV", CVBC(), LateralCV()),
)
# The belt's filter has a constant velocity, so models of acceleration are left out for
# pictures.
OF_VELOCITY = tuple(
    (name, when, where)
    for name, when, where in VALVE_MODELS
    if not isinstance(when, CA | CALV) and not isinstance(where, LateralCA)
)
PASS_S = (
    1000.0  # from one pass of the same recording to the next, longer than any recording
)


class Entering(NamedTuple):
    """Tracks that enter the prediction phase, and particles that truly arrive."""

    last: pd.DataFrame  # kilnflight.tables.BELT_LAST, a row for each of n tracks
    truth: Integers  # (n,) the particle of each track; -1: none that arrives
    arrival: pd.DataFrame  # kilnflight.tables.BELT_ARRIVAL, a row for each particle
    target_mm: float  # x of the valves

    @property
    def rows(self) -> Integers:
        """Row (n,) of ``arrival`` that holds each track's particle; -1: none."""
        return np.asarray(pd.Index(self.arrival["particle"]).get_indexer(self.truth))

    def halves(self) -> tuple[Entering, Entering]:
        """Return the earlier and the later half of the particles, each with its tracks.

        Tracks without a particle are split at the median time of the last observations.
        The first half calibrates the models, the second tests them.
        """
        first = (
            self.arrival["time_s"].rank(method="first") <= len(self.arrival) / 2
        ).to_numpy()
        rows = self.rows
        entry = self.last["time_s"]
        early = (entry <= entry.median()).to_numpy()
        early = np.where(rows >= 0, first[rows], early) if len(first) else early
        first_half, second_half = (
            self._replace(
                last=self.last[tracks],
                truth=self.truth[tracks],
                arrival=self.arrival[particles],
            )
            for tracks, particles in ((early, first), (~early, ~first))
        )
        return first_half, second_half

    def fit(self, models: Models) -> Models:
        """Return name, arrival and lateral model, calibrated with known particles."""
        matched = self.rows >= 0
        target = self.target_mm
        last = self.last[matched].assign(particle=self.truth[matched])
        arrival = self.arrival.iloc[self.rows[matched]]
        return [
            (
                name,
                when.calibrated(last, arrival, target),
                where.calibrated(last, arrival),
            )
            for name, when, where in models
        ]

    def predict(self, when: ArrivalModel, where: LateralModel) -> pd.DataFrame:
        """Return time and place of all n tracks at the valves.

        The columns are those of `kilnflight.tables.BELT_PREDICTED`.
        """
        return predict_arrivals(self.last, when, where, self.target_mm)

    @property
    def missed_share(self) -> float:
        """Share of the arriving particles that no track follows, so without a
        prediction.
        """
        return float((~self.arrival["particle"].isin(self.truth)).mean())


def draw_lots(
    entering: Entering, predicted: pd.DataFrame, blown: float, seed: int
) -> tuple[pd.DataFrame, pd.DataFrame, Flags]:
    """Repeat a recording, with other particles to be blown out in each pass.

    Each particle is to be blown out in one pass and counts as one of the others in the
    rest. So few particles suffice for both shares. Tracks without a particle are never
    blown out.

    Parameters
    ----------
    entering
        Tracks and arrivals of the recording.
    predicted
        `kilnflight.tables.BELT_PREDICTED`, a row per track of ``entering``.
    blown
        Share of the particles to be blown out in a pass; there are 1 / ``blown``
        passes.
    seed
        Seed of the draw.

    Returns
    -------
    meant : DataFrame
        `kilnflight.tables.BELT_PREDICTED` of the particles to be blown out; pass k is
        shifted by k times `PASS_S`.
    every : DataFrame
        `kilnflight.tables.BELT_ARRIVAL` (m rows) of all passes, shifted alike.
    chosen : ndarray
        (m,), whether a particle is to be blown out in that pass.
    """
    passes = round(1 / blown)
    arrival = entering.arrival
    lot = np.random.default_rng(seed).permutation(len(arrival)) % passes
    matched = entering.rows >= 0
    meant = predicted[matched]
    meant = meant.assign(time_s=meant["time_s"] + PASS_S * lot[entering.rows[matched]])
    number = np.repeat(np.arange(passes), len(arrival))
    every = pd.concat([arrival] * passes, ignore_index=True)
    every["time_s"] += PASS_S * number
    return meant, every, np.tile(lot, passes) == number


def of_bodies(bodies: pd.DataFrame, phase: PredictionPhase) -> Entering:
    """Return exact tracks that enter the phase; each is its own particle.

    ``bodies`` are `kilnflight.tables.BELT_TRACKS`.
    """
    observed = phase.observe(bodies)
    truth = observed.last["particle"].to_numpy()
    return Entering(observed.last, truth, observed.arrival, phase.target_mm)


def of_pictures(
    pictured: PictureTracks, bodies: pd.DataFrame, phase: PredictionPhase
) -> Entering:
    """Return valid tracks from pictures that enter the phase.

    ``bodies`` are exact `kilnflight.tables.BELT_TRACKS` at 1000 Hz, which give the true
    particle of each track and the arrivals.
    """
    arrival = phase.observe(bodies).arrival
    last = followed_particles(pictured, bodies)
    truth = last["truth"].where(last["truth"].isin(arrival["particle"]), -1)
    return Entering(last, truth.to_numpy(), arrival, phase.target_mm)
