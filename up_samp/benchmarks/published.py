"""How published SAMP problems are written, whatever the family.

The authors of the paper (Tosello et al., ICAPS 2026) write their problems in plain calls of Unified
Planning. This module says the same in code of its own:

- Every object has one fluent without parameters (``robot0_at``, ``door0_at``), every move a
  condition on it at its start and an effect on it at ``end - 1`` (or at ``end``). Nothing
  happens at a move's start: while a robot drives, its fluent says where it came from.
- *With fluents* obstacles are dicts ``{object: fluent}``. *Without fluents* they are lists, and
  what a condition asked is one constraint per activity, over helpers (who make it true) and rivals
  (who undo it).
- One thing at a time is said by a disjunction for each pair of activities, or by resources
  (``uses``); a third way adds one resource that everything uses (one activity after another).
- Robots have a motion model and a control model (a bicycle as long as the footprint).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

from unified_planning.model import Fluent, FNode, GlobalEndTiming, TimePointInterval, Timing
from unified_planning.model.motion import (
    ActivityWaypoints,
    ConfigurationObject,
    MotionActivity,
    MotionModels,
    MovableObject,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, LE, And, Equals, Implies, MovableType, Not, Or

from up_samp.benchmarks.instances import Encoding, check_encoding
from up_samp.benchmarks.places import (
    FamilyDoor,
    FamilyFloor,
    ProblemOnMap,
    least_duration,
)
from up_samp.upio.expressions import at_start, present


@cache
def control_model(length: float) -> partial[None]:
    """Return the model of a car ``length`` m long, the same whenever it is asked for: problems are
    compared by it.
    """
    return partial(bicycle, length)


def bicycle(length: float, q: Sequence[float], u: Sequence[float], qdot: Any) -> None:
    """Fill ``qdot`` (m/s, m/s, rad/s) of a car ``length`` m long: q = (x, y, theta), u = (speed,
    steering).
    """
    speed, steering = u
    qdot[0] = speed * math.cos(q[2])
    qdot[1] = speed * math.sin(q[2])
    qdot[2] = speed * math.tan(steering) / length


# ------------------ What a problem in a published form is made of


Need = tuple[Activity, Sequence[Activity], Sequence[Activity], bool]
"""What an activity needs, and who gives and takes it (for the form without fluents): helpers make
it true, rivals may undo it, and whether it holds from the beginning.
"""


def needed(need: Need) -> FNode:
    """Return the constraint over starts, ends and presences that says a need."""
    a, helpers, undoing, initially = need
    rivals = [(r, r.present, GE(r.start, a.end)) for r in undoing if r is not a]
    ways = []
    for h in helpers:
        if h is a:
            continue
        begin = h.start
        kept = [
            Implies(there, Or(LE(r.end, begin), after)) for r, there, after in rivals if r is not h
        ]
        ways.append(And([h.present, LE(h.end, a.start), *kept]))
    if initially:
        ways.append(And([Implies(there, after) for _, there, after in rivals]))
    return Or(ways)


@dataclass
class PublishedRobot:
    """A robot of the problem and all that it may do."""

    body: MovableObject
    start: ConfigurationObject
    at: Fluent | None
    token: Fluent | None
    moves: list[tuple[MotionActivity, ConfigurationObject, ConfigurationObject]] = field(
        default_factory=list
    )
    busy: list[Activity] = field(default_factory=list)
    stands: list[tuple[Activity, Sequence[ConfigurationObject]]] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The object's name."""
        return str(self.body.name)

    def moves_to(self, places: Iterable[ConfigurationObject]) -> list[MotionActivity]:
        """Return its moves that end at one of ``places``."""
        names = {p.name for p in places}
        return [a for a, _, to in self.moves if to.name in names]

    def moves_from(self, place: ConfigurationObject) -> list[MotionActivity]:
        """Return its moves that leave ``place``."""
        return [a for a, origin, _ in self.moves if origin.name == place.name]

    def preconditions(self) -> Iterator[Need]:
        """Yield what each thing needs that it does at a place: that it has come there."""
        moves = [a for a, _, _ in self.moves]
        for a, places in self.stands:
            helpers = self.moves_to(places)
            same = {id(h) for h in helpers}
            rivals = [m for m in moves if id(m) not in same]
            initially = any(p.name == self.start.name for p in places)
            yield a, helpers, rivals, initially


