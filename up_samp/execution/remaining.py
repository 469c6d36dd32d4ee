"""What is left of a problem: an ordinary UP problem from now on, with what has begun frozen."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Container, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from unified_planning.model import FNode, Parameter, TimepointKind
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.timing import TimeInterval, Timing
from unified_planning.plans import Schedule

from up_samp.execution.astray import led_by, place_of
from up_samp.execution.build import planned_of
from up_samp.execution.graph import At, Event
from up_samp.execution.lives import DriveCells, Life
from up_samp.execution.state import FloorState, TaskPhase
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import is_same_place
from up_samp.io.plan_dict import PlanDict
from up_samp.model import Configuration, ProblemError, UnsupportedError
from up_samp.model.errors import short
from up_samp.model.frames import Frame
from up_samp.model.objective import MinimizeCosts
from up_samp.scheduling.compilers.plain import Expr, fluents_in, show
from up_samp.scheduling.compilers.translate import read_expression
from up_samp.scheduling.partial_order.differences import Planned, constant, kept
from up_samp.scheduling.partial_order.orders import durations
from up_samp.upio.expressions import activities_in, conditions_of, own_end, told_by
from up_samp.upio.movers import Involved, brought, named_as_planned, whereabouts
from up_samp.upio.restrict import Decided, keep_times

# ------------------ What has happened by now: effects, as initial values of what is left


@dataclass(eq=False)
class ValuesNow:
    """What effects of ``source`` that have happened leave behind, ``since`` units (of ``unit`` s)
    after the plan's start. Activities that are ``gone`` have given back what they took.
    """

    source: SchedulingProblem
    planned: Planned
    state: FloorState
    unit: float
    since: int
    gone: frozenset[str]

    def holds(self, node: FNode) -> bool:
        """Return whether a condition holds in the new initial state."""
        return kept(self.now, read_expression(self.source, node)) == []

    @cached_property
    def now(self) -> Planned:
        """The plan, with fluents as they are now."""
        changed = {key: constant(value) for key, value in self.changed.items()}
        problem = self.planned.problem
        initial = {**problem.initial, **changed}
        return replace(self.planned, problem=replace(problem, initial=initial))

    @cached_property
    def changed(self) -> dict[Expr, Any]:
        """The values of fluents that effects have changed."""
        values: dict[Expr, Any] = {}
        for _, _, key, kind, amount in self._happened:
            old = values.get(key)
            if old is None and kind != "assign":
                old = self.planned.value(self.planned.problem.initial_value(key))
            if kind == "assign":
                values[key] = amount
            else:
                values[key] = old + (amount if kind == "increase" else -amount)
        return values

    def check_bounds(self) -> None:
        """Raise :class:`ProblemError` where a fluent has a value that its type does not have."""
        for key, value in self.changed.items():
            kind, *bounds = self.planned.problem.fluents[key[1]].type
            if kind != "int" or isinstance(value, bool):
                continue
            least, most = bounds
            if (least is not None and value < least) or (most is not None and value > most):
                by = [f"'{owner}'" for _, owner, other, *_ in self._happened if other == key]
                raise ProblemError(
                    f"what has happened is against the problem: '{show(key)}' is {value} now, and "
                    f"may be {least} to {most}; it was changed by {', '.join(by)}"
                )

    @cached_property
    def lasts(self) -> dict[tuple[str, str], int]:
        """How long (units) activities last: at least by their start, at most by their end."""
        needs = (told.difference for told in durations(self.planned))
        return {need.first: abs(need.lag) for need in needs}

    @cached_property
    def uses(self) -> frozenset[str]:
        """Fluents that are only taken from and given back to: nothing reads their values."""
        problem = self.planned.problem
        told = {e[1] for whole in problem.read() for e in fluents_in(whole)}
        told |= {e.fluent[1] for e in problem.effects if e.kind == "assign"}
        return frozenset(problem.fluents.keys() - told)

    def before(self, key: Expr) -> Any:
        """Return the new initial value of a fluent: what is under way takes anew what it uses."""
        value = self.changed[key]
        for _, owner, other, kind, amount in self._happened if key[1] in self.uses else ():
            if other == key and self.under_way(owner):
                value += amount if kind == "decrease" else -amount
        return value

    def under_way(self, name: str) -> bool:
        """Return whether an activity has begun, goes on, and is not over."""
        return name not in self.gone and self.state.phase.get(name) is TaskPhase.RUNNING

    @cached_property
    def _happened(self) -> list[tuple[float, str, Expr, str, Any]]:
        """Effects that have happened, in their order: when (s), whose, on what, how."""
        return sorted(self._effects(), key=lambda e: e[0])

    def _effects(self) -> Iterator[tuple[float, str, Expr, str, Any]]:
        for effect in self.planned.problem.effects:
            time = self._when(effect)
            if time is None:
                continue
            key = self.planned.ground(effect.fluent)
            if effect.condition != ("bool", True):
                raise UnsupportedError(f"conditional effect on {show(effect.fluent)}, from now on")
            amount = self.planned.value(effect.value)
            if key is not None:
                yield time, effect.owner or "the problem", key, effect.kind, amount

    def _when(self, effect: Any) -> float | None:
        """Return when an effect happened (s), ``None`` if it has not."""
        _, anchor, owner, delay = effect.time
        if anchor == "zero":
            time = delay * self.unit
            return time if time < self.since * self.unit else None
        if owner is None or owner not in self.state.phase:
            return None
        at = At.START if anchor == "start" else At.END
        fired = self.state.fired.get(Event(at, owner))
        if fired is None:
            return None
        if owner in self.gone and at is At.START:
            # what a robot that is out of order has taken, it gives back
            return None
        time = fired + delay * self.unit
        return time if at is At.END or time <= (self.since + 1e-9) * self.unit else None


# ------------------ What is left of an activity that has begun


def begun(activity: Activity, values: ValuesNow) -> Activity:
    """Return an activity that has begun: mandatory, and only what is left of it."""
    name, state, unit = activity.name, values.state, values.unit
    copy = activity.clone()
    copy._optional, copy._present = False, activity._environment.expression_manager.TRUE()
    start = state.fired[Event(At.START, name)]
    gone = values.since * unit - start
    if state.graph.tasks[name].moves:
        least, most = (values.lasts.get((end, name), 0) for end in ("start", "end"))
        longest = max(w.travel.whole for w in state.ways_of[name])
        shortest = max(1, math.ceil(least - gone / unit - 1e-9))
        enough = max(shortest, 2 * math.ceil(longest / unit) + 10)
        copy.set_duration_bounds(shortest, max(most - math.floor(gone / unit), enough))
    else:
        copy.set_fixed_duration(units_left(name, values))
    copy._effects = {}
    for timing, effects in activity.effects.items():
        if timing.timepoint.kind != TimepointKind.START:
            copy._effects[timing] = effects
            continue
        later = math.ceil(start / unit + timing.delay - values.since - 1e-9)
        # what it uses it takes anew, as schedulers know it
        left = [e for e in effects if later > 0 or e.fluent.fluent().name in values.uses]
        if left:
            copy._effects.setdefault(Timing(max(later, 0), timing.timepoint), []).extend(left)
    # what was asked until now was so; it is kept where it still is, for schedulers that
    # find their way by it
    copy._conditions = {}
    for span, nodes in conditions_of(activity).items():
        rest = _rest_of(span, activity, values.since - start / unit)
        holding = [n for n in nodes if rest is not None or values.holds(n)]
        if holding:
            copy._conditions.setdefault(span if rest is None else rest, []).extend(holding)
    return copy


def units_left(name: str, values: ValuesNow) -> int:
    """Return how long (units) an activity goes on that has begun and drives nothing."""
    state = values.state
    end = state.fired[Event(At.START, name)] + state.graph.tasks[name].expected
    return max(1, math.ceil(end / values.unit - values.since - 1e-9))


def _rest_of(span: TimeInterval, activity: Activity, passed: float) -> TimeInterval | None:
    """Return what is left of a condition's interval ``passed`` units after the activity's start, on
    a clock that begins then (``None``: nothing is).
    """
    ends = []
    for k, timing in enumerate((span.lower, span.upper)):
        own = own_end(timing, activity)
        if own is not None and not own[0]:
            left = timing.delay - passed
            if k == 1 and left <= 1e-9:
                return None
            whole = math.ceil(left - 1e-9) if k == 1 else math.floor(left + 1e-9)
            timing = Timing(max(0, whole), timing.timepoint)
        ends.append(timing)
    return TimeInterval(*ends, span.is_left_open(), span.is_right_open())


# ------------------ What has changed on the floor, and what is left of the problem then


Pose = tuple[float, float, float]


@dataclass(frozen=True)
class Surprise:
    """What has changed on the floor. ``broken`` maps robots that are out of order to where they
    stand, ``cancelled`` and ``shut`` name activities, and objects that stay where they are; ``new``
    are functions that add tasks to the problem. ``same_choices``: who does what stays as planned
    (optional activities that the plan leaves out stay out), which is much quicker to solve.
    """

    broken: Mapping[str, Pose] = field(default_factory=dict)
    cancelled: Sequence[str] = ()
    shut: Sequence[str] = ()
    new: Sequence[Callable[[SchedulingMotionProblem], None]] = ()
    same_choices: bool = False


@dataclass(frozen=True)
class Remaining:
    """``problem`` starts at ``since`` (units of the old clock), with robots standing at ``poses``.

    Robots under way stop there: these are the points at which they can. ``hint`` is what is left of
    the old plan, as a UP schedule of the new problem. ``notes`` say which constraints fell away.
    ``params`` are parameters of an engine that the new plan has to have in common with the old one:
    the length of a unit, and the clearance.
    """

    problem: SchedulingMotionProblem
    since: int
    poses: Mapping[str, Configuration]
    stops: Mapping[str, float]
    """How far robots under way still go in the motion that they are in (m), before they stand."""
    hint: Schedule | None
    notes: tuple[str, ...]
    params: Mapping[str, float] = field(default_factory=dict)
    localisation: float = TOLERANCES.localisation
    """How far (m) from where they tell to be robots may be, as the old plan is followed."""


def check_names(surprise: Surprise, source: SchedulingMotionProblem, state: FloorState) -> None:
    """Raise :class:`ProblemError` where a surprise speaks of what is not there, or has begun."""
    activities = {a.name for a in source.activities}
    objects = {o.name for o in source.all_objects}
    for name in surprise.cancelled:
        if name not in activities:
            raise ProblemError(f"cancelled '{name}' is no activity of '{source.name}'")
        if state.phase.get(name) in (TaskPhase.DONE, TaskPhase.RUNNING):
            raise ProblemError(f"'{name}' cannot be cancelled: it has begun")
    for name in (*surprise.broken, *surprise.shut):
        if name not in objects:
            raise ProblemError(f"'{name}' is no object of '{source.name}'")


def rest_of_plan(
    target: SchedulingMotionProblem, planned: Planned, state: FloorState, since: int
) -> Schedule | None:
    """Return the rest of the old plan on the new clock, to begin from (it need not be valid);
    ``None`` where it lacks something that has to be done.
    """
    here = [a for a in target.activities if a.name in planned.times]
    wanted = {a.name for a in target.activities if not a.optional}
    if not wanted <= {a.name for a in here}:
        return None
    if any(a.parameters for a in here) or target.base_variables:
        return None
    assignment: dict[Any, Any] = {}
    for activity in here:
        start, end = planned.times[activity.name]
        begun = state.phase[activity.name] is TaskPhase.RUNNING
        first = 0 if begun else max(0, start - since)
        assignment[activity.start] = first
        assignment[activity.end] = first + (max(1, end - since) if begun else end - start)
    return Schedule(here, assignment, target.environment)


# ------------------ Where everybody stands when a new clock starts


Place = tuple[Configuration, Any]
"""A pose, and the type of configurations that it is one of (which says on which map)."""


def _types(problem: SchedulingMotionProblem) -> dict[tuple[str, str], Any]:
    """Return the types of the configurations at which objects are first (``""``), and to which
    activities bring them.
    """
    found = {("", m.object().name): place.type for m, place in problem.initial_configuration}
    for activity in problem.motion_activities:
        found |= {(activity.name, who): goal.type for who, goal in brought(activity).items()}
    return found


# ------------------ What is left of a problem


def remaining_problem(
    problem: SchedulingMotionProblem,
    plan: PlanDict,
    state: FloorState,
    lives: Mapping[str, Life],
    surprise: Surprise,
) -> Remaining:
    """Return what is left to do from now on.

    What is done is gone from it, with its effects in the initial state; what has begun is
    mandatory and starts at 0, motions from where their robot can stop; everything else is as it
    was, so that the rest may be planned anew: by the robots that the plan chose, where a parameter
    says which one moves. Raises :class:`ProblemError` where something that
    has to be done cannot be any more.
    """
    if not isinstance(problem, SchedulingMotionProblem):
        raise UnsupportedError("remaining problems are made of problems with motions only")
    named = named_as_planned(problem, plan)
    involved = Involved(named, whereabouts(problem))
    return _Builder(named, plan, state, lives, surprise, involved).build()


class _Builder:
    def __init__(
        self,
        problem: SchedulingMotionProblem,
        plan: PlanDict,
        state: FloorState,
        lives: Mapping[str, Life],
        surprise: Surprise,
        involved: Involved,
    ):
        self.involved = involved
        self.source, self.plan, self.state, self.lives = problem, plan, state, lives
        self.surprise = surprise
        self.types = _types(problem)
        self.unit = float(plan["seconds_per_unit"])
        self.m = problem.environment.expression_manager
        self.planned = planned_of(problem, plan)
        self.notes: list[str] = []
        check_names(self.surprise, problem, state)
        self.stops = self._stops()
        self.since = math.ceil(max([state.now, *(t for _, t in self.stops.values())]) / self.unit)
        self.gone = self._gone()
        self.notes += [
            f"not optional, and cannot happen any more, dropped: '{a.name}'"
            for a in self.source.activities
            if not a.optional and a.name in self.gone and a.name not in self.surprise.cancelled
        ]
        self.surely = {a.name for a in problem.activities if not a.optional}
        self.exact = self._over()
        self.values = ValuesNow(problem, self.planned, state, self.unit, self.since, self.gone)

    # ------------------------------------------------------------------ what has happened

    def _stops(self) -> dict[str, tuple[float, float]]:
        """Return where robots under way can stop: progress (m) and when they stand there (s)."""
        found = {}
        for way in self.state.ways.values():
            if self.state.phase[way.activity] is not TaskPhase.RUNNING:
                continue
            if way.object in self.surprise.broken:
                continue
            strayed = self.state.strayed.get(way.object)
            if strayed is not None:
                self.notes.append(f"'{way.object}' is off its path, and goes on from where it is")
            here = self.state.here(way), self.state.now
            found[way.object] = self.state.rest(way) if strayed is None else here
        return found

    def _gone(self) -> frozenset[str]:
        """Return the activities that cannot happen any more."""
        found = set(self.surprise.cancelled)
        for activity in self.source.activities:
            phase = self.state.phase.get(activity.name, TaskPhase.WAITING)
            if phase is TaskPhase.DONE:
                continue
            if self.surprise.same_choices and activity.name not in self.state.phase:
                found.add(activity.name)
            name = activity.name
            chosen = {
                v
                for k, v in self.planned.values.items()
                if phase is TaskPhase.RUNNING and k.startswith(f"{name}.")
            }
            if any(self.involved.needs(name, r) or r in chosen for r in self.surprise.broken):
                found.add(name)
            if phase is TaskPhase.WAITING and any(
                self.involved.moves(name, d) for d in self.surprise.shut
            ):
                found.add(name)
        return frozenset(found)

    def _over(self) -> dict[str, tuple[float, float]]:
        """Return when what is over really started and ended (units)."""
        return {
            name: (self._started(name), self.state.fired[Event(At.END, name)] / self.unit)
            for name in self.state.those(TaskPhase.DONE)
            if name not in self.gone
        }

    def _running(self) -> list[str]:
        return [n for n in self.state.those(TaskPhase.RUNNING) if n not in self.gone]

    # ------------------------------------------------------------------ the new problem

    def build(self) -> Remaining:
        """Return the remaining problem."""
        target = self.source.clone()
        running = set(self._running())
        fix = self._substitution(self.exact)
        self.sure = self._substitution(self._sure_times())
        self._costs(fix, target)
        target._base._constraints = self._constraints(fix, self.source._base)
        keep_times(fix, target._base)
        self._refuse_times(target._base)
        self._timed(target._base)
        target._activities = []
        for activity in self.source.activities:
            if activity.name in self.exact or activity.name in self.gone:
                continue
            going = activity.name in running
            copy = begun(activity, self.values) if going else activity.clone()
            copy._constraints = self._constraints(fix, activity)
            keep_times(fix, copy)
            self._refuse_times(copy, activity.name)
            target._activities.append(copy)
        target._motion_activities = [a for a in target._activities if isinstance(a, MotionActivity)]
        for name in sorted(running):
            activity = next(a for a in target._activities if a.name == name)
            target.add_constraint(self.m.LE(activity.start, self.m.Int(0)))
        self._choose(target, running)
        places = self._set_places(target)
        self._initial(target)
        for add in self.surprise.new:
            add(target)
        poses = {name: place.configuration for name, place in places.items()}
        return Remaining(
            target,
            self.since,
            {n: tuple(float(v) for v in p) for n, p in poses.items()},
            {name: at for name, (at, _) in self.stops.items()},
            rest_of_plan(target, self.planned, self.state, self.since),
            tuple(self.notes),
            {k: float(self.plan[k]) for k in ("seconds_per_unit", "margin") if k in self.plan},
        )

    def _refuse_times(self, left: Any, owner: str | None = None) -> None:
        """Raise :class:`UnsupportedError` where conditions or effects are at times of others that
        have begun.
        """
        spans = ((span, (span.lower, span.upper)) for span in conditions_of(left))
        for what, times in (*spans, *((time, (time,)) for time in left.effects)):
            names = {name for t in times if (name := t.timepoint.container) != owner}
            for name in sorted(names & (self.exact.keys() | set(self._running()))):
                raise UnsupportedError(
                    f"what is asked or happens at {what} in '{owner or self.source.name}', from "
                    f"now on: '{name}' has begun"
                )

    def _started(self, name: str) -> float:
        """Return when an activity began (units)."""
        return self.state.fired[Event(At.START, name)] / self.unit

    def _substitution(self, exact: Mapping[str, tuple[float, float]]) -> Decided:
        """Return what puts in what is known, with these times (units, old clock)."""
        begun = {n: (self._started(n), None) for n in self._running()}
        return Decided(
            self.source.environment,
            absent=self.gone,
            lost={p.name for p in self._parameters(self.gone)},
            present=set(self._running()),
            values=self._known_values(),
            exact={**begun, **exact},
            shift=self.since,
        )

    def _sure_times(self) -> dict[str, tuple[float, float]]:
        """Return the times (units, old clock) of what is over, and of what has begun and ends when
        it ends: a deadline that it will miss is over for the rest, too.
        """
        found = dict(self.exact)
        for name in self._running():
            if not self.state.graph.tasks[name].moves:
                end = self.since + units_left(name, self.values)
                found[name] = self._started(name), end
        return found

    def _costs(self, fix: Decided, target: SchedulingMotionProblem) -> None:
        """Let what is to be best count from where the old clock began."""
        target.clear_quality_metrics()
        for metric in self.source.quality_metrics:
            if isinstance(metric, MinimizeCosts):
                left = [cost for cost in map(fix.cost, metric.costs) if cost is not None]
                metric = MinimizeCosts(left, self.source.environment)
            elif not metric.is_minimize_makespan():
                raise UnsupportedError(f"what is left of a problem with the metric '{metric}'")
            target.add_quality_metric(metric)

    def _choose(self, target: SchedulingMotionProblem, running: Set[str]) -> None:
        """What has begun keeps what was chosen for it; nothing else chooses a broken robot."""
        for activity in target._activities:
            for parameter in activity.parameters:
                same = self.m.Iff if parameter.type.is_bool_type() else self.m.Equals
                equal = partial(same, self.m.ParameterExp(parameter))
                if activity.name in running and parameter.name in self.planned.values:
                    value = self._constant(self.planned.values[parameter.name])
                    activity.add_constraint(equal(value))
                for name in self.surprise.broken if activity.name not in running else ():
                    robot = self.source.object(name)
                    if parameter.type.is_compatible(robot.type):
                        activity.add_constraint(self.m.Not(equal(self.m.ObjectExp(robot))))

    def _known_values(self) -> dict[str, FNode]:
        """Return the parameters of what is over or has begun, and of the plan's variables."""
        names = (p.name for p in self._parameters(self.exact) if p.name in self.planned.values)
        return {name: self._constant(self.planned.values[name]) for name in names}

    def _parameters(self, owners: Container[str]) -> Iterator[Parameter]:
        return (p for a in self.source.activities if a.name in owners for p in a.parameters)

    def _constant(self, value: Any) -> FNode:
        if isinstance(value, bool):
            return self.m.Bool(value)
        if isinstance(value, int):
            return self.m.Int(value)
        return self.m.ObjectExp(self.source.object(str(value)))

    def _constraints(self, fix: Decided, chronicle: Any) -> list[tuple[FNode, list[FNode]]]:
        found: list[tuple[FNode, list[FNode]]] = []
        for constraint, scope in chronicle._constraints:
            scopes = [fix(s, False) for s in scope]
            if any(s.is_false() for s in scopes):
                continue
            fixed = fix(constraint)
            if fixed.is_true():
                continue
            known = self.sure(constraint)
            fixed = known if known.is_false() else fixed
            open_scopes = [s for s in scopes if not s.is_true() and not self._mandatory(s)]
            if fixed.is_false() and open_scopes:
                # whoever it is about may still be left out
                found.append((self.m.Not(self.m.And(open_scopes)), []))
                continue
            if fixed.is_false():
                self._fallen(constraint)
                continue
            found.append((fixed, open_scopes))
        return found

    def _mandatory(self, scope: FNode) -> bool:
        name = scope.presence().container if scope.is_present_exp() else None
        return name in self.surely

    def _fallen(self, constraint: FNode) -> None:
        """A constraint that cannot hold any more: fine if it was about cancelled tasks alone."""
        text = short(str(constraint), 160)
        names = activities_in(constraint)
        cancelled = set(self.surprise.cancelled)
        own = any(
            all(self.involved.needs(name, robot) for name in names)
            for robot in self.surprise.broken
        )
        if not names & self.gone:
            # broken by what has happened: a deadline that is over
            self.notes.append(f"already broken, dropped: {text}")
        elif names & cancelled and names - cancelled <= self.gone | self.exact.keys():
            self.notes.append(f"about cancelled tasks, dropped: {text}")
        elif own and names <= self.gone | self.exact.keys():
            self.notes.append(f"about a broken robot alone, dropped: {text}")
        else:
            raise ProblemError(
                f"what is left cannot be done: nothing can keep '{text}' any more; cancel its tasks"
            )

    def _timed(self, base: Any) -> None:
        """Move the problem's own timed conditions and effects to the new clock."""
        effects: dict[Any, Any] = {}
        for timing, items in base.effects.items():
            if timing.timepoint.kind == TimepointKind.GLOBAL_START:
                timing = Timing(timing.delay - self.since, timing.timepoint)
                if timing.delay < 0:
                    continue  # it has happened
            effects[timing] = items
        base._effects = effects
        conditions: dict[Any, Any] = {}
        for span, items in conditions_of(base).items():
            kept = [part for i in items for part in self._kept(i)]
            if kept and span.lower.timepoint.kind == TimepointKind.GLOBAL_START:
                raise UnsupportedError(f"the problem's own condition over {span}, from now on")
            if kept:
                conditions[span] = kept
        base._conditions = conditions

    def _kept(self, node: FNode) -> list[FNode]:
        """Return what is left of a condition of the problem's own: not what speaks of robots that
        are out of order alone.
        """
        if node.is_and():
            return [part for a in node.args for part in self._kept(a)]
        about = self.involved.about(node)
        if about and about <= set(self.surprise.broken):
            self.notes.append(f"about a broken robot, dropped: {node}")
            return []
        return [node]

    # ------------------------------------------------------------------ where everybody is

    def _set_places(self, target: SchedulingMotionProblem) -> dict[str, ConfigurationObject]:
        """Set every object's initial configuration to where it is; begun motions go on from
        there.
        """
        found: dict[str, ConfigurationObject] = {}
        target._initial_configuration = []
        for movable, _ in self.source.initial_configuration:
            name = movable.object().name
            place = self._place(target, name, *self._where(name))
            found[name] = place
            target._initial_configuration.append((movable, self.m.ObjectExp(place)))
        for activity in target._motion_activities:
            if self.state.phase.get(activity.name) is TaskPhase.RUNNING:
                self._go_on(activity, found)
        return found

    def _where(self, name: str) -> Place:
        """Return where an object stands: robots under way stop first."""
        for ride in self.plan.get("rides", ()):
            running = self.state.phase[ride["activity"]] is TaskPhase.RUNNING
            if ride["object"] == name and running:
                carrier, type_ = self._where(ride["carrier"])
                return Frame(*carrier).of(ride["offset"]), type_
        life = self.lives[name]
        here = place_of(self.state, life)
        if here is None:
            raise ProblemError(f"where '{name}' is, what was told does not say")
        pose = here.path.poses[0]
        if isinstance(here, DriveCells) and name in self.stops:
            pose = here.path.poses_at(np.array([self.stops[name][0]]))[0]
        if name in self.state.strayed:
            pose = self.state.strayed[name].pose
        pose = self.surprise.broken.get(name, here.frame.inverse.of(pose))
        return tuple(float(v) for v in pose), self.types[led_by(life, here), name]

    def _place(
        self, target: SchedulingMotionProblem, name: str, pose: Configuration, type_: Any
    ) -> ConfigurationObject:
        """Return the configuration object at a pose, a new one where the problem has none."""
        for item in self.source.all_objects:
            if not isinstance(item, ConfigurationObject) or item.type != type_:
                continue
            if is_same_place(item.configuration, pose):
                return item
        numbers = itertools.chain([""], (f"_{k}" for k in itertools.count(1)))
        names = (f"now_{name}{number}" for number in numbers)
        fresh = next(free for free in names if not target.has_name(free))
        place = ConfigurationObject(fresh, type_, SE2(*pose))
        target.add_object(place)
        return place

    def _go_on(self, activity: MotionActivity, places: Mapping[str, ConfigurationObject]) -> None:
        constraints = []
        for c in activity._motion_constraints:
            if not isinstance(c, ActivityWaypoints):
                raise UnsupportedError(
                    f"'{activity.name}' has begun: {type(c).__name__} cannot be gone on with"
                )
            who = c.movable.object().name
            constraints.append(
                ActivityWaypoints(
                    c.movable,
                    places[who],
                    self._ahead(c, places[who].configuration),
                    static_obstacles=c.static_obstacles,
                    dynamic_obstacles_at_start=c.dynamic_obstacles_at_start,
                )
            )
        activity._motion_constraints = constraints
        activity._motion_constraints_set = set(constraints)

    def _ahead(self, constraint: ActivityWaypoints, start: SE2) -> list[FNode]:
        """Return the waypoints that are left of a motion that has begun, and goes on at ``start``;
        who is to come straight to a dock, and is off the line, comes from before it again.
        """
        mover = constraint.movable.object()
        here = place_of(self.state, self.lives[mover.name])
        *inner, last = constraint.waypoints
        if not (inner and isinstance(here, DriveCells)):
            there = is_same_place(start, last.object().configuration)
            return [last] if there else [*inner, last]
        left, since = [], 0
        stop = self.stops.get(mover.name, (0.0, 0.0))[0]
        for node in inner:
            pose = here.frame.of(tuple(node.object().configuration))
            gaps = np.abs(here.path.natural.poses[since:] - np.asarray(pose))
            gaps[:, 2] = np.abs(np.remainder(gaps[:, 2] + math.pi, math.tau) - math.pi)
            since += int(gaps.max(axis=1).argmin())
            if here.path.natural_s[since] > stop:
                left.append(node)
        goal = tuple(last.object().configuration)
        zones = (mover.motion_parameters or {}).get("zones", ())
        off = any(z.dock and z.binds(goal) and not z.leads_in(tuple(start)) for z in zones)
        if off and not left:
            left = inner[-1:]
        return [*left, last]

    # ------------------------------------------------------------------ fluents

    def _initial(self, target: SchedulingMotionProblem) -> None:
        """Put the effects that have happened into the initial state, and where broken robots are.

        :raises ProblemError: where what has happened breaks the bounds of a fluent.
        """
        self.values.check_bounds()
        for key in self.values.changed:
            arguments = [self._constant(e[1]) for e in key[2:]]
            fluent = target.fluent(key[1])
            target.set_initial_value(fluent(*arguments), self._constant(self.values.before(key)))
        standing = {m.object().name: place for m, place in target.initial_configuration}
        told = {node: name for node, name in _told(target) if self._misled(target, node, name)}
        whose = {n: w for n, w in self.involved.told.items() if w in self.surprise.broken}
        for node, name in {**whose, **told}.items():
            if node.type.is_compatible(standing[name].type):
                self._stands(target, node, standing[name])

    def _misled(self, target: SchedulingMotionProblem, told: FNode, name: str) -> bool:
        """Return whether a fluent tells of an obstacle a place where it neither stands nor is being
        brought: one that it has left, and that its fluent tells until its drive is over.
        """
        aims = [next(p for m, p in target.initial_configuration if m.object().name == name)]
        for activity in target._activities:
            if self.state.phase.get(activity.name) is TaskPhase.RUNNING:
                aims += [goal for who, goal in brought(activity).items() if who == name]
        value = target.initial_value(told)
        return name in self.surprise.broken or not any(_one_place(value, aim) for aim in aims)

    def _stands(self, target: SchedulingMotionProblem, told: FNode, place: FNode) -> None:
        """Let a fluent tell where an object stands now. What has begun where the fluent told a
        place that it was at asks for this one.
        """
        equal, before = self.m.Equals, target.initial_value(told)
        target.set_initial_value(told, place)
        now = equal(told, place)
        instead: dict[Any, Any] = {equal(told, before): now, equal(before, told): now}
        for activity in target._activities:
            if self.state.phase.get(activity.name) is TaskPhase.RUNNING:
                activity._conditions = {
                    span: [node.substitute(instead) for node in nodes]
                    for span, nodes in activity._conditions.items()
                }


def _told(problem: SchedulingMotionProblem) -> Iterator[tuple[FNode, str]]:
    """Yield the fluents that tell where obstacles of motions are, with these."""
    for activity in problem.motion_activities:
        for constraint in activity.motion_constraints:
            for listed in (constraint.static_obstacles, constraint.dynamic_obstacles_at_start):
                for obstacle, value in listed.items() if isinstance(listed, dict) else ():
                    node = told_by(activity.name, obstacle, value)
                    if node.is_fluent_exp() and all(a.is_constant() for a in node.args):
                        yield node, obstacle.name


def _one_place(one: FNode, two: FNode) -> bool:
    """Return whether two expressions are one place for certain."""
    if not (one.is_object_exp() and two.is_object_exp()):
        return bool(one == two)
    a, b = one.object(), two.object()
    return a.type == b.type and is_same_place(a.configuration, b.configuration)
