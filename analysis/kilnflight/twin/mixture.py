"""How much to feed so that ten frames show what Table 5.2 counts.

Run as ``python -m kilnflight.twin.mixture``.

The five ground-truth subsets differ in how many particles burn in the air, do not burn yet,
and burn on the wall. All fractions are fed together; what differs is when the last handfuls
were thrown in. Three handfuls per subset are enough: sheets that have had time to ignite,
chips and granules that are still on their way, and a mixture that has landed. Their sizes
are found from what a large handful of each shows, and written into `kilnflight.twin.scenes`.
Only the feed is found here; no label is ever placed by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count, product

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from kilnflight.project import claims
from kilnflight.twin import truth
from kilnflight.twin.calibration import calibrated
from kilnflight.twin.exposure import exposed
from kilnflight.twin.feed import Burst
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas
from kilnflight.twin.scene import Scene, Twin
from kilnflight.twin.truth import FRAMES, LABELLED, SUBSETS

CLOSE = 0.08  # a class count off by less is close enough; the rule is 10 % (design)
FLYING, UNLIT, LANDED = "flying", "unlit", "landed"
# With the frozen flight inputs shreds burn in numbers and early, confetti seldom: what burns in
# the air is a handful of mostly shreds thrown 0.3 to 0.6 s before.
# Fractions of each handful and their shares; start relative to the labelled frames, duration.
HANDFULS: dict[str, tuple[dict[str, float], float, float]] = {
    FLYING: ({"paper shred": 0.8, "confetti": 0.2}, -0.6, 0.3),
    UNLIT: (
        {"wood chip": 0.45, "PE granule": 0.45, "confetti": 0.06, "paper shred": 0.04},
        -0.25,
        0.25,
    ),
    LANDED: (
        {"wood chip": 0.45, "PE granule": 0.45, "confetti": 0.06, "paper shred": 0.04},
        -0.85,
        0.4,
    ),
}


def handful(kind: str, count: int, rate_hz: float = 330.0) -> tuple[Burst, ...]:
    """Return the bursts of one handful of ``count`` particles."""
    shares, start, duration = HANDFULS[kind]
    moment = LABELLED.start / rate_hz
    sizes = np.round(np.cumsum([0.0, *shares.values()]) * count).astype(int)
    return tuple(
        Burst(name, int(size), moment + start, duration)
        for name, size in zip(shares, np.diff(sizes), strict=True)
    )


def published_counts(subset: str) -> npt.NDArray[np.float64]:
    """Return burning in air, non-burning in air, burning on the wall of Table 5.2."""
    return claims.published("table_5.2")[subset].to_numpy(dtype=np.float64)[:3]


def counted(scene: Scene) -> npt.NDArray[np.float64]:
    """Return the visible particles of the labelled frames by class, summed, (3,)."""
    twin, total = Twin(scene), np.zeros(3)
    for t in LABELLED:
        seen = truth.sightings(twin, t)
        total += np.bincount(seen["label"][seen["visible"]], minlength=5)[2:5]
    return total


def fed(name: str, sizes: dict[str, int], seed: int) -> Scene:
    """Return the scene of a subset with the given handfuls, its picture as assumed."""
    feed = sum((handful(kind, size) for kind, size in sizes.items()), ())
    flight, gas = calibrated().applied(Flight(), Gas())
    return Scene(name, feed, FRAMES, seed, flight=flight, gas=gas)


def subset(name: str, sizes: dict[str, int], seed: int) -> Scene:
    """Return the scene of a subset with the given handfuls, in the frozen light."""
    return exposed().applied(fed(name, sizes, seed))


def off(found: npt.NDArray[np.float64], wanted: npt.NDArray[np.float64]) -> float:
    """Return the largest relative difference of a class count."""
    return float(np.max(np.abs(found / wanted - 1)))


def solve(name: str, seed: int, rounds: int = 6, tries: int = 40) -> dict[str, int]:
    """Return the handfuls whose labelled frames count as Table 5.2 does.

    A large handful of each kind shows how many sightings a particle yields; least squares
    without negative sizes gives the sizes; a few rounds correct for what chance made of them,
    and `refine` searches near the best.
    """
    wanted = published_counts(name)
    large = 300
    yields = np.stack(
        [counted(subset(name, {kind: large}, seed)) / large for kind in HANDFULS], axis=1
    )
    known: dict[tuple[int, ...], float] = {}

    def measure(sizes: tuple[int, ...]) -> npt.NDArray[np.float64]:
        found = counted(subset(name, dict(zip(HANDFULS, sizes, strict=True)), seed))
        known[sizes] = off(found, wanted)
        return found

    sizes, _ = nnls(yields, wanted)
    for _ in range(rounds):
        whole = tuple(map(int, np.round(sizes)))
        step, *_ = np.linalg.lstsq(yields, wanted - measure(whole), rcond=None)
        sizes = np.maximum(sizes + 0.7 * step, 0.0)
    best = refine(known, measure, tries)
    return dict(zip(HANDFULS, best, strict=True))


def refine(
    known: dict[tuple[int, ...], float], measure: Callable[[tuple[int, ...]], object], tries: int
) -> tuple[int, ...]:
    """Return the sizes that are least off, after trying neighbours of the best in turn.

    Parameters
    ----------
    known
        How much sizes are off; ``measure`` adds to it.
    measure
        Called with sizes that are not known yet.
    tries
        At most so many; it stops earlier where no class is off by `CLOSE`.
    """

    def best() -> tuple[int, ...]:
        return min(known, key=lambda sizes: (known[sizes], sizes))

    for _ in range(tries):
        centre = best()
        if known[centre] <= CLOSE:
            break
        fresh = (one for one in neighbours(centre) if one not in known)
        measure(next(fresh))
    return best()


def neighbours(sizes: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """Yield other sizes, one changed at a time, nearest first."""
    for step in count(1):
        for place, sign in product(range(len(sizes)), (1, -1)):
            changed = list(sizes)
            changed[place] = max(changed[place] + sign * step, 0)
            yield tuple(changed)


def main() -> int:
    """Print the handfuls of every subset, and what they show beside Table 5.2."""
    for number, name in enumerate(SUBSETS, start=1):
        sizes = solve(name, number)
        found = counted(subset(name, sizes, number))
        published = published_counts(name).astype(int)
        print(f"{name}: {sizes} shows {found.astype(int)}, published {published}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
