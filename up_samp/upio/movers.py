"""Activities whose moved object is a parameter: one activity for each object, and plans back; which
fluents tell where objects are; who needs whom.

"Some robot fetches the pallet" is one activity with a parameter for the robot. Motions are planned
for one body each, so the problem that is solved has, beside such an activity, an optional one for
each object that the parameter may be, with the motions and all that is said of the object. It is
there if and only if the parameter is that object, and lasts as long.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unified_planning.model import (
    Effect,
    Fluent,
    FNode,
    Object,
    Parameter,
    TimeInterval,
    Timepoint,
    Timing,
)
from unified_planning.model.motion import (
    ActivityWaypoints,
    MotionActivity,
    MovableObject,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.model import ProblemError, UnsupportedError
from up_samp.upio.expressions import (
    activities_in,
    conditions_of,
    constraints_of,
    effects_of,
    rewritten,
    walk,
    with_parameter,
)
from up_samp.upio.objective import check_copied
from up_samp.upio.plan import SampSchedule
from up_samp.upio.read_maps import MOST_MOVERS


@dataclass(frozen=True)
class Settled:
    """A problem whose motions move objects that are named. ``copies`` tell each added activity's
    name and that of the original one it stands for.
    """

    original: SchedulingMotionProblem
    problem: SchedulingMotionProblem
    copies: Mapping[str, str]

    def back(self, plan: SampSchedule) -> SampSchedule:
        """Return a plan of ``problem`` as one of the original."""
        there = {a.name: a for a in plan.activities}
        activities = [a for a in self.original.activities if a.name in there]
        assignment = {}
        for activity in activities:
            for variable in (activity.start, activity.end, *activity.parameters):
                assignment[variable] = plan.get(variable)
        for variable in self.original.base_variables:
            assignment[variable] = plan.get(variable)
        paths = {}
        for (moved, constraint), path in plan.motion_paths.items():
            index = moved.motion_constraints.index(constraint)
            activity = self.original.get_activity(self.copies.get(moved.name, moved.name))
            paths[activity, activity.motion_constraints[index]] = path
        trajectories = {self._key(key): t for key, t in plan.trajectories.items()}
        back = SampSchedule(
            activities,
            assignment,
            paths,
            trajectories,
            self.original.environment,
            plan.seconds_per_unit,
        )
        back.margin = plan.margin
        return back

    def _key(self, key: str) -> str:
        """Return the name of a trajectory, which may be that of an activity's further motion."""
        if key in self.copies:
            return self.copies[key]
        name, mark, index = key.rpartition("#")
        return f"{self.copies[name]}{mark}{index}" if name in self.copies else key


def settle_movers(problem: SchedulingMotionProblem) -> Settled | None:
    """Return the problem with named objects in all motions (None: it has no others).

    :raises UnsupportedError: where there would be too many activities.
    """
    choosing = {a.name: found for a in problem.motion_activities if (found := movers(a))}
    if not choosing:
        return None
    check_copied(problem)
    settled = problem.clone()
    names = {a.name for a in problem.activities}
    copies: dict[str, str] = {}
    activities: list[Activity] = []
    for activity in problem.activities:
        parameters = choosing.get(activity.name)
        if parameters is None:
            activities.append(next(a for a in settled._activities if a.name == activity.name))
            continue
        activities.append(_without_motions(activity, parameters))
        mine = []
        for chosen in _choices(problem, activity, parameters):
            copy = _copy(activity, _fresh(activity, chosen, names), chosen)
            copies[copy.name] = activity.name
            mine.append((copy, chosen))
        activities += [copy for copy, _ in mine]
        _tie(settled, activity, mine)
    settled._activities[:] = activities
    settled._motion_activities[:] = [a for a in activities if isinstance(a, MotionActivity)]
    return Settled(problem, settled, copies)


def named_as_planned(problem: SchedulingProblem, plan: Mapping[str, Any]) -> SchedulingProblem:
    """Return the problem with the objects that a plan (a dictionary, ``docs/plan-format.md``) has
    chosen named in its motions; activities that the plan leaves out move nothing. It is the problem
    itself where no parameter says what moves.
    """
    choosing = {a.name: movers(a) for a in getattr(problem, "motion_activities", ())}
    if not any(choosing.values()):
        return problem
    given = {e["name"]: e.get("parameters", {}) for e in plan["activities"]}
    named = problem.clone()
    for k, activity in enumerate(problem.activities):
        parameters = choosing.get(activity.name)
        if not parameters:
            continue
        there = activity.name in given
        chosen = {
            p: _chosen(problem, activity, p, given[activity.name]) for p in parameters if there
        }
        kept = _copy(activity, activity.name, chosen, whole=True)
        if not chosen:
            kept.clear_motion_constraints()
            kept.clear_motion_effects()
        named._activities[k] = kept
    named._motion_activities[:] = [a for a in named._activities if isinstance(a, MotionActivity)]
    return named


