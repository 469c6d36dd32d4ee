"""Random worlds in which robots have more to do with a leaf than to come past it: they come to rest
where it lies, unheeded on their way there, and wait until they can set off, or stay; or they set it
elsewhere as they arrive (who shuts a door behind itself).
"""

import random

from unified_planning.model import Timing
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
    ConfigurationType,
    Equals,
    MinimizeMakespan,
    MovableType,
    Or,
)

from tests.shuffled import shuffled
from tests.soundness.worlds import BOX, DOOR, LEFT, PLACES, RIGHT, write_rooms

CAR = MotionModels.REEDSSHEPP
LIMITS = {"v_max": 1.0, "a_max": 0.5}
MODELS = (
    {"motion_model": MotionModels.SE2, "motion_parameters": LIMITS},
    {"motion_model": CAR, "motion_parameters": LIMITS | {"turning_radius": 0.5}},
    {"motion_model": CAR, "motion_parameters": LIMITS | {"turning_radius": 0.0}},
)
HALTS = {"gap": (5.0, 3.0, 0.0), "m": (2.6, 3.0, 0.5)}
"""Where robots halt, and how the leaf lies on them."""


class Leaves:
    """Two rooms, a robot in one of them, and a leaf."""

    def __init__(self, seed, folder, **moved):
        self.rng = random.Random(seed)
        self.problem = SchedulingMotionProblem(str(seed))
        area = OccupancyMap(str(write_rooms(folder)), (0, 0))
        self.spot = ConfigurationType("place", area, ConfigurationKind.SE2)
        poses = PLACES | {"gap": HALTS["gap"]} | moved
        self.place = {n: ConfigurationObject(n, self.spot, SE2(*p)) for n, p in poses.items()}
        self.problem.add_objects(self.place.values())
        model = self.rng.choice(MODELS)
        self.robot = MovableObject("r", MovableType("robot"), footprint=list(BOX), **model)
        still = {"motion_model": MotionModels.SE2}
        self.leaf = MovableObject("door", MovableType("leaf"), footprint=list(DOOR), **still)
        self.problem.add_objects([self.robot, self.leaf])
        self.problem.set_initial_configuration(self.robot, self.place["a"])
        self.problem.add_quality_metric(MinimizeMakespan())
        self.told, self.early = None, 0

    def begin(self, place):
        """Put the leaf where it is at first, which a fluent tells in some problems."""
        self.problem.set_initial_configuration(self.leaf, self.place[place])
        if self.rng.random() < 0.4:
            here, self.early = self.place[place], self.rng.choice([0, 1])
            self.told = self.problem.add_fluent("told", self.spot, default_initial_value=here)

    def drive(self, name, origin, *ways, decided=False, **lists):
        """Add a drive."""
        made = self.problem.add_motion_activity(name, 1)
        made.set_duration_bounds(1, 40)
        way = [self.place[p] for p in ways]
        if decided:
            way[-1] = made.add_parameter("to", self.spot)
            made.add_constraint(Or([Equals(way[-1], self.place[p]) for p in (ways[-1], "c")]))
        made.add_motion_constraint(ActivityWaypoints(self.robot, self.place[origin], way, **lists))
        made.add_motion_effect(self.robot, way[-1])
        return made

    def heeded(self):
        """Return how a drive lists the leaf."""
        moving = {"dynamic_obstacles_at_start": [self.leaf]}
        return self.rng.choice([{}, {"static_obstacles": [self.leaf]}, moving, moving])

    def set_leaf(self, made, to):
        """Let an activity set the leaf somewhere as it ends."""
        made.add_motion_effect(self.leaf, self.place[to])
        if self.told is not None:
            made.add_effect(Timing(-self.early, made.end), self.told, self.place[to])

    def turns(self, *goals):
        """Add activities that do nothing but turn the leaf."""
        for k, to in enumerate(goals):
            turn = self.problem.add_motion_activity(f"turn{k}", 1, self.rng.random() < 0.3)
            self.set_leaf(turn, to)
            self.problem.add_constraint(GE(turn.start, self.rng.choice([0, 5, 6])), [turn.present])


def halts(seed, folder):
    """Return a problem in which a robot is where the leaf lies."""
    rng = random.Random(f"halts {seed}")
    halt = rng.choice(sorted(HALTS))
    world = Leaves(f"halts {seed}", folder, lying=HALTS[halt])
    world.begin("lying")
    goal = rng.choice([p for p in (*LEFT, *RIGHT) if p != halt])
    ways = rng.choice([(goal,), (goal,), (halt,), (halt, halt), (halt, goal), (goal, halt)])
    come = world.drive("come", "a", halt, static_obstacles=[], dynamic_obstacles_at_start=[])
    go = world.drive("go", halt, *ways, decided=rng.random() < 0.3, **world.heeded())
    world.problem.add_constraint(LE(come.end, go.start))
    if rng.random() < 0.6:
        world.problem.add_constraint(LE(go.start, rng.choice([3, 4])))
    world.turns(*rng.choice([(), ("aside",), ("aside",), ("aside", "away")]))
    return shuffled(world.problem, seed).problem


def behind(seed, folder):
    """Return a problem in which a robot sets the leaf elsewhere as it arrives."""
    rng = random.Random(f"behind {seed}")
    world = Leaves(f"behind {seed}", folder)
    world.begin(rng.choice(["away", "away", "shut"]))
    goals = rng.choice(RIGHT), rng.choice(LEFT[1:])
    first = world.drive("go0", "a", goals[0], **world.heeded())
    world.set_leaf(first, rng.choice(["shut", "shut", "shut", "aside"]))
    if rng.random() < 0.5:
        then = world.drive("go1", *goals, **world.heeded())
        world.problem.add_constraint(LE(first.end, then.start))
        if rng.random() < 0.6:
            world.set_leaf(then, rng.choice(["shut", "away"]))
    if rng.random() < 0.3:
        world.problem.add_constraint(LE(first.end, rng.choice([3, 4])))
    world.turns(*rng.choice([(), (), ("away",), ("aside", "shut")]))
    return shuffled(world.problem, seed).problem
