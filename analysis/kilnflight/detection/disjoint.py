"""Disjoint sets of indices, each a tree of parents (Tarjan 1975)."""

from typing import Any

from kilnflight.compiled import compiled


@compiled
def find_root(parents: Any, member: int) -> int:
    """Return the root of a member's set, halving the way to it.

    ``parents`` (n,) are indices; a root is its own parent. Compiled:
    `scipy.cluster.hierarchy.DisjointSet` cannot be called from compiled code.
    """
    while parents[member] != member:
        parents[member] = parents[parents[member]]
        member = parents[member]
    return member


@compiled
def unite(parents: Any, member: int, other: int) -> bool:
    """Join two members' sets under the lower root; return whether they differed.

    ``parents`` (n,) are those of `find_root`.
    """
    first = find_root(parents, member)
    second = find_root(parents, other)
    parents[max(first, second)] = min(first, second)
    return first != second
