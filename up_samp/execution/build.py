"""From a problem and its plan to the graph of what depends on what."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from unified_planning.model import FNode
from unified_planning.model.motion import MotionActivity
from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.execution.graph import (
    ORIGIN,
    At,
    Bound,
    Choice,
    Edge,
    Event,
    Graph,
    Narrow,
    PlannedTask,
    reduced,
)
from up_samp.execution.lives import DriveCells, Life, drives_of, errors_of, lives_of
from up_samp.execution.meetings import (
    Key,
    Meeting,
    meetings_of,
    narrow_places,
    steps_of,
    switched,
)
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import TravelProfile, travels_of
from up_samp.io.plan_dict import PlanDict, snapshot_of, word
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.graphs import reached
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling.compilers.plain import Condition, Expr
from up_samp.scheduling.compilers.translate import read_expression, read_plain
from up_samp.scheduling.partial_order.differences import Difference, Planned, Point
from up_samp.scheduling.partial_order.orders import OrderConstraint, orders_of, performers
from up_samp.upio.expressions import told_by
from up_samp.upio.movers import named_as_planned

Sides = Mapping[Key, bool]


class Draft:
    """Edges under construction, by events."""

    def __init__(self, tasks: Mapping[str, PlannedTask], lives: Mapping[str, Life]):
        self.tasks = tasks
        self.drives = drives_of(lives)
        self.edges: dict[tuple[Event, Event], Edge] = {}
        self.bounds: list[Bound] = []
        self.tight: list[Edge] = []
        self.after: dict[Event, set[Event]] = {}
        """Which events wait for which, also as long as it is open how (``tight``)."""
        self.orders: list[tuple[OrderConstraint, float]] = []
        """Orders that could be the other way round (see ``settle_choices``)."""
        self.together: dict[Event, set[Event]] = {}
        """Starts that are to happen at one instant."""

    def add_order(self, order: OrderConstraint, unit: float) -> None:
        """Add a difference: an edge, or a bound where the plan has it the other way round.

        Raises :class:`UnsupportedError` where two changes of one instant each wait for the other.
        """
        if order.instead is not None:
            self.orders.append((order, unit))
            return
        need = order.difference
        firsts, thens = self._events(need.first), self._events(need.then)
        for first, then in itertools.product(firsts, thens):
            lag = need.lag * unit + (TOLERANCES.strict if need.strict else 0.0)
            if first == then:
                continue
            # two that are to happen at once: the second follows the first, and that is watched
            at_once = need.lag <= 0 and self._at_once(then, first)
            if at_once and need.lag == 0 and first.at is then.at is At.START:
                self.let_begin_together(first, then)
            if at_once and need.lag == 0 and order.kind not in _WATCHED:
                raise UnsupportedError(
                    f"{first} and {then} happen at one instant, and each has to come first "
                    f"({order.why}): no executive could keep it"
                )
            late = self.time(then) < self.time(first) - TOLERANCES.same_time
            if then == ORIGIN or at_once or late or _backward(need):
                self.bounds.append(Bound(then, first, -need.lag * unit, order.why))
                continue
            self._add(Edge(first, then, max(0.0, lag), order.kind, order.why))
            if need.lag < 0:
                self.bounds.append(Bound(then, first, -need.lag * unit, order.why))

    def _at_once(self, first: Event, then: Event) -> bool:
        """Return whether ``then`` has to wait for ``first``, and both happen at one instant."""
        now = self.time(first)
        if abs(self.time(then) - now) > TOLERANCES.same_time:
            return False

        def at_once(event: Event) -> Iterator[Event]:
            own = [Event(At.END, event.activity)] if event.at is At.START else []
            for later in (*self.after.get(event, ()), *own):
                if abs(self.time(later) - now) <= TOLERANCES.same_time:
                    yield later

        return then in reached([first], at_once)

    def settle_choices(self) -> tuple[Choice, ...]:
        """Return the choices that all other orders leave open; what is not open is an order."""
        after = self._after()
        found: dict[tuple[Event, ...], Choice] = {}
        for order, unit in self.orders:
            one, two = (
                self._way(order, order.difference, unit),
                self._way(order, order.instead, unit),
            )
            if (
                one is None
                or two is None
                or self.time(one.then) < self.time(one.first) - TOLERANCES.same_time
                or any(_leads(after, way.then, way.first) for way in (one, two))
                or any(way.then in self.together for way in (one, two))
            ):
                self.add_order(replace(order, instead=None), unit)
                continue
            key = (one.first, one.then, two.first, two.then)
            known = found.get(key)
            if known is not None:
                one, two = (
                    replace(way, lag=max(way.lag, old.lag))
                    for way, old in zip((one, two), known, strict=True)
                )
            found[key] = (one, two)
        self.orders = []
        for planned, _ in found.values():
            self.put(planned)
        return tuple(found.values())

    def _way(self, order: OrderConstraint, need: Difference | None, unit: float) -> Edge | None:
        """Return a difference as a way of a choice, where an end waits for another activity."""
        if need is None or need.lag < 0 or need.first[0] != "end":
            return None
        if need.then[0] not in ("start", "end"):
            return None
        if need.first[1] == need.then[1]:
            return None
        lag = need.lag * unit + (TOLERANCES.strict if need.strict else 0.0)
        then = Event(At.START, need.then[1])
        if need.then[0] == "end":
            if self.tasks[need.then[1]].moves:
                return None
            then, lag = self._begun_before(need.then[1], lag)
        return Edge(Event(At.END, need.first[1]), then, lag, order.kind, order.why, free=True)

    def _begun_before(self, task: str, lag: float) -> tuple[Event, float]:
        """Return what is held back for an end that comes ``lag`` s after something, and for how
        long (s): what lasts as long as it lasts can only be held back before it begins.
        """
        return Event(At.START, task), max(0.0, lag - self.tasks[task].expected)

    def _events(self, point: Point) -> tuple[Event, ...]:
        anchor, name = point
        if anchor == "zero":
            return (ORIGIN,)
        if anchor == "horizon":
            return tuple(Event(At.END, task) for task in self.tasks)
        return (Event(At.START if anchor == "start" else At.END, name),)

    def add_meeting(self, meeting: Meeting, sides: Sides = MappingProxyType({})) -> None:
        """Add the steps of a meeting, with other sides than planned for some components."""
        for step in steps_by(meeting, sides):
            self._add(step)

    def _add(self, edge: Edge) -> None:
        first, then = edge.first, edge.then
        task = self.tasks.get(then.activity)
        if (
            then.at is At.END
            and task is not None
            and not task.moves
            and first.activity != task.name
        ):
            then, lag = self._begun_before(task.name, edge.lag)
            if self.time(first) >= self.time(then) - TOLERANCES.same_time:
                self.after.setdefault(first, set()).add(edge.then)
                self.tight.append(edge)
                return
            edge = replace(edge, then=then, lag=lag)
        self.put(edge)

    def put(self, edge: Edge) -> None:
        """Add an edge, unless there is a stronger one already. What is asked for anyhow is not free
        to be turned round.
        """
        pair = edge.first, edge.then
        if edge.first == ORIGIN and edge.lag <= 0.0:
            return
        self.after.setdefault(edge.first, set()).add(edge.then)
        known = self.edges.get(pair, edge)
        stronger = edge if known.lag < edge.lag else known
        self.edges[pair] = replace(stronger, free=known.free and edge.free)

    def let_begin_together(self, one: Event, other: Event) -> None:
        """Note that two starts are to happen at one instant."""
        self.together.setdefault(one, set()).add(other)
        self.together.setdefault(other, set()).add(one)

    def _begin_together(self) -> None:
        """Let what begins together wait for all that any of it waits for."""
        done: set[Event] = set()
        for event in self.together:
            group = set() if event in done else reached([event], self.together.__getitem__)
            done |= group
            for edge in [e for e in self.edges.values() if e.then in group]:
                for then in group if edge.first not in group else ():
                    self.put(replace(edge, then=then, free=False))

    def _settle(self) -> None:
        """Hold tasks back before they begin, not before they end, wherever that makes no cycle."""
        for edge in self.tight:
            then, lag = self._begun_before(edge.then.activity, edge.lag)
            held_back = not _leads(self._after(), then, edge.first)
            self.put(replace(edge, then=then, lag=lag) if held_back else edge)
        self.tight = []
        self._begin_together()

    def _after(self) -> dict[Event, list[Event]]:
        """Return which events follow which directly, in whatever way it will be seen to."""
        graph = self.full(0.0)
        after: dict[Event, list[Event]] = {}
        for a, b in graph.implied:
            after.setdefault(graph.events[a], []).append(graph.events[b])
        for edge in (*graph.edges, *self.tight):
            after.setdefault(edge.first, []).append(edge.then)
        return after

    def time(self, event: Event) -> float:
        """Return when an event happens as planned (s)."""
        (found,) = planned_times([event], self.tasks, self.drives)
        return found

    def full(self, margin: float) -> Graph:
        """Return the graph so far, with all of its edges."""
        edges, waiting = self.edges.values(), self.tight
        return graph_of(self.tasks, self.drives, edges, self.bounds, margin, waiting)

    def graph(self, margin: float) -> Graph:
        """Return the finished graph."""
        self._settle()
        return _finished(self.full(margin))


Drives = Mapping[tuple[str, str], DriveCells]


def planned_times(
    events: Sequence[Event], tasks: Mapping[str, PlannedTask], drives: Drives
) -> list[float]:
    """Return when events happen as planned (s)."""
    found = [0.0] * len(events)
    points: dict[tuple[str, str, At], list[int]] = {}
    for k, event in enumerate(events):
        if event.at in (At.START, At.END):
            found[k] = tasks[event.activity].planned[0 if event.at is At.START else 1]
        elif event.at is not At.ORIGIN:
            points.setdefault((event.activity, event.object, event.at), []).append(k)
    for (activity, who, at), numbers in points.items():
        drive = drives.get((activity, who))
        if drive is None:
            raise ProblemError(
                f"the plan cannot be followed: its dependencies speak of {events[numbers[0]]}, "
                "which is not driven"
            )
        places = np.array([events[k].progress for k in numbers])
        times = (drive.reached if at is At.REACH else drive.left)(places)
        for k, time in zip(numbers, times.tolist(), strict=True):
            found[k] = time
    return found


def graph_of(
    tasks: Mapping[str, PlannedTask],
    drives: Drives,
    edges: Collection[Edge],
    bounds: Collection[Bound],
    margin: float,
    also: Iterable[Edge] = (),
) -> Graph:
    """Return a graph of edges and bounds; the events of those of ``also`` are in it, too."""
    events: dict[Event, None] = {ORIGIN: None}
    for name in tasks:
        events[Event(At.START, name)] = None
        events[Event(At.END, name)] = None
    some: Iterable[Edge | Bound] = (*edges, *bounds, *also)
    events.update(dict.fromkeys(event for one in some for event in (one.first, one.then)))
    return Graph(
        tasks,
        tuple(events),
        tuple(planned_times(list(events), tasks, drives)),
        tuple(edges),
        tuple(bounds),
        margin=margin,
        lengths={key: round(drive.path.length, 6) for key, drive in drives.items()},
    )


_WATCHED = ("constraint", "duration")
"""Kinds of orders that may ask for two things to happen together."""


def _rank(order: OrderConstraint) -> tuple[bool, bool, Point, Point]:
    """What a change leaves behind for others comes before what is only to happen together."""
    need = order.difference
    # what begins when another thing ends, ends it by nothing that it does
    backward = need.then[0] == "end" and need.first[0] != "end"
    return order.kind in _WATCHED, backward, need.first, need.then


def _finished(full: Graph) -> Graph:
    """Return a graph reduced, with the events that are left, and seen to have no cycle."""
    edges = reduced(full)
    needed = {event for e in edges for event in (e.first, e.then)}
    inner = (At.REACH, At.LEAVE)
    kept = [k for k, e in enumerate(full.events) if e in needed or e.at not in inner]
    graph = replace(
        full,
        events=tuple(full.events[k] for k in kept),
        times=tuple(full.times[k] for k in kept),
        edges=tuple(edges),
        before_reduction=len(full.edges),
    )
    _ = graph.order  # a cycle is an error now, not on the floor
    return graph


def _backward(need: Difference) -> bool:
    """Return whether a difference only bounds how long something may take."""
    return need.lag < 0 and need.first[1] == need.then[1]


def _leads(after: Mapping[Event, list[Event]], first: Event, then: Event) -> bool:
    """Return whether there is a way from ``first`` to ``then``."""
    return then in reached([first], lambda event: after.get(event, ()))


# ------------------ From a problem and its plan to the graph of what depends on what


@dataclass(frozen=True, eq=False)
class Dependencies:
    """A plan's graph with the geometry that it came from."""

    graph: Graph
    lives: Mapping[str, Life]
    meetings: tuple[Meeting, ...]
    choices: tuple[Choice, ...] = ()
    """Orders of activities that could be the other way round, too."""
    localisation: float = 0.0
    """How far (m) from where it tells to be a robot may be: what margins have grown for."""
    problem: SchedulingProblem | None = None
    """What was planned (``None``: only the plan file is known)."""
    sides: Sides = field(default_factory=dict)
    """Who goes first of components that the plan's times do not order."""
    undecided: frozenset[Key] = frozenset()
    """Components of which it is to be decided who goes first: what is planned leaves no order, and
    the graph says nothing of who goes first anywhere (see ``settle`` in ``reorder.py``).
    """

    @cached_property
    def errors(self) -> dict[str, float]:
        """The same of each object, which may have its own."""
        return errors_of(self.lives, self.localisation)

    @cached_property
    def travels(self) -> dict[tuple[str, str], TravelProfile]:
        """The fastest drives of all motions, by activity and object."""
        return travels_of(self.lives)

    @cached_property
    def narrow(self) -> tuple[Narrow, ...]:
        """Where the plan has not the clearance that would cover the localisation error, and
        whoever drives there has to be known better. Elsewhere it is covered.
        """
        return narrow_places(self.meetings, self.graph.margin)


