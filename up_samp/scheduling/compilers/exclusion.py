"""Who cannot be at work at once: ``uses`` as constraints on the order of users, for engines that
count resources wrongly when durations vary; and tokens for cliques of activities that are apart.

A resource is a fluent that activities only take from at their start and give back to at their end
(the same amount). Activities that together take too much must not all overlap. As intervals have
Helly's property (pairwise overlapping ones share an instant), it is enough that of each minimal
set that takes too much some two are apart; with pairs alone that is the disjunctive resource,
which a later pass turns into a token. A use without duration takes nothing.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from up_samp.model import UnsupportedError
from up_samp.scheduling.cliques import clique_cover, graph_of
from up_samp.scheduling.compilers.plain import (
    LIMITS,
    TRUE,
    Activity,
    Compiled,
    Condition,
    Effect,
    Expr,
    Fluent,
    PlainProblem,
    disjunction,
    end,
    fluents_in,
    fresh,
    names_in_use,
    negation,
    show,
    start,
)


@dataclass(frozen=True)
class PlainResource:
    """A renewable resource: how much each activity takes of how much there is."""

    fluent: Expr
    capacity: int
    amounts: dict[str, int]


def compile_resources(problem: PlainProblem) -> Compiled:
    """Replace resources by constraints on the order of their users.

    Where there are too many sets of users that take too much together, the resource stays if no
    duration of a user can vary: then engines count rightly.

    Raises:
        UnsupportedError: more than ``LIMITS.forbidden_sets`` such sets of users, some of whose
            durations vary, or that may be absent.
    """
    constraints: list[Expr] = []
    gone: set[Expr] = set()
    for resource in find_resources(problem):
        sets = list(itertools.islice(_minimal_sets(resource), LIMITS.forbidden_sets + 1))
        if len(sets) <= LIMITS.forbidden_sets:
            gone.add(resource.fluent)
            constraints += [_not_all_at_once(problem, users) for users in sets]
        elif not all(_fixed(problem.activity(name)) for name in resource.amounts):
            raise UnsupportedError(
                f"resource {show(resource.fluent)}: too many sets of activities take more "
                f"than {resource.capacity} together"
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


def find_resources(problem: PlainProblem) -> list[PlainResource]:
    """Return the fluents (without arguments) that are resources."""
    effects: dict[Expr, list[Effect]] = defaultdict(list)
    for effect in problem.effects:
        effects[effect.fluent].append(effect)
    read = {f for expression in _read_expressions(problem) for f in fluents_in(expression)}
    found = []
    for fluent, changes in effects.items():
        if fluent in read or len(fluent) > 2:
            continue
        amounts = amounts_taken(changes)
        tpe, initial = problem.fluents[fluent[1]].type, problem.initial_value(fluent)
        if amounts is None or initial[0] != "int" or tpe[1] is None:
            continue
        if tpe[2] is not None and initial[1] > tpe[2]:
            continue
        found.append(PlainResource(fluent, initial[1] - tpe[1], amounts))
    return found


def _read_expressions(problem: PlainProblem) -> Iterator[Expr]:
    yield from problem.constraints
    for condition in problem.conditions:
        yield condition.expression
    for activity in problem.activities:
        yield activity.lower
        yield activity.upper
    for effect in problem.effects:
        yield effect.value
        yield effect.condition
        yield from effect.fluent[2:]


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


def _minimal_sets(resource: PlainResource) -> Iterator[tuple[str, ...]]:
    """Yield the sets of users that take too much, of which no proper subset does."""
    users = sorted(resource.amounts, key=lambda n: -resource.amounts[n])

    def extend(chosen: tuple[str, ...], total: int, rest: int) -> Iterator[tuple[str, ...]]:
        for i in range(rest, len(users)):
            amount = resource.amounts[users[i]]
            # users come by falling amounts: the last one is the smallest of the set
            if total + amount > resource.capacity:
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


# ------------------ Cliques of activities that are pairwise apart


Clique = tuple[tuple[str, ...], int]
"""Members, and a gap: of any two that are present, one ends that much or more before the other
starts.
"""


def disjunctive_pair(constraint: Expr, optional: frozenset[str]) -> tuple[str, str, int] | None:
    """Return ``(a, b, gap)`` if the constraint (in normal form) says just that ``a`` and ``b``
    are ``gap`` apart, as far as both are present.
    """
    if constraint[0] != "or":
        return None
    orders: list[tuple[str, str, int]] = []
    guards: set[str] = set()
    for part in constraint[1:]:
        if part[0] == "not" and part[1][0] == "pres":
            guards.add(part[1][1])
        elif part[0] == "le" and part[1][0] == part[2][0] == "time":
            (_, first, a, before), (_, second, b, after) = part[1], part[2]
            if first != "end" or second != "start":
                return None
            orders.append((a, b, before - after))
        else:
            return None
    if len(orders) != 2:
        return None
    (a, b, gap), (c, d, other_gap) = orders
    if (a, b) != (d, c) or a == b or gap != other_gap:
        return None
    return (a, b, gap) if guards == {a, b} & optional else None


def find_cliques(pairs: dict[tuple[str, str], int], order: list[str]) -> list[Clique]:
    """Return cliques of three and more of one gap among ``pairs`` (sorted names -> gap)."""
    number = {name: i for i, name in enumerate(order)}
    return [
        (tuple(order[i] for i in members), gap)
        for gap in sorted(set(pairs.values()))
        for members in clique_cover(
            graph_of((number[a], number[b]) for (a, b), g in pairs.items() if g == gap)
        )
        if len(members) > 2
    ]


def pairs_of(problem: PlainProblem) -> dict[tuple[str, str], tuple[int, Expr]]:
    """Return the disjunctive pairs of a problem in normal form: sorted names -> (gap, constraint).

    Of several constraints over one pair the one with the larger gap counts.
    """
    optional = problem.optional_names
    pairs: dict[tuple[str, str], tuple[int, Expr]] = {}
    for constraint in problem.constraints:
        pair = disjunctive_pair(constraint, optional)
        if pair is not None:
            key = (min(pair[:2]), max(pair[:2]))
            if key not in pairs or pairs[key][0] < pair[2]:
                pairs[key] = (pair[2], constraint)
    return pairs


# ------------------ Cliques of disjunctions to tokens
# For engines with object fluents: linear, not quadratic. A token is a state variable whose value
# names an activity. Each member of the clique takes it at its start and needs it unchanged while it
# runs: over ``[start + 1, end - 1 + gap]``. Another member then cannot start in between, and two
# cannot start at one instant, as their effects would meet.


def compile_tokens(problem: PlainProblem) -> Compiled:
    """Replace the disjunctions (in normal form) of each clique by a token.

    Only activities take part for which the token says exactly the same: those that last at least
    ``1 - gap`` (with ``gap`` 0 an activity without duration may coincide with another one's start)
    and whose interval is never empty or always.
    """
    pairs = pairs_of(problem)
    lengths = {a.name: (a.lower, a.upper) for a in problem.activities}

    def exact(name: str, gap: int) -> bool:
        lower, upper = lengths[name]
        if lower[0] != "int" or upper[0] != "int" or gap not in (0, 1) or lower[1] + gap < 1:
            return False
        return bool(lower[1] + gap >= 2 or upper[1] + gap < 2)

    edges = {k: gap for k, (gap, _) in pairs.items() if all(exact(name, gap) for name in k)}
    cliques = find_cliques(edges, [a.name for a in problem.activities])
    return Compiled(_with_tokens(problem, cliques, pairs)) if cliques else Compiled(problem)


def _with_tokens(
    problem: PlainProblem,
    cliques: list[Clique],
    pairs: dict[tuple[str, str], tuple[int, Expr]],
) -> PlainProblem:
    taken = names_in_use(problem)
    types, objects = dict(problem.types), dict(problem.objects)
    fluents, conditions, effects = dict(problem.fluents), [], []
    covered: set[Expr] = set()
    for members, gap in cliques:
        token_type = fresh("Token", taken)
        types[token_type] = None
        idle = fresh("nobody", taken)
        objects[idle] = token_type
        token = fresh("token", taken)
        fluents[token] = Fluent(("user", token_type), (), ("obj", idle))
        for i, name in enumerate(members):
            mine = fresh(f"{token}_{name}", taken)
            objects[mine] = token_type
            effects.append(Effect(start(name), "assign", ("flu", token), ("obj", mine), owner=name))
            upper = problem.activity(name).upper[1]
            if upper + gap >= 2:
                held = ("eq", ("flu", token), ("obj", mine))
                low, high = start(name, 1), end(name, gap - 1)
                conditions.append(Condition(low, high, held, name))
            covered.update(pairs[min(name, other), max(name, other)][1] for other in members[:i])
    return replace(
        problem,
        constraints=tuple(c for c in problem.constraints if c not in covered),
        conditions=(*problem.conditions, *conditions),
        effects=(*problem.effects, *effects),
        types=types,
        objects=objects,
        fluents=fluents,
    )
