"""Drive a bar of valves by predictions of particles that enter the prediction phase.

::

    tracks or pictures -> Entering -> fitted models -> predictions -> lots -> ValveBar

Neither paper evaluates valves. The first half of the particles calibrates the models,
the second half is reported (notebook 45).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from kilnflight.arrays import Flags, Integers
from kilnflight.belt.models import ArrivalModel, LateralModel
from kilnflight.belt.online import predict_arrivals

Models = Sequence[tuple[str, ArrivalModel, LateralModel]]
# From one pass of the same recording to the next, longer than any recording.
PASS_S = 1000.0


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
        rank = self.arrival["time_s"].rank(method="first").to_numpy()
        first = rank <= len(rank) / 2
        entry = self.last["time_s"]
        early = (entry <= entry.median()).to_numpy().copy()
        matched = self.rows >= 0
        early[matched] = first[self.rows[matched]]
        return self._select(early, first), self._select(~early, ~first)

    def _select(self, tracks: Flags, particles: Flags) -> Entering:
        return self._replace(
            last=self.last[tracks],
            truth=self.truth[tracks],
            arrival=self.arrival[particles],
        )

    def fit(self, models: Models) -> Models:
        """Return name, arrival and lateral model, calibrated with known particles."""
        matched = self.rows >= 0
        target = self.target_mm
        last = self.last[matched].assign(particle=self.truth[matched])
        arrival = self.arrival.iloc[self.rows[matched]]
        fitted = []
        for name, when, where in models:
            arrival_model = when.calibrated(last, arrival, target)
            fitted.append((name, arrival_model, where.calibrated(last, arrival)))
        return fitted

    def predict(self, when: ArrivalModel, where: LateralModel) -> pd.DataFrame:
        """Return time and place of all n tracks at the valves.

        The columns are those of `kilnflight.tables.BELT_PREDICTED`.
        """
        return predict_arrivals(self.last, when, where, self.target_mm)

    @property
    def missed_share(self) -> float:
        """Share of arriving particles that no track follows."""
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