def _chosen(problem: Any, activity: Activity, parameter: Parameter, values: Any) -> Object:
    own = parameter.name.removeprefix(f"{activity.name}.")
    value = values.get(own)
    chosen = problem.object(value) if isinstance(value, str) and problem.has_object(value) else None
    if not isinstance(chosen, MovableObject) or not parameter.type.is_compatible(chosen.type):
        raise ProblemError(
            f"the plan gives the parameter '{own}' of activity '{activity.name}' no object "
            "that moves"
        )
    return chosen


def movers(activity: MotionActivity) -> list[Parameter]:
    """Return the activity's own parameters that say which objects it moves."""
    moved = [c.movable for c in activity.motion_constraints if isinstance(c, ActivityWaypoints)]
    named = [e.parameter() for e in (*moved, *activity.motion_effects) if e.is_parameter_exp()]
    return [p for p in dict.fromkeys(named) if p in activity.parameters]


def _choices(
    problem: SchedulingMotionProblem, activity: MotionActivity, parameters: list[Parameter]
) -> Iterator[dict[Parameter, Object]]:
    """Yield what the parameters may be, together."""
    domains = [
        [o for o in problem.objects(p.type) if isinstance(o, MovableObject)] for p in parameters
    ]
    empty = [p.name for p, domain in zip(parameters, domains, strict=True) if not domain]
    if empty:
        raise UnsupportedError(f"there is no movable object for '{empty[0]}'")
    size = math.prod(map(len, domains))
    if size > MOST_MOVERS:
        raise UnsupportedError(
            f"activity '{activity.name}' may move {size} different choices of objects, more than "
            f"{MOST_MOVERS}: name the objects that take part"
        )
    for chosen in itertools.product(*domains):
        yield dict(zip(parameters, chosen, strict=True))


def _fresh(activity: MotionActivity, chosen: Mapping[Parameter, Object], names: set[str]) -> str:
    name = f"{activity.name}({', '.join(o.name for o in chosen.values())})"
    while name in names:
        name += "_"
    names.add(name)
    return name


class _PutMover:
    """Puts objects in place of the parameters that name them, and a copy in its original's."""

    def __init__(self, activity: MotionActivity, name: str, chosen: Mapping[Parameter, Object]):
        self.activity, self.name = activity, name
        manager = activity._environment.expression_manager
        self._others: dict[FNode, FNode] = {}
        self._values = {manager.ParameterExp(p): manager.ObjectExp(o) for p, o in chosen.items()}

    def __call__(self, node: FNode) -> FNode:
        """Return an expression over objects."""
        return node.substitute({**self._values, **self._others})

    def also(self, parameter: Parameter, other: Parameter) -> None:
        """Put a parameter in place of another one, where objects are put as well."""
        manager = self.activity._environment.expression_manager
        self._others[manager.ParameterExp(parameter)] = manager.ParameterExp(other)

    def speaks(self, *nodes: FNode) -> bool:
        """Return whether some expression speaks of the parameters."""
        return any(node.substitute(self._values) != node for node in nodes)

    def timing(self, timing: Timing) -> Timing:
        """Return a time of the copy for one of the activity."""
        point = timing.timepoint
        if point.container != self.activity.name:
            return timing
        return Timing(timing.delay, Timepoint(point.kind, self.name))

    def span(self, span: TimeInterval) -> TimeInterval:
        """Return an interval of the copy for one of the activity."""
        ends = self.timing(span.lower), self.timing(span.upper)
        return TimeInterval(*ends, span.is_left_open(), span.is_right_open())

    def motion(self, constraint: Any) -> Any:
        """Return a motion constraint of the copy for one of the activity."""
        if not isinstance(constraint, ActivityWaypoints):
            return constraint
        return ActivityWaypoints(
            self(constraint.movable),
            self(constraint.starting),
            [*map(self, constraint.waypoints)],
            self._obstacles(constraint.static_obstacles),
            self._obstacles(constraint.dynamic_obstacles_at_start),
            self.activity._environment,
        )

    def _obstacles(self, given: Any) -> Any:
        """Return obstacles as a constraint lists them: by fluents, or without."""
        if not isinstance(given, dict):
            return given
        return {o: self(e) if isinstance(e, FNode) else e for o, e in given.items()}


def _without_motions(activity: MotionActivity, parameters: list[Parameter]) -> Activity:
    """Return the activity without its motions, and without what is said of what it moves."""
    plain = Activity(activity.name, 1, activity.optional, _env=activity._environment)
    plain._set_duration_constraint(activity.duration)
    plain._parameters.update(activity._parameters)
    plain._constraints += activity._constraints
    # any object shows what speaks of them
    stand_in = {p: Object("?", p.type, activity._environment) for p in parameters}
    put = _PutMover(activity, activity.name, stand_in)
    _say(activity, plain, put, lambda *nodes: not put.speaks(*nodes))
    return plain


