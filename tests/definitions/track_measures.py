"""Eqs 5.1 to 5.7 frame by frame and pair by pair."""

from itertools import permutations, product

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


def likeness(truth, candidates, frame, gate):
    """Return how alike the positions of a frame are, for all pairs within the gate."""
    near = {}
    for t, c in product(truth, candidates):
        if frame in truth[t] and frame in candidates[c]:
            apart = float(np.linalg.norm(truth[t][frame][0] - candidates[c][frame][0]))
            if apart < gate:
                near[t, c] = 1 - apart / gate
    return near


def best(worth):
    """Return the pairs of largest sum of worth, each of a side once."""
    if not worth:
        return []
    (t, c), *_ = worth
    rest = {pair: w for pair, w in worth.items() if pair != (t, c)}
    apart = {pair: w for pair, w in rest.items() if t not in pair[:1] and c != pair[1]}
    with_it, without = [(t, c), *best(apart)], best(rest)
    return max(with_it, without, key=lambda pairs: sum(worth[pair] for pair in pairs))


def hota(truth, candidates, gate):
    """Return HOTA: pairs by the alignment of their tracks, at 19 thresholds."""
    frames = {
        frame for track in [*truth.values(), *candidates.values()] for frame in track
    }
    looks = {frame: likeness(truth, candidates, frame, gate) for frame in frames}
    common = dict.fromkeys(product(truth, candidates), 0.0)
    for near in looks.values():
        for (t, c), alike in near.items():
            of_t = sum(each for pair, each in near.items() if pair[0] == t)
            of_c = sum(each for pair, each in near.items() if pair[1] == c)
            common[t, c] += alike / (of_t + of_c - alike)
    every = {(t, c): len(truth[t]) + len(candidates[c]) for t, c in common}
    aligned = {pair: n / (every[pair] - n) for pair, n in common.items()}
    taken = []
    for near in looks.values():
        pairs = best({pair: aligned[pair] * alike for pair, alike in near.items()})
        taken += [(pair, near[pair]) for pair in pairs]
    n, m = (sum(map(len, tracks.values())) for tracks in (truth, candidates))
    scores = []
    for least in np.arange(0.05, 0.99, 0.05):
        hits = [pair for pair, alike in taken if alike >= least - 1e-9]
        detected = len(hits) / (n + m - len(hits))
        counts = [hits.count(pair) for pair in hits]
        shares = [
            count / (every[pair] - count)
            for pair, count in zip(hits, counts, strict=True)
        ]
        associated = sum(shares) / max(len(hits), 1)
        scores.append(np.sqrt(detected * associated))
    return np.mean(scores)


def mota(truth, candidates, gate):
    """Return MOTA: pairs stay while they are near, the rest are most alike."""
    frames = {
        frame for track in [*truth.values(), *candidates.values()] for frame in track
    }
    last, hits, switches = {}, 0, 0
    for frame in sorted(frames):
        near = likeness(truth, candidates, frame, gate)
        worth = {
            pair: a + 1000 * (last.get(pair[0]) == pair[1]) for pair, a in near.items()
        }
        for t, c in best(worth):
            hits += 1
            switches += last.get(t, c) != c
            last[t] = c
    n, m = (sum(map(len, tracks.values())) for tracks in (truth, candidates))
    return 1 - (n - hits + m - hits + switches) / n
