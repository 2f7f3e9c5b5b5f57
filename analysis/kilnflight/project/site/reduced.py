"""What a site of a reduced run says: that it is one, and the verdicts of `make full`.

figures/ of the repository holds the run at full scale; what is cited comes from there.
"""

from __future__ import annotations

import pandas as pd

from kilnflight.project import claims, figures, paths


def scales() -> list[str]:
    """Return the scales of the figures that the site shows, but for full."""
    shown = {str(entry.provenance["parameters"].get("scale")) for entry in figures.entries()}
    return sorted(shown - {"full", "None"})


def full_verdicts() -> pd.DataFrame:
    """Return the claims of the run at full scale; none if they are not there."""
    path = paths.root() / "figures" / "claims.csv"
    if not path.is_file():
        return pd.DataFrame(columns=["id", "verdict"])
    return pd.read_csv(path, keep_default_na=False)


def banner() -> str:
    """Return what stands on every page of a reduced run; empty at full scale."""
    names, whole = scales(), full_verdicts()
    if not names:
        return ""
    counts = ", ".join(f"{number} {word}" for word, number in claims.count(whole).items())
    told = f" At full scale: {counts}." if len(whole) else ""
    return (
        f"A reduced run (scale {' and '.join(names)}): little input, other numbers.{told} "
        "Cite from figures/ only."
    )


def beside_full(verdicts: pd.DataFrame) -> pd.DataFrame:
    """Return verdicts with those at full scale beside them, where they differ."""
    if not scales():
        return verdicts
    whole = full_verdicts().set_index("id")["verdict"]
    other = verdicts["id"].map(whole).astype(object)
    return verdicts.assign(full=other.where(other != verdicts["verdict"]).fillna(""))
