"""Published values and claims: load them, compare, give a verdict.

The tables are kept as printed, misprints included (`kilnflight.experiments.errata` lists those).
A claim is a sentence of one of the three works turned into something that can fail:
either a number with bounds (columns ``low`` and ``high`` of claims.csv; an empty one is
open; an end is included unless the expectation says ``<`` or ``>`` of it), or a set of
named conditions that must all hold.

Column ``bound`` says whose the bound is: ``print`` if the sentence states it, ``ours`` if it
only says "far more" or "slightly". What lies beyond a bound of ours, but not beyond what the
words can mean at most (``loose_low``, ``loose_high``), is not decidable.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from kilnflight.checks import InputError
from kilnflight.project import paths

REPRODUCED = "reproduced"
NOT_REPRODUCED = "not reproduced"
NOT_DECIDABLE = "not decidable"
VERDICTS = (REPRODUCED, NOT_REPRODUCED, NOT_DECIDABLE)
CAUSES = {
    "method": "the method itself, or a choice in it that no work prints",
    "twin": "an input of the twin that nobody published",
    "chain": "true on the twin, lost by detection, tracking or measuring",
    "criterion": "the words of the claim allow both outcomes; a bound would be ours",
    "misprint": "what is printed contradicts itself",
}
ON_TRUTH = {
    REPRODUCED: "holds on the twin's own truth",
    NOT_REPRODUCED: "fails on the twin's own truth",
    NOT_DECIDABLE: "not decidable on the twin's own truth",
}


@dataclass(frozen=True)
class Verdict:
    """What became of one claim; one row of figures/claims.csv."""

    id: str
    verdict: str
    measured: str
    published: str
    reason: str = ""
    criterion: str = ""
    because: str = ""


def published(name: str, *, as_printed: bool = False) -> pd.DataFrame:
    """Load a published table, for example ``published("table_5.5")``.

    Parameters
    ----------
    name
        Stem of a file in data/reference/published.
    as_printed
        Keep every cell as the string that was printed (its digits matter).

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
    return pd.read_csv(path, dtype=str, keep_default_na=False) if as_printed else pd.read_csv(path)


def load() -> pd.DataFrame:
    """Load the claims, indexed by id."""
    return pd.read_csv(paths.reference() / "claims.csv", index_col="id")


def _claim(claim_id: str) -> pd.Series:
    claims = load()
    if claim_id not in claims.index:
        raise InputError(f"no claim {claim_id!r} in data/reference/claims.csv; check the id.")
    return pd.Series(claims.loc[claim_id])


def _verdict(
    claim: pd.Series, verdict: str, measured: str, reason: str, because: str = ""
) -> Verdict:
    """Return a verdict with what it rests on in one line.

    That is quantity, expectation, bounds and whose they are.
    """
    closed = claim[["low", "high"]].notna().all()
    within = f" [{claim['low']:g}, {claim['high']:g}]" if closed else ""
    ours = " (a bound of ours)" if claim["bound"] == "ours" else ""
    criterion = f"{claim['quantity']}: {claim['expect']}{within}{ours}"
    cause = "" if verdict == REPRODUCED else because
    return Verdict(str(claim.name), verdict, measured, claim["claim"], reason, criterion, cause)


Measured = npt.ArrayLike | pd.Series | Mapping[str, bool | None]


def judge(
    claim_id: str,
    measured: Measured,
    *,
    note: str = "",
    truth: Measured | None = None,
    because: str = "",
) -> Verdict:
    """Turn a measured value and a claim into a verdict.

    Parameters
    ----------
    claim_id
        Id in data/reference/claims.csv.
    measured
        For a claim with bounds: a number, or an array or Series (its labels are shown) of
        which every value must lie within them, in the unit of the claim. For any other
        claim: named conditions, for example ``{"spheres 9.1 ms > 4.2 ms": True}``; all must
        hold. A condition that hangs on a bound of ours is ``None``: if no other condition
        fails, the claim is not decidable.
    note
        What a reader must know beside the verdict (which source, which reading).
    truth
        What the same measure gives on the twin's own truth. A claim that fails on it fails
        because of the twin; one that holds on it and not as measured, because of the chain.
    because
        One of `CAUSES`: why the claim is not reproduced, where ``truth`` does not say it.
        It is left out of the verdict if the claim is reproduced.

    Raises
    ------
    InputError
        If the claim or the cause does not exist, the kind of measurement does not fit the
        claim, or a number is not finite.
    """
    claim = _claim(claim_id)
    _check_cause(claim_id, because)
    verdict, text = _judged(claim, measured)
    if truth is not None:
        on_truth, values = _judged(claim, truth)
        note = f"{ON_TRUTH[on_truth]} ({values}); {note}".removesuffix("; ")
        cause = {REPRODUCED: because or "chain", NOT_REPRODUCED: "twin"}
        because = cause.get(on_truth, "criterion")
    if verdict == NOT_DECIDABLE:
        because = "criterion"
    return _verdict(claim, verdict, text, note, because)


def _check_cause(claim_id: str, because: str) -> None:
    if because and because not in CAUSES:
        raise InputError(f"claim {claim_id}: because={because!r} is not one of {list(CAUSES)}.")


def _judged(claim: pd.Series, measured: Measured) -> tuple[str, str]:
    """Return the verdict on a measured value, and the value in words."""
    if isinstance(measured, Mapping):
        return _all_hold(claim, measured)
    return _within_bounds(claim, measured)


