"""What all notebooks conclude: the verdict on every claim."""

import pandas as pd

from kilnflight.checks import InputError
from kilnflight.publication import choices, claims
from kilnflight.store import index


def collect() -> pd.DataFrame:
    """Return the verdict on every claim, in the order of claims.csv.

    Verdicts come from the folder of figures, where each notebook saved its own. A claim
    without one is open, and so is one whose verdict turns with a choice that neither
    text nor tools decide (`kilnflight.publication.choices`).

    Returns
    -------
    DataFrame
        ``id``, ``verdict``, ``because``, ``measured``, ``published``, ``notebook``,
        ``reason``.

    Raises
    ------
    InputError
        If two notebooks judge the same claim.
    """
    known = claims.load()
    rows = choices.opened(index.rows("verdicts"), index.rows("choices"))
    names = ["id", "verdict", "because", "measured", "published", "notebook", "reason"]
    judged = pd.DataFrame(rows, columns=names).set_index("id")
    twice = judged.index[judged.index.duplicated()]
    if len(twice):
        by = " and ".join(judged["notebook"][twice[0]])
        raise InputError(
            f"claim {twice[0]} is judged by {by}; leave it to one notebook."
        )
    table = judged.reindex(known.index).assign(published=known["sentence"])
    return table.fillna({"verdict": claims.OPEN}).fillna("").reset_index()