def dependencies_of(
    problem: SchedulingProblem,
    plan: PlanDict,
    *,
    margin: float | None = None,
    localisation: float = TOLERANCES.localisation,
) -> Dependencies:
    """Return the dependency graph of a valid plan: acyclic, transitively reduced, with reasons.

    ``margin``: clearance in m that is kept where the plan keeps it (None: the one that the plan
    was made with). It grows until it covers ``localisation``, how far (m) a robot may be from where
    it tells to be, for each of two bodies that drives, and 1 cm more (``TOLERANCES.margin``); where
    the plan keeps less, see ``Dependencies.narrow``.

    Raises :class:`ProblemError` where the plan breaks the problem,
    :class:`UnsupportedError` for what no executive can keep.
    """
    unit = float(plan["seconds_per_unit"])
    if margin is None:
        margin = float(plan.get("margin", TOLERANCES.margin))
    problem = named_as_planned(problem, plan)
    snapshot = snapshot_of(problem, unit)
    check_same(problem, snapshot, plan)
    plan = with_avoid(plan, snapshot)
    planned = planned_of(problem, plan)
    lives = lives_of(plan)
    meetings = meetings_of(lives, margin, localisation)
    draft = Draft(tasks_of(plan, performers(planned, snapshot)), lives)
    # of two that ask for one instant the first one settles who goes first
    for order in sorted(orders_of(with_places(planned, problem), snapshot), key=_rank):
        draft.add_order(order, unit)
    choices = draft.settle_choices()
    for meeting in meetings:
        draft.add_meeting(meeting)
    try:
        graph = draft.graph(margin)
    except ProblemError as error:  # the plan may do all at once, on the floor somebody is first
        raise UnsupportedError(f"{error}: no executive could keep the plan") from error
    return Dependencies(graph, lives, tuple(meetings), choices, localisation, problem)


