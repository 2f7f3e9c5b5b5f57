"""Eqs 5.1 to 5.7 frame by frame and pair by pair, against the fast way."""

from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilnflight.scores import score_tracks

coordinate = st.integers(-5, 5)
rows = st.lists(
    st.tuples(st.integers(0, 9), st.integers(0, 3), coordinate, coordinate, coordinate),
    min_size=1,
    max_size=30,
    unique_by=lambda row: row[:2],
)


def filled(table):
    """Particle -> frame -> (position, whether there is a row), gaps on straight lines."""
    tracks = {}
    for particle, of_one in table.groupby("particle"):
        at = {frame: np.array(rest) for frame, _, *rest in of_one.itertuples(index=False)}
        tracks[particle] = {}
        for frame in range(min(at), max(at) + 1):
            before = max(f for f in at if f <= frame)
            after = min(f for f in at if f >= frame)
            share = (frame - before) / max(after - before, 1)
            place = at[before] + share * (at[after] - at[before])
            tracks[particle][frame] = place, frame in at
    return tracks


def gated(true, candidate, frame, gate):
    """Eq. 5.1 with the rules on what only one track has; 0 where neither is."""
    if frame not in true or frame not in candidate:
        return gate * ((frame in true) + (frame in candidate))
    distance = float(np.linalg.norm(true[frame][0] - candidate[frame][0]))
    return distance if candidate[frame][1] and distance < gate else gate


def distance(true, candidate, gate):
    """Eq. 5.2."""
    return sum(gated(true, candidate, frame, gate) for frame in {*true, *candidate})


def least(truth, candidates, gate):
    """Eq. 5.3 by trying out every choice; ``None`` is a dummy."""
    choices = permutations([*candidates.values(), *[{}] * len(truth)], len(truth))
    return min(
        sum(distance(t, c, gate) for t, c in zip(truth.values(), choice, strict=True))
        for choice in choices
    )


def counts(truth, candidates, pairs, gate):
    """tp, fn, fp and fp of spurious tracks of the given pairs."""
    tp = fp = 0
    for t, c in pairs.items():
        true, detected = truth[t], candidates[c]
        for frame, (_, real) in detected.items():
            match = frame in true and gated(true, detected, frame, gate) < gate
            tp += match
            fp += not match and (real or frame not in true)
    rest = [detected for c, detected in candidates.items() if c not in pairs.values()]
    spurious = sum(real for detected in rest for _, real in detected.values())
    length = sum(map(len, truth.values()))
    return tp, length - tp, fp + spurious, spurious


@settings(deadline=None)  # the first call compiles
@given(rows, rows, st.sampled_from([1.0, 2.5, 6.0, 20.0]), st.integers(1, 3))
def test_the_fast_way_is_the_definition(truth, candidate, gate, dimensions):
    names = ["frame", "particle", *["x", "y", "z"][:dimensions]]
    tables = [
        pd.DataFrame([row[: len(names)] for row in first], columns=names)
        for first in (truth, candidate)
    ]
    score = score_tracks(*tables, gate, columns=names[2:])
    true, candidates = map(filled, tables)
    empty = gate * sum(map(len, true.values()))
    pairs = dict(score.pairs[["truth", "candidate"]].to_numpy().tolist())
    rest = sum(len(first) for c, first in candidates.items() if c not in pairs.values())
    best = least(true, candidates, gate)
    assert score.alpha == pytest.approx(1 - best / empty, abs=1e-9)
    assert score.beta == pytest.approx((empty - best) / (empty + gate * rest), abs=1e-9)
    assert counts(true, candidates, pairs, gate) == (
        score.tp,
        score.fn,
        score.fp,
        score.fp_spurious_only,
    )
    for t, c, apart in score.pairs.itertuples(index=False):
        assert apart == pytest.approx(distance(true[t], candidates[c], gate))
        assert apart < gate * len(true[t])
