"""One meaning, listed in another order and under other names: UP problems and fleets.

What a seed changes: the order of activities, parameters, constraints and their scopes, conditions,
effects, objects, fluents and their parameters, initial values, motion constraints and effects,
obstacles, corners of outlines; the operands of what is commutative; and all names.
"""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from unified_planning.model import (
    DurationInterval,
    Effect,
    Fluent,
    FNode,
    Object,
    Parameter,
    Presence,
    TimeInterval,
    Timepoint,
    Timing,
    Variable,
)
from unified_planning.model.metrics import (
    MaximizeExpressionOnFinalState,
    MinimizeActionCosts,
    MinimizeExpressionOnFinalState,
    MinimizeMakespan,
    Oversubscription,
    TemporalOversubscription,
)
from unified_planning.model.mixins import TimeModelMixin
from unified_planning.model.motion import (
    ConfigurationObject,
    MotionActivity,
    MovableObject,
    SchedulingMotionProblem,
)
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import MotionSchedule, Schedule

from up_samp.fleet.records import GROUND, FleetRecords
from up_samp.model.objective import Cost, MinimizeCosts
from up_samp.upio.objective import Objective, ObjectivePart
from up_samp.upio.plan import SampSchedule

COMMUTATIVE = {Op.AND, Op.OR, Op.EQUALS, Op.IFF, Op.PLUS, Op.TIMES}
T = TypeVar("T")
Names = dict[tuple[str, str], str]
"""(sort of thing, its name) -> its other name."""


@dataclass(frozen=True)
class Shuffled:
    """``problem`` says what ``original`` says. ``names`` maps (sort, name in ``problem``) to the
    name in ``original``; ``constraints`` maps an activity of ``original`` to where its motion
    constraints, as ``problem`` lists them, were.
    """

    original: SchedulingProblem
    problem: SchedulingProblem
    names: Names
    constraints: dict[str, list[int]]

    def back(self, plan: Schedule) -> Schedule:
        """Return a plan of ``problem`` as one of ``original``, to be judged by that."""
        old = self.original
        by_name = {a.name: a for a in old.activities}
        names = [(a, self.names["activity", a.name]) for a in plan.activities]
        given = {}
        for activity, name in names:
            given[by_name[name].start] = plan.get(activity.start)
            given[by_name[name].end] = plan.get(activity.end)
        known = {p.name: p for a in old.activities for p in a.parameters}
        known |= {v.name: v for v in old.base_variables}
        for variable, value in plan.assignment.items():
            if isinstance(variable, Parameter):
                told = old.object(self.names["object", value.object().name]) if (
                    value.is_object_exp()
                ) else value  # fmt: skip
                given[known[self.names["parameter", variable.name]]] = told
        activities = [by_name[name] for _, name in names]
        if not isinstance(plan, MotionSchedule):
            return Schedule(activities, given, old.environment)
        paths = {}
        for (activity, constraint), path in plan.motion_paths.items():
            own = by_name[self.names["activity", activity.name]]
            place = activity.motion_constraints.index(constraint)
            paths[own, own.motion_constraints[self.constraints[own.name][place]]] = path
        if not isinstance(plan, SampSchedule):
            return MotionSchedule(activities, given, paths, old.environment)
        tracks = {self._track(key): track for key, track in plan.trajectories.items()}
        back = SampSchedule(
            activities, given, paths, tracks, old.environment, plan.seconds_per_unit
        )
        back.margin = plan.margin
        return back

    def _track(self, key: str) -> str:
        """Return the name of a trajectory in ``original``."""
        activity, _, further = key.partition("#")
        name = self.names["activity", activity]
        place = self.constraints[name][int(further or 0)]
        return f"{name}#{place}" if place else name


def shuffled(problem: SchedulingProblem, seed: Hashable, *, rename: bool = True) -> Shuffled:
    """Return ``problem`` in the listing of a seed; names stay where not ``rename``."""
    return _Shuffler(problem, seed, rename).result()


class _Listing:
    """An order and names, by seed."""

    def __init__(self, seed: Hashable, rename: bool) -> None:
        self.rng = random.Random(f"listing {seed}")
        self.rename = rename
        self.told: Names = {}

    def order(self, things: Iterable[T]) -> list[T]:
        """Return things in another order."""
        some = list(things)
        self.rng.shuffle(some)
        return some

    def name(self, sort: str, name: str) -> str:
        """Return the other name of a thing."""
        if (sort, name) == ("floors", GROUND):
            return name
        if (sort, name) not in self.told:
            head = "".join(self.rng.choices("abmnxyzABMXYZ", k=self.rng.randint(1, 3)))
            other = f"{head}{len(self.told)}"
            other += "x" * (other == name)
            self.told[sort, name] = other if self.rename else name
        return self.told[sort, name]

    def corners(self, outline: Any) -> Any:
        """Return a polygon's corners from another one on."""
        first = self.rng.randrange(len(outline))
        return [*outline[first:], *outline[:first]]


