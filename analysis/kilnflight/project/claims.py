"""Published values and claims: load them, compare, give a verdict.

The tables are kept as printed, misprints included (`kilnflight.experiments.errata` lists those).
A claim is a sentence of one of the three works turned into something that can fail:
either a number with bounds (columns ``low`` and ``high`` of claims.csv; an empty one is
open; an end is included unless the expectation says ``<`` or ``>`` of it), or a set of
named conditions that must all hold.

Column ``bound`` says whose the bound is: ``print`` if the sentence states it, ``ours`` if it
only says "far more" or "slightly". A bound of ours decides only if bounds half and twice as far
from ``about`` decide alike; otherwise the claim is not decidable. ``about`` is what the words
compare with: a number they name, 1 for shares and ratios, 0 (empty) for differences.
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
WORDS = {REPRODUCED: "holds", NOT_REPRODUCED: "fails", NOT_DECIDABLE: "is not decidable"}
ON_TRUTH = "on the twin's own truth"
JUDGED = "cause assigned by judgement"  # nothing that was computed shows it
MEASURED = 60  # characters of what was measured
OTHER_BOUNDS = (1.0, 0.5, 2.0)  # times the distance of a bound of ours; one rule for all claims


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


def _claim(claim_id: str, because: str) -> pd.Series:
    claims = load()
    if because and because not in CAUSES:
        raise InputError(f"claim {claim_id}: because={because!r} is not one of {list(CAUSES)}.")
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
    claim = _claim(claim_id, because)
    verdict, text = _judged(claim, measured)
    if truth is not None:
        on_truth, values = _judged(claim, truth)
        note = f"{WORDS[on_truth]} {ON_TRUTH} ({values}); {note}".removesuffix("; ")
        cause = {REPRODUCED: because or "chain", NOT_REPRODUCED: "twin"}
        because = cause.get(on_truth, "criterion")
    if verdict == NOT_DECIDABLE:
        because = "criterion"
    return _verdict(claim, verdict, text, note, because)


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
    if not all(isinstance(holds, bool | np.bool_ | None) for holds in conditions.values()):
        raise InputError(
            f"claim {claim.name}: a condition is neither True nor False: {conditions}."
        )
    word = {True: "yes", False: "NO", None: "open"}
    given = {name: None if holds is None else bool(holds) for name, holds in conditions.items()}
    found = set(given.values())
    verdict = NOT_REPRODUCED if False in found else NOT_DECIDABLE if None in found else REPRODUCED
    return verdict, "; ".join(f"{name}: {word[holds]}" for name, holds in given.items())


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
    scales = OTHER_BOUNDS if claim["bound"] == "ours" else (1.0,)
    answers = {_inside(claim, values, scale) for scale in scales}
    if len(answers) > 1:
        return NOT_DECIDABLE, text
    return REPRODUCED if answers.pop() else NOT_REPRODUCED, text


def _inside(claim: pd.Series, values: pd.Series, scale: float) -> bool:
    """Return whether values lie within bounds ``scale`` times as far from ``about``.

    An empty bound is open. "< 8 %" excludes 8 % and not 0 %; "<= 0.01" includes its end.
    """
    about = np.nan_to_num(claim["about"])
    low, high = (about + scale * (claim[side] - about) for side in ("low", "high"))
    strict = re.match(r"[<>](?!=)", claim["expect"])
    sign = strict.group() if strict else ""
    under = values <= low if sign == ">" else values < low
    over = values >= high if sign == "<" else values > high
    return not (under | over).any()


def about(value: float, named: float, bound: float) -> bool | None:
    """Return whether a value is "about" what a sentence names, within a bound of ours.

    None where bounds half and twice as far decide otherwise.
    """
    answers = {bool(abs(value - named) <= scale * bound) for scale in OTHER_BOUNDS}
    return answers.pop() if len(answers) == 1 else None


def check(claim_id: str, holds: bool | None, measured: object = "", reason: str = "") -> Verdict:
    """Return the verdict on a claim: reproduced, not reproduced or, for None, open.

    Parameters
    ----------
    claim_id
        Id in data/reference/claims.csv, which also holds the sentence and the cause of a failure.
    holds
        Whether the claim holds; None if neither outcome is shown (see `all_of`, `beyond`).
    measured
        What was measured: a text or number, or a Series of numbers (its labels are shown), cut
        to 60 characters.
    reason
        One sentence for the reader, at most 160 characters.

    Raises
    ------
    InputError
        If there is no such claim, or the outcome is neither true, false nor None.
    """
    claim = _claim(claim_id, "")
    if not isinstance(holds, bool | np.bool_ | None):
        raise InputError(f"claim {claim_id}: holds={holds!r} is neither True, False nor None.")
    verdict = NOT_DECIDABLE if holds is None else REPRODUCED if holds else NOT_REPRODUCED
    if isinstance(measured, pd.Series):
        measured = ", ".join(f"{name} {value:.4g}" for name, value in measured.items())
    text = f"{measured:.4g}" if isinstance(measured, float) else str(measured)
    cause = str(claim["cause"]) if verdict == NOT_REPRODUCED else ""
    short = text if len(text) <= MEASURED else text[: MEASURED - 3] + "..."
    return Verdict(claim_id, verdict, short, claim["claim"], reason, because=cause)


def all_of(*answers: bool | None) -> bool | None:
    """Return False if any answer is, else None if any answer is, else True."""
    if any(answer is not None and not answer for answer in answers):
        return False
    return None if None in answers else True


def beyond(low: float, high: float) -> bool | None:
    """Return whether an interval lies above 0; None if it holds 0."""
    return True if low > 0 else False if high < 0 else None


def within(low: float, high: float, least: float, most: float) -> bool | None:
    """Return whether an interval lies between two bounds; None if it holds one of them.

    Examples
    --------
    >>> within(0.2, 0.3, 0.1, 0.4), within(0.2, 0.5, 0.1, 0.4), within(0.5, 0.6, 0.1, 0.4)
    (True, None, False)
    """
    return all_of(beyond(low - least, high - least), beyond(most - high, most - low))


def with_cause(verdict: Verdict, shown: str = "") -> Verdict:
    """Return a verdict whose reason says what shows its cause, if it was not reproduced.

    Without ``shown`` the cause was assigned by judgement, and the reason says so.
    """
    if verdict.verdict != NOT_REPRODUCED:
        return verdict
    return replace(verdict, reason=f"{verdict.reason}; {shown or JUDGED}".removeprefix("; "))


def undecidable(claim_id: str, reason: str, measured: str = "", because: str = "") -> Verdict:
    """Return the verdict "not decidable" for a claim, with the reason (required).

    ``because`` is one of `CAUSES`.
    """
    if not reason.strip():
        raise InputError(f"claim {claim_id}: say why it cannot be decided here.")
    return _verdict(_claim(claim_id, because), NOT_DECIDABLE, measured, reason, because)


def in_both_readings(verdict: Verdict, other: Verdict, name: str) -> Verdict:
    """Return a verdict that tells another reading of the text, called ``name``.

    Where the two differ the claim is not decidable, because of the method.
    """
    reason = f"{verdict.reason}; {name}: {other.verdict} ({other.measured})".removeprefix("; ")
    if verdict.verdict == other.verdict:
        return replace(verdict, reason=reason)
    return replace(verdict, verdict=NOT_DECIDABLE, reason=reason, because="method")


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


def first_twin() -> pd.DataFrame:
    """Load the verdicts that the first twin gave on claims about the kiln, indexed by id."""
    path = paths.reference() / "first_twin.csv"
    return pd.read_csv(path, index_col="id", keep_default_na=False)


def beside_first_twin(table: pd.DataFrame) -> pd.DataFrame:
    """Return the first twin's verdicts beside those of a table from `collect`.

    Returns
    -------
    DataFrame
        ``id``, ``first_twin``, ``second_look`` (verdicts), ``label`` ("second look" where they
        differ), ``first_twin_measured``, ``second_look_measured``.
    """
    first, now = first_twin(), table.set_index("id")
    rows = pd.DataFrame({"first_twin": first["verdict"], "second_look": now["verdict"]})
    rows = rows.reindex(first.index)
    differ = rows["first_twin"] != rows["second_look"]
    return rows.assign(
        label=differ.map({True: "second look", False: ""}),
        first_twin_measured=first["measured"],
        second_look_measured=now["measured"],
    ).reset_index()


def without_cause(table: pd.DataFrame) -> list[str]:
    """Return the claims that are not reproduced and say no cause; ``table`` from `collect`."""
    missing = (table["verdict"] != REPRODUCED) & ~table["because"].isin(list(CAUSES))
    return [str(claim_id) for claim_id in table.loc[missing, "id"]]


def count(table: pd.DataFrame) -> dict[str, int]:
    """Return how often each verdict occurs, in the order of `VERDICTS`."""
    counts = table["verdict"].value_counts().reindex(list(VERDICTS), fill_value=0)
    return {str(verdict): int(number) for verdict, number in counts.items()}
