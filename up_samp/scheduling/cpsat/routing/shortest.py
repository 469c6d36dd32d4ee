"""Shortest ways between all pairs of places."""

from __future__ import annotations

from collections.abc import Iterable

Pair = tuple[int, int]


def shorten(lengths: dict[Pair, int], places: Iterable[int]) -> dict[Pair, int]:
    """Make ``lengths`` (0 or more) those of shortest ways; return, for each pair that is shorter
    by way of another place, the last one that made it so (Floyd and Warshall).

    Of ways of one length the first one found stays. Sparse lengths are few steps: places that
    nothing leads from cost nothing. (``scipy.sparse.csgraph`` returns other ones among equals.)
    """
    order = list(places)
    via: dict[Pair, int] = {}
    for middle in order:
        onward = [(b, lengths[middle, b]) for b in order if b != middle and (middle, b) in lengths]
        for a in order:
            first = lengths.get((a, middle))
            if a == middle or first is None:
                continue
            for b, second in onward:
                known = lengths.get((a, b))
                if known is None or first + second < known:
                    lengths[a, b] = first + second
                    via[a, b] = middle
    return via