class _Shuffler(_Listing):
    """Writes one problem again."""

    def __init__(self, problem: SchedulingProblem, seed: Hashable, rename: bool) -> None:
        super().__init__(seed, rename)
        self.old, self.env = problem, problem.environment
        self.made: dict[Any, Any] = {}
        self.nodes: dict[int, FNode] = {}
        self.places: dict[Fluent, list[int]] = {}
        self.constraints: dict[str, list[int]] = {}

    def result(self) -> Shuffled:
        old = self.old
        defaults = {self.type(t): self(v) for t, v in old.initial_defaults.items()}
        self.new = type(old)(old.name, self.env, initial_defaults=defaults)
        TimeModelMixin._clone_to(old, self.new)
        for add in self.order([self._objects, self._fluents]):
            add()
        for variable in self.order(old.base_variables):
            self.parameter(variable, self.new.add_variable)
        for activity in self.order(old.activities):
            self._activity(activity)
        for fluent, value in self.order(old.explicit_initial_values.items()):
            self.new.set_initial_value(self(fluent), self(value))
        self._chronicle(old._base, self.new._base)
        for activity in old.activities:
            self._chronicle(activity, self.made["activity", activity.name])
        if isinstance(old, SchedulingMotionProblem):
            for pair in self.order(old.initial_configuration):
                self.new.set_initial_configuration(*map(self, pair))
        for metric in old.quality_metrics:
            self.new.add_quality_metric(self._metric(metric))
        names = {(sort, new): name for (sort, name), new in self.told.items()}
        return Shuffled(old, self.new, names, self.constraints)

    # -- what there is ---------------------------------------------------------------------------
    def _once(self, thing: Any, make: Callable[[], T]) -> T:
        if thing not in self.made:
            self.made[thing] = make()
        return self.made[thing]

    def type(self, tpe: Any) -> Any:
        if not tpe.is_user_type():
            return tpe
        types = self.env.type_manager

        def make() -> Any:
            name = self.name("type", tpe.name)
            if tpe.is_configuration_type():
                return types.ConfigurationType(name, tpe.occupancy_map, tpe.kind)
            father = None if tpe.father is None else self.type(tpe.father)
            return (types.MovableType if tpe.is_movable_type() else types.UserType)(name, father)

        return self._once(tpe, make)

    def object(self, thing: Object) -> Object:
        return self._once(thing, lambda: self._object(thing))

    def _object(self, thing: Object) -> Object:
        name, tpe = self.name("object", thing.name), self.type(thing.type)
        if isinstance(thing, ConfigurationObject):
            return ConfigurationObject(name, tpe, thing.configuration, self.env)
        if not isinstance(thing, MovableObject):
            return Object(name, tpe, self.env)
        return MovableObject(
            name,
            tpe,
            footprint=self.corners(thing.footprint) if thing.footprint else thing.footprint,
            geometric_model=thing.geometric_model,
            motion_model=thing.motion_model,
            motion_parameters=self._items(thing.motion_parameters),
            control_model=thing.control_model,
            control_parameters=self._items(thing.control_parameters),
            env=self.env,
        )

    def _items(self, some: Any) -> Any:
        return dict(self.order(some.items())) if some else some

    def _objects(self) -> None:
        for thing in self.order(self.old.all_objects):
            self.new.add_object(self.object(thing))

    def fluent(self, fluent: Fluent) -> Fluent:
        def make() -> Fluent:
            self.places[fluent] = self.order(range(fluent.arity))
            signature = [fluent.signature[k] for k in self.places[fluent]]
            name = self.name("fluent", fluent.name)
            told = [
                Parameter(self.name(f"parameter of {name}", p.name), self.type(p.type), self.env)
                for p in signature
            ]
            return Fluent(name, self.type(fluent.type), told, environment=self.env)

        return self._once(fluent, make)

    def _fluents(self) -> None:
        for fluent in self.order(self.old.fluents):
            value = self.old.fluents_defaults.get(fluent)
            value = None if value is None else self(value)
            self.new.add_fluent(self.fluent(fluent), default_initial_value=value)

    def parameter(self, old: Parameter, add: Callable[[str, Any], Parameter]) -> None:
        """Add the parameter of an activity, or a variable of the problem."""
        owner, _, own = old.name.rpartition(".")
        made = add(self.name(f"own {owner}", own), self.type(old.type))
        self.made[old] = made
        self.told["parameter", old.name] = made.name

    def variable(self, variable: Variable) -> Variable:
        name = self.name("variable", variable.name)
        return Variable(name, self.type(variable.type), self.env)

    # -- expressions -----------------------------------------------------------------------------
    def __call__(self, node: FNode) -> FNode:
        if node.node_id not in self.nodes:
            self.nodes[node.node_id] = self._node(node)
        return self.nodes[node.node_id]

    def _node(self, node: FNode) -> FNode:
        kind, payload = node.node_type, node._content.payload
        told = {
            Op.OBJECT_EXP: self.object,
            Op.PARAM_EXP: lambda p: self.made[p],
            Op.VARIABLE_EXP: self.variable,
            Op.FLUENT_EXP: self.fluent,
            Op.TIMING_EXP: self.timing,
            Op.PRESENT_EXP: lambda p: Presence(self.name("activity", p.container)),
            Op.EXISTS: lambda some: tuple(self.order(map(self.variable, some))),
            Op.FORALL: lambda some: tuple(self.order(map(self.variable, some))),
        }
        if kind in told:
            payload = told[kind](payload)
        elif payload is not None and not node.is_constant():
            raise NotImplementedError(f"{kind} is not shuffled")
        args = list(map(self, node.args))
        if kind is Op.FLUENT_EXP:
            args = [args[k] for k in self.places[node.fluent()]]
        elif kind in COMMUTATIVE:
            args = self.order(args)
        if kind is Op.EQUALS:  # UP takes no number that is equal to a time
            args.sort(key=lambda a: not a.type.is_time_type())
        return self.env.expression_manager.create_node(kind, tuple(args), payload)

    def timing(self, timing: Timing | Timepoint) -> Timing:
        if isinstance(timing, Timepoint):  # UP takes bare ones, too
            timing = Timing(0, timing)
        point = timing.timepoint
        owner = point.container
        told = None if owner is None else self.name("activity", owner)
        return Timing(timing.delay, Timepoint(point.kind, told))

    def span(self, span: TimeInterval) -> TimeInterval:
        return TimeInterval(
            self.timing(span.lower),
            self.timing(span.upper),
            span.is_left_open(),
            span.is_right_open(),
        )

    def _metric(self, metric: Any) -> Any:
        if isinstance(metric, MinimizeMakespan):
            return MinimizeMakespan(self.env)
        if isinstance(metric, MinimizeCosts):
            return MinimizeCosts(map(self._cost, self.order(metric.costs)), self.env)
        if isinstance(metric, MinimizeExpressionOnFinalState | MaximizeExpressionOnFinalState):
            return type(metric)(self(metric.expression), self.env)
        if isinstance(metric, Oversubscription):
            gains = self.order(metric.goals.items())
            return Oversubscription({self(goal): gain for goal, gain in gains}, self.env)
        if isinstance(metric, TemporalOversubscription):
            timed = {
                (self.span(span), self(goal)): gain
                for (span, goal), gain in self.order(metric.goals.items())
            }
            return TemporalOversubscription(timed, self.env)
        if isinstance(metric, MinimizeActionCosts):
            assert not metric.costs  # UP takes no activities for actions here
            return MinimizeActionCosts({}, self(metric.default), self.env)
        if isinstance(metric, Objective):
            parts = [self._part(part) for part in self.order(metric.parts)]
            return Objective(metric.name, metric.sign, parts, self.env)
        raise NotImplementedError(f"{metric} is not shuffled")

    def _cost(self, cost: Cost) -> Cost:
        name = None if cost.activity is None else self.name("activity", cost.activity)
        return replace(cost, node=self(cost.node), activity=name)

    def _part(self, part: ObjectivePart) -> ObjectivePart:
        span = None if part.interval is None else self.span(part.interval)
        name = None if part.activity is None else self.name("activity", part.activity)
        return replace(part, node=self(part.node), interval=span, activity=name)

    # -- activities ------------------------------------------------------------------------------
    def _activity(self, old: Any) -> None:
        """Add an activity with its parameters; whatever names others comes later."""
        moves = isinstance(old, MotionActivity)
        add = self.new.add_motion_activity if moves else self.new.add_activity
        new = add(self.name("activity", old.name), 1, optional=old.optional)
        self.made["activity", old.name] = new
        for parameter in self.order(old.parameters):
            self.parameter(parameter, new.add_parameter)

    def _chronicle(self, old: Any, new: Any) -> None:
        assert not old.simulated_effects
        for constraint, scope in self.order(old.scoped_constraints):
            new._add_constraint(self(constraint), self.order(map(self, scope)))
        for span, some in self.order(old.conditions.items()):
            told = self.span(span)
            for condition in self.order(some):
                new.add_condition(told, self(condition))
        for timing, some in self.order(old.effects.items()):
            for effect in self.order(some):
                new._add_effect_instance(self.timing(timing), self._effect(effect))
        if old is self.old._base:
            return
        lasts = old.duration
        new._set_duration_constraint(
            DurationInterval(
                self(lasts.lower), self(lasts.upper), lasts.is_left_open(), lasts.is_right_open()
            )
        )
        if isinstance(old, MotionActivity):
            self._motions(old, new)

    def _effect(self, effect: Effect) -> Effect:
        every = tuple(self.order(map(self.variable, effect.forall)))
        parts = map(self, (effect.fluent, effect.value, effect.condition))
        return Effect(*parts, kind=effect.kind, forall=every)

    def _motions(self, old: MotionActivity, new: MotionActivity) -> None:
        self.constraints[old.name] = self.order(range(len(old.motion_constraints)))
        for k in self.constraints[old.name]:
            constraint = old.motion_constraints[k]
            new.add_motion_constraint(
                type(constraint)(
                    self(constraint.movable),
                    self(constraint.starting),
                    list(map(self, constraint.waypoints)),
                    self._obstacles(constraint.static_obstacles),
                    self._obstacles(constraint.dynamic_obstacles_at_start),
                    self.env,
                )
            )
        for movable, to in self.order(old.motion_effects.items()):
            new.add_motion_effect(self(movable), self(to))

    def _obstacles(self, some: Any) -> Any:
        if isinstance(some, Mapping):
            return {self.object(o): self._whatever(at) for o, at in self.order(some.items())}
        return some if some is None else [self.object(o) for o in self.order(some)]

    def _whatever(self, at: Any) -> Any:
        """Return an expression, or a fluent or an object that stands for one."""
        if isinstance(at, FNode):
            return self(at)
        return self.fluent(at) if isinstance(at, Fluent) else self.object(at)


