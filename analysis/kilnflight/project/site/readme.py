"""The lines of README.md with results, from figures/."""

from __future__ import annotations

import pandas as pd

from kilnflight.checks import InputError
from kilnflight.project import claims, figures, paths
from kilnflight.project.cache import write_whole

MARK = "<!-- results: made by `make full`, do not edit -->"
END_MARK = "<!-- end of results -->"
# Results that README.md shows, by number of the notebook: topic and table.
SHOWN = {
    "01": ("Printed numbers", "figures/errata.csv"),
    "14": ("Skill of the twin", "figures/twin-count.csv"),
    "24": ("Detection", "figures/table-5-11-detection.csv"),
    "57": ("Bands", "figures/twin-bands.csv"),
}


def claims_table() -> pd.DataFrame:
    """Return every claim with its verdict."""
    return pd.read_csv(paths.figures() / "claims.csv", keep_default_na=False)


def claims_sentence() -> str:
    """Return how many claims have which verdict."""
    totals = claims.count(claims_table())
    counts = ", ".join(f"{number} {verdict}" for verdict, number in totals.items())
    return f"Of {sum(totals.values())} published claims: {counts}."


def results_block() -> str:
    """Return the lines of README.md with results, from figures/."""
    results = figures.overview().set_index("notebook")["result"]
    lines = [MARK, f"- {claims_sentence()} [Every verdict](figures/claims.csv)."]
    for stem, result in results.items():
        if str(stem)[:2] in SHOWN:
            topic, table = SHOWN[str(stem)[:2]]
            lines.append(f"- {topic}: {result} [Table]({table}).")
    return "\n".join([*lines, END_MARK])


def update_readme() -> bool:
    """Write the current results into README.md; return whether that changed it."""
    path = paths.root() / "README.md"
    text = path.read_text()
    if MARK not in text or END_MARK not in text:
        raise InputError(
            f"README.md: the lines {MARK!r} and {END_MARK!r} are missing; restore them."
        )
    before, _, rest = text.partition(MARK)
    updated = before + results_block() + rest.partition(END_MARK)[2]
    if updated != text:
        write_whole(path, updated.encode())
    return updated != text
