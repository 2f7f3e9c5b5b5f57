"""Importance sampling of a posterior of few numbers, in rounds.

The first round draws from the prior. Each later one draws from a heavy-tailed distribution about
what was found before, and from the prior, so that nothing is left out. All count by their common
density (the balance heuristic; Veach and Guibas 1995).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats

from kilnflight.checks import InputError

Array = npt.NDArray[np.float64]
FREEDOM = 5  # degrees of the Student t of the later rounds
FROM_PRIOR = 0.25  # of the later rounds
LEAST = 60.0  # effective draws that shape the next round; fewer are made more alike


class Posterior(NamedTuple):
    """Weighted draws."""

    points: Array  # (n, k), in the order of the prior
    log_density: Array  # (n,): prior times likelihood
    weights: Array  # (n,), sum 1

    @property
    def effective(self) -> float:
        """The effective sample size (Kish)."""
        return effective(self.weights)

    def moments(self) -> tuple[Array, Array]:
        """Return mean and standard deviation of each number, (k,)."""
        mean = self.weights @ self.points
        return mean, np.sqrt(self.weights @ (self.points - mean) ** 2)

    def resampled(self, count: int, seed: int) -> Array:
        """Return equally likely draws (count, k), by systematic resampling in random order."""
        generator = np.random.default_rng([seed, 3])
        levels = (np.arange(count) + generator.random()) / count
        rows = np.searchsorted(np.cumsum(self.weights), levels)
        return self.points[generator.permutation(np.minimum(rows, len(self.points) - 1))]


def effective(weights: Array) -> float:
    """Return the effective size of a weighted sample."""
    return float(weights.sum() ** 2 / (weights**2).sum())


def sample_posterior(
    prior: Mapping[str, Any],
    log_likelihood: Callable[[Array], float],
    rounds: tuple[int, ...],
    seed: int,
) -> Posterior:
    """Return draws from a posterior.

    Parameters
    ----------
    prior
        Independent distributions of `scipy.stats` by name.
    log_likelihood
        Of a point (k,); minus infinity where there can be nothing.
    rounds
        Draws of each round; the first one is from the prior.
    seed
        The same seed gives the same draws.

    Raises
    ------
    InputError
        If hardly a draw of a round agrees with the likelihood.
    """
    sides = list(prior.values())
    cube = stats.qmc.Sobol(len(sides), seed=np.random.default_rng([seed, 1]))
    with warnings.catch_warnings():  # where a count is no power of two
        warnings.simplefilter("ignore", UserWarning)
        cubes = [cube.random(count) for count in rounds]
    generator = np.random.default_rng([seed, 2])
    points, known = np.empty((0, len(sides))), np.empty(0)
    near: list[Any] = []
    for count, place in zip(rounds, cubes, strict=True):
        drawn = np.stack([d.ppf(u) for d, u in zip(sides, place.T, strict=True)], axis=1)
        if near:
            moved = generator.random(count) >= FROM_PRIOR
            drawn[moved] = near[-1].rvs(size=int(moved.sum()), random_state=generator)
        possible = np.isfinite(_log_prior(sides, drawn))
        more = [
            log_likelihood(p) if good else -np.inf for p, good in zip(drawn, possible, strict=True)
        ]
        points, known = np.concatenate([points, drawn]), np.concatenate([known, more])
        found = _weighted(sides, points, known, near, rounds)
        near.append(_around(found))
    return found


def _log_prior(sides: Sequence[Any], points: Array) -> Array:
    return np.sum([d.logpdf(column) for d, column in zip(sides, points.T, strict=True)], axis=0)


def _weighted(
    sides: Sequence[Any], points: Array, known: Array, near: Sequence[Any], rounds: Sequence[int]
) -> Posterior:
    """Return all points so far, weighted by the common density of the rounds so far."""
    log_prior = _log_prior(sides, points)
    share = np.array(rounds[: len(near) + 1]) / len(points)
    part = [np.log(share[0] + FROM_PRIOR * share[1:].sum()) + log_prior]
    for portion, each in zip((1.0 - FROM_PRIOR) * share[1:], near, strict=True):
        part.append(np.log(portion) + np.atleast_1d(each.logpdf(points)))
    density = log_prior + known
    if not np.isfinite(density).any():
        raise InputError("posterior: no draw agrees with the likelihood. Take more draws.")
    log_weights = density - np.logaddexp.reduce(part, axis=0)
    weights = np.exp(log_weights - log_weights.max())
    return Posterior(points, density, weights / weights.sum())


def _around(found: Posterior) -> Any:
    """Return a heavy-tailed distribution about weighted points, wider where these are few."""
    weights = found.weights
    while effective(weights) < LEAST:
        weights = weights**0.8
        if (weights > 0).sum() < LEAST:
            raise InputError(
                f"posterior: of {len(weights)} draws hardly any agrees with the likelihood. Take "
                "more draws, or a narrower prior."
            )
    mean = np.average(found.points, axis=0, weights=weights)
    spread = np.cov(found.points, rowvar=False, aweights=weights)
    return stats.multivariate_t(mean, np.atleast_2d(spread), df=FREEDOM)
