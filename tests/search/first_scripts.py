"""Small problems as people write them who write their first script, with optima found by hand.

Robots drive at 1 m/s and 1 m/s^2 in an open hall: x m take x + 1 s, rounded up to whole units.
"""

from __future__ import annotations

from PIL import Image, ImageDraw
from unified_planning.model import Fluent
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
from unified_planning.shortcuts import (
    GE,
    LE,
    BoolType,
    ClosedTimeInterval,
    ConfigurationType,
    Equals,
    Exists,
    Forall,
    GlobalEndTiming,
    GlobalStartTiming,
    Iff,
    Implies,
    IntType,
    MinimizeMakespan,
    MovableType,
    Not,
    Object,
    OpenTimeInterval,
    Or,
    RightOpenTimeInterval,
    Timing,
    UserType,
    Variable,
)

BOX = [(-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (-0.4, 0.3)]
PLACES = {"a": (3, 3), "b": (18, 3), "c": (3, 9), "d": (18, 9)}
"""From a to b are 15 m (16 units), from b to d 6 m (7), from a to d 16.2 m (18)."""


class Hall:
    """A hall of 24 m x 12 m with robots r at a and q at c."""

    def __init__(self, folder) -> None:
        image = Image.new("L", (240, 120), 254)
        ImageDraw.Draw(image).rectangle([0, 0, 239, 119], outline=0)
        image.save(folder / "hall.png")
        (folder / "hall.yaml").write_text(
            "image: hall.png\nresolution: 0.1\norigin: [0.0, 0.0, 0.0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
        )
        floor = OccupancyMap(str(folder / "hall.yaml"), SE2(0.0, 0.0, 0.0))
        self.spot = ConfigurationType("spot", floor, ConfigurationKind.SE2)
        self.robot = MovableType("robot")
        self.problem = SchedulingMotionProblem("first")
        for name, (x, y) in PLACES.items():
            place = ConfigurationObject(name, self.spot, SE2(float(x), float(y), 0.0))
            self.problem.add_object(place)
            setattr(self, name, place)
        self.r, self.q = self._robot("r", self.a), self._robot("q", self.c)
        self.problem.add_quality_metric(MinimizeMakespan())

    def _robot(self, name, place):
        robot = MovableObject(
            name, self.robot, footprint=BOX, motion_model=MotionModels.SE2,
            motion_parameters={"v_max": 1.0, "a_max": 1.0},
        )  # fmt: skip
        self.problem.add_object(robot)
        self.problem.set_initial_configuration(robot, place)
        return robot

    def drive(self, robot, start, goal, *, optional=False, bounds=(1, 60)):
        """Add a drive."""
        name = f"{robot.name}_{start.name}_{goal.name}"
        move = self.problem.add_motion_activity(name, 1, optional=optional)
        move.set_duration_bounds(*bounds)
        move.add_motion_constraint(ActivityWaypoints(robot, start, [goal]))
        move.add_motion_effect(robot, goal)
        return move

    def at(self, robot, start):
        """Add a fluent that is to tell where a robot is."""
        fluent = Fluent(f"{robot.name}_at", self.spot)
        return self.problem.add_fluent(fluent, default_initial_value=start)


def always(activity):
    return ClosedTimeInterval(Timing(0, activity.start), Timing(0, activity.end))


def stock_of_pills(hall):
    """A counter that doses are taken from, one at an instant: 16, seen at 17, and 4 and 3."""
    p = hall.problem
    pills = p.add_fluent("pills", IntType(0, 3), default_initial_value=2)
    given = p.add_fluent("given", IntType(0, 5), default_initial_value=0)
    at = hall.at(hall.r, hall.a)
    go = hall.drive(hall.r, hall.a, hall.b)
    go.add_effect(go.end, at, hall.b)
    for k in range(2):
        give = p.add_activity(f"give{k}", 3)
        give.add_condition(always(give), Equals(at, hall.b))
        give.add_condition(give.start, GE(pills, 1))
        give.add_decrease_effect(give.start, pills, 1)
        give.add_increase_effect(give.end, given, 1)
    p.add_condition(GlobalEndTiming(), Equals(given, 2))
    return 17 + 1 + 3


def place_by_place(hall):
    """A flag per place, cleared when the robot leaves: 16 there, seen at 17, 3 of work, 1, 7."""
    p = hall.problem
    at = {x.name: p.add_fluent(f"at_{x.name}", default_initial_value=x is hall.a)
          for x in (hall.a, hall.b, hall.d)}  # fmt: skip
    for x, y in ((hall.a, hall.b), (hall.b, hall.d), (hall.a, hall.d)):
        move = hall.drive(hall.r, x, y, optional=True)
        move.add_condition(move.start, at[x.name])
        move.add_effect(move.start, at[x.name], False)
        move.add_effect(move.end, at[y.name], True)
    work = p.add_activity("work", 3)
    work.add_condition(always(work), at["b"])
    p.add_condition(GlobalEndTiming(), at["d"])
    return 17 + 3 + 1 + 7


def odd_instants(hall):
    """Effects in the midst of a move and after its end: hot from 14 to 21, or all later."""
    p = hall.problem
    lamp, hot = (p.add_fluent(n, default_initial_value=False) for n in ("lamp", "hot"))
    one, two = hall.drive(hall.r, hall.a, hall.b), hall.drive(hall.q, hall.c, hall.d)
    one.add_effect(one.start + 3, lamp, True)
    one.add_effect(one.end - 2, hot, True)
    one.add_effect(one.end + 5, hot, False)
    two.add_condition(two.start, lamp)
    for instant in (two.end - 1, two.end):
        two.add_condition(instant, Not(hot))
    return 23


def reserved_aisle(hall):
    """Whoever crosses owns the aisle, which is nobody's before: 18, seen at 19, and 18."""
    p, who = hall.problem, UserType("who")
    nobody, *owners = (Object(n, who) for n in ("nobody", "R", "Q"))
    p.add_objects([nobody, *owners])
    owner = p.add_fluent(Fluent("owner", who), default_initial_value=nobody)
    ways = ((hall.r, hall.a, hall.d), (hall.q, hall.c, hall.b))
    for (robot, start, goal), name in zip(ways, owners, strict=True):
        move = hall.drive(robot, start, goal)
        move.add_condition(move.start, Equals(owner, nobody))
        move.add_effect(move.start, owner, name)
        move.add_condition(RightOpenTimeInterval(move.start + 1, move.end), Equals(owner, name))
        move.add_effect(move.end, owner, nobody)
    return 18 + 1 + 18


def either_helper(hall):
    """One of two, by Iff and a variable; the early one has to wait for its shift."""
    p = hall.problem
    early = p.add_variable("early", BoolType())
    shift = p.add_variable("shift", IntType(0, 40))
    one = hall.drive(hall.r, hall.a, hall.b, optional=True)
    two = hall.drive(hall.q, hall.c, hall.b, optional=True)
    p.add_constraint(Iff(early, one.present))
    p.add_constraint(Iff(Not(early), two.present))
    for move in (one, two):
        p.add_constraint(LE(shift, move.start), scope=[move.present])
    p.add_constraint(GE(shift, 5))
    p.add_constraint(Implies(early, GE(shift, 20)))
    return 5 + 18


def length_by_fluent(hall):
    """A table tells how long drives take; nothing tells where the robot is."""
    p = hall.problem
    table = p.add_fluent(Fluent("table", IntType(0, 99), x=hall.spot), default_initial_value=16)
    for x, y in ((hall.a, hall.b), (hall.b, hall.d)):
        hall.drive(hall.r, x, y, bounds=(table(y), 60))
    return 16 + 16


def open_interval(hall):
    """The place is needed in the midst of each drive only, so that drives touch."""
    at = hall.at(hall.r, hall.a)
    for x, y in ((hall.a, hall.b), (hall.b, hall.d)):
        move = hall.drive(hall.r, x, y, bounds=(0, 60))
        move.add_effect(move.end, at, y)
        span = OpenTimeInterval(Timing(0, move.start), Timing(0, move.end))
        move.add_condition(span, Equals(at, x))
    return 16 + 7


def any_robot(hall):
    """Somebody has to be at b for 5, then somebody at d, and in the end nobody at c."""
    p = hall.problem
    at = Fluent("at", hall.spot, who=hall.robot)
    p.add_fluent(at)
    for robot, start in ((hall.r, hall.a), (hall.q, hall.c)):
        p.set_initial_value(at(robot), start)
        for goal in (hall.b, hall.d):
            move = hall.drive(robot, start, goal, optional=True)
            move.add_effect(move.end, at(robot), goal)
    v = Variable("v", hall.robot)
    first, then = p.add_activity("first", 5), p.add_activity("then", 5)
    first.add_condition(always(first), Exists(Equals(at(v), hall.b), v))
    then.add_condition(always(then), Exists(Equals(at(v), hall.d), v))
    p.add_constraint(LE(first.end, then.start))
    p.add_condition(GlobalEndTiming(), Forall(Not(Equals(at(v), hall.c)), v))
    return 17 + 5 + 5


def open_hours(hall):
    """The gate is open from 10 to 50: in at 11, 16 there, 3, and back by 49."""
    p = hall.problem
    gate = p.add_fluent("gate", default_initial_value=False)
    p.add_effect(GlobalStartTiming(10), gate, True)
    p.add_effect(GlobalStartTiming(50), gate, False)
    there, back = hall.drive(hall.r, hall.a, hall.b), hall.drive(hall.r, hall.b, hall.a)
    for move in (there, back):
        move.add_condition(always(move), gate)
    p.add_constraint(LE(there.end + 3, back.start))
    p.add_constraint(Or(LE(back.end, 49), GE(back.start, 60)))
    return 11 + 16 + 3 + 16


SCRIPTS = (
    stock_of_pills, place_by_place, odd_instants, reserved_aisle, either_helper, length_by_fluent,
    open_interval, any_robot, open_hours,
)  # fmt: skip
