"""Before the first schedule: check the input's geometry, state bounds and certificates."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator, Sequence
from functools import partial

from up_samp.model import (
    Configuration,
    MotionModel,
    Outcome,
    PathQuery,
    PathReport,
    Placed,
    ProblemError,
    UnsupportedError,
)
from up_samp.model.refinement import Layer, Refinement, Strength, end_of, start_of
from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.motion import MotionService
from up_samp.refinement import rules
from up_samp.search.cases import MotionCase
from up_samp.search.context import Context, Signature

EAGER_SHARE = 0.2
"""Share of the remaining time (at most ``EAGER_SECONDS``) that goes into durations known early."""
EAGER_SECONDS = 30.0
EAGER_QUERY_SECONDS = 2.0
"""Limit of one query before the first schedule; what takes longer may never be needed."""


def check_geometry(snapshot: Snapshot, service: MotionService) -> None:
    """Raise :class:`ProblemError` where a robot starts in a wall or in another object."""
    drivers = sorted({t.object for t in snapshot.tasks})
    _check_flyers(snapshot, drivers)
    for name in drivers:
        body = snapshot.objects[name].body
        pose = snapshot.configurations[snapshot.initial[name]]
        in_wall, _ = service.pose_blockers(body, pose, ())
        if in_wall:
            raise ProblemError(
                f"object '{name}' starts at '{snapshot.initial[name]}' {_show(pose)}, which is in "
                f"a wall or outside the map '{snapshot.map_file}'"
            )
        heeded = _heeded(snapshot, name)
        others = tuple(
            Placed(o, snapshot.objects[o].body, snapshot.configurations[place])
            for o, place in snapshot.initial.items()
            if o != name and (heeded is None or o in heeded)
        )
        _, hit = service.pose_blockers(body, pose, others)
        if hit:
            raise ProblemError(
                f"object '{name}' overlaps '{min(hit)}' at the start; move one of them "
                f"('{name}' starts at '{snapshot.initial[name]}' {_show(pose)})"
            )


def _check_flyers(snapshot: Snapshot, drivers: list[str]) -> None:
    """Raise :class:`UnsupportedError` where something drives in the plane beside free flyers."""
    flyers = [
        n for n, o in sorted(snapshot.objects.items())
        if o.body.kinematics.model is MotionModel.SE3 and n in snapshot.initial
    ]  # fmt: skip
    planar = [n for n in drivers if n not in flyers]
    if flyers and planar:
        raise UnsupportedError(
            f"object '{flyers[0]}' is in space (SE3) and '{planar[0]}' drives in the plane: the "
            "two are not coordinated with each other"
        )


def _show(pose: Configuration) -> str:
    return "(" + ", ".join(f"{v:g}" for v in pose) + ")"


def _heeded(snapshot: Snapshot, name: str) -> frozenset[str] | None:
    """Return the obstacles that all motions of ``name`` heed (None: all objects)."""
    heeded: frozenset[str] | None = None
    for task in snapshot.tasks:
        if task.object == name and task.avoid is not None:
            heeded = task.avoid if heeded is None else heeded & task.avoid
    return heeded


def state_bounds(context: Context) -> list[Refinement]:
    """Return a lower bound on every motion's duration, admissible for any planner: for whatever
    is decided, and (where that tells more) for each choice of its decisions.
    """
    why = "no motion between these poses is faster, whatever else stands there"
    bounds: dict[MotionTask, dict[MotionCase, int]] = {}
    for signature, cases in context.by_signature.items():
        units = context.units(admissible_duration(context, signature))
        for case in cases:
            bounds.setdefault(case.task, {})[case] = units
    found = []
    for task, units_of in bounds.items():
        least = min(units_of.values())
        if least > 1:
            found.append(rules.lasts(task.activity, least, why))
        for case, units in units_of.items():
            if units > max(least, 1):
                found.append(rules.only_given(rules.lasts(task.activity, units, why), case.given))
    return found


def admissible_duration(context: Context, signature: Signature) -> float:
    """Return an admissible duration (s) of a motion."""
    body, poses = signature
    return context.service.lower_bound_through(body, poses)


def state_durations(context: Context) -> list[Refinement]:
    """Return the planner's own best duration of every motion, as far as time allows.

    They are found among the fixed obstacles alone: objects that move only make motions slower.
    """
    limit = min(EAGER_SECONDS, EAGER_SHARE * context.deadline.remaining())
    deadline = context.deadline.within(limit if math.isfinite(limit) else EAGER_SECONDS)
    found = []
    total = len(context.by_signature)
    seconds = min(EAGER_QUERY_SECONDS, context.query_seconds)
    for count, cases in enumerate(context.by_signature.values()):
        if deadline.expired():
            break
        if count % 10 == 0:
            context.report("motions", f"unobstructed motions {count}/{total}")
        found += [
            r
            for r in duration_refinements(context, cases, seconds)
            if r.strength is not Strength.HEURISTIC
        ]
    return found


def fastest_path(context: Context, query: PathQuery, seconds: float) -> tuple[PathReport, Strength]:
    """Return the planner's answer and what its duration is worth.

    Only a motion whose planner finished its search is the planner's fastest.
    """
    report = context.service.plan(query, context.deadline.within(seconds))
    return report, Strength.RELATIVE if report.complete else Strength.HEURISTIC


def duration_refinements(
    context: Context, cases: Sequence[MotionCase], seconds: float
) -> list[Refinement]:
    """Plan a motion among fixed obstacles; return what that tells of ``cases``, all of which are
    this motion.
    """
    signature = context.signature(cases[0])
    if signature in context.durations:
        return []
    started = time.monotonic()
    body, poses = signature
    # what is said of all equivalent motions may count on what all of them heed only
    obstacles = tuple(
        o
        for o in fixed_obstacles(context)
        if all(c.task.avoid is None or o.name in c.task.avoid for c in cases)
    )
    query = PathQuery(body, poses, obstacles)
    report, strength = fastest_path(context, query, seconds)
    context.history.seconds_motion += time.monotonic() - started
    if report.outcome is Outcome.IMPOSSIBLE:
        return [
            rules.only_given(rules.impossible(c.activity, report.reason), c.given) for c in cases
        ]
    if report.trajectory is None:
        return []
    if strength is Strength.RELATIVE:
        context.durations[signature] = report.trajectory.duration
    units = context.units(report.trajectory.duration)
    if units <= _stated_bound(context, signature):
        return []
    why = f"the planner's fastest unobstructed motion takes {report.trajectory.duration:.2f} s"
    return [
        rules.only_given(rules.lasts(c.activity, units, why, strength=strength), c.given)
        for c in cases
    ]


def _stated_bound(context: Context, signature: Signature) -> int:
    """Return the units that a motion is known to take at least (0: nothing was stated)."""
    if not context.params.bounds_first:
        return 0
    units = context.units(admissible_duration(context, signature))
    return units if units > 1 else 0


def fixed_obstacles(context: Context) -> tuple[Placed, ...]:
    """Return the movable objects that nothing ever moves."""
    snapshot = context.snapshot
    still = set(snapshot.initial) - snapshot.moved()
    return tuple(
        Placed(n, snapshot.objects[n].body, snapshot.configurations[snapshot.initial[n]])
        for n in sorted(still)
    )


def state_certificates(context: Context) -> list[Refinement]:
    """Return proofs of what is unreachable while a door-like object is where it may be."""
    found: list[Refinement] = []
    for obstacle, configuration in _instant_places(context):
        placed = Placed(
            obstacle,
            context.snapshot.objects[obstacle].body,
            context.snapshot.configurations[configuration],
        )
        for signature, cases in context.by_signature.items():
            heeding = [c for c in cases if c.task.avoid is None or obstacle in c.task.avoid]
            if heeding and signature[0].kinematics.model is not MotionModel.SE3:
                found += _certify(context, signature, heeding, placed, configuration)
    return found


def _certify(
    context: Context,
    signature: Signature,
    cases: list[MotionCase],
    placed: Placed,
    configuration: str,
) -> list[Refinement]:
    body, poses = signature
    service = context.service
    why = f"{placed.name} at {configuration} blocks the way"
    _, at_start = service.pose_blockers(body, poses[0], (placed,))
    if at_start:
        why = f"{placed.name} at {configuration} lies on the first pose"
        if context.returns_to(placed.name, configuration):
            return _blocked_while(context, cases, placed.name, configuration, why)
        changes = context.movers[placed.name]
        return [
            rules.only_given(rules.gone_before(start_of(c.activity), changes, 0, why), c.given)
            for c in cases
        ]
    proof = service.certificate(body, poses, (placed,))
    if proof is None:
        return []
    # a static obstacle stays all the time: then it must be gone from the start
    # (a condition cannot hang on decisions: there the weaker cut has to do)
    static = [c for c in cases if placed.name in (c.task.static or ()) and not c.given]
    others = [c for c in cases if c not in static]
    found = [rules.needs_away(c.activity, placed.name, configuration, why) for c in static]
    if not others:
        return found
    if context.returns_to(placed.name, configuration):
        cuts = _blocked_while(context, others, placed.name, configuration, why)
    else:
        tail = _tail_units(context, signature, placed)
        cuts = [opened(context, c, placed.name, configuration, tail, why) for c in others]
    return found + cuts


def _blocked_while(
    context: Context, cases: list[MotionCase], obstacle: str, configuration: str, why: str
) -> list[Refinement]:
    places = {obstacle: configuration}
    return [
        rules.only_given(rules.blocked_while(c.activity, places, context.movers, why), c.given)
        for c in cases
    ]


def opened(
    context: Context,
    case: MotionCase,
    obstacle: str,
    configuration: str,
    tail: int,
    why: str,
    *,
    strength: Strength = Strength.PROVEN,
    layer: Layer = Layer.GEOMETRIC,
) -> Refinement:
    """Return that an obstacle which does not come back has left ``tail`` units before the end."""
    changes = context.movers[obstacle]
    if len(changes) <= 1 and not case.given:
        return rules.needs_open(
            case.activity, obstacle, configuration, tail, why, strength=strength, layer=layer
        )
    # a condition would forbid further changes in its interval, although the obstacle has gone
    point = end_of(case.activity)
    cut = rules.gone_before(point, changes, max(1, tail), why, strength=strength, layer=layer)
    return rules.only_given(cut, case.given)


def _tail_units(context: Context, signature: Signature, placed: Placed) -> int:
    """Return how long a motion at least takes after the obstacle has gone (whole units, down)."""
    body, poses = signature
    seconds = context.after.seconds(body, poses, placed, partial(context.service.bounds.way, body))
    return math.floor(seconds / context.snapshot.seconds_per_unit)


def _instant_places(context: Context) -> Iterator[tuple[str, str]]:
    snapshot = context.snapshot
    for obstacle in sorted(context.instant):
        places = {snapshot.initial[obstacle]}
        places |= {
            c.term.name
            for c in snapshot.changes
            if c.object == obstacle and c.term.kind is TermKind.CONSTANT
        }
        for place in sorted(places):
            yield obstacle, place


def state_places(context: Context) -> list[Refinement]:
    """Return that configurations which overlap hold one driving object at a time."""
    nodes = _resting_nodes(context)
    found = []
    covered: set[tuple[int, int]] = set()
    edges = _overlapping(context, nodes)
    for pair in sorted(edges):
        if pair in covered:
            continue
        clique = _grow(pair, len(nodes), edges, nodes)
        covered |= {p for p in itertools.combinations(sorted(clique), 2)}
        found.append(_place(context, [nodes[i] for i in sorted(clique)]))
    return found


def _resting_nodes(context: Context) -> list[tuple[str, str]]:
    """Return (object, configuration) for objects whose whole motion is known and heeds all."""
    snapshot = context.snapshot
    nodes: set[tuple[str, str]] = set()
    for name in sorted(context.drivers):
        tasks = [t for t in snapshot.tasks if t.object == name]
        constant = all(t.kind is TermKind.CONSTANT for task in tasks for t in task.terms)
        heeds = all(t.avoid is None or t.avoid >= context.drivers - {name} for t in tasks)
        changed = any(c.object == name for c in snapshot.changes)
        if constant and heeds and not changed:
            nodes |= {(name, t.name) for task in tasks for t in (task.terms[0], task.terms[-1])}
            nodes.add((name, snapshot.initial[name]))
    return sorted(nodes)


def _overlapping(context: Context, nodes: list[tuple[str, str]]) -> set[tuple[int, int]]:
    snapshot = context.snapshot
    edges = set()
    for i, j in itertools.combinations(range(len(nodes)), 2):
        (a, place_a), (b, place_b) = nodes[i], nodes[j]
        if a != b and context.service.overlap(
            snapshot.objects[a].body,
            snapshot.configurations[place_a],
            snapshot.objects[b].body,
            snapshot.configurations[place_b],
        ):
            edges.add((i, j))
    return edges


def _grow(
    pair: tuple[int, int],
    count: int,
    edges: set[tuple[int, int]],
    nodes: list[tuple[str, str]],
) -> set[int]:
    """Return a clique around an edge: all of different objects overlap each other."""
    clique = set(pair)
    for node in range(count):
        if node not in clique and all(
            nodes[node][0] == nodes[m][0] or (min(node, m), max(node, m)) in edges for m in clique
        ):
            clique.add(node)
    return clique


def _place(context: Context, members: list[tuple[str, str]]) -> Refinement:
    inside = set(members)
    arrivals, departures = set(), set()
    for task in context.snapshot.tasks:
        if (task.object, task.terms[-1].name) in inside:
            arrivals.add(task.activity)
        if (task.object, task.terms[0].name) in inside:
            departures.add(task.activity)
    taken = any(context.snapshot.initial[name] == place for name, place in members)
    name = "_".join(sorted({place for _, place in members}))
    return rules.place_for_one(name, arrivals, departures, taken)
