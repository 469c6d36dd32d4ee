"""Write the relaxation: the scheduling problem that remains when nothing is known of motions.

Motion activities become plain ones, configurations plain objects. So that trajectories can be
continuous (Definition 9.3), each object that changes its configuration has a state: an
object-valued fluent that its motions need at their start and set in the end. Where one of the
problem's own fluents does just that already (``robot_at``), it serves, if it is set at the
motions' ends or a unit *early*. A state of our own is set a unit early, if all that set it last
that long: an effect at t is seen from t + 1 on, so that motions of one object may touch. Where it
is set at their ends, motions need it right after their starts, for the same reason; what else the
problem itself asks of its fluent at their starts stays as it is.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from functools import partial

from unified_planning.model import Effect, FNode, Timing
from unified_planning.model.mixins.timed_conds_effs import TimedCondsEffs
from unified_planning.model.motion import MotionActivity, SchedulingMotionProblem
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.model.scheduling.chronicle import Chronicle
from unified_planning.model.timing import (
    OpenTimeInterval,
    RightOpenTimeInterval,
    TimePointInterval,
)

from up_samp.model import ProblemError, UnsupportedError, check_time
from up_samp.model.snapshot import ChangeTask, MotionTask, Snapshot, Term, TermKind
from up_samp.upio.expressions import (
    at_start,
    closed,
    conditions_of,
    effects_of,
    inner,
    nothing_but_an_instant,
    own_end,
    rewritten,
    told_by,
    whole,
)
from up_samp.upio.objective import objective_of, only_makespan
from up_samp.upio.relaxation import Relaxation, Rewriter, choose, named_fluent, told_fluents


def copy_state(
    problem: SchedulingMotionProblem, plain: SchedulingProblem, rewriter: Rewriter
) -> None:
    """Copy settings, objects, fluents and initial values."""
    plain.epsilon = problem.epsilon
    plain.discrete_time = problem.discrete_time
    plain.self_overlapping = problem.self_overlapping
    for obj in problem.all_objects:
        plain.add_object(rewriter.object(obj))
    defaults = problem.fluents_defaults
    for fluent in problem.fluents:
        value = defaults.get(fluent)
        plain.add_fluent(
            rewriter.fluent(fluent),
            default_initial_value=None if value is None else rewriter(value),
        )
    for fluent_exp, value in problem.explicit_initial_values.items():
        plain.set_initial_value(rewriter(fluent_exp), rewriter(value))


def check_fluents(problem: SchedulingMotionProblem, rewriter: Rewriter) -> None:
    """Raise where a fluent is used that the problem does not have, or that never has a value: no
    schedule would fit it.
    """
    known = set(problem.fluents)
    stray = sorted(f.name for f in rewriter.fluents if f not in known)
    if stray:
        raise ProblemError(
            f"the fluent '{stray[0]}' is used, but it is not in the problem (add it with "
            "problem.add_fluent, or add_resource)"
        )
    given = {f for f, value in problem.fluents_defaults.items() if value is not None}
    given |= {e.fluent() for e in problem.explicit_initial_values}
    given |= {effect.fluent.fluent() for _, effect, _ in problem.all_effects()}
    empty = sorted(f.name for f in rewriter.fluents if f not in given)
    if empty:
        raise ProblemError(f"the fluent '{empty[0]}' has no initial value, and nothing sets it")


def copy_chronicle(source: Chronicle, target: Chronicle, rewriter: Rewriter) -> None:
    """Copy parameters, constraints, conditions and effects of an activity, or of the problem."""
    for name, parameter in source._parameters.items():
        target._parameters[name] = rewriter.parameter(parameter)
    for constraint, scope in source._constraints:
        target._constraints.append((rewriter(constraint), [rewriter(s) for s in scope]))
    _copy_timed(source, target, rewriter)


def _copy_timed(source: TimedCondsEffs, target: TimedCondsEffs, rewriter: Rewriter) -> None:
    for span, conditions in conditions_of(source).items():
        same = target._conditions.setdefault(span, [])
        same += [c for c in map(rewriter, conditions) if c not in same]
    for timing, effect in effects_of(source):
        target._add_effect_instance(timing, rewriter.effect(effect))
    if source._simulated_effects:
        raise UnsupportedError("simulated effects are not supported in scheduling problems")


_ANYWHERE = "samp_anywhere"
"""Plain type of all configurations, on whatever map."""


def relax(problem: SchedulingMotionProblem, snapshot: Snapshot) -> Relaxation:
    """Return the relaxation of ``problem``; neither it nor its parts are shared with it."""
    lifts = _lifted(snapshot)
    types = problem.environment.type_manager
    rewriter = Rewriter(problem.environment, types.UserType(_ANYWHERE) if lifts else None)
    plain = SchedulingProblem(problem.name, problem.environment)
    copy_state(problem, plain, rewriter)
    copy_chronicle(problem._base, plain._base, rewriter)
    for activity in problem.activities:
        copy = Activity(activity.name, 1, activity.optional, _env=problem.environment)
        copy_chronicle(activity, copy, rewriter)
        copy._set_duration_constraint(rewritten(activity.duration, rewriter))
        plain._activities.append(copy)
    if problem.quality_metrics and only_makespan(problem):
        plain.add_quality_metric(problem.quality_metrics[0])
    elif (objective := objective_of(problem)) is not None:
        plain.add_quality_metric(objective.rewritten(rewriter))
    told = {str(e): rewriter(e) for e in told_fluents(problem)}
    check_fluents(problem, rewriter)
    relaxation = Relaxation(plain, snapshot, rewriter, {}, told_fluents=told)
    lasting = find_lasting(relaxation)
    for name in sorted(snapshot.moved()):
        _add_state(relaxation, name, lasting)
    _agree_at_end(problem, relaxation)
    drives = _drives_of(snapshot)
    for task in snapshot.tasks:
        _hold_static(relaxation, task, drives)
    for activity in problem.activities:
        if isinstance(activity, MotionActivity):
            hold_told(relaxation, activity)
    return relaxation


def _add_state(relaxation: Relaxation, name: str, lasting: frozenset[str]) -> None:
    """Give object ``name`` a state fluent and tie its motions to it; those in ``lasting`` surely
    last a unit.
    """
    snapshot = relaxation.snapshot
    # who rides is moved like who drives: it has to be where it is taken from
    rides = (r for r in snapshot.rides if r.load == name)
    tasks = [
        *snapshot.by_object.get(name, ()),
        *(MotionTask(r.activity, 0, name, (r.origin, r.goal)) for r in rides),
    ]
    changes = [c for c in snapshot.changes if c.object == name]
    early = int(lasting.issuperset(snapshot.movers[name]))
    own, early = _tracking_fluent(relaxation, name, tasks, changes, early)
    state = own if own is not None else _new_state(relaxation, name)
    relaxation.state[name] = state
    relaxation.early[name] = early
    decided = any(t.kind is not TermKind.CONSTANT for task in tasks for t in task.terms)
    equal = partial(_one_place, relaxation) if decided else relaxation.manager.Equals
    for task in tasks:
        activity = relaxation.activities[task.activity]
        first, *others = task.terms
        # reading the state also keeps others from moving the object meanwhile
        start = choose(relaxation, activity, first, state=state)
        via = [choose(relaxation, activity, term) for term in others]
        # what the problem reads at the very start, nobody changes then
        told = own is not None and (
            (
                first.kind is TermKind.FLUENT
                and named_fluent(relaxation, activity, first.name) == own
            )
            or _reads(activity, own)
        )
        span = closed(activity) if told and not early else whole(activity, early)
        there = equal(state, start)
        activity.add_condition(span, there)
        if not (told or early or task.activity in lasting):
            activity.add_condition(nothing_but_an_instant(activity), there)
        if own is None:
            activity.add_effect(Timing(-early, activity.end), state, via[-1])
    for change in changes:
        activity = relaxation.activities[change.activity]
        goal = choose(relaxation, activity, change.term, at_end=True)
        if own is None:
            activity.add_effect(Timing(-early, activity.end), state, goal)


def _one_place(relaxation: Relaxation, one: FNode, other: FNode) -> FNode:
    """Return that two expressions for configurations are of one pose: by one name, or by two names
    for it.
    """
    manager = relaxation.manager
    ways = [manager.Equals(one, other)]
    for names in dict.fromkeys(relaxation.snapshot.alike.values()):
        places = [relaxation.place(name) for name in names]
        if places[0].type not in (one.type, other.type):
            continue  # on another map
        sides = [
            manager.Bool(side in places)
            if side.is_object_exp()
            else manager.Or([manager.Equals(side, p) for p in places])
            for side in (one, other)
        ]
        ways.append(manager.And(sides))
    return manager.Or(ways).simplify()


def _reads(activity: Activity, state: FNode) -> bool:
    """Return whether the problem itself reads a state at an activity's very start."""
    return any(
        own_end(span.lower, activity) == (False, 0)
        and not span.is_left_open()
        and any(state in condition.args for condition in conditions)
        for span, conditions in activity.conditions.items()
    )