def check_same(problem: SchedulingProblem, snapshot: Snapshot, plan: PlanDict) -> None:
    """Raise :class:`ProblemError` where a plan is one of another problem, or encoding."""
    named = problem.name or "the problem"
    here = {a.name for a in problem.activities}
    there = {a["name"] for a in plan["activities"]}
    drives = {(t.activity, t.object) for t in snapshot.tasks if t.activity in there}
    driven = {(m["activity"], m["object"]) for m in plan["motions"]}
    lacks = [f"'{named}' has no activity '{name}'" for name in sorted(there - here)]
    lacks += [f"'{named}' has no motion of '{o}' in '{a}'" for a, o in sorted(driven - drives)]
    lacks += [f"the plan has no motion of '{o}' in '{a}'" for a, o in sorted(drives - driven)]
    musts = {a.name for a in problem.activities if not a.optional}
    lacks += [f"the plan lacks '{name}', which is not optional" for name in sorted(musts - there)]
    if lacks:
        raise ProblemError(
            f"the plan of '{plan.get('problem', '')}' is of another problem, or of another "
            f"encoding of it: {lacks[0]}"
        )


def planned_of(problem: SchedulingProblem, plan: PlanDict) -> Planned:
    """Return a problem as plain values, under a plan; what is best there says nothing of who waits
    for whom.
    """
    times = {a["name"]: (int(a["start"]), int(a["end"])) for a in plan["activities"]}
    values = dict(plan.get("parameters", {}))
    for entry in plan["activities"]:
        for short, value in entry.get("parameters", {}).items():
            values[f"{entry['name']}.{short}"] = value
    return Planned(read_plain(problem, objective=False), times, values)