def _say(activity: Activity, other: Activity, put: _PutMover, wanted: Callable[..., bool]) -> None:
    """Give another activity the conditions and effects that are ``wanted``, with objects put in."""
    for span, conditions in conditions_of(activity).items():
        mine = [put(c) for c in conditions if wanted(c)]
        if mine:
            other._conditions[put.span(span)] = mine
    for timing, effect in effects_of(activity):
        spoken = effect.fluent, effect.value, effect.condition
        if wanted(*spoken):
            said = Effect(*map(put, spoken), effect.kind, effect.forall)
            other._add_effect_instance(put.timing(timing), said)


def _copy(
    activity: MotionActivity, name: str, chosen: Mapping[Parameter, Object], *, whole: bool = False
) -> MotionActivity:
    """Return the activity of one choice: its motions, and what is said of what it moves (all that
    is said, if ``whole``).
    """
    put = _PutMover(activity, name, chosen)
    copy = MotionActivity(name, 1, activity.optional or not whole, _env=activity._environment)
    if whole:
        copy._parameters.update(activity._parameters)
        copy._constraints += activity._constraints
    else:
        for parameter in activity.parameters:
            if parameter not in chosen:
                own = parameter.name.removeprefix(f"{activity.name}.")
                put.also(parameter, with_parameter(copy, own, parameter.type))
    copy._set_duration_constraint(rewritten(activity.duration, put))
    _say(activity, copy, put, lambda *nodes: whole or put.speaks(*nodes))
    for constraint in activity.motion_constraints:
        copy.add_motion_constraint(put.motion(constraint))
    for movable, place in activity.motion_effects.items():
        copy.add_motion_effect(put(movable), put(place))
    return copy


def _tie(
    problem: SchedulingMotionProblem,
    activity: MotionActivity,
    copies: list[tuple[MotionActivity, dict[Parameter, Object]]],
) -> None:
    """Say that the copy of what was chosen is there, when the activity is, and no other."""
    manager = problem.environment.expression_manager
    here = [manager.auto_promote(activity.present)[0]] if activity.optional else []
    presences = []
    for copy, chosen in copies:
        present = manager.auto_promote(copy.present)[0]
        values = [
            manager.Equals(manager.ParameterExp(p), manager.ObjectExp(o)) for p, o in chosen.items()
        ]
        problem.add_constraint(manager.Iff(present, manager.And(*here, *values)))
        same = [(copy.start, activity.start), (copy.end, activity.end)]
        rest = [p for p in activity.parameters if p not in chosen]
        same += [
            tuple(map(manager.ParameterExp, pair))
            for pair in zip(copy.parameters, rest, strict=True)
        ]
        for mine, its in same:
            one, other = manager.auto_promote(mine, its)
            alike = manager.Iff if one.type.is_bool_type() else manager.Equals
            problem.add_constraint(alike(one, other), scope=[copy.present])
        presences.append(present)
    # said once more, as it is recognised best
    problem.add_constraint(manager.Or(*presences, *(manager.Not(h) for h in here)))
    for one, other in itertools.combinations(presences, 2):
        problem.add_constraint(manager.Or(manager.Not(one), manager.Not(other)))


# ------------------ Which fluents tell where objects are, however a problem writes it
# Sites write ``robot_at(r0)``, ``r0_at`` or ``at_3``, drives that end at a parameter, and values
# that mean "on the road" while a robot drives. What they have in common: only what moves an object
# sets the fluent, and each drive sets it to where the drive ends.


def whereabouts(problem: SchedulingMotionProblem) -> Mapping[FNode, str]:
    """Return the ground fluents that tell where an object is, with its name.

    Assumed of each: effects of activities alone set it, all of them move the object, and each sets
    it to the configuration that it brings the object to (beside other values, perhaps).
    """
    settled = settle_movers(problem)
    source = problem if settled is None else settled.problem
    assigned, loose = changes_of(source)
    reached = {activity.name: brought(activity) for activity in source.activities}
    found: dict[FNode, str] = {}
    for fluent, changes in assigned.items():
        set_to: dict[str, set[FNode]] = {activity.name: set() for activity, _, _ in changes}
        for activity, _, effect in changes:
            if effect.is_assignment() and effect.condition.is_true():
                set_to[activity.name].add(effect.value)
        # of each activity that sets it the objects that it brings to where it sets it
        told = [{o for o, at in reached[n].items() if at in values} for n, values in set_to.items()]
        whose = set[str]().union(*told)
        if fluent.fluent() not in loose and len(whose) == 1 and all(told):
            (found[fluent],) = whose
    return found


FluentChanges = dict[FNode, list[tuple[Activity, Timing, Effect]]]
"""Fluent expression -> what activities do to it, and when."""