def _agree_at_end(problem: SchedulingMotionProblem, relaxation: Relaxation) -> None:
    """A fluent that names a drive's goal is read at its start, and again at its end by a motion
    effect that repeats it: it must say the same.
    """
    driven = {(t.activity, t.object): t.terms[-1] for t in relaxation.snapshot.tasks}
    for activity in problem.activities:
        if not isinstance(activity, MotionActivity):
            continue
        mine = relaxation.activities[activity.name]
        for movable, value in activity.motion_effects.items():
            term = driven.get((activity.name, movable.object().name))
            if term is not None and term.kind is TermKind.FLUENT:
                goal = choose(relaxation, mine, term)
                same = relaxation.manager.Equals(relaxation.rewriter(value), goal)
                mine.add_condition(TimePointInterval(Timing(0, mine.end)), same)


def _drives_of(snapshot: Snapshot) -> dict[str, list[str]]:
    """Return the activities that drive each object, or take it along."""
    found: dict[str, list[str]] = {}
    for task in snapshot.tasks:
        for name in sorted(task.moved):
            found.setdefault(name, []).append(task.activity)
    return found


def _hold_static(relaxation: Relaxation, task: MotionTask, drives: Mapping[str, list[str]]) -> None:
    """Keep a task's static obstacles where they are while it lasts (UP: they "remain static").

    Its ends are left out: a change at the very start or end does no harm. A condition that reads
    an object's state, whatever it is, keeps the activities apart that would change it; those that
    drive the object, whose state changes only at their end, are kept apart by constraints.
    """
    manager = relaxation.manager
    activity = relaxation.activities[task.activity]
    for name in sorted(task.static or ()):
        if name not in relaxation.state:
            continue
        check_time()
        state = relaxation.state[name]
        span = inner(activity, relaxation.early[name])
        activity.add_condition(span, manager.Equals(state, state))
        for other in drives.get(name, ()):
            if other != task.activity:
                rival = relaxation.activities[other]
                apart = manager.Or(
                    manager.LE(rival.end, activity.start),
                    manager.LE(activity.end, rival.start),
                )
                relaxation.constrain(apart, activity, rival)


