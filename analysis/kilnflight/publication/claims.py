"""Published values and claims: load them, compare, give a verdict.

The tables are kept as printed, misprints included (`kilnflight.experiments.errata`
lists those). A claim is a sentence of one of the three works
(data/reference/claims.csv). A notebook tests it in one line on a table that it has just
saved: `check`. The rules of a verdict stand in docs/limits.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.store import paths

REPRODUCED = "reproduced"
NOT_REPRODUCED = "not reproduced"
OPEN = "open"
VERDICTS = (REPRODUCED, NOT_REPRODUCED, OPEN)
# Why a claim is not reproduced: the work's method or statement fails, ours differs or
# may, a choice that nothing decides, an input of the simulation, other recordings, a
# misprint.
CAUSES = ("work", "implementation", "choice", "twin", "data", "misprint")
MEASURED = 60
REASON = 160  # characters


@dataclass(frozen=True)
class Verdict:
    """Verdict on one claim; a row of figures/claims.csv."""

    id: str
    verdict: str  # one of `VERDICTS`
    # one of `CAUSES` if it is not reproduced; "choice" if that leaves it open; else ""
    because: str
    measured: str  # at most 60 characters
    published: str  # sentence of the claim
    reason: str = ""  # one sentence


def published(name: str, *, as_printed: bool = False) -> pd.DataFrame:
    """Load a published table, for example ``published("table_5.5")``.

    Parameters
    ----------
    name
        Stem of a file in data/reference/published.
    as_printed
        Keep every cell as the printed string, since its digits tell how it was rounded.

    Raises
    ------
    InputError
        If there is no such table.
    """
    folder = paths.reference() / "published"
    path = folder / f"{name}.csv"
    if Path(name).name != name or not path.is_file():
        names = ", ".join(sorted(file.stem for file in folder.glob("*.csv")))
        raise InputError(f"no published table {name!r}; there are {names}.")
    return (
        pd.read_csv(path, dtype=str, keep_default_na=False)
        if as_printed
        else pd.read_csv(path)
    )


def load() -> pd.DataFrame:
    """Load data/reference/claims.csv: one row per claim, indexed by id."""
    return pd.read_csv(paths.reference() / "claims.csv", index_col="id")


def check(
    claim_id: str, holds: bool | None, measured: object = "", reason: str = ""
) -> Verdict:
    """Return the verdict on a claim: reproduced, not reproduced or open.

    Parameters
    ----------
    claim_id
        Id in data/reference/claims.csv, which also holds the sentence and the cause of
        a failure.
    holds
        Whether the claim holds; None (open) if neither outcome is shown.
    measured
        Text, number, or Series of numbers with its labels; cut to 60 characters.
    reason
        One sentence for the reader, at most 160 characters.

    Raises
    ------
    InputError
        If the id is unknown, ``holds`` is no bool or None, or the reason is too long.
    """
    claims = load()
    if claim_id not in claims.index:
        raise InputError(
            f"no claim {claim_id!r} in data/reference/claims.csv; check the id."
        )
    if not isinstance(holds, bool | np.bool_ | None):
        raise InputError(
            f"claim {claim_id}: holds={holds!r} is neither True, False nor None."
        )
    if len(reason) > REASON:
        raise InputError(
            f"claim {claim_id}: its reason has {len(reason)} of {REASON} characters."
        )
    if isinstance(measured, pd.Series):
        measured = ", ".join(f"{name} {value:.4g}" for name, value in measured.items())
    text = (
        f"{measured:.4g}".replace("nan", "-")
        if isinstance(measured, float)
        else str(measured)
    )
    short = text if len(text) <= MEASURED else text[: MEASURED - 3] + "..."
    verdict = OPEN if holds is None else REPRODUCED if holds else NOT_REPRODUCED
    cause = (
        str(claims["cause"].fillna("")[claim_id]) if verdict == NOT_REPRODUCED else ""
    )
    return Verdict(
        claim_id, verdict, cause, short, str(claims.loc[claim_id, "sentence"]), reason
    )


def all_of(*answers: bool | None) -> bool | None:
    """Return whether all answers are True; None if one is None and none False."""
    if any(answer is not None and not answer for answer in answers):
        return False
    return None if None in answers else True


def beyond(low: float, high: float) -> bool | None:
    """Return whether an interval lies above 0; None (open) if it contains 0.

    A claimed order holds beyond chance if the interval of the difference lies above 0.
    """
    return True if low > 0 else False if high < 0 else None


def above(draws: pd.Series) -> bool | None:
    """Return whether draws of a difference lie above 0 (95 %); None (open) if not all
    on a side.
    """
    return beyond(*draws.quantile([0.025, 0.975]))


def within(low: float, high: float, least: float, most: float) -> bool | None:
    """Return whether an interval lies between two bounds; None if it contains one.

    Examples
    --------
    >>> within(0.2, 0.3, 0.1, 0.4), within(0.2, 0.5, 0.1, 0.4), within(0.5, 0.6, 0.1, 0.4)
    (True, None, False)
    """
    return all_of(beyond(low - least, high - least), beyond(most - high, most - low))


def count(table: pd.DataFrame) -> dict[str, int]:
    """Return the number of claims with each verdict, in the order of `VERDICTS`."""
    return {verdict: int((table["verdict"] == verdict).sum()) for verdict in VERDICTS}
