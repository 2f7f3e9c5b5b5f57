"""Choices that no work prints: both values compared, and the verdicts that turn.

data/reference/choices.csv has one row for each choice: what is not printed, what is
chosen, what else could be, and what decides. A chapter's notebook computes the result
with both values once and hands it to `kilnflight.publication.figures.conclude`.
Notebook 01 shows all of them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd
from pandas import DataFrame

from kilnflight.arrays import Facts
from kilnflight.checks import InputError
from kilnflight.publication import claims
from kilnflight.store import paths

# Neither text nor tools decide these choices.
UNDECIDED = ("identified", "assumption")


@dataclass(frozen=True)
class Comparison:
    """One result with the chosen and with the other value.

    Parameters
    ----------
    id
        Id in data/reference/choices.csv.
    quantity
        What is compared, with its unit.
    chosen, other
        Both results, at most 60 characters each.
    turns
        Both verdicts, by id, of the claims whose verdict differs.
    """

    id: str
    quantity: str
    chosen: str
    other: str
    turns: Mapping[str, str]


def load() -> DataFrame:
    """Load data/reference/choices.csv: one row per choice, indexed by id, all text."""
    path = paths.reference() / "choices.csv"
    return pd.read_csv(path, dtype=str, keep_default_na=False).set_index("id")


def compare(
    choice_id: str,
    quantity: str,
    *,
    chosen: object,
    other: object,
    turns: Mapping[str, str] | None = None,
) -> Comparison:
    """Return the comparison of a result with both values of a choice.

    Parameters
    ----------
    choice_id
        Id in data/reference/choices.csv.
    quantity
        What is compared, with its unit.
    chosen, other
        Result with our value and with the other one: a number, or a text of at most 60
        characters.
    turns
        Claims whose verdict differs, from `turned`; None: none was judged.

    Raises
    ------
    InputError
        If the id is unknown or a text is too long.
    """
    if choice_id not in load().index:
        raise InputError(
            f"no choice {choice_id!r} in data/reference/choices.csv; check the id."
        )
    return Comparison(
        id=choice_id,
        quantity=quantity,
        chosen=_short(choice_id, chosen),
        other=_short(choice_id, other),
        turns=turns or {},
    )


def _short(choice_id: str, value: object) -> str:
    """Return a result as text, or raise an `InputError` if it is too long."""
    text = claims.as_text(value)
    if len(text) > claims.MOST_MEASURED:
        raise InputError(
            f"choice {choice_id}: {text!r} has {len(text)} characters of "
            f"{claims.MOST_MEASURED}."
        )
    return text


def turned(
    checks: Iterable[claims.Verdict], others: Iterable[claims.Verdict]
) -> dict[str, str]:
    """Return the claims whose verdict differs, each with both: "reproduced -> open".

    The first verdict is that of ``checks``, the second that of ``others``.
    """
    verdicts = {each.id: each.verdict for each in others}
    turns = {}
    for each in checks:
        other = verdicts.get(each.id, each.verdict)
        if other != each.verdict:
            turns[each.id] = f"{each.verdict} -> {other}"
    return turns


def opened(
    verdicts: Iterable[Facts], comparisons: Iterable[Mapping[str, Any]]
) -> list[Facts]:
    """Return verdicts, open where they turn with a choice that nothing decides.

    A comparison on the simulation opens no verdict on the authors' data.
    """
    decided_by = load()["decided_by"]
    turning = set[tuple[str, str]]()
    for each in comparisons:
        if decided_by[each["id"]] in UNDECIDED:
            turning.update((claim, each["data"]) for claim in each["turns"])
    rows = []
    for row in verdicts:
        if (row["id"], row["data"]) in turning:
            row = row | {"verdict": claims.OPEN, "because": "choice"}
        rows.append(row)
    return rows
