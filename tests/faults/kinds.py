"""Kinds of faults of arrays, tables, numbers and files, and what must become of each.

What is wrong is refused by one `InputError`. What is the same in another form makes no
difference.
"""

import dataclasses
from datetime import datetime

import numpy as np
import pandas as pd

REFUSED, SAME, DATE = "refused", "same", datetime(2026, 1, 1)


def spot(values, rng, what):
    """Return values of which one is another."""
    kind = object if isinstance(what, str) else np.result_type(values, type(what))
    changed = np.array(values, kind)
    changed.flat[rng.integers(changed.size)] = what
    return changed


WRONG = {
    "nan": lambda values, rng: spot(values, rng, np.nan),
    "inf": lambda values, rng: spot(values, rng, rng.choice([np.inf, -np.inf])),
    "huge": lambda values, rng: spot(values, rng, 1e160),
    "a text": lambda values, rng: spot(values, rng, "3"),
    "texts": lambda values, rng: values.astype(str),
    "objects of text": lambda values, rng: values.astype(str).astype(object),
    "complex": lambda values, rng: values + 1j,
    "dates": lambda values, rng: np.full(np.shape(values), DATE),
    "truths": lambda values, rng: values > np.mean(values),
    **{
        f"objects with {what}": lambda values, rng, what=what: spot(
            values.astype(object), rng, what
        )
        for what in (True, (), frozenset(), DATE)
    },
}
CELLS = tuple(WRONG)
WRONG |= {
    "masked": lambda v, rng: np.ma.array(
        v, mask=spot(np.zeros(v.shape, bool), rng, True)
    ),
    "deeper": lambda values, rng: values[None],
    "ragged": lambda values, rng: [*values.tolist(), [1.0] * 7],
    **{
        name: lambda _, __, made=made: made
        for name, made in (("none", None), ("a word", "film"))
    },
    "a mapping": lambda values, rng: {"x": values},
}
OTHER_FORM = {
    "lists": lambda values, rng: values.tolist(),
    "columns first": lambda values, rng: np.asfortranarray(values),
    "backwards": lambda values, rng: np.flip(np.flip(values).copy()),
    "other bytes": lambda values, rng: values.astype(values.dtype.newbyteorder()),
    "objects": lambda values, rng: values.astype(object),
}


def column(table, name, rng, kind):
    """Return a table of which one column has a fault of an array."""
    return table.assign(
        **{name: pd.Series(WRONG[kind](table[name].to_numpy(), rng), table.index)}
    )


def other(table, name, rng, change):
    """Return a table of which one cell is changed."""
    values = table[name].to_numpy(float, copy=True)
    values[k] = change(values[k := rng.integers(len(values))])
    return table.assign(**{name: values})


WRONG_COLUMNS = {
    **{
        kind: lambda t, name, rng, kind=kind: column(t, name, rng, kind)
        for kind in CELLS
    },
    "missing": lambda table, name, rng: table.drop(columns=name),
    "twice": lambda table, name, rng: pd.concat([table, table[[name]]], axis=1),
}
OTHER_COLUMNS = {
    "floats": lambda table, name, rng: table.astype({name: float}),
    "nullable": lambda table, name, rng: table.assign(
        **{name: table[name].convert_dtypes()}
    ),
}
WRONG_WHOLE = {
    "a fraction": lambda table, name, rng: other(
        table, name, rng, lambda value: value + 0.5
    ),
    "below": lambda table, name, rng: other(table, name, rng, lambda value: -2),
    "beyond": lambda table, name, rng: other(table, name, rng, lambda value: 1e300),
    "far below": lambda table, name, rng: other(
        table, name, rng, lambda value: -(2.0**63)
    ),
}
WRONG_TABLES = {
    "a row twice": lambda t, rng: pd.concat([t, t.iloc[[rng.integers(len(t))]]]),
    "no table": lambda table, rng: table.to_numpy(),
    "nothing": lambda table, rng: None,
    "levels": lambda t, rng: t.set_axis(
        pd.MultiIndex.from_product([t.columns]), axis=1
    ),
    "a path": lambda table, rng: "tracks.csv",
}
OTHER_TABLES = {
    "another order": lambda table, rng: table[list(rng.permutation(table.columns))],
    "more columns": lambda table, rng: table.assign(more="text"),
    "an index": lambda table, rng: table.set_axis(rng.permutation(len(table)) + 7),
}
NUMBERS = {
    "nan": np.nan,
    "inf": np.inf,
    "text": "5",
    "none": None,
    "complex": 1j,
    "true": True,
}
NUMBERS |= {"below": -1.0, "several": np.array([1.0, 2.0]), "date": DATE}


def patched(content, rng, change):
    """Return the bytes of a file with up to 64 of them changed."""
    k = rng.integers(len(content))
    return content[:k] + change(content[k : k + 64]) + content[k + 64 :]


def cut(content, length):
    """Return the first bytes; a table cut after a whole line is a shorter table."""
    return content[:length].rstrip(b"\n")


BYTES = {
    "empty": lambda content, rng: b"",
    "cut": lambda content, rng: cut(content, rng.integers(len(content))),
    "cut at the end": lambda content, rng: cut(
        content, len(content) - rng.integers(1, 1 + len(content) // 9)
    ),
    "longer": lambda content, rng: content + rng.bytes(rng.integers(1, 99)),
    "other": lambda content, rng: rng.bytes(len(content)),
    "text": lambda content, rng: b"frame,x\n1,2\n",
    "a byte": lambda c, rng: patched(
        c, rng, lambda part: bytes([part[0] ^ 65]) + part[1:]
    ),
    "zeros": lambda content, rng: patched(content, rng, lambda part: bytes(len(part))),
}


def faults(value):
    """Yield column, kind, what must become of it and the function that makes it of a
    value.
    """
    if isinstance(value, pd.DataFrame):
        for right, kinds in ((REFUSED, WRONG_TABLES), (SAME, OTHER_TABLES)):
            yield from ((None, kind, right, make) for kind, make in kinds.items())
        for name in value.select_dtypes("number").columns:
            whole = WRONG_WHOLE if value[name].dtype.kind == "i" else {}
            for right, kinds in (
                (REFUSED, WRONG_COLUMNS | whole),
                (SAME, OTHER_COLUMNS),
            ):
                for kind, make in kinds.items():
                    yield (
                        name,
                        kind,
                        right,
                        lambda t, rng, n=name, make=make: make(t, n, rng),
                    )
    elif isinstance(value, np.ndarray):
        for right, kinds in ((REFUSED, WRONG), (SAME, OTHER_FORM)):
            yield from ((None, kind, right, make) for kind, make in kinds.items())
    else:
        yield from (
            (None, k, REFUSED, lambda _, __, v=v: v) for k, v in NUMBERS.items()
        )


def equal(one, two):
    """Return whether two results are the same to rounding."""
    if isinstance(one, pd.DataFrame):
        return all(
            equal(one[name].to_numpy(), two[name].to_numpy()) for name in one.columns
        )
    if dataclasses.is_dataclass(one):
        return equal(list(vars(one).values()), list(vars(two).values()))
    if isinstance(one, list | tuple):
        return len(one) == len(two) and all(map(equal, one, two))
    a, b = np.asarray(one), np.asarray(two)
    if a.dtype.kind in "biuf" and b.dtype.kind in "biuf":
        return a.shape == b.shape and np.allclose(
            a, b, rtol=1e-6, atol=1e-6, equal_nan=True
        )
    return a.tolist() == b.tolist()
