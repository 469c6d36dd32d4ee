"""What is left of a problem: an ordinary UP problem from now on, with what has begun frozen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from functools import partial
from typing import Any

from unified_planning.model import FNode, TimepointKind
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    SchedulingMotionProblem,
)

from up_samp.execution.begun import begun
from up_samp.execution.build import planned_of
from up_samp.execution.graph import At, Event
from up_samp.execution.involved import Involved
from up_samp.execution.lives import Drive
from up_samp.execution.places import Places
from up_samp.execution.state import Phase, State
from up_samp.execution.substitute import Substitution, later_by, names_in
from up_samp.execution.surprise import Remaining, Surprise, check_names, rest_of_plan
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.values import ValuesNow
from up_samp.io.plan_dict import PlanDict
from up_samp.model import Configuration, ProblemError, UnsupportedError
from up_samp.upio.movers import named_as_planned
from up_samp.upio.whereabouts import whereabouts


def remaining_problem(
    problem: SchedulingMotionProblem,
    plan: PlanDict,
    state: State,
    drives: Mapping[tuple[str, str], Drive],
    surprise: Surprise | None = None,
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
    return _Builder(named, plan, state, drives, surprise or Surprise(), involved).build()


class _Builder:
    def __init__(
        self,
        problem: SchedulingMotionProblem,
        plan: PlanDict,
        state: State,
        drives: Mapping[tuple[str, str], Drive],
        surprise: Surprise,
        involved: Involved,
    ):
        self.involved = involved
        self.source, self.plan, self.state, self.drives = problem, plan, state, drives
        self.surprise = surprise
        self.places = Places(problem, plan, state, drives)
        self.unit = float(plan["seconds_per_unit"])
        self.m = problem.environment.expression_manager
        self.planned = planned_of(problem, plan)
        self.notes: list[str] = []
        check_names(self.surprise, problem, state)
        self.stops = self._stops()
        self.since = math.ceil(max([state.now, *(t for _, t in self.stops.values())]) / self.unit)
        self.gone = self._gone()
        self.surely = {a.name for a in problem.activities if not a.optional}
        self.past = self._past()
        self.values = ValuesNow(self.planned, state, self.unit, self.since, self.gone)

    # ------------------------------------------------------------------ what has happened

    def _stops(self) -> dict[str, tuple[float, float]]:
        """Return where robots under way can stop: progress (m) and when they stand there (s)."""
        found = {}
        for way in self.state.ways.values():
            if self.state.phase[way.activity] is not Phase.RUNNING:
                continue
            if way.object in self.surprise.broken:
                continue
            speed = way.travel.speed_at(way.progress)
            if speed > 0.0:
                speed = max(speed, way.travel.speed_at(way.progress + 0.25))
            brake = speed * speed / (2 * way.travel.accel)
            at = min(way.progress + brake, self.state.until(way), way.length)
            found[way.object] = (at, self.state.now + speed / way.travel.accel)
        return found

    def _gone(self) -> frozenset[str]:
        """Return the activities that cannot happen any more."""
        found = set(self.surprise.cancelled)
        for activity in self.source.activities:
            phase = self.state.phase.get(activity.name, Phase.WAITING)
            if phase is Phase.DONE:
                continue
            if self.surprise.same_choices and activity.name not in self.state.phase:
                found.add(activity.name)
            name = activity.name
            chosen = {
                v
                for k, v in self.planned.values.items()
                if phase is Phase.RUNNING and k.startswith(f"{name}.")
            }
            if any(self.involved.needs(name, r) or r in chosen for r in self.surprise.broken):
                found.add(name)
            if phase is Phase.WAITING and any(
                self.involved.moves(name, d) for d in self.surprise.shut
            ):
                found.add(name)
        return frozenset(found)

    def _past(self) -> dict[str, tuple[int, int | None]]:
        """Return starts and ends that are over (units, rounded down)."""
        found: dict[str, tuple[int, int | None]] = {}
        for name, phase in self.state.phase.items():
            if phase is Phase.WAITING or name in self.gone:
                continue
            start = self.state.fired[Event(At.START, name)]
            end = self.state.fired.get(Event(At.END, name))
            if phase is Phase.DONE and end is not None:
                found[name] = (self._units(start), self._units(end))
        return found

    def _exact(self) -> dict[str, tuple[float, float]]:
        """Return when what is over really started and ended (units)."""
        return {
            name: (
                self.state.fired[Event(At.START, name)] / self.unit,
                self.state.fired[Event(At.END, name)] / self.unit,
            )
            for name in self.past
        }

    def _units(self, seconds: float) -> int:
        return math.floor(seconds / self.unit + 1e-9)

    def _running(self) -> list[str]:
        return [n for n, p in self.state.phase.items() if p is Phase.RUNNING and n not in self.gone]

    # ------------------------------------------------------------------ the new problem

    def build(self) -> Remaining:
        """Return the remaining problem."""
        target = self.source.clone()
        running = set(self._running())
        fix = Substitution(
            self.source.environment,
            self.since,
            self.past,
            self.gone,
            self._known_values(),
            frozenset(running),
            self._exact(),
        )
        target._base._constraints = self._constraints(fix, self.source._base, None)
        self._timed(target._base)
        target._activities, places = [], {}
        for activity in self.source.activities:
            if activity.name in self.past or activity.name in self.gone:
                continue
            copy = (
                begun(activity, self.values, self.source.environment)
                if activity.name in running
                else activity.clone()
            )
            copy._constraints = self._constraints(fix, activity, activity.name)
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

    def _choose(self, target: SchedulingMotionProblem, running: Set[str]) -> None:
        """What has begun keeps what was chosen for it; nothing else chooses a broken robot."""
        for activity in target._activities:
            for parameter in activity.parameters:
                equal = partial(self.m.Equals, self.m.ParameterExp(parameter))
                if activity.name in running and parameter.name in self.planned.values:
                    value = self._constant(self.planned.values[parameter.name])
                    activity.add_constraint(equal(value))
                for name in self.surprise.broken if activity.name not in running else ():
                    robot = self.source.object(name)
                    if parameter.type.is_compatible(robot.type):
                        activity.add_constraint(self.m.Not(equal(self.m.ObjectExp(robot))))

    def _known_values(self) -> dict[str, FNode]:
        """Return the parameters of what is over or has begun, and of the plan's variables."""
        found = {}
        for full, value in self.planned.values.items():
            owner = full.split(".")[0] if "." in full else None
            if owner in self.past:
                found[full] = self._constant(value)
        return found

    def _constant(self, value: Any) -> FNode:
        if isinstance(value, bool):
            return self.m.Bool(value)
        if isinstance(value, int):
            return self.m.Int(value)
        return self.m.ObjectExp(self.source.object(str(value)))

    def _constraints(
        self, fix: Substitution, chronicle: Any, owner: str | None
    ) -> list[tuple[FNode, list[FNode]]]:
        found: list[tuple[FNode, list[FNode]]] = []
        for constraint, scope in chronicle._constraints:
            scopes = [fix(s, False) for s in scope]
            if any(s.is_false() for s in scopes):
                continue
            fixed = fix(constraint)
            if fixed.is_true():
                continue
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
        text = str(constraint)
        text = text if len(text) < 160 else text[:157] + "..."
        names = names_in(constraint)
        cancelled = set(self.surprise.cancelled)
        own = any(
            all(self.involved.needs(name, robot) for name in names)
            for robot in self.surprise.broken
        )
        if not names & self.gone:
            # broken by what has happened: a deadline that is over
            self.notes.append(f"already broken, dropped: {text}")
        elif names & cancelled and names - cancelled <= self.gone | set(self.past):
            self.notes.append(f"about cancelled tasks, dropped: {text}")
        elif own and names <= self.gone | set(self.past):
            self.notes.append(f"about a broken robot alone, dropped: {text}")
        else:
            raise ProblemError(
                f"what is left cannot be done: nothing can keep '{text}' any more; cancel its tasks"
            )

    def _timed(self, base: Any) -> None:
        """Move the problem's own timed conditions and effects to the new clock."""
        effects: dict[Any, Any] = {}
        for timing, items in base.effects.items():
            later = later_by(timing, self.since)
            if timing.timepoint.kind == TimepointKind.GLOBAL_START and later.delay < 0:
                continue  # it has happened
            effects[later] = items
        base._effects = effects
        conditions: dict[Any, Any] = {}
        for span, items in base.conditions.items():
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
        at = {name: progress for name, (progress, _) in self.stops.items()}
        target._initial_configuration = []
        for movable, _ in self.source.initial_configuration:
            name = movable.object().name
            pose, type_ = self.places.of(name, at, self.surprise.broken)
            place = self._place(target, name, pose, type_)
            found[name] = place
            target._initial_configuration.append((movable, self.m.ObjectExp(place)))
        for activity in target._motion_activities:
            if self.state.phase.get(activity.name) is Phase.RUNNING:
                self._go_on(activity, found)
        return found

    def _place(
        self, target: SchedulingMotionProblem, name: str, pose: Configuration, type_: Any
    ) -> ConfigurationObject:
        """Return the configuration object at a pose, a new one where the problem has none."""
        for item in self.source.all_objects:
            if isinstance(item, ConfigurationObject) and item.type == type_:
                there = [float(v) for v in item.configuration]
                turn = math.remainder(there[2] - pose[2], math.tau) if len(pose) == 3 else 0.0
                gap = max(abs(a - b) for a, b in zip(there[:2], pose[:2], strict=True))
                if max(gap, abs(turn)) <= TOLERANCES.place:
                    return item
        base = f"now_{name}"
        fresh, count = base, 0
        while target.has_name(fresh):
            count += 1
            fresh = f"{base}_{count}"
        place = ConfigurationObject(fresh, type_, SE2(*pose))
        target.add_object(place)
        return place

    def _go_on(self, activity: MotionActivity, places: Mapping[str, ConfigurationObject]) -> None:
        constraints = []
        for c in activity._motion_constraints:
            if not isinstance(c, ActivityWaypoints) or len(c.waypoints) != 1:
                raise UnsupportedError(
                    f"'{activity.name}' has begun and has several waypoints: what is left of it "
                    "cannot be said yet"
                )
            who = c.movable.object().name
            constraints.append(
                ActivityWaypoints(
                    c.movable,
                    places[who],
                    c.waypoints,
                    static_obstacles=c.static_obstacles,
                    dynamic_obstacles_at_start=c.dynamic_obstacles_at_start,
                )
            )
        activity._motion_constraints = constraints
        activity._motion_constraints_set = set(constraints)

    # ------------------------------------------------------------------ fluents

    def _initial(self, target: SchedulingMotionProblem) -> None:
        """Put the effects that have happened into the initial state, and where broken robots are.

        :raises ProblemError: where what has happened breaks the bounds of a fluent.
        """
        self.values.check_bounds()
        for key, value in self.values.changed.items():
            arguments = [self._constant(e[1]) for e in key[2:]]
            fluent = target.fluent(key[1])
            target.set_initial_value(fluent(*arguments), self._constant(value))
        standing = {m.object().name: place for m, place in target.initial_configuration}
        for told, name in self.involved.told.items():
            if name in self.surprise.broken and told.type.is_compatible(standing[name].type):
                target.set_initial_value(told, standing[name])