def _new_state(relaxation: Relaxation, name: str) -> FNode:
    problem = relaxation.problem
    place = problem.object(relaxation.snapshot.initial[name])
    lifted = name in _lifted(relaxation.snapshot)
    tpe = relaxation.rewriter.above if lifted else place.type
    fluent = problem.add_fluent(f"samp_at_{name}", tpe, default_initial_value=place)
    return fluent()


def _lifted(snapshot: Snapshot) -> frozenset[str]:
    """Return the objects that motion effects may take to another map."""
    if len(snapshot.maps) < 2:
        return frozenset()
    maps: dict[str, set[int | None]] = {}
    for name, place in snapshot.initial.items():
        maps[name] = {snapshot.map_of[place]}
    for task in snapshot.tasks:
        maps[task.object].add(task.map)
    put = [(c.object, c.term) for c in snapshot.changes]
    put += [(r.load, r.goal) for r in snapshot.rides]
    for name, term in put:
        known = term.kind is TermKind.CONSTANT
        maps[name].add(snapshot.map_of[term.name] if known else None)
    return frozenset(name for name, found in maps.items() if len(found) > 1)


def _tracking_fluent(
    relaxation: Relaxation,
    name: str,
    tasks: list[MotionTask],
    changes: list[ChangeTask],
    early: int,
) -> tuple[FNode | None, int]:
    """Return a fluent of the problem that already tells where ``name`` is, if there is one, and
    how many units before the ends of what moves the object its state is set.

    It must start at the object's initial configuration and be assigned by just the activities that
    move the object, ``early`` units before their ends or else at these, to just the values that the
    motions lead to.
    """
    problem = relaxation.problem
    goals = {t.activity: t.terms[-1] for t in tasks} | {c.activity: c.term for c in changes}
    initial = problem.object(relaxation.snapshot.initial[name])
    # a fluent tells the names that the problem has, not the one that stands for several here
    values = {} if name in relaxation.snapshot.renamed else relaxation.given_values
    begun = [e for e, v in values.items() if v.is_object_exp() and v.object() == initial]
    set_by, loose = relaxation.given_changes
    for units, expression in itertools.product(dict.fromkeys((early, 0)), begun):
        told = [
            (a.name, _term(effect) if timing == Timing(-units, a.end) else None)
            for a, timing, effect in set_by.get(expression, ())
        ]
        known = expression.fluent() not in loose and len(told) == len(goals)
        if known and dict(told) == goals:
            return expression, units
    return None, early


