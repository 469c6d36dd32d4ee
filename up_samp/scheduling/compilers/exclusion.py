"""Who cannot be at work at once: ``uses`` as constraints on the order of users, for engines that
count resources wrongly when durations vary.

A resource is a fluent that activities only take from at their start and give back to at their end
(the same amount). Activities that together take too much must not all overlap. As intervals have
Helly's property (pairwise overlapping ones share an instant), it is enough that of each minimal
set that takes too much some two are apart. A use without duration takes nothing.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace

from up_samp.model import UnsupportedError
from up_samp.scheduling.compilers.plain import (
    TRUE,
    Activity,
    Compiled,
    Effect,
    Expr,
    PlainProblem,
    disjunction,
    end,
    fluents_in,
    negation,
    show,
    start,
)


def compile_resources(problem: PlainProblem, most: int = 5000) -> Compiled:
    """Replace resources by constraints on the order of their users.

    Where there are too many sets of users that take too much together, the resource stays if no
    duration of a user can vary: then engines count rightly.

    Raises:
        UnsupportedError: more than ``most`` such sets of users of a resource, some of whose
            durations vary, or that may be absent.
    """
    constraints: list[Expr] = []
    gone: set[Expr] = set()
    for fluent, capacity, amounts in _resources(problem):
        sets = list(itertools.islice(_minimal_sets(amounts, capacity), most + 1))
        if len(sets) <= most:
            gone.add(fluent)
            constraints += [_not_all_at_once(problem, users) for users in sets]
        elif not all(_fixed(problem.activity(name)) for name in amounts):
            raise UnsupportedError(
                f"resource {show(fluent)}: too many sets of activities take more "
                f"than {capacity} together"
            )
    if not gone:
        return Compiled(problem)
    names = {f[1] for f in gone}
    return Compiled(
        replace(
            problem,
            constraints=(*problem.constraints, *constraints),
            effects=tuple(e for e in problem.effects if e.fluent not in gone),
            fluents={n: f for n, f in problem.fluents.items() if n not in names},
            initial={k: v for k, v in problem.initial.items() if k[1] not in names},
        )
    )


def _fixed(activity: Activity) -> bool:
    """Return whether the activity takes place, with a certain positive duration."""
    lower = activity.lower
    return not activity.optional and lower == activity.upper and lower[0] == "int" and lower[1] > 0


def _resources(problem: PlainProblem) -> Iterator[tuple[Expr, int, dict[str, int]]]:
    """Yield the fluents (without arguments) that are resources: how much there is, and how much
    each activity takes.
    """
    effects: dict[Expr, list[Effect]] = defaultdict(list)
    for effect in problem.effects:
        effects[effect.fluent].append(effect)
    read = {f for expression in problem.read() for f in fluents_in(expression)}
    for fluent, changes in effects.items():
        if fluent in read or len(fluent) > 2:
            continue
        amounts = amounts_taken(changes)
        tpe, initial = problem.fluents[fluent[1]].type, problem.initial_value(fluent)
        if amounts is None or initial[0] != "int" or tpe[1] is None:
            continue
        if tpe[2] is None or initial[1] <= tpe[2]:
            yield fluent, initial[1] - tpe[1], amounts


def amounts_taken(effects: Iterable[Effect]) -> dict[str, int] | None:
    """Return who takes how much, if all effects are the two halves of ``uses``."""
    taken: dict[str, int] = defaultdict(int)
    given: dict[str, int] = defaultdict(int)
    for effect in effects:
        owner = effect.owner
        if owner is None or effect.condition != TRUE or effect.value[0] != "int":
            return None
        if effect.kind == "decrease" and effect.time == start(owner):
            taken[owner] += effect.value[1]
        elif effect.kind == "increase" and effect.time == end(owner):
            given[owner] += effect.value[1]
        else:
            return None
    return dict(taken) if taken == given and all(a > 0 for a in taken.values()) else None


def _minimal_sets(amounts: dict[str, int], capacity: int) -> Iterator[tuple[str, ...]]:
    """Yield the sets of users that take too much, of which no proper subset does."""
    users = sorted(amounts, key=lambda n: -amounts[n])

    def extend(chosen: tuple[str, ...], total: int, rest: int) -> Iterator[tuple[str, ...]]:
        for i in range(rest, len(users)):
            amount = amounts[users[i]]
            # users come by falling amounts: the last one is the smallest of the set
            if total + amount > capacity:
                yield (*chosen, users[i])
            else:
                yield from extend((*chosen, users[i]), total + amount, i + 1)

    yield from extend((), 0, 0)


def _not_all_at_once(problem: PlainProblem, users: tuple[str, ...]) -> Expr:
    ways = [negation(problem.presence(name)) for name in users]
    for name in users:
        lower = problem.activity(name).lower
        if lower[0] != "int" or lower[1] < 1:
            ways.append(("le", end(name), start(name)))
    ways += [("le", end(a), start(b)) for a, b in itertools.permutations(users, 2)]
    return disjunction(ways)