def _all_hold(claim: pd.Series, conditions: Mapping[str, bool | None]) -> tuple[str, str]:
    """Return whether all conditions of a claim hold, and each in words.

    The claim is one without bounds.
    """
    if claim[["low", "high"]].notna().any() or not conditions:
        raise InputError(f"claim {claim.name} asks for {claim['expect']!r}: pass the number.")
    answers = list(conditions.values())
    if not all(holds is None or isinstance(holds, bool | np.bool_) for holds in answers):
        raise InputError(
            f"claim {claim.name}: a condition is neither True nor False: {conditions}."
        )
    word = {True: "yes", False: "NO", None: "open"}
    parts = (
        f"{name}: {word[None if holds is None else bool(holds)]}"
        for name, holds in conditions.items()
    )
    failed = any(holds is not None and not holds for holds in answers)
    open_ = any(holds is None for holds in answers)
    verdict = NOT_REPRODUCED if failed else NOT_DECIDABLE if open_ else REPRODUCED
    return verdict, "; ".join(parts)


def _within_bounds(claim: pd.Series, measured: npt.ArrayLike | pd.Series) -> tuple[str, str]:
    """Return whether all numbers lie within the bounds of a claim, and each in words."""
    bounded = claim[["low", "high"]].notna().any()
    values = pd.Series(np.atleast_1d(np.asarray(measured, dtype=np.float64)))
    if not bounded or values.empty or not np.isfinite(values).all():
        raise InputError(
            f"claim {claim.name} got {measured!r}; pass "
            + ("finite numbers." if bounded else "named conditions (it has no bounds).")
        )
    names = measured.index if isinstance(measured, pd.Series) else [""] * len(values)
    text = ", ".join(f"{name} {v:.4g}".strip() for name, v in zip(names, values, strict=True))
    if _inside(claim, values, "low", "high"):
        return REPRODUCED, text
    possible = claim["bound"] == "ours" and _inside(claim, values, "loose_low", "loose_high")
    return NOT_DECIDABLE if possible else NOT_REPRODUCED, text


def _inside(claim: pd.Series, values: pd.Series, lowest: str, highest: str) -> bool:
    """Return whether values lie between two columns of a claim; empty ones are open.

    "< 8 %" excludes 8 % and not 0 %; "0.35..0.75" and "<= 0.01" include their ends.
    """
    strict = re.match(r"[<>](?!=)", str(claim["expect"]))
    above, below = (strict is not None and strict.group() == sign for sign in "><")
    low = np.nan_to_num(claim[lowest], nan=-np.inf)
    high = np.nan_to_num(claim[highest], nan=np.inf)
    over = values > low if above else values >= low
    under = values < high if below else values <= high
    return bool((over & under).all())


def undecidable(claim_id: str, reason: str, measured: str = "", because: str = "") -> Verdict:
    """Return the verdict "not decidable" for a claim, with the reason (required).

    ``because`` is one of `CAUSES`.
    """
    if not reason.strip():
        raise InputError(f"claim {claim_id}: say why it cannot be decided here.")
    _check_cause(claim_id, because)
    return _verdict(_claim(claim_id), NOT_DECIDABLE, measured, reason, because)


def fitted(verdict: Verdict, to: str) -> Verdict:
    """Return the verdict on a claim that a calibration aimed at.

    Agreement is then no result: "reproduced" becomes "not decidable", because of the twin.
    A miss stays a miss.

    Parameters
    ----------
    verdict
        From `judge`.
    to
        What was fitted to what, for the reason.
    """
    if verdict.verdict != REPRODUCED:
        return verdict
    reason = f"{verdict.reason}; agrees, but {to}".removeprefix("; ")
    return replace(verdict, verdict=NOT_DECIDABLE, reason=reason, because="twin")


def count_reproduced(verdicts: Iterable[Verdict]) -> int:
    """Return how many of a notebook's claims are reproduced."""
    return sum(verdict.verdict == REPRODUCED for verdict in verdicts)


def verdict_table(verdicts: Iterable[Verdict], notebook: str) -> pd.DataFrame:
    """Return verdicts as the rows of figures/claims.csv, one per claim, ids unique."""
    names = [field.name for field in fields(Verdict)]
    table = pd.DataFrame([astuple(verdict) for verdict in verdicts], columns=names)
    for claim_id in table.loc[table["id"].duplicated(), "id"]:
        raise InputError(f"{notebook}: claim {claim_id} is judged twice; judge it once.")
    table.insert(4, "notebook", notebook)
    return table


def collect(tables: Iterable[pd.DataFrame]) -> pd.DataFrame:
    """Return one row for every claim, in the order of claims.csv.

    A claim that no notebook has judged is "not decidable", and says what it waits for.
    """
    all_claims = load()
    judged = pd.concat([verdict_table([], ""), *tables], ignore_index=True)
    for claim_id, rows in judged.groupby("id"):
        if len(rows) > 1:
            raise InputError(
                f"claim {claim_id} is judged by {' and '.join(rows['notebook'])}; "
                "leave it to one notebook."
            )
    waiting = all_claims.loc[~all_claims.index.isin(judged["id"]), "testable_with"]
    undecided = [
        undecidable(
            str(claim_id), f"no notebook tests it yet; testable with: {source}", because="method"
        )
        for claim_id, source in waiting.items()
    ]
    table = pd.concat([judged, verdict_table(undecided, "")], ignore_index=True)
    return table.set_index("id").loc[all_claims.index].reset_index().fillna("")


def without_cause(table: pd.DataFrame) -> list[str]:
    """Return the claims that are not reproduced and say no cause; ``table`` from `collect`."""
    missing = (table["verdict"] != REPRODUCED) & ~table["because"].isin(list(CAUSES))
    return [str(claim_id) for claim_id in table.loc[missing, "id"]]


def count(table: pd.DataFrame) -> dict[str, int]:
    """Return how often each verdict occurs, in the order of `VERDICTS`."""
    counts = table["verdict"].value_counts().reindex(list(VERDICTS), fill_value=0)
    return {str(verdict): int(number) for verdict, number in counts.items()}
