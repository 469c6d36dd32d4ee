"""Random small worlds whose waypoints hang on decisions: parameters, variables, fluents.

A world is plain values; :func:`build` makes the UP problem of it, and of the same world with every
decision made (``decided``): its waypoints are constants then, and a plain condition says of each
fluent that is read what it has to be. The best plan of a world is the best of its decided worlds.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from unified_planning.environment import get_environment
from unified_planning.model import Fluent, Timing
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.model.timing import TimePointInterval
from unified_planning.shortcuts import Equals, Implies, Object, Or

from tests.shuffled import shuffled
from tests.soundness.worlds import BOX, DOOR, LEFT, PLACES, RIGHT

NAMED = "name_of_{}"
"""How the name of a place is called."""
SPOTS = tuple(p for p in LEFT + RIGHT if not p.endswith("2"))
Decisions = Mapping[str, str]
"""Parameter or variable -> place; ``drive:fluent`` -> the place that the fluent gives the drive."""


@dataclass(frozen=True)
class Where:
    """A waypoint: ``kind`` is ``place``, ``decision`` (a parameter's or variable's full name) or
    ``fluent``.
    """

    kind: str
    name: str


@dataclass(frozen=True)
class Step:
    """A drive. ``tracks``: its robot's fluent is set to its goal at its end."""

    name: str
    robot: str
    start: Where
    goal: Where
    optional: bool = False
    release: int = 0
    deadline: int | None = None


@dataclass(frozen=True)
class Switch:
    """An activity of one unit that sets a fluent to ``value`` at its end."""

    name: str
    fluent: str
    value: Where
    optional: bool
    release: int


@dataclass(frozen=True)
class World:
    """A problem. ``decisions`` are the values that each parameter and variable may take."""

    seed: int
    car: bool
    robots: tuple[tuple[str, str], ...]
    steps: tuple[Step, ...]
    decisions: Mapping[str, tuple[str, ...]]
    fluents: Mapping[str, str]
    switches: tuple[Switch, ...] = ()
    tracked: frozenset[str] = frozenset()
    door: str | None = None
    opening: tuple[bool, int] | None = None

    def owner(self, decision: str) -> str | None:
        """Return the activity that a parameter belongs to."""
        return decision.rpartition(".")[0] or None

    def values(self, where: Where) -> tuple[str, ...]:
        """Return the places that a waypoint may be."""
        if where.kind == "place":
            return (where.name,)
        if where.kind == "decision":
            return self.decisions[where.name]
        found = {self.fluents[where.name]}
        found.update(*(self.values(s.value) for s in self.switches if s.fluent == where.name))
        if where.name in self.tracked:
            robot = where.name.removeprefix("at_")
            found.update(*(self.values(s.goal) for s in self.steps if s.robot == robot))
        return tuple(sorted(found))

    def all_decisions(self) -> Iterator[dict[str, str]]:
        """Yield every way to make all decisions."""
        domains = dict(self.decisions)
        for step in self.steps:
            for where in (step.start, step.goal):
                if where.kind == "fluent":
                    domains[f"{step.name}:{where.name}"] = self.values(where)
        for values in itertools.product(*domains.values()):
            yield dict(zip(domains, values, strict=True))


def random_world(seed: int) -> World:
    """Return the world of a seed: at least one waypoint hangs on a decision."""
    rng = random.Random(f"decisions {seed}")
    starts = ("a", "d") if rng.random() < 0.5 else ("a", "b")
    robots = tuple((f"r{k}", p) for k, p in enumerate(starts[: rng.choice((1, 1, 2))]))
    decisions: dict[str, tuple[str, ...]] = {}
    fluents: dict[str, str] = {}
    switches: list[Switch] = []
    steps: list[Step] = []
    tracked = set()
    for robot, place in robots:
        track = rng.random() < 0.35
        if track:
            fluents[f"at_{robot}"] = place
            tracked.add(f"at_{robot}")
        here = Where("place", place)
        for number in range(rng.choice((1, 1, 2) if len(robots) > 1 else (1, 2, 2))):
            name = f"{robot}_{number}"
            goal = _goal(rng, name, track, decisions, fluents, switches)
            start = Where("fluent", f"at_{robot}") if track and rng.random() < 0.7 else here
            steps.append(
                Step(
                    name,
                    robot,
                    start,
                    goal,
                    optional=number > 0 and rng.random() < 0.3,
                    release=rng.choice((0, 0, 0, 1)),
                    deadline=rng.choice((None, None, None, 3, 5)),
                )
            )
            here = goal
    door = "shut" if rng.random() < 0.45 else None
    opening = None
    if door and rng.random() < 0.75:
        opening = (rng.random() < 0.5, rng.choice((0, 1, 2)))
    world = World(
        seed,
        rng.random() < 0.4,
        robots,
        tuple(steps),
        decisions,
        fluents,
        tuple(switches),
        frozenset(tracked),
        door,
        opening,
    )
    hanging = any(w.kind != "place" for s in steps for w in (s.start, s.goal))
    return world if hanging else random_world(seed + 1_000_003)


def _goal(rng, name, track, decisions, fluents, switches) -> Where:
    """Return a goal of a random sort, and enter what it needs."""
    places = tuple(sorted(rng.sample(SPOTS, rng.choice((2, 2, 3)))))
    roll = rng.random()
    if roll < 0.4:
        decisions[f"{name}.to"] = places
        return Where("decision", f"{name}.to")
    if roll < 0.5:
        decisions["spot"] = decisions.get("spot", places)
        return Where("decision", "spot")
    if roll < 0.75 and not track:
        if "target" not in fluents:
            fluents["target"] = places[0]
            value = Where("place", places[1])
            if rng.random() < 0.3:
                decisions["switch.value"] = places[1:]
                value = Where("decision", "switch.value")
            switches.append(
                Switch("switch", "target", value, rng.random() < 0.7, rng.choice((0, 0, 1, 2)))
            )
        return Where("fluent", "target")
    return Where("place", rng.choice(SPOTS))


