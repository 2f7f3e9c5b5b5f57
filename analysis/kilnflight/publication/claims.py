"""Published values and claims: load them, compare, give a verdict.

The tables are kept as printed, misprints included (`kilnflight.experiments.errata`
lists those). A claim is a sentence of one of the three works
(data/reference/claims.csv). A notebook tests it in one line on a table that it has just
saved: `check`. The rules of a verdict stand in docs/limits.md.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from pandas import DataFrame, Series

from kilnflight.checks import InputError
from kilnflight.store import paths

REPRODUCED = "reproduced"
NOT_REPRODUCED = "not reproduced"
OPEN = "open"
VERDICTS = (REPRODUCED, NOT_REPRODUCED, OPEN)
MOST_MEASURED = 60  # characters
MOST_REASON = 160


@dataclass(frozen=True)
class Verdict:
    """Verdict on one claim; a row of figures/claims.csv.

    Parameters
    ----------
    id
        Id in data/reference/claims.csv.
    verdict
        One of `VERDICTS`.
    because
        Why it is not reproduced: the work's method or statement fails (``"work"``),
        ours differs (``"implementation"``), nothing decides a choice (``"choice"``, as
        where it is open, see `kilnflight.publication.choices.opened`), the simulation
        has another input (``"twin"``; empty on the authors' data), the recordings are
        other ones (``"data"``), or the work has a misprint (``"misprint"``).
    measured
        Our result, at most `MOST_MEASURED` characters.
    published
        Sentence of the claim.
    reason
        One sentence, at most `MOST_REASON` characters.
    """

    id: str
    verdict: str
    because: str
    measured: str
    published: str
    reason: str


def published(name: str, *, as_printed: bool = False) -> DataFrame:
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
    if not path.is_file():
        names = ", ".join(sorted(file.stem for file in folder.glob("*.csv")))
        raise InputError(f"no published table {name!r}; there are {names}.")
    if as_printed:
        return pd.read_csv(path, dtype=str, keep_default_na=False)
    return pd.read_csv(path)


def load() -> DataFrame:
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
        If the id is unknown, ``holds`` is neither bool nor None, or the reason is too
        long.
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
    if len(reason) > MOST_REASON:
        raise InputError(
            f"claim {claim_id}: its reason has {len(reason)} characters, more than "
            f"{MOST_REASON}."
        )
    verdict = REPRODUCED
    cause = ""
    if holds is None:
        verdict = OPEN
    elif not holds:
        verdict = NOT_REPRODUCED
        cause = claims["cause"].fillna("")[claim_id]
    text = as_text(measured)
    if len(text) > MOST_MEASURED:
        text = f"{text[: MOST_MEASURED - 3]}..."
    return Verdict(
        id=claim_id,
        verdict=verdict,
        because=cause,
        measured=text,
        published=claims["sentence"][claim_id],
        reason=reason,
    )


def as_text(value: object) -> str:
    """Return a result as text; floats have four significant digits, NaN is "-".

    Examples
    --------
    >>> as_text(0.123456), as_text(pd.Series({"f1": 0.9})), as_text("none")
    ('0.1235', 'f1 0.9', 'none')
    """
    if isinstance(value, Series):
        return ", ".join(f"{name} {as_text(each)}" for name, each in value.items())
    if isinstance(value, float):
        return f"{value:.4g}".replace("nan", "-")
    return str(value)


def all_of(*answers: bool | None) -> bool | None:
    """Return whether all answers are True; None if one is None and none False."""
    if False in answers:
        return False
    if None in answers:
        return None
    return True


def beyond(low: float, high: float) -> bool | None:
    """Return whether an interval lies above 0; None (open) if it contains 0.

    A claimed order holds beyond chance if the interval of the difference lies above 0.
    """
    if low > 0:
        return True
    if high < 0:
        return False
    return None


def above(draws: Series) -> bool | None:
    """Return whether 95 % of the draws of a difference lie above 0; None: open."""
    return beyond(*draws.quantile([0.025, 0.975]))


def within(low: float, high: float, least: float, most: float) -> bool | None:
    """Return whether an interval lies between two bounds; None if it contains one.

    Examples
    --------
    >>> ends = ((0.2, 0.3), (0.2, 0.5), (0.5, 0.6))
    >>> [within(low, high, 0.1, 0.4) for low, high in ends]
    [True, None, False]
    """
    return all_of(beyond(low - least, high - least), beyond(most - high, most - low))
