"""A yard with a plan made by hand: all that a schedule can say, and what may be wrong with it."""

import math
from types import SimpleNamespace

import numpy as np
from unified_planning.model import Fluent, Timing
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
from unified_planning.model.timing import ClosedTimeInterval, TimePointInterval
from unified_planning.plans import MotionSchedule
from unified_planning.shortcuts import (
    GE,
    LE,
    And,
    ConfigurationType,
    Equals,
    MinimizeMakespan,
    MovableType,
    Not,
    Or,
    Plus,
)

from tests import handmade
from up_samp.model import Trajectory

PLACES = {
    "c0": (4.0, 12.0, 0.0),
    "cm": (8.0, 12.0, 0.0),
    "c1": (12.0, 12.0, 0.0),
    "c2": (12.0, 14.0, 0.0),
    "c3": (6.0, 12.0, 0.0),
    "t0": (4.0, 4.0, 0.0),
    "t1": (25.0, 4.0, 0.0),
    "shut": (15.0, 4.0, 0.0),
    "open": (15.0, 9.0, 0.0),
}
TIMES = {
    "open_door": (2, 3),
    "cart_go": (0, 9),
    "cart_on": (10, 20),
    "truck_go": (4, 20),
    "weld": (0, 4),
    "paint": (4, 7),
    "grind": (10, 13),
    "inspect": (21, 23),
    "clean_a": (5, 6),
}
BOX = [(-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5)]
LIMITS = {"v_max": 2.0, "a_max": 0.5}


def line(a, b, begin, v_max=2.0, a_max=0.5):
    """Return the fastest drive on the straight line between two poses of one heading."""
    length = math.dist(a[:2], b[:2])
    plain = handmade.drive((0.0, 0.0, 0.0), [(length, 0.0)], begin, v_max, a_max)
    share = plain.poses[:, :1] / length
    return Trajectory(plain.times, np.array(a) + share * (np.array(b) - np.array(a)))