def changes_of(problem: SchedulingProblem) -> tuple[FluentChanges, frozenset[Fluent]]:
    """Return what activities change, and the fluents that something sets without an activity, or
    with arguments that are decided.
    """
    found: FluentChanges = {}
    loose = set()
    for timing, effect, activity in problem.all_effects():
        if activity is None or not all(a.is_constant() for a in effect.fluent.args):
            loose.add(effect.fluent.fluent())
        if activity is not None:
            found.setdefault(effect.fluent, []).append((activity, timing, effect))
    return found, frozenset(loose)


def brought(activity: Activity) -> dict[str, FNode]:
    """Return the objects that an activity moves, with the configurations that it brings them to."""
    if not isinstance(activity, MotionActivity):
        return {}
    return {m.object().name: goal for m, goal in _moved(activity) if m.is_object_exp()}


def _moved(activity: MotionActivity) -> Iterator[tuple[FNode, FNode]]:
    told = (c for c in activity.motion_constraints if isinstance(c, ActivityWaypoints))
    yield from ((c.movable, c.waypoints[-1]) for c in told)
    yield from activity.motion_effects.items()


# ------------------ Who needs whom


class Involved:
    """Who needs whom in a problem. An activity needs an object if

    - it moves it, or a condition or effect of it speaks of it;
    - a condition or effect of it speaks of a fluent that tells where the object is;
    - it takes at its start what every drive of the object takes, and no other object's drive;
    - it is kept apart from every drive of the object, pair by pair, and so of no other object.

    Names of activities say nothing. ``told`` are the fluents that tell where objects are.
    """

    def __init__(self, problem: SchedulingMotionProblem, told: Mapping[FNode, str]) -> None:
        self.told = told
        self.moved = {a.name: frozenset(brought(a)) for a in problem.activities}
        self._of = {
            a.name: {*self.moved[a.name], *(who for n in _mentions(a) for who in self.about(n))}
            for a in problem.activities
        }
        drives: dict[str, set[str]] = {}
        for activity in problem.motion_activities:
            for constraint in activity.motion_constraints:
                for who in self.moved[activity.name] & _objects(constraint.movable):
                    drives.setdefault(who, set()).add(activity.name)
        driving = set().union(*drives.values())
        for takers in _takers(problem).values():
            whole = _whole(takers, drives)
            others = [d for d in drives if d not in whole and drives[d] & takers]
            for name in takers - driving if len(whole) == 1 and not others else ():
                self._of[name] |= whole
        for name, rivals in _rivals(problem).items():
            whole = _whole(rivals, drives)
            if name not in driving and len(whole) == 1:
                self._of[name] |= whole

    def needs(self, activity: str, name: str) -> bool:
        """Return whether an activity needs an object."""
        return name in self._of.get(activity, ())

    def moves(self, activity: str, name: str) -> bool:
        """Return whether an activity drives an object or puts it elsewhere."""
        return name in self.moved.get(activity, ())

    def about(self, node: FNode) -> frozenset[str]:
        """Return the movable objects that an expression speaks of, or of whose whereabouts."""
        return _objects(node) | {self.told[n] for n in walk(node) if n in self.told}


def _mentions(activity: Activity) -> Iterator[FNode]:
    for nodes in activity.conditions.values():
        yield from nodes
    yield from (effect.fluent for _, effect in effects_of(activity))


def _objects(node: FNode) -> frozenset[str]:
    objects = (n.object() for n in walk(node) if n.is_object_exp())
    return frozenset(o.name for o in objects if isinstance(o, MovableObject))


def _takers(problem: SchedulingMotionProblem) -> dict[FNode, set[str]]:
    """Return which activities change a fluent as they start."""
    found: dict[FNode, set[str]] = {}
    for activity in problem.activities:
        for timing, effect in effects_of(activity):
            if timing.is_from_start():
                found.setdefault(effect.fluent, set()).add(activity.name)
    return found


def _rivals(problem: SchedulingMotionProblem) -> dict[str, set[str]]:
    """Return by activity those that are kept apart from it, by a constraint on just the two that
    speaks of the start and the end of both.
    """
    found: dict[str, set[str]] = {}
    for owner, constraint, _ in constraints_of(problem):
        pair = activities_in(constraint) | ({owner} if owner else set())
        points = {
            (n.timing().timepoint.container or owner, n.timing().is_from_start())
            for n in walk(constraint)
            if n.is_timing_exp()
        }
        if len(pair) == 2 and len(points) == 4:
            for name in pair:
                found.setdefault(name, {name}).update(pair)
    return found


def _whole(members: set[str], drives: Mapping[str, set[str]]) -> set[str]:
    """Return the objects of which every drive is among some activities."""
    return {who for who, mine in drives.items() if mine <= members}