# -- fleets --------------------------------------------------------------------------------------
SORTS = {
    "robot_types": ("type", "keep_out"),
    "robots": ("on",),
    "places": ("start", "end", "at", "input", "output", "opened_from"),
    "doors": (),
    "automatic_doors": (),
    "airlocks": ("airlock",),
    "zones": (),
    "floors": ("floor", "stops"),
    "lifts": (),
    "resources": (),
    "jobs": ("id", "task", "after", "attached", "together"),
    "skills": (),
    "kinds": ("load", "capacity"),
    "modes": (),
}
"""Sorts of names in a fleet: the fields (beside one of that name) that hold them."""
SORT_OF = {name: sort for sort, fields in SORTS.items() for name in (sort, *fields)}
LISTS = ("orders", "tasks")
OUTLINES = ("footprint", "leaf", "polygon")


@dataclass
class ShuffledFleet:
    """``records`` say what the original ones say; ``names`` as in :class:`Shuffled`."""

    records: FleetRecords
    names: Names = field(default_factory=dict)


def shuffled_fleet(records: FleetRecords, seed: Hashable, *, rename: bool = True) -> ShuffledFleet:
    """Return a fleet's records in the listing of a seed; names stay where not ``rename``."""
    listing = _Listing(seed, rename)
    told = _record(listing, records)
    return ShuffledFleet(told, {(s, new): old for (s, old), new in listing.told.items()})


def _record(listing: _Listing, record: Any) -> Any:
    values = {
        f.name: _value(listing, f.name, getattr(record, f.name)) for f in dataclasses.fields(record)
    }
    return dataclasses.replace(record, **values)


def _value(listing: _Listing, name: str, value: Any) -> Any:
    """Return the value of a record's field: names in it by what the field is called."""
    sort = SORT_OF.get(name)
    if isinstance(value, Mapping):
        told = {listing.name(sort, k): _value(listing, "", v) for k, v in value.items()}
        return dict(listing.order(told.items()))
    if dataclasses.is_dataclass(value):
        return _record(listing, value)
    if name in LISTS:
        return tuple(_record(listing, v) for v in listing.order(value))
    if name in OUTLINES and len(value) > 2:
        return tuple(listing.corners(value))
    if sort is not None and isinstance(value, str):
        return listing.name(sort, value)
    if sort is not None and isinstance(value, tuple) and all(isinstance(v, str) for v in value):
        return tuple(listing.name(sort, v) for v in listing.order(value))
    return value  # a number, or the pose of a start