def with_places(planned: Planned, problem: SchedulingProblem) -> Planned:
    """Return a plan with what motions read of fluents as conditions: where they begin and lead to,
    and where their static obstacles are, at their start; where a motion effect leads to, at its
    end.
    """
    read: list[Condition] = []
    for activity in problem.activities:
        for anchor, node in _places(activity):
            if node.is_fluent_exp():
                at: Expr = ("time", anchor, activity.name, 0)
                read.append(Condition(at, at, read_expression(problem, node), activity.name))
    if not read:
        return planned
    conditions = (*planned.problem.conditions, *read)
    return replace(planned, problem=replace(planned.problem, conditions=conditions))


def _places(activity: Activity) -> Iterator[tuple[str, FNode]]:
    """Yield what tells where an activity's motions lead, and when it is read."""
    if not isinstance(activity, MotionActivity):
        return
    for constraint in activity.motion_constraints:
        for node in (constraint.starting, *constraint.waypoints):
            yield "start", node
        told = constraint.static_obstacles
        for obstacle, value in told.items() if isinstance(told, dict) else ():
            yield "start", told_by(activity.name, obstacle, value)
    for node in activity.motion_effects.values():
        yield "end", node


def with_avoid(plan: PlanDict, snapshot: Snapshot) -> PlanDict:
    """Return the plan with what each motion must keep clear of (``avoid``; absent: everything).

    Raises :class:`ProblemError` where it is not a plan of the snapshot's problem.
    """
    avoid = {(t.activity, t.object): t.avoid for t in snapshot.tasks}
    motions = []
    for motion in plan["motions"]:
        key = motion["activity"], motion["object"]
        if key not in avoid:
            raise ProblemError(
                f"'{snapshot.name}' is not the plan's problem: it has no activity "
                f"'{key[0]}' in which '{key[1]}' moves"
            )
        listed = avoid[key]
        entry = {k: v for k, v in motion.items() if k != "avoid"}
        if listed is not None:
            entry["avoid"] = sorted(listed)
        motions.append(entry)
    return {**plan, "motions": motions}


