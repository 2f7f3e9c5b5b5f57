"""Eqs 5.1 to 5.7 frame by frame and pair by pair."""

from itertools import permutations

import numpy as np


def filled(table):
    """Return particle -> frame -> (position, whether there is a row), gaps on straight
    lines.
    """
    tracks = {}
    for particle, of_one in table.groupby("particle"):
        at = {
            frame: np.array(rest) for frame, _, *rest in of_one.itertuples(index=False)
        }
        tracks[particle] = {}
        for frame in range(min(at), max(at) + 1):
            before = max(f for f in at if f <= frame)
            after = min(f for f in at if f >= frame)
            share = (frame - before) / max(after - before, 1)
            place = at[before] + share * (at[after] - at[before])
            tracks[particle][frame] = place, frame in at
    return tracks


def unfilled(table):
    """Return the same without the gaps: in these a track has no position."""
    tracks = {particle: {} for particle in table["particle"]}
    for frame, particle, *rest in table.itertuples(index=False):
        tracks[particle][frame] = np.array(rest), True
    return tracks


def gated(true, candidate, frame, gate):
    """Return Eq. 5.1: the gate for a frame of one track only, 0 for a frame of none."""
    if frame not in true or frame not in candidate:
        return gate * ((frame in true) + (frame in candidate))
    distance = float(np.linalg.norm(true[frame][0] - candidate[frame][0]))
    return distance if candidate[frame][1] and distance < gate else gate


def distance(true, candidate, gate):
    """Return Eq. 5.2."""
    return sum(gated(true, candidate, frame, gate) for frame in {*true, *candidate})


def least(truth, candidates, gate):
    """Return Eq. 5.3, the least of all choices; an empty track is a dummy."""
    choices = permutations([*candidates.values(), *[{}] * len(truth)], len(truth))
    return min(
        sum(distance(t, c, gate) for t, c in zip(truth.values(), choice, strict=True))
        for choice in choices
    )


def counts(truth, candidates, pairs, gate):
    """Return tp, fn and fp of the given pairs (Eq. 5.6, as the challenge counts)."""
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
    return tp, length - tp, fp + spurious
