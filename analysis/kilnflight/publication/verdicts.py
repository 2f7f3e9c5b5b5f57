"""What all notebooks conclude: the verdict on every claim."""

from pandas import DataFrame

from kilnflight.checks import InputError
from kilnflight.publication import choices, claims
from kilnflight.store import index

COLUMNS = [
    "id",
    "verdict",
    "because",
    "measured",
    "published",
    "notebook",
    "reason",
    "data",
]


def collect() -> DataFrame:
    """Return the verdict on every claim, in the order of claims.csv.

    Verdicts come from the folder of figures, where each notebook saved its own. A claim
    without one is open, and so is one whose verdict turns with a choice that neither
    text nor tools decide (`kilnflight.publication.choices`). A verdict on the authors'
    own data takes the place of one on the simulation.

    Returns
    -------
    DataFrame
        ``id``, ``verdict``, ``because``, ``measured``, ``published``, ``notebook``,
        ``reason``, ``data`` ("authors", "simulated", or empty without a test).

    Raises
    ------
    InputError
        If two notebooks judge the same claim on the same data.
    """
    known = claims.load()
    rows = choices.opened(index.rows("verdicts"), index.rows("choices"))
    judged = DataFrame(rows, columns=COLUMNS)
    twice = judged[judged.duplicated(["id", "data"], keep=False)]
    if len(twice):
        claim = twice["id"].iloc[0]
        by = " and ".join(twice.loc[twice["id"] == claim, "notebook"])
        raise InputError(f"claim {claim} is judged by {by}; leave it to one notebook.")
    first = judged.sort_values("data").drop_duplicates("id").set_index("id")
    table = first.reindex(known.index).assign(published=known["sentence"])
    return table.fillna({"verdict": claims.OPEN}).fillna("").reset_index()