def tasks_of(
    plan: PlanDict,
    who: Mapping[str, tuple[str, ...]],
    expected: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, PlannedTask]:
    """Return the plan's activities; one that mentions nobody belongs to whom its name mentions.
    ``expected``: how long (s) they last undisturbed, where that is not as planned.
    """
    unit = float(plan["seconds_per_unit"])
    movers = sorted({m["object"] for m in plan["motions"]})
    tasks = {}
    for entry in plan["activities"]:
        name = entry["name"]
        moves = tuple(
            m["object"] for m in plan["motions"] if m["activity"] == name and _goes(m["samples"])
        )
        doers = who.get(name) or tuple(m for m in movers if word(m).search(name))
        start, end = entry["start"] * unit, entry["end"] * unit
        takes = expected.get(name, end - start)
        tasks[name] = PlannedTask(name, (start, end), takes, doers or moves, moves)
    return tasks


def _goes(samples: list[list[float]]) -> bool:
    """Return whether a motion goes anywhere."""
    return any(
        abs(a - b) > TOLERANCES.still
        for row in samples
        for a, b in zip(row[1:], samples[0][1:], strict=True)
    )


def with_sides(dependencies: Dependencies, sides: Sides) -> Graph:
    """Return the graph with other sides for some components and choices; :class:`ProblemError` on
    a cycle.
    """
    old = dependencies.graph
    draft = Draft(old.tasks, dependencies.lives)
    for edge in old.edges:
        if edge.fixed:
            draft.edges[edge.first, edge.then] = edge
    for k, (planned, other) in enumerate(dependencies.choices):
        draft.put(planned if sides.get(k, True) else other)
    draft.bounds = [*old.bounds]
    for bound in old.bounds:
        if bound.most <= 0.0 and bound.first.at is bound.then.at is At.START:
            draft.let_begin_together(bound.first, bound.then)
    for meeting in dependencies.meetings:
        draft.add_meeting(meeting, sides)
    return draft.graph(old.margin)