def _term(effect: Effect) -> Term | None:
    """Return what an effect surely sets a fluent to, if that is a name."""
    if not effect.is_assignment() or effect.is_conditional():
        return None
    if effect.value.is_object_exp():
        return Term(TermKind.CONSTANT, effect.value.object().name)
    if effect.value.is_parameter_exp():
        return Term(TermKind.PARAMETER, effect.value.parameter().name)
    return None


# ---------------------------------------------------------------- who surely lasts a unit or more


def find_lasting(relaxation: Relaxation) -> frozenset[str]:
    """Return the activities that last a unit or more, of those that move objects: their durations
    say so, or they drive something to another pose, which takes time. Where only the latter is
    the case, it is stated, too.
    """
    snapshot = relaxation.snapshot
    movers = snapshot.by_activity.keys() | {c.activity for c in snapshot.changes}
    long = {name for name in movers if _lasts(relaxation, name)}
    drives = {t.activity for t in snapshot.tasks if _leads_away(snapshot, t)} - long
    for name in sorted(drives):
        activity = relaxation.activities[name]
        later = relaxation.manager.Plus(activity.start, 1)
        activity.add_constraint(relaxation.manager.LE(later, activity.end))
    return frozenset(long | drives)


def _lasts(relaxation: Relaxation, name: str) -> bool:
    duration = relaxation.activities[name].duration
    return _least(relaxation, duration.lower) + duration.is_left_open() >= 1


def _least(relaxation: Relaxation, node: FNode) -> int:
    """Return a whole number that an expression for a duration is never below (0: not known)."""
    if node.is_int_constant() or node.is_real_constant():
        return max(0, math.ceil(node.constant_value()))
    if node.is_plus():
        return sum(_least(relaxation, part) for part in node.args)
    if node.is_parameter_exp():
        bound = node.parameter().type.lower_bound
        return 0 if bound is None else max(0, int(bound))
    if node.is_fluent_exp() and node.fluent() not in relaxation.given_effects:
        values = [v for f, v in relaxation.given_values.items() if f.fluent() == node.fluent()]
        return min((_least(relaxation, v) for v in values), default=0)
    return 0


def _leads_away(snapshot: Snapshot, task: MotionTask) -> bool:
    """Return whether a drive surely comes to another pose than that from which it starts."""
    return any(
        a.kind is b.kind is TermKind.CONSTANT
        and snapshot.configurations[a.name] != snapshot.configurations[b.name]
        for a, b in itertools.pairwise(task.terms)
    )


# ---------------------------------------------------------------- obstacles given by fluents
# A static obstacle rests at its fluent's value all through a motion. Where the fluent is the
# object's state and is set a unit early, the two agree at every instant. Where it is set at the end
# of what moves the object, they differ for one instant, and the motion must not start just then.
# Any other fluent is compared with the state at the motion's start, and stays until its end.
# Dynamic obstacles' fluents ask nothing more (``docs/semantics.md``, rule 19).


def hold_told(relaxation: Relaxation, source: MotionActivity) -> None:
    """State for a motion activity of the problem what its static obstacles' fluents ask."""
    activity = relaxation.activities[source.name]
    for constraint in source.motion_constraints:
        told = constraint.static_obstacles
        if not isinstance(told, dict):
            continue
        for movable, value in told.items():
            node = told_by(source.name, movable, value)
            _hold(relaxation, activity, movable.name, relaxation.rewriter(node))


def _hold(relaxation: Relaxation, activity: Activity, name: str, told: FNode) -> None:
    state, initial = relaxation.state.get(name), relaxation.snapshot.initial.get(name)
    late = state is not None and not relaxation.early[name]
    if told == state:
        if late:
            _not_just_set(relaxation, activity, name)
        return
    if initial is None:
        return
    place = relaxation.place(initial) if state is None else state
    equal = _one_place(relaxation, told, place)
    span = RightOpenTimeInterval(Timing(0, activity.start), Timing(-1, activity.end))
    if late:
        # the state tells a unit late what happens right at the start; the fluent stays then
        activity.add_condition(at_start(activity), relaxation.manager.Equals(told, told))
        span = OpenTimeInterval(Timing(0, activity.start), Timing(-1, activity.end))
    else:
        activity.add_condition(at_start(activity), equal)
    activity.add_condition(span, equal)


def _not_just_set(relaxation: Relaxation, activity: Activity, name: str) -> None:
    """Let ``activity`` not start at the very instant at which the object is set elsewhere."""
    manager = relaxation.manager
    snapshot = relaxation.snapshot
    for other in sorted(snapshot.movers[name] - {activity.name}):
        rival = relaxation.activities[other]
        apart = manager.Or(
            manager.LT(rival.end, activity.start),
            manager.LT(activity.start, rival.end),
        )
        relaxation.constrain(apart, activity, rival)