def build(
    world: World, map_file, decided: Decisions | None = None, *, named: bool = False
) -> SchedulingMotionProblem:
    """Return the UP problem of a world; with ``decided``, of the world with these decisions.

    ``named``: what is decided are names of places, and a fluent tells where each one is.
    """
    return _Builder(world, map_file, decided, named).build()


class _Builder:
    def __init__(self, world: World, map_file, decided: Decisions | None, named: bool):
        env = get_environment()
        self.named = named and decided is None
        self.world, self.decided = world, decided
        self.kind = env.type_manager.ConfigurationType(
            "place", OccupancyMap(str(map_file), (0, 0)), ConfigurationKind.SE2
        )
        self.problem = SchedulingMotionProblem(f"decisions{world.seed}", env)
        self.places = {}
        for name, pose in PLACES.items():
            self.places[name] = ConfigurationObject(name, self.kind, SE2(*pose), env)
            self.problem.add_object(self.places[name])
        self.movable = {}
        self.fluents = {}
        self.parameters = {}
        self.activities = {}

    def build(self) -> SchedulingMotionProblem:
        world, problem = self.world, self.problem
        for name, place in world.robots:
            limits = {"v_max": 1.0, "a_max": 0.5} | ({"turning_radius": 0.5} if world.car else {})
            model = MotionModels.REEDSSHEPP if world.car else MotionModels.SE2
            self._add(name, place, BOX, motion_model=model, motion_parameters=limits)
        if world.door is not None:
            self._add("door", world.door, DOOR, motion_model=MotionModels.SE2)
        for name, place in world.fluents.items():
            self.fluents[name] = Fluent(name, self.kind)
            problem.add_fluent(self.fluents[name], default_initial_value=self.places[place])
        for item in (*world.steps, *world.switches):
            motion = isinstance(item, Step)
            add = problem.add_motion_activity if motion else problem.add_activity
            self.activities[item.name] = add(item.name, 1, item.optional)
        if self.named:
            self._name_places()
        if self.decided is None:
            self._declare()
        for step in world.steps:
            self._drive(step)
        for switch in world.switches:
            activity = self.activities[switch.name]
            value = self._expression(activity, switch.value)
            activity.add_effect(activity.end, self.fluents[switch.fluent], value)
            if switch.release:
                activity.add_release_date(switch.release)
        if world.opening is not None:
            optional, release = world.opening
            activity = problem.add_motion_activity("open", 1, optional)
            activity.add_motion_effect(self.movable["door"], self.places["away"])
            if release:
                activity.add_release_date(release)
        problem.add_quality_metric(MinimizeMakespan())
        return shuffled(problem, world.seed, rename=False).problem

    def _add(self, name, place, shape, **keywords) -> None:
        types = self.problem.environment.type_manager
        item = MovableObject(
            name,
            types.MovableType(f"{name[0]}_type"),
            footprint=list(shape),
            env=self.problem.environment,
            **keywords,
        )
        self.movable[name] = item
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.places[place])

    def _name_places(self) -> None:
        problem = self.problem
        sort = problem.environment.type_manager.UserType("name")
        self.names = {p: Object(NAMED.format(p), sort, problem.environment) for p in PLACES}
        problem.add_objects(self.names.values())
        self.told = Fluent("told", self.kind, at=sort)
        problem.add_fluent(self.told, default_initial_value=self.places["a"])
        for place, name in self.names.items():
            problem.set_initial_value(self.told(name), self.places[place])

    def _declare(self) -> None:
        kind, values_of = (
            (next(iter(self.names.values())).type, self.names)
            if self.named
            else (self.kind, self.places)
        )
        for name, values in self.world.decisions.items():
            owner = self.world.owner(name)
            if owner is None:
                parameter = self.problem.add_variable(name, kind)
            else:
                parameter = self.activities[owner].add_parameter(name.rpartition(".")[2], kind)
            self.parameters[name] = parameter
            self.problem.add_constraint(Or(Equals(parameter, values_of[v]) for v in values))

    def _drive(self, step: Step) -> None:
        activity = self.activities[step.name]
        activity.set_duration_bounds(1, 40)
        start = self._expression(activity, step.start)
        goal = self._expression(activity, step.goal)
        activity.add_motion_constraint(ActivityWaypoints(self.movable[step.robot], start, [goal]))
        if f"at_{step.robot}" in self.world.tracked:
            activity.add_effect(activity.end, self.fluents[f"at_{step.robot}"], goal)
        if step.release:
            activity.add_release_date(step.release)
        if step.deadline is not None:
            activity.add_deadline(step.deadline)
        for where in (step.start, step.goal) if self.decided is not None else ():
            owner = self.world.owner(where.name) if where.kind == "decision" else None
            if owner not in (None, step.name):
                other = self.activities[owner]
                self.problem.add_constraint(Implies(activity.present, other.present))

    def _expression(self, activity, where: Where):
        """Return a waypoint as UP has it; decided, a constant (and what a fluent has to be)."""
        if where.kind == "place":
            return self.places[where.name]
        if where.kind == "decision":
            if self.named:
                return self.told(self.parameters[where.name])
            if self.decided is None:
                return self.parameters[where.name]
            return self.places[self.decided[where.name]]
        fluent = self.fluents[where.name]
        if self.decided is None:
            return fluent()
        place = self.places[self.decided[f"{activity.name}:{where.name}"]]
        activity.add_condition(
            TimePointInterval(Timing(0, activity.start)), Equals(fluent(), place)
        )
        return place
