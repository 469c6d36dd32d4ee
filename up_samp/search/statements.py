"""What is stated of motions: before the first schedule, and whenever a check tells more."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from operator import itemgetter

import shapely

from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    avoids,
    check_time,
    stays,
)
from up_samp.model.frames import Frame
from up_samp.model.graphs import grouped
from up_samp.model.refinement import Given, Refinement, Strength, end_of, start_of
from up_samp.model.snapshot import MotionTask, TermKind
from up_samp.refinement import rules
from up_samp.search.facts import Facts, MotionCase, Signature, are_apart
from up_samp.search.knowledge import Knowledge
from up_samp.search.world import Motions, near, touching

# ------------------ How long motions take: for any planner, and the planner's own


QUERY = 2.0
"""s for one motion: what takes longer may never be needed."""
PROBE = 30
"""Motions after which is told whether all can be asked for..."""
HOPELESS = 4.0
"""...which they are not where all would take so many times the time that there is: others are left
to be learned when a candidate uses them, and most never are."""


def lower_bounds(motions: Motions, knowledge: Knowledge) -> list[Refinement]:
    """Return a lower bound on every motion's duration, admissible for any planner: for whatever
    is decided, and (where that tells more) for each choice of its decisions.
    """
    why = "no motion between these poses is faster, whatever else stands there"
    bounds: dict[MotionTask, dict[MotionCase, int]] = {}
    for signature, cases in motions.facts.by_signature.items():
        check_time()
        units = motions.facts.units(motions.service.lower_bound(*signature))
        knowledge.stated[signature] = units if units > 1 else 0
        for case in cases:
            bounds.setdefault(case.task, {})[case] = units
    found = []
    for task, units_of in bounds.items():
        least = min(units_of.values())
        if least > 1:
            found.append(rules.lasts(task.activity, least, why))
        found += [
            rules.only_given(rules.lasts(task.activity, units, why), case.given)
            for case, units in units_of.items()
            if units > max(least, 1)
        ]
    return found


def fastest_durations(
    motions: Motions,
    knowledge: Knowledge,
    tell: Callable[[int, int], None],
) -> list[Refinement]:
    """Return the planner's own best duration of every motion, as far as time allows: guesses, where
    the planner may have missed a faster way.

    Where they are far too many for that, few of them are asked for. They are found among the fixed
    obstacles alone: objects that move only make motions slower.
    ``tell`` is called with how many of how many motions are done.
    """
    found = []
    signatures = motions.facts.by_signature
    seconds = min(QUERY, motions.budget.query_seconds)
    deadline = motions.budget.part("unobstructed motions")
    whole = deadline.remaining()
    for count, cases in enumerate(signatures.values()):
        if deadline.expired():
            break
        spent = whole - deadline.remaining()
        if count >= PROBE and spent * len(signatures) > HOPELESS * whole * count:
            break
        if count % 10 == 0:
            tell(count, len(signatures))
        limit = motions.budget.deadline.within(seconds)
        found += duration_of(motions, knowledge, cases, limit)
    return found


def duration_of(
    motions: Motions, knowledge: Knowledge, cases: Sequence[MotionCase], deadline: Deadline
) -> list[Refinement]:
    """Plan a motion among fixed obstacles; return what that tells of ``cases``, all of which are
    this motion.
    """
    facts = motions.facts
    signature = facts.signature(cases[0])
    if signature in knowledge.durations:
        return []
    query = PathQuery(*signature, facts.fixed_for(cases))
    report, strength = motions.fastest(query, deadline)
    if report.outcome is Outcome.IMPOSSIBLE:
        return [_ruled_out(case, report) for case in cases]
    if report.trajectory is None:
        knowledge.history.missed.append(str(cases[0]) + touching(report.reason))
        return []
    if strength is Strength.RELATIVE:
        knowledge.durations[signature] = report.trajectory.duration
    units = facts.units(report.trajectory.duration)
    if units <= knowledge.stated.get(signature, 0):
        return []
    why = f"the planner's fastest unobstructed motion takes {report.trajectory.duration:.2f} s"
    return [
        rules.only_given(rules.lasts(c.activity, units, why, strength=strength), c.given)
        for c in cases
    ]


# ------------------ Proofs that a motion cannot be made while an object like a door is where it is


Standing = tuple[str, Mapping[str, str]]
"""One of some objects that always change together (the leaves of a door), whose place tells those
of all, and where they are."""


def unreachable(motions: Motions) -> list[Refinement]:
    """Return proofs of what is unreachable, at all or while a door-like object is where it may
    be.
    """
    known = motions.facts.by_signature.items()
    by_signature = [(signature, cases) for signature, cases in known if not signature[0].flies]
    found = [stated for _, cases in by_signature for stated in _never_possible(motions, cases)]
    states = _instant_states(motions.facts)
    for standing, (signature, cases) in product(states, by_signature):
        by_heeded: dict[tuple[Placed, ...], list[MotionCase]] = {}
        for case in cases:
            heeded = motions.facts.heeded(case.task, standing[1])
            by_heeded.setdefault(heeded, []).append(case)
        by_heeded.pop((), None)
        for placed, heeding in by_heeded.items():
            found += _certify(motions, signature, heeding, placed, standing)
    return found


def _never_possible(motions: Motions, cases: Sequence[MotionCase]) -> list[Refinement]:
    """Return proofs that ``cases``, all of one motion, cannot be made, whatever moves where."""
    check_time()
    report = motions.never_possible(cases)
    return [] if report is None else [_ruled_out(case, report) for case in cases]


def _ruled_out(case: MotionCase, report: PathReport) -> Refinement:
    return rules.only_given(rules.impossible(case.activity, case.why_not(report)), case.given)


def _certify(
    motions: Motions,
    signature: Signature,
    cases: list[MotionCase],
    placed: Sequence[Placed],
    standing: Standing,
) -> list[Refinement]:
    facts, service = motions.facts, motions.service
    obstacle, places = standing
    configuration = places[obstacle]
    body, poses = signature
    if service.certificate(body, poses, placed) is None:
        return []
    names = frozenset(p.name for p in placed)
    why = f"{_listed(names, places, 'block')} the way"
    movers, returns = facts.snapshot.movers[obstacle], facts.returns_to(obstacle, configuration)
    found: list[Refinement] = []
    for case in cases:
        # a static obstacle stays all the time: then it must be gone from the start
        static = names <= (case.task.static or frozenset())
        if static and not case.given:  # a condition cannot hang on decisions
            found.append(rules.needs_away(case.activity, obstacle, configuration, why))
        elif returns:
            found += blocked_while(facts, [case], {obstacle: configuration}, why)
        elif static:
            found.append(_gone_from_the_start(case, movers, why))
        else:
            found += _opened(motions, case, obstacle, configuration, (body, poses, placed), why)
    return found


def _listed(names: Iterable[str], places: Mapping[str, str], verb: str) -> str:
    """Return what is where, with what it does."""
    what = [f"{name} at {places[name]}" for name in sorted(names)]
    return f"{' and '.join(what)} {verb}{'s' if len(what) == 1 else ''}"


def _gone_from_the_start(case: MotionCase, changes: Iterable[str], why: str) -> Refinement:
    cut = rules.gone_before(start_of(case.activity), changes, 0, why)
    return rules.only_given(cut, case.given)


def blocked_while(
    facts: Facts,
    cases: Iterable[MotionCase],
    places: Mapping[str, str],
    why: str,
    strength: Strength = Strength.PROVEN,
) -> list[Refinement]:
    """State that motions must not be made while objects rest at these ``places``."""
    movers = facts.snapshot.movers
    return [
        rules.only_given(
            rules.blocked_while(c.activity, places, movers, why, strength=strength), c.given
        )
        for c in cases
    ]


def _opened(
    motions: Motions,
    case: MotionCase,
    obstacle: str,
    configuration: str,
    past: tuple[Body, Sequence[Configuration], Sequence[Placed]],
    why: str,
) -> list[Refinement]:
    """State that an obstacle which does not come back has left before the end, by as much as the
    rest of the motion takes (``past`` it) at least: all of it, if it lies where the motion begins
    (who was there before it rests until it can set off).
    """
    facts, service = motions.facts, motions.service
    changes = facts.snapshot.movers[obstacle]
    body, poses, placed = past
    _, at_start = service.pose_blockers(body, poses[0], placed)
    least = service.lower_bound(body, poses) if at_start else service.least_after(*past)
    units = max(1, facts.units(least))
    found = []
    if len(changes) <= 1 and not case.given:
        found.append(rules.needs_away(case.activity, obstacle, configuration, why, at_end=True))
    # a condition would forbid further changes in its interval, although the obstacle has gone
    if units > 1 or not found:
        cut = rules.gone_before(end_of(case.activity), changes, units, why)
        found.append(rules.only_given(cut, case.given))
    return found


def _instant_states(facts: Facts) -> list[Standing]:
    """Return where what changes without driving may be: each thing, with all whose places its own
    tells, as they always change together. Of several that tell the same the first one says it.
    """
    snapshot, found = facts.snapshot, dict[frozenset[tuple[str, str]], str]()
    constant = (c for c in snapshot.changes if c.term.kind is TermKind.CONSTANT)
    known = {(c.object, c.activity): c.term.name for c in constant}
    for things in sorted(set(facts.changed_together.values())):
        movers = sorted(snapshot.movers[things[0]])
        rows = {tuple(known.get((t, a), "") for t in things) for a in movers}  # "": any place
        rows.add(tuple(snapshot.initial[t] for t in things))
        for row, k in product(sorted(rows), range(len(things))):
            columns = zip(*(r for r in rows if r[k] in (row[k], "")), strict=True)
            sure = {t: c[0] for t, c in zip(things, columns, strict=True) if {*c} == {c[0] or None}}
            if row[k]:
                found.setdefault(frozenset({**sure, things[k]: row[k]}.items()), things[k])
    return [(thing, dict(sorted(places))) for places, thing in found.items()]


# ------------------ Unary places: configurations that overlap hold one driving object at a time


Node = tuple[str, str]
"""An object and a configuration of it."""
Edges = set[tuple[int, int]]
"""Which two nodes are not taken at one time."""


def unary_places(motions: Motions) -> list[Refinement]:
    """State that configurations which overlap hold one driving object at a time, and so do those
    to which no motions lead two objects together.
    """
    nodes = resting_nodes(motions.facts)
    overlapping, in_order = _overlapping(motions, nodes), _in_order(motions, nodes)
    found = []
    for told, named, why in (
        (overlapping, itemgetter(1), "objects that rest at these configurations would overlap"),
        (in_order - overlapping, "_at_".join, "nobody passes anybody on the way there"),
    ):
        edges, covered = _by_any_name(motions.facts.snapshot.alike, nodes, told), Edges()
        for pair in sorted(edges):
            if pair in covered:
                continue
            clique = _grow(pair, edges, nodes)
            covered.update(itertools.combinations(sorted(clique), 2))
            members = [nodes[i] for i in sorted(clique)]
            name = "_".join(sorted({named(member) for member in members}))
            found.append(_place(motions.facts, members, name, why))
    return found


def resting_nodes(facts: Facts) -> list[tuple[str, str]]:
    """Return (object, configuration) for objects whose whole motion is known and heeds all."""
    snapshot = facts.snapshot
    nodes: set[tuple[str, str]] = set()
    # what comes and goes by other means than its own motions is not counted right
    elsewise = snapshot.moved_otherwise
    for name in sorted(facts.drivers):
        tasks = snapshot.by_object[name]
        ends = [places_of(facts, *end) for end in product(tasks, (0, -1))]
        heeds = avoids(snapshot.heeded[name], *(facts.drivers - {name}))
        if heeds and name not in elsewise:
            nodes.update(
                (name, place) for place in (snapshot.initial[name], *itertools.chain(*ends))
            )
    return sorted(nodes)


def places_of(facts: Facts, task: MotionTask, which: int) -> dict[str, str | None]:
    """Return where a motion may begin (``which`` 0) or end (-1), with the variable that tells it
    (None: it is no choice).
    """
    choice = facts.choice(task, task.terms[which])
    return dict.fromkeys(choice.values, choice.variable)


def _overlapping(motions: Motions, nodes: list[tuple[str, str]]) -> Edges:
    snapshot = motions.facts.snapshot
    edges: Edges = set()
    for i, j in itertools.combinations(range(len(nodes)), 2):
        if j == i + 1:
            check_time()
        (a, place_a), (b, place_b) = nodes[i], nodes[j]
        one = snapshot.objects[a].body, snapshot.configurations[place_a]
        other = snapshot.objects[b].body, snapshot.configurations[place_b]
        if a != b and near(*one, *other) and motions.service.overlap(*one, *other):
            edges.add((i, j))
    return edges


def _by_any_name(alike: Mapping[str, Sequence[str]], nodes: list[Node], edges: Edges) -> Edges:
    """Return the edges that are there by whatever names of the poses, which differ by rounding: who
    comes to a place by one of its names may leave it by another.
    """

    def pose(i: int) -> tuple[str, Sequence[str]]:
        name, place = nodes[i]
        return name, alike.get(place, (place,))

    same = grouped(range(len(nodes)), pose)  # of objects in the same order
    return {(i, j) for i, j in edges if edges.issuperset(product(same[pose(i)], same[pose(j)]))}


def _in_order(motions: Motions, nodes: list[tuple[str, str]]) -> Edges:
    """Return which two objects rest nowhere at one time as nobody passes anybody on the way."""
    index = {node: i for i, node in enumerate(nodes)}
    return {(index[one], index[other]) for one, other in never_together(motions, nodes, 2)}


def never_together(
    motions: Motions, nodes: list[tuple[str, str]], count: int
) -> Iterator[tuple[tuple[str, str], ...]]:
    """Yield so many (object, configuration) each, to which no motions lead these objects together,
    as far as time allows.
    """
    facts = motions.facts
    at, tasks = facts.snapshot.configurations, facts.snapshot.tasks
    # only what all of them heed
    fixed = [o for o in facts.fixed if all(avoids(t.avoid, o.name) for t in tasks)]
    places: dict[str, list[tuple[str, str]]] = {}
    for node in nodes:
        places.setdefault(node[0], []).append(node)
    deadline = motions.budget.part("orders that cannot change")
    for names in itertools.combinations(places, count):
        if deadline.expired():
            return
        first = [facts.placed(name, facts.snapshot.initial[name]) for name in names]
        apart = motions.service.in_order(first, fixed)
        if apart is not None:
            every = product(*(places[name] for name in names))
            yield from (some for some in every if apart([at[place] for _, place in some]))


def _grow(pair: tuple[int, int], edges: Edges, nodes: list[tuple[str, str]]) -> set[int]:
    """Return a clique around an edge: all of different objects overlap each other."""
    clique = set(pair)
    for node in range(len(nodes)):
        if node not in clique and all(
            nodes[node][0] == nodes[m][0] or (min(node, m), max(node, m)) in edges for m in clique
        ):
            clique.add(node)
    return clique


def _place(facts: Facts, members: list[tuple[str, str]], name: str, why: str) -> Refinement:
    check_time()
    inside = set(members)
    always: dict[int, set[str]] = {0: set(), -1: set()}
    decided: dict[int, set[tuple[str, str, str]]] = {0: set(), -1: set()}
    for task, which in product(facts.snapshot.tasks, always):
        for place, variable in places_of(facts, task, which).items():
            if (task.object, place) not in inside:
                continue
            if variable is None:
                always[which].add(task.activity)
            else:
                decided[which].add((task.activity, variable, place))
    taken = any(facts.snapshot.initial[name] == place for name, place in members)
    told = rules.unary_place(name, always[-1], always[0], taken, decided[0], decided[-1])
    return replace(told, why=why)


# ------------------ Orders on rings: three objects keep the order in which they began


Arrival = tuple[str, Given]


def kept_orders(motions: Motions) -> list[Refinement]:
    """State which three objects do not rest somewhere together, since no motions lead them there,
    though they may lead each two of them.
    """
    nodes = resting_nodes(motions.facts)
    apart = set(never_together(motions, nodes, 2))  # which unary places tell
    found = []
    for some in never_together(motions, nodes, 3):
        if apart.isdisjoint(itertools.combinations(some, 2)):
            found += _not_all(motions.facts, some)
    return found


def _not_all(facts: Facts, some: Sequence[Node]) -> list[Refinement]:
    """State that objects do not rest at their places at one time: for all ways to come there."""
    found = []
    for ways in product(*(_ways(facts, node) for node in some)):
        arrivals = [way for way in ways if way is not None]
        given = {decision for _, decided in arrivals for decision in decided}
        if arrivals and len(dict(given)) == len(given):
            come = [activity for activity, _ in arrivals]
            gone = [
                activity
                for node, way in zip(some, ways, strict=True)
                for activity, _ in _drives(facts, node, 0)
                if way is None or activity != way[0]  # which is over when it has come by that
            ]
            told = rules.not_all_there(come, gone, "nobody passes anybody on the ring")
            found.append(rules.only_given(told, tuple(sorted(given))))
    return found


def _ways(facts: Facts, node: Node) -> list[Arrival | None]:
    """Return how an object comes to a place (None: it begins there)."""
    name, place = node
    begins: list[Arrival | None] = [None] if facts.snapshot.initial[name] == place else []
    return [*begins, *_drives(facts, node, -1)]


def _drives(facts: Facts, node: Node, which: int) -> list[Arrival]:
    """Return the drives of an object that may begin (``which`` 0) or end (-1) at a place, with the
    decisions under which they do, by any name of it: who came by one may leave by another.
    """
    name, place = node
    names = facts.snapshot.alike.get(place, (place,))
    found: list[Arrival] = []
    for task in facts.snapshot.by_object.get(name, ()):
        for there, variable in places_of(facts, task, which).items():
            if there in names:
                found.append((task.activity, () if variable is None else ((variable, there),)))
    return found


# ------------------ Handing over a place: who arrives where another one leaves comes later
# Two objects share a place if they would overlap there. Who arrives then comes a *gap* after the
# other one's departure has begun. The gap is *proven* by the footprints and the accelerations alone
# (the last metres of the one and the first metres of the other). Both are under way then: after the
# one drive and before the other, bodies may be others. Neither rests there when the other one has
# come: no motion leads there that does not heed it, and without their loads they overlap as well.


PAIRS = 1500
"""Of motions, whose gaps are stated, at most."""
ALLOWANCE = 0.95
"""Accelerations are judged with a little tolerance: proven gaps are that much shorter."""


def proven_handovers(motions: Motions) -> list[Refinement]:
    """Return the proven gaps at all shared places, before the first schedule."""
    facts = motions.facts
    pairs = list(itertools.islice(_pairs(motions), PAIRS + 1))
    if len(pairs) > PAIRS:
        return []
    found = []
    for leaving, coming in pairs:
        both = facts.signature(leaving), facts.signature(coming)
        least = min(itertools.starmap(motions.service.lower_bound, both))
        units = facts.units(min(least, proven_gap(*both)))
        if units > 0:
            cut = rules.handed_over(
                leaving.activity,
                coming.activity,
                units,
                f"{coming.task.object} arrives where {leaving.task.object} leaves",
                strength=Strength.PROVEN,
            )
            given = tuple(sorted({*leaving.given, *coming.given}))
            found.append(rules.only_given(cut, given))
    return found


def _pairs(motions: Motions) -> Iterator[tuple[MotionCase, MotionCase]]:
    """Yield (who leaves a place, who comes to it) for all motions that are known."""
    facts = motions.facts
    snapshot, poses_of = facts.snapshot, {case: facts.signature(case)[1] for case in facts.cases}
    leaving: dict[tuple[Body, Configuration], list[MotionCase]] = {}
    coming: dict[tuple[Body, Configuration], list[MotionCase]] = {}
    for case, poses in sorted(poses_of.items(), key=lambda i: str(i[1])):
        body = snapshot.objects[case.task.object].body
        leaving.setdefault((body, poses[0]), []).append(case)
        if not stays(poses):
            coming.setdefault((body, poses[-1]), []).append(case)
    for (here, going), (there, arriving) in product(leaving.items(), coming.items()):
        check_time()
        if here[0].flies or there[0].flies or not motions.service.overlap(*here, *there):
            continue
        pairs = product(going, arriving)
        yield from (pair for pair in pairs if are_apart(snapshot, *pair))


def proven_gap(leaving: Signature, coming: Signature) -> float:
    """Return a lower bound (s) on the time from one's departure to the other's arrival.

    Both footprints hold a disc. From rest the first one's has moved ``A t^2`` at most after t
    (``A`` half of its acceleration), the second one's has ``B (T - t)^2`` left before it comes to
    rest at T. The two discs are apart at every t only if T is long enough: the least of ``A t^2 +
    B (T - t)^2`` is ``T^2 A B / (A + B)``. Top speeds are left out.
    """
    (one, from_poses), (other, to_poses) = leaving, coming
    best = 0.0
    for first, second in product(_discs(one), _discs(other)):
        p = Frame(*from_poses[0]).of((*first[:2], 0.0))[:2]
        q = Frame(*to_poses[-1]).of((*second[:2], 0.0))[:2]
        way = first[2] + second[2] - math.dist(p, q)
        a, b = _pull(one, first), _pull(other, second)
        if way > 0 and a is not None and b is not None:
            best = max(best, ALLOWANCE * math.sqrt(way * (a + b) / (a * b)))
    return best


def _pull(body: Body, disc: tuple[float, float, float]) -> float | None:
    """Return half of the acceleration (m/s^2) of a disc's centre, at most; None: not bounded."""
    kinematics, off = body.kinematics.own, math.hypot(disc[0], disc[1])
    if kinematics.mobility.steers:
        return kinematics.a_max / 2 * (1 + off / kinematics.turning_radius)
    if kinematics.mobility.sideways and off < 1e-3:
        return kinematics.a_max / 2
    return None


@functools.lru_cache(maxsize=256)
def _discs(body: Body) -> tuple[tuple[float, float, float], ...]:
    """Return centres (body frame) and radii (m) of discs inside the footprint: the largest one,
    and the largest around the reference point, which moves no faster than the body.
    """
    shape = shapely.Polygon(body.footprint)
    line = shapely.maximum_inscribed_circle(shape, tolerance=1e-3)
    (x, y), rim = line.coords[0], line.coords[-1]
    found = [(x, y, math.dist((x, y), rim) - 2e-3)]
    if shape.contains(shapely.Point(0.0, 0.0)):
        found.append((0.0, 0.0, shape.exterior.distance(shapely.Point(0.0, 0.0))))
    return tuple(found)
