"""What objects ask of the order of activities: they move one way at a time, and rest for others."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

from up_samp.model import ProblemError
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling.compilers.expressions import Expr, subexpressions
from up_samp.scheduling.partial_order.differences import (
    Difference,
    Planned,
)
from up_samp.scheduling.partial_order.order import OrderConstraint


def _movers(planned: Planned, snapshot: Snapshot) -> dict[str, list[tuple[str, bool]]]:
    """Return for each object who moves it (activity, whether it drives), in the plan's order: what
    is set somewhere at an instant may drive on from there at once.
    """
    found: dict[str, list[tuple[str, bool]]] = {}
    driven = {(t.activity, t.object) for t in snapshot.tasks}
    for task in snapshot.tasks:
        if task.activity in planned.times:
            for name in (task.object, *(ride.load for ride in task.rides)):
                found.setdefault(name, []).append((task.activity, True))
    for change in snapshot.changes:
        if change.activity in planned.times and (change.activity, change.object) not in driven:
            found.setdefault(change.object, []).append((change.activity, False))
    for movers in found.values():
        movers.sort(key=lambda m: _place_in_life(planned, *m))
    return found


def _place_in_life(planned: Planned, activity: str, drives: bool) -> tuple[int, int, bool, str]:
    start, end = planned.times[activity]
    return (start if drives else end), end, drives, activity


def lives(planned: Planned, snapshot: Snapshot) -> Iterator[OrderConstraint]:
    """One motion or change of an object after the other."""
    for name, movers in _movers(planned, snapshot).items():
        for (one, _), (two, drives) in itertools.pairwise(movers):
            then = ("start" if drives else "end", two)
            need = Difference(("end", one), then, 0, strict=True)
            yield OrderConstraint(need, "object", f"{one} and {two} both move {name}")


def resting(planned: Planned, snapshot: Snapshot) -> Iterator[OrderConstraint]:
    """Static obstacles rest from the start to the end of the motion that lists them."""
    movers = _movers(planned, snapshot)
    for task in snapshot.tasks:
        if task.activity not in planned.times:
            continue
        start, end = planned.times[task.activity]
        for obstacle in sorted(task.static or ()):
            for name, drives in movers.get(obstacle, ()):
                if name == task.activity:
                    continue
                begin, stop = planned.times[name]
                why = f"{obstacle} rests during {task.activity}, {name} moves it"
                then = ("start" if drives else "end", name)
                before = Difference(("end", name), ("start", task.activity), 0)
                after = Difference(("end", task.activity), then, 0)
                if stop <= start:
                    yield OrderConstraint(before, "static obstacle", why, after)
                elif end <= (begin if drives else stop):
                    yield OrderConstraint(after, "static obstacle", why, before)
                else:
                    raise ProblemError(f"in the plan {why} at the same time")


def performers(planned: Planned, snapshot: Snapshot) -> Mapping[str, tuple[str, ...]]:
    """Return which driven objects each activity mentions: who does it."""
    movers = {t.object for t in snapshot.tasks}
    found: dict[str, dict[str, None]] = {name: {} for name in planned.times}
    for task in snapshot.tasks:
        if task.activity in found:
            found[task.activity][task.object] = None
    mentions: list[tuple[str | None, Expr]] = []
    mentions += [(c.owner, c.expression) for c in planned.problem.conditions]
    mentions += [(e.owner, e.fluent) for e in planned.problem.effects]
    for owner, e in mentions:
        if owner not in found:
            continue
        for sub in subexpressions(e):
            value = planned.value(sub) if sub[0] in ("obj", "par") else None
            if isinstance(value, str) and value in movers:
                found[owner][value] = None
    return {name: tuple(sorted(who)) for name, who in found.items()}
