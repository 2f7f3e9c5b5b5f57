"""Headline numbers of several seeds side by side."""

import pandas as pd
from tools import seeds


def test_seeds_stand_beside_each_other_with_their_spread():
    columns = ["chapter", "quantity", "value_published", "value"]
    first = pd.DataFrame(
        [["Flight", "dwell", "0.3 to 0.5", 0.4], ["Belt", "error", "1.5", 1.0]],
        columns=columns,
    )
    second = first.iloc[::-1].assign(value=[2.0, 0.25])
    table = seeds.beside({0: first, 1: second})
    assert table.to_dict("records") == [
        {
            "chapter": "Flight",
            "quantity": "dwell",
            "printed": "0.3 to 0.5",
            "seed_0": 0.4,
            "seed_1": 0.25,
            "spread": 0.15000000000000002,
        }
    ]
