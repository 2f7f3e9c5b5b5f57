"""Headline numbers of the kiln with several seeds: ``python tools/seeds.py``.

Notebook 00 of each run saves headlines.csv. ``make seeds`` runs the notebooks with
seeds 1 and 2; seed 0 is that of ``make full``.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pandas as pd

from kilnflight.publication import figures
from kilnflight.store import paths

SEEDS = (1, 2)


def beside(runs: Mapping[int, pd.DataFrame]) -> pd.DataFrame:
    """Return a table with a column for each seed and their spread.

    Parameters
    ----------
    runs
        headlines.csv of a run by its seed. Numbers of the belt are left out: they
        rest on the authors' tracks.
    """
    first = next(iter(runs.values()))
    kiln = first[first["chapter"] != "Belt"]
    table = kiln[["chapter", "quantity"]].assign(printed=kiln["value_published"])
    for seed, headlines in runs.items():
        values = headlines.set_index("quantity")["value"]
        table[f"seed_{seed}"] = table["quantity"].map(values)
    values = table.filter(like="seed_")
    return table.assign(spread=values.max(axis=1) - values.min(axis=1))


def main() -> None:
    """Save figures/headline-seeds.csv."""
    folders = {0: paths.figures()}
    folders |= {seed: Path("build", f"seed-{seed}", "figures") for seed in SEEDS}
    runs = {
        seed: pd.read_csv(folder / "headlines.csv") for seed, folder in folders.items()
    }
    caption = (
        "Headline numbers of the simulated kiln with three seeds, each another set of "
        "particles, noise and draws; spread: largest less smallest."
    )
    origin = figures.trace("tools/seeds", {"scale": "full", "seeds": [0, *SEEDS]})
    made = json.loads((folders[SEEDS[-1]] / "index.json").read_text("utf-8"))
    commit = made["figures"]["headlines"]["provenance"]["commit"]  # that of the runs
    origin = replace(origin, commit=commit)
    figures.save("headline-seeds", beside(runs), caption=caption, provenance=origin)


if __name__ == "__main__":
    main()