@dataclass
class Leaf:
    """A door of the problem, and the activities that open it."""

    body: MovableObject
    opened: ConfigurationObject
    button: ConfigurationObject
    at: Fluent | None
    token: Fluent | None
    openings: list[Activity] = field(default_factory=list)


# ------------------ How published SAMP problems are written, whatever the family


CONTROLS = {"v_min": 1.0, "v_max": 20.0, "phi_min": -1.0, "phi_max": 1.0}
"""What bounds the control models of all robots (m/s, rad); the lowest speed says how slow a move
may be.
"""
HANDLING = 1
"""Units that picking something and opening a door take."""


@dataclass(frozen=True)
class Manner:
    """What is fixed for a whole family: see the fields.

    ``guess`` is the acceleration (m/s^2) in the lower bound on a move's duration, ``early`` the
    units before a move's end at which its effects happen, ``model`` and ``turning_radius`` (m)
    are the robots'. With ``heed_all`` moves name no obstacles: everything counts.
    ``bounds`` are every move's, units, where they do not come from the distance.
    """

    floor: FamilyFloor
    guess: float
    early: int = 1
    model: MotionModels = MotionModels.REEDSSHEPP
    turning_radius: float = 1.0
    heed_all: bool = False
    bounds: tuple[int, int] | None = None