class Yard:
    """Builds the problem; its plan is made by :meth:`plan`."""

    def __init__(self, folder):
        pose = ConfigurationType(
            "pose", OccupancyMap(str(handmade.write_map(folder)), (0, 0)), ConfigurationKind.SE2
        )
        self.pose = pose
        self.problem = SchedulingMotionProblem("yard")
        self.places = {n: ConfigurationObject(n, pose, SE2(*p)) for n, p in PLACES.items()}
        self.problem.add_objects(list(self.places.values()))
        self.door = self._add("door", [(-0.5, -2), (0.5, -2), (0.5, 2), (-0.5, 2)], "shut")
        self.cart = self._add("cart", BOX, "c0", motion_parameters=LIMITS)
        self.truck = self._add(
            "truck",
            BOX,
            "t0",
            motion_model=MotionModels.REEDSSHEPP,
            motion_parameters=LIMITS | {"turning_radius": 1.0},
        )
        self.at = {n: self._fluent(n, p) for n, p in (("cart", "c0"), ("door", "shut"))}
        self.activities = {}
        self._drives()
        self._work()
        self.problem.add_quality_metric(MinimizeMakespan())

    def _add(self, name, corners, place, **keywords):
        keywords.setdefault("motion_model", MotionModels.SE2)
        item = MovableObject(name, MovableType(f"{name}_type"), footprint=corners, **keywords)
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.places[place])
        return item

    def _fluent(self, name, place):
        fluent = Fluent(f"{name}_at", self.pose)
        self.problem.add_fluent(fluent, default_initial_value=self.places[place])
        return fluent

    def _drive(self, name, robot, stops, bounds, *, optional=False, **obstacles):
        drive = self.problem.add_motion_activity(name, optional=optional)
        drive.set_duration_bounds(*bounds)
        stops = [self.places.get(s, s) if isinstance(s, str) else s(drive) for s in stops]
        drive.add_motion_constraint(ActivityWaypoints(robot, stops[0], stops[1:], **obstacles))
        drive.add_motion_effect(robot, stops[-1])
        self.activities[name] = drive
        return drive, stops[-1]

    def _drives(self):
        go, goal = self._drive("cart_go", self.cart, ["c0", "cm", "c1"], (5, 30))
        self._where(go, "cart", "c0", goal)
        go.add_deadline(20)
        on, goal = self._drive("cart_on", self.cart, ["c1", self._choice], (5, 30))
        self._where(on, "cart", "c1", goal)
        opens = self.problem.add_motion_activity("open_door", duration=1)
        opens.add_release_date(1)
        opens.add_motion_effect(self.door, self.places["open"])
        opens.add_effect(opens.end, self.at["door"], self.places["open"])
        self.activities["open_door"] = opens
        through, _ = self._drive(
            "truck_go", self.truck, ["t0", "t1"], (5, 40),
            static_obstacles={self.door: self.at["door"]},
            dynamic_obstacles_at_start={self.cart: self.at["cart"]},
        )  # fmt: skip
        through.add_condition(
            ClosedTimeInterval(Timing(0, through.start), Timing(0, through.end)),
            Equals(self.at["door"], self.places["open"]),
        )
        self._drive("truck_back", self.truck, ["t1", "t0"], (5, 40), optional=True)

    def _choice(self, activity):
        to = activity.add_parameter("to", self.pose)
        activity.add_constraint(Or(Equals(to, self.places[p]) for p in ("c0", "c3")))
        return to

    def _where(self, activity, name, start, goal):
        at = TimePointInterval(Timing(0, activity.start))
        activity.add_condition(at, Equals(self.at[name], self.places[start]))
        activity.add_effect(activity.end, self.at[name], goal)

    def _work(self):
        power = self.problem.add_resource("power", 2)
        for name, duration, amount in (("weld", 4, 2), ("paint", 3, 1), ("grind", 3, 1)):
            self._job(name, duration).uses(power, amount)
        self.activities["grind"].add_release_date(10)
        self.activities["paint"].add_deadline(25)
        inspect, through = self._job("inspect", 2), self.activities["truck_go"]
        self.problem.add_constraint(GE(inspect.start, Plus(through.end, 1)))
        self.problem.add_constraint(LE(inspect.end, Plus(through.end, 10)))
        a, b = (self._job(n, 1, optional=True) for n in ("clean_a", "clean_b"))
        self.problem.add_constraint(Or(a.present, b.present))
        self.problem.add_constraint(Not(And(a.present, b.present)))
        self.night = self.problem.add_variable(
            "night", self.problem.environment.type_manager.BoolType()
        )
        self.problem.add_constraint(Or(self.night, LE(self.activities["weld"].end, 30)))

    def _job(self, name, duration, *, optional=False):
        self.activities[name] = self.problem.add_activity(name, duration, optional=optional)
        return self.activities[name]

    def plan(self):
        """Return a good plan."""
        p = PLACES
        trajectories = {
            "cart_go": line(p["c0"], p["c1"], 0.2),
            "cart_on": line(p["c1"], p["c0"], 10.5),
            "truck_go": handmade.drive(p["t0"], [(21.0, 0.0)], 4.5),
        }
        assignment = {self.night: False}
        for name, (start, end) in TIMES.items():
            assignment[self.activities[name].start] = start
            assignment[self.activities[name].end] = end
        (to,) = self.activities["cart_on"].parameters
        assignment[to] = self.problem.environment.expression_manager.ObjectExp(self.places["c0"])
        plan = MotionSchedule(
            [self.activities[n] for n in TIMES], assignment, {}, self.problem.environment
        )
        plan.motion_paths = {
            (self.activities[n], self.activities[n].motion_constraints[0]): handmade.as_path(t)
            for n, t in trajectories.items()
        }
        plan.trajectories = trajectories
        return plan


def make(folder):
    yard = Yard(folder)
    return SimpleNamespace(problem=yard.problem, plan=yard.plan())
