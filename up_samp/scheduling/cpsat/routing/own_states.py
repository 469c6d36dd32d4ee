"""What sequences of tasks know of a traveller beside where it is: what it carries, what it has set.

A load is picked up and delivered by the same traveller; a fork that is taken holds nothing else. So
what a traveller may do next hangs on what it did before, whoever else did what meanwhile. All of
that is one number of each traveller, which each task changes: the states of a finite automaton.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.routing.dispatch import OwnState, RoutedWork
from up_samp.scheduling.cpsat.routing.set_back import Way

Known = tuple[tuple[int, ...], frozenset[Way]]
"""(the values of its own states, what it has begun and has still to end: ways of tasks)."""


Partners = dict[Way, frozenset[Way]]
"""A way to do a task -> what its traveller has begun and ends by it, ways of other tasks."""


def _partners(work: RoutedWork, wanted: frozenset[int]) -> Partners:
    """Return what has to be begun and ended by the same traveller, among ``wanted`` tasks."""
    routes = {way: work.tasks[way[0]].ways[way[1]][0] for way in work.needs}
    ends = {
        way: {o for o, gap in needs.ended.items() if gap > 0 and routes[o] == routes[way]}
        for way, needs in work.needs.items()
        if way[0] in wanted
    }
    enders = Counter(o for o, _ in {(o, way[0]) for way, some in ends.items() for o in some})
    # what several tasks end is not over when one of them is done
    once = frozenset(o for o, count in enders.items() if count == 1 and o[0] in wanted)
    return {way: once & some for way, some in ends.items()}


def own_states_after(
    work: RoutedWork, wanted: list[int], choices: list[tuple[int, Way]], most: int
) -> Any:
    """Return the number of a traveller after each of ``choices`` ((traveller, way)), by the one
    before it: a row for each number (0: at first), a column for each choice; -1: not then. What
    would take more numbers than ``most`` is left out.

    Assumes: whoever changes a traveller's own state is among the choices.
    """
    some = frozenset(wanted)
    partners = _partners(work, some)
    columns, tables = [], []
    for axis in range(len(work.routes)):
        mine = {column: way for column, (who, way) in enumerate(choices) if who == axis}
        states = [s for s in work.own if s.route == axis and {t for t, _ in s.changes} <= some]
        columns.append(list(mine))
        tables.append(_table(states, partners, list(mine.values()), most))
    after = np.full((max(map(len, tables)), len(choices)), -1, dtype=np.int64)
    for some_columns, table in zip(columns, tables, strict=True):
        after[np.ix_(range(len(table)), some_columns)] = table
    return after


def _table(states: list[OwnState], partners: Partners, ways: list[Way], most: int) -> Any:
    """Return the rows of one traveller (one row that tells nothing, if they are too many)."""
    first: Known = (tuple(s.initial for s in states), frozenset())
    begin = frozenset[Way]().union(*partners.values())
    agenda: list[Any] = [first]
    numbers: dict[Known | None, int] = {None: -1, first: 0}
    rows: list[list[int]] = []
    for known in agenda:
        row = []
        for way in ways:
            ended = partners.get(way, frozenset())
            following = _following(states, known, way, ended, begin & {way})
            if following not in numbers:
                numbers[following] = len(agenda)
                agenda.append(following)
            row.append(numbers[following])
        rows.append(row)
        if len(numbers) > most:
            return np.zeros((1, len(ways)), dtype=np.int64)
    return np.array(rows, dtype=np.int64).reshape(len(rows), len(ways))


def _following(
    states: list[OwnState], known: Known, way: Way, ended: frozenset[Way], begins: frozenset[Way]
) -> Known | None:
    """Return what is known after a task is done in one way, which has ``ended`` what was begun and
    ``begins`` something; ``None`` if it cannot be done then.
    """
    values, begun = known
    after = [state.after(value, way) for state, value in zip(states, values, strict=True)]
    now = tuple(value for value in after if value is not None)
    fits = ended <= begun and len(now) == len(after)
    return (now, begun - ended | begins) if fits else None