class Form(ProblemOnMap):
    """A problem under construction in one of the published forms."""

    def __init__(self, name: str, manner: Manner, encoding: Encoding, metric: bool) -> None:
        check_encoding(encoding)
        super().__init__(name, manner.floor.yaml, metric=metric)
        self.manner = manner
        self.with_fluents = encoding.startswith("fluents")
        self.with_resources = encoding.endswith("-uses")
        self.line = (
            self.problem.add_resource("sequential_schedule", 1)
            if encoding.endswith("-sequential")
            else None
        )
        self.robot_type, self.door_type = MovableType("robot"), MovableType("door")
        self.robots: list[PublishedRobot] = []
        self.doors: list[Leaf] = []
        self.needs: list[Need] = []

    # ---------------------------------------------------------------- objects
    def robot(self, start: ConfigurationObject) -> PublishedRobot:
        """Add a robot that stands at ``start``."""
        name = f"robot{len(self.robots)}"
        footprint = self.manner.floor.footprint
        xs = [x for x, _ in footprint]
        body = self.body(
            name,
            self.robot_type,
            footprint,
            start,
            self.manner.model,
            motion_parameters={"turning_radius": self.manner.turning_radius},
            control_model=control_model(max(xs) - min(xs)),
            control_parameters=dict(CONTROLS),
        )
        robot = PublishedRobot(body, start, self._at(name, start), self._token(name))
        self.robots.append(robot)
        return robot

    def door(self, door: FamilyDoor) -> Leaf:
        """Add a closed door."""
        name = f"door{len(self.doors)}"
        closed = self.place(f"{name}_closed", door.closed)
        opened = self.place(f"{name}_open", door.open)
        button = self.place(f"{name}_button", door.button)
        body = self.body(name, self.door_type, door.footprint, closed)
        leaf = Leaf(body, opened, button, self._at(name, closed), self._token(name))
        self.doors.append(leaf)
        return leaf

    def _at(self, name: str, place: ConfigurationObject) -> Fluent | None:
        if not self.with_fluents:
            return None
        at = Fluent(f"{name}_at", self.pose_type)
        self.problem.add_fluent(at, default_initial_value=place)
        return at

    def _token(self, name: str) -> Fluent | None:
        return self.problem.add_resource(f"{name}_free", 1) if self.with_resources else None

    # ------------------------------------------------------------- activities
    def move(
        self, robot: PublishedRobot, origin: ConfigurationObject, to: ConfigurationObject
    ) -> MotionActivity:
        """Add the optional move of ``robot`` from ``origin`` to ``to``, once all objects exist."""
        name = f"move_{robot.name}_{origin.name}_to_{to.name}"
        a = self.problem.add_motion_activity(name, 1, optional=True)
        a.set_duration_bounds(*(self.manner.bounds or self._bounds(origin, to)))
        a.add_motion_effect(robot.body, to)
        static = self._obstacles(self.doors)
        dynamic = self._obstacles([r for r in self.robots if r is not robot])
        a.add_motion_constraint(ActivityWaypoints(robot.body, origin, [to], static, dynamic))
        if robot.at is not None:
            a.add_condition(at_start(a), Equals(robot.at, origin))
            a.add_effect(self.done(a), robot.at, to)
        robot.moves.append((a, origin, to))
        robot.stands.append((a, [origin]))
        self.occupy(robot, a)
        return a

    def _bounds(self, origin: ConfigurationObject, to: ConfigurationObject) -> tuple[int, int]:
        a, b = self.poses[origin.name], self.poses[to.name]
        low = least_duration(a, b, self.manner.guess)
        return low, max(low, math.ceil(round(math.dist(a[:2], b[:2]) / CONTROLS["v_min"], 9)))

    def _obstacles(self, things: Sequence[PublishedRobot] | Sequence[Leaf]) -> Any:
        if self.manner.heed_all:
            return None
        if self.with_fluents:
            return {thing.body: thing.at for thing in things}
        return [thing.body for thing in things]

    def done(self, a: Activity) -> Timing:
        """Return when the effects of ``a`` happen."""
        return Timing(-self.manner.early, a.end)

    def occupy(self, robot: PublishedRobot, a: Activity) -> None:
        """Let ``a`` be among the things that ``robot`` does one at a time."""
        robot.busy.append(a)
        if robot.token is not None:
            a.uses(robot.token)

    def work(
        self, robot: PublishedRobot, name: str, places: Sequence[ConfigurationObject], duration: int
    ) -> Activity:
        """Add something optional that ``robot`` does at one of ``places``."""
        a = self.problem.add_activity(name, duration=duration, optional=True)
        self.stand(robot, a, places)
        return a

    def stand(
        self, robot: PublishedRobot, a: Activity, places: Sequence[ConfigurationObject]
    ) -> None:
        """Let ``robot`` do ``a`` at one of ``places``."""
        if robot.at is not None:
            a.add_condition(at_start(a), Or([Equals(robot.at, p) for p in places]))
        robot.stands.append((a, places))
        self.occupy(robot, a)

    def openings(self) -> None:
        """Let every robot open every door, from its button, as often as it likes: once."""
        for robot, leaf in itertools.product(self.robots, self.doors):
            name = f"open_{leaf.body.name}_{robot.name}"
            a = self.problem.add_motion_activity(name, HANDLING, optional=True)
            a.set_fixed_duration(HANDLING)
            a.add_motion_effect(leaf.body, leaf.opened)
            if leaf.at is not None:
                a.add_effect(self.done(a), leaf.at, leaf.opened)
            if leaf.token is not None:
                a.uses(leaf.token)
            self.stand(robot, a, [leaf.button])
            leaf.openings.append(a)

    # -------------------------------------------------------------- the rules
    def exactly_one(self, activities: Sequence[Activity], *, inside: bool = True) -> None:
        """One of the optional ``activities`` is present, and none of the others: said ``inside``
        each of them, or as an implication of the problem.
        """
        self.problem.add_constraint(Or([a.present for a in activities]))
        if len(activities) < 2:
            return
        for a in activities:
            none = Not(Or([b.present for b in activities if b is not a]))
            if inside:
                a.add_constraint(none)
            else:
                self.problem.add_constraint(Implies(a.present, none))

    def one_at_a_time(self, activities: Sequence[Activity]) -> None:
        """Keep each pair of ``activities`` apart, if both are present."""
        for a, b in itertools.combinations(activities, 2):
            apart = Or(LE(a.end, b.start), GE(a.start, b.end))
            self.problem.add_constraint(apart, scope=present(a, b))

    def end_at(self, places: dict[int, ConfigurationObject]) -> None:
        """Let robots (by number) be at ``places`` when everything is over (with fluents)."""
        if self.with_fluents:
            wanted = [Equals(self.robots[r].at, place) for r, place in places.items()]
            self.problem.add_condition(TimePointInterval(GlobalEndTiming()), And(wanted))

    def finish(self) -> SchedulingMotionProblem:
        """State what is left: who is where without fluents, and one thing at a time."""
        if not self.with_fluents:
            for robot in self.robots:
                self.needs += robot.preconditions()
            for need in self.needs:
                self.problem.add_constraint(needed(need), scope=[need[0].present])
        if not self.with_resources:
            for robot in self.robots:
                self.one_at_a_time(robot.busy)
            for leaf in self.doors:
                self.one_at_a_time(leaf.openings)
        if self.line is not None:
            for a in self.problem.activities:
                a.uses(self.line)
        return self.problem
