"""From a problem and its plan to the graph of what depends on what."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from unified_planning.model import FNode
from unified_planning.model.motion import MotionActivity
from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.execution.draft import Draft, why_of
from up_samp.execution.graph import Choice, Graph, PlannedTask
from up_samp.execution.lives import Life, lives_of
from up_samp.execution.meetings import Meeting, Narrow, meetings_of, narrow_places
from up_samp.execution.reduce import MEETING
from up_samp.execution.staircase import Step, steps_of, switched
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import Travel, travels_of
from up_samp.io.plan_dict import PlanDict, snapshot_of
from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.snapshot import Snapshot
from up_samp.scheduling.compilers.expressions import Expr
from up_samp.scheduling.compilers.plain import Condition
from up_samp.scheduling.compilers.read import read_expression
from up_samp.scheduling.compilers.read import read_problem as read_plain
from up_samp.scheduling.partial_order.differences import Planned
from up_samp.scheduling.partial_order.objects import performers
from up_samp.scheduling.partial_order.orders import orders_of
from up_samp.upio.movers import named_as_planned
from up_samp.upio.relaxing import told_by


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

    @cached_property
    def travels(self) -> dict[tuple[str, str], Travel]:
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
    was made with). It grows by ``localisation``, how far (m) a robot may be from where it tells to
    be, for each of two bodies that drives; where the plan keeps less, see ``Dependencies.narrow``.

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
    draft.add_orders(orders_of(with_places(planned, problem), snapshot), unit)
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
    """Return a problem as plain values, under a plan."""
    times = {a["name"]: (int(a["start"]), int(a["end"])) for a in plan["activities"]}
    values = dict(plan.get("parameters", {}))
    for entry in plan["activities"]:
        for short, value in entry.get("parameters", {}).items():
            values[f"{entry['name']}.{short}"] = value
    return Planned(read_plain(problem), times, values)


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
    """Return the plan with what each motion must keep clear of (``avoid``; absent: everything)."""
    avoid = {(t.activity, t.object): t.avoid for t in snapshot.tasks}
    motions = []
    for motion in plan["motions"]:
        listed = avoid[motion["activity"], motion["object"]]
        entry = {k: v for k, v in motion.items() if k != "avoid"}
        if listed is not None:
            entry["avoid"] = sorted(listed)
        motions.append(entry)
    return {**plan, "motions": motions}


def tasks_of(plan: PlanDict, who: Mapping[str, tuple[str, ...]]) -> dict[str, PlannedTask]:
    """Return the plan's activities; one that mentions nobody belongs to whom its name mentions."""
    unit = float(plan["seconds_per_unit"])
    movers = sorted({m["object"] for m in plan["motions"]})
    tasks = {}
    for entry in plan["activities"]:
        name = entry["name"]
        moves = tuple(
            m["object"] for m in plan["motions"] if m["activity"] == name and _goes(m["samples"])
        )
        doers = who.get(name) or tuple(m for m in movers if _mentions(name, m))
        start, end = entry["start"] * unit, entry["end"] * unit
        tasks[name] = PlannedTask(name, (start, end), end - start, doers or moves, moves)
    return tasks


def _goes(samples: list[list[float]]) -> bool:
    """Return whether a motion goes anywhere."""
    return any(
        abs(a - b) > TOLERANCES.still
        for row in samples
        for a, b in zip(row[1:], samples[0][1:], strict=True)
    )


def _mentions(text: str, name: str) -> bool:
    return bool(re.search(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])", text))


Side = Mapping[tuple[str, str, int], bool]
"""Who goes first in a component of two objects' obstacle: (one, other, component) -> whether
one.
"""


def with_sides(
    dependencies: Dependencies, sides: Side, turned: Collection[int] = frozenset()
) -> Graph:
    """Return the graph with other sides for some components, and the choices numbered ``turned``
    the other way round; :class:`ProblemError` on a cycle.
    """
    draft = _orders_again(dependencies, turned)
    for meeting in dependencies.meetings:
        for step in steps_by(meeting, sides):
            draft.put(step.first, step.then, 0.0, MEETING, why_of(meeting, step))
    return draft.graph(dependencies.graph.margin)


def coarse(dependencies: Dependencies) -> Dependencies:
    """Return the baseline in which motions that meet wait for each other as a whole, wherever one
    of them goes first all the way and no cycle comes of it.
    """
    draft = _orders_again(dependencies)
    for meeting in dependencies.meetings:
        draft.add_meeting(meeting)
    draft.coarsen(dependencies.meetings)
    graph = draft.graph(dependencies.graph.margin)
    return replace(dependencies, graph=graph)


def _orders_again(dependencies: Dependencies, turned: Collection[int] = frozenset()) -> Draft:
    """Return a draft with everything but who goes first where bodies would meet."""
    old = dependencies.graph
    draft = Draft(old.tasks, dependencies.lives)
    for edge in old.edges:
        if edge.kind != MEETING and not edge.free:
            pair = (old.events[edge.first], old.events[edge.then])
            draft.edges[pair] = (edge.lag, edge.kind, edge.why)
    for k, choice in enumerate(dependencies.choices):
        draft.put_choice(choice, int(k in turned))
    for bound in old.bounds:
        pair = (old.events[bound.first], old.events[bound.then])
        draft.bounds.append((*pair, bound.most, bound.why))
    return draft


def steps_by(meeting: Meeting, sides: Side) -> list[Step]:
    """Return a meeting's steps, with other sides than planned for some components."""
    own = {c: sides[(*meeting.pair, c)] for c in meeting.components if (*meeting.pair, c) in sides}
    found = [] if own and len(own) == len(meeting.components) else steps_of(meeting, without=own)
    for component, one_first in own.items():
        found += switched(meeting, component, one_first)
    return found