def timed(dependencies: Dependencies) -> Dependencies:
    """Return the baseline that follows the clock: everybody begins when the plan says so, after
    what they did before, and looks at nobody. Late robots collide.
    """
    old = dependencies.graph
    draft = Draft(old.tasks, dependencies.lives)
    last: dict[str, Event] = {}
    for task in sorted(old.tasks.values(), key=lambda t: t.planned):
        begin = Event(At.START, task.name)
        draft.put(Edge(ORIGIN, begin, task.planned[0], "constraint", "the timetable"))
        for who in task.who:
            if who in last:
                why = f"{who} does one after the other"
                draft.put(Edge(last[who], begin, 0.0, "constraint", why))
            last[who] = Event(At.END, task.name)
    draft.bounds = [*old.bounds]
    return replace(dependencies, graph=draft.graph(old.margin))


def steps_by(meeting: Meeting, sides: Sides, without: Collection[int] = ()) -> list[Edge]:
    """Return a meeting's steps, with other sides than planned for some components. Components
    ``without`` are left out.
    """
    left = [c for c in meeting.components if c not in without]
    own = {c: sides[(*meeting.pair, c)] for c in left if (*meeting.pair, c) in sides}
    found = steps_of(meeting, without={*own, *without})
    for component, one_first in own.items():
        found += switched(meeting, component, one_first)
    return found
