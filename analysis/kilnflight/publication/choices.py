"""Choices that no work prints: load them, compare both values, name the verdicts that
turn.

data/reference/choices.csv has one row for each choice: what is not printed, what is
chosen, what else could be, and what decides. A chapter's notebook computes the result
with both values once and hands it to `kilnflight.publication.figures.conclude`.
Notebook 01 shows all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from kilnflight.checks import InputError
from kilnflight.publication import claims
from kilnflight.store import index, paths

# What can decide a choice. Sentences and the authors' programs are evidence; the others
# are not.
DECIDED_BY = ("text", "tools", "identified", "assumption")
UNDECIDED = ("identified", "assumption")


@dataclass(frozen=True)
class Comparison:
    """One result with the chosen and with the other value."""

    id: str
    quantity: str  # with its unit
    chosen: str  # at most 60 characters, like `other`
    other: str
    turns: Mapping[str, str]  # ids of the claims whose verdict differs, both verdicts


def load() -> pd.DataFrame:
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
    """Return a result as text; numbers with four digits."""
    if isinstance(value, float):
        return "-" if pd.isna(value) else f"{value:.4g}"
    text = str(value)
    if len(text) > claims.MEASURED:
        raise InputError(
            f"choice {choice_id}: {text!r} has {len(text)} characters of "
            f"{claims.MEASURED}."
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
    verdicts: Iterable[dict[str, Any]], comparisons: Iterable[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return verdicts, open where they turn with a choice that neither text nor tools
    decide.
    """
    decided_by = load()["decided_by"]
    turning = set[str]()
    for each in comparisons:
        if decided_by[each["id"]] in UNDECIDED:
            turning |= set(each["turns"])
    rows = []
    for row in verdicts:
        if row["id"] in turning:
            row = {**row, "verdict": claims.OPEN, "because": "choice"}
        rows.append(row)
    return rows


def compared() -> list[dict[str, Any]]:
    """Return the comparisons that all notebooks saved, each with its notebook."""
    return [
        {**each, "notebook": stem}
        for stem, concluded in index.load()["notebooks"].items()
        for each in concluded.get("choices", [])
    ]


def collect() -> pd.DataFrame:
    """Return every choice with its results, in the order of choices.csv.

    Returns
    -------
    DataFrame
        The columns of choices.csv; ``quantity``, ``result_chosen`` and
        ``result_other``, one entry for each comparison, joined by semicolons;
        ``verdicts_that_turn``, ids of claims; ``notebook``. Empty where no notebook
        compared.
    """
    table = load()
    texts = {"quantity": "quantity", "result_chosen": "chosen", "result_other": "other"}
    for column in (*texts, "verdicts_that_turn", "notebook"):
        table[column] = ""
    rows = pd.DataFrame(
        compared(), columns=["id", *texts.values(), "turns", "notebook"]
    )
    for choice_id, part in rows.groupby("id"):
        for column, name in texts.items():
            table.loc[choice_id, column] = "; ".join(part[name])
        turning = dict.fromkeys(claim for turns in part["turns"] for claim in turns)
        table.loc[choice_id, "verdicts_that_turn"] = " ".join(turning)
        table.loc[choice_id, "notebook"] = " ".join(dict.fromkeys(part["notebook"]))
    return table.reset_index()
