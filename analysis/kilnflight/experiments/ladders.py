"""Values of trackers' parameters that may be tried, ours and other people's.

Every parameter has a ladder of values in steps of about the same ratio, the same ladder for
all trackers. `kilnflight.experiments.contest` tries a small grid in full and climbs from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product

from kilnflight.association import GNN, JPDA, Associator
from kilnflight.checks import InputError
from kilnflight.experiments import other_trackers as peers
from kilnflight.experiments.pursuit import Tracker
from kilnflight.tracking.gate import Gate
from kilnflight.tracking.motion import ConstantVelocity
from kilnflight.tracking.tracker import Management, track

# The ladders, for ours and for peers alike. Ends that are not nought are far from any use.
GATES = (0.7, 1.0, 1.4, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)  # standard deviations
NOISES = (0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # px/frame^1.5
STEPS = (2.5, 3.5, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0)  # px
PATIENCE = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 90)  # frames; the stretches have 100

Setting = tuple[float, ...]


@dataclass(frozen=True)
class Ladders:
    """A tracker, and the values of its parameters that may be tried.

    Raises
    ------
    InputError
        If a ladder is not ascending, or a value of the grid is not on it.
    """

    build: Callable[..., Tracker]  # of one value per parameter, in this order
    rungs: Mapping[str, Setting]  # parameter -> the values of its ladder, ascending
    grid: Mapping[str, Setting]  # parameter -> values that are tried in every combination

    def __post_init__(self) -> None:
        """Refuse ladders that cannot be climbed."""
        for name, ladder in self.rungs.items():
            first = self.grid.get(name, ())
            if sorted(set(ladder)) != list(ladder) or not first or not set(first) <= set(ladder):
                raise InputError(
                    f"Ladders: {name} has the ladder {ladder} and the grid {first}. Give the "
                    "ladder in ascending order and take the grid from it."
                )

    def first(self) -> list[Setting]:
        """Return the settings of the grid."""
        return list(product(*(self.grid[name] for name in self.rungs)))

    def neighbors(self, setting: Setting) -> list[Setting]:
        """Return the settings one step up or down on one ladder."""
        found = []
        for k, ladder in enumerate(self.rungs.values()):
            at = ladder.index(setting[k])
            for value in (*ladder[max(at - 1, 0) : at], *ladder[at + 1 : at + 2]):
                found.append((*setting[:k], value, *setting[k + 1 :]))
        return found

    def ends(self, setting: Setting) -> str:
        """Return the parameters that are at an end of their ladders, "" for none.

        A ladder that the grid holds in full, yes or no, say, has nothing beyond its ends.
        """
        pairs = zip(self.rungs.items(), setting, strict=True)
        at_end = [name for (name, some), value in pairs if value in (some[0], some[-1])]
        return ", ".join(one for one in at_end if set(self.grid[one]) != set(self.rungs[one]))

    def text(self, setting: Setting) -> str:
        """Return the setting in words."""
        pairs = zip(self.rungs, setting, strict=True)
        return ", ".join(f"{name} {value:g}" for name, value in pairs)


def ours() -> dict[str, Ladders]:
    """Return the ladders of GNN and JPDA."""
    rungs = {"gate": GATES, "noise": NOISES, "lost": PATIENCE}
    grid = {"gate": (2.0, 3.0, 4.0, 6.0), "noise": (0.5, 1.0, 2.0), "lost": (3, 5, 8, 12)}
    return {
        "GNN": Ladders(_Ours(GNN()), rungs, grid),
        "JPDA": Ladders(_Ours(JPDA()), rungs, grid),
    }


@dataclass(frozen=True)
class _Ours:
    """Our tracker with an associator, of gate, noise and patience."""

    associator: Associator

    def __call__(self, gate: float, noise: float, lost: float) -> Tracker:
        return partial(
            track,
            associator=self.associator,
            motion=ConstantVelocity(acceleration_noise=noise),
            gate=Gate(gate),
            management=Management(invisible=int(lost)),
        )


def theirs() -> dict[str, Ladders]:
    """Return the ladders of trackpy, laptrack and Stone Soup; all are installed or not."""
    filtered = {"gate": GATES, "noise": NOISES, "unseen": PATIENCE}
    return {
        "trackpy": Ladders(
            lambda step, unseen, predicted: peers.Trackpy(step, int(unseen), bool(predicted)),
            {"step": STEPS, "unseen": PATIENCE, "predicted": (0, 1)},
            {"step": (15.0, 20.0), "unseen": (2, 5), "predicted": (0, 1)},
        ),
        "laptrack": Ladders(
            lambda step, gap, unseen: peers.LapTrack(step, gap, int(unseen)),
            {"step": STEPS, "gap": STEPS, "unseen": PATIENCE},
            {"step": (20.0, 40.0), "gap": (20.0, 40.0), "unseen": (2, 5)},
        ),
        "GNN, Stone Soup": Ladders(
            lambda gate, noise, unseen: peers.StoneSoupGNN(gate, noise, int(unseen)),
            filtered,
            {"gate": (3.0, 4.0), "noise": (1.0,), "unseen": (3, 5)},
        ),
        "JPDA, Stone Soup": Ladders(
            lambda gate, noise, unseen: peers.StoneSoupJPDA(gate, noise, int(unseen)),
            filtered,
            {"gate": (2.0, 3.0), "noise": (1.0,), "unseen": (1, 2)},
        ),
    }
