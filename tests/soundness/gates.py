"""Random worlds of two rooms and a gap in whose doors lies all that is odd: two leaves, turned
together or one by one, opened, shut again and set aside; robots that drive by constants, fluents or
parameters and heed everything, lists, or dicts; crates, releases and orders.
"""

import random

from unified_planning.model import ClosedTimeInterval, Timing
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
    LE,
    ConfigurationType,
    Equals,
    Fluent,
    Iff,
    Implies,
    MinimizeMakespan,
    MovableType,
    Or,
)

from tests.shuffled import shuffled
from tests.soundness.worlds import BOX, CRATE, DOOR, LEFT, PLACES, RIGHT, write_rooms

HALF = ((-0.1, -0.4), (0.1, -0.4), (0.1, 0.4), (-0.1, 0.4))
LEAVES = {"shut1": (5.0, 2.6, 0.0), "shut2": (5.0, 3.4, 0.0)}
LEAVES |= {"open1": (5.0, 1.0, 0.0), "open2": (5.0, 5.0, 0.0)}
LIMITS = {"v_max": 1.0, "a_max": 0.5}


class Gates:
    """The problem of a seed."""

    def __init__(self, seed, folder):
        self.rng = rng = random.Random(f"gates {seed}")
        self.problem = problem = SchedulingMotionProblem(f"gates{seed}")
        area = OccupancyMap(str(write_rooms(folder)), (0, 0))
        self.spot = ConfigurationType("place", area, ConfigurationKind.SE2)
        self.place = {
            name: ConfigurationObject(name, self.spot, SE2(*pose))
            for name, pose in (PLACES | LEAVES | {"also_c": PLACES["c"]}).items()
        }
        problem.add_objects(self.place.values())
        self.style = rng.choice(["fluent", "constant", "parameter", "mixed"])
        self.told = self.style != "constant" or rng.random() < 0.5
        self.early = rng.choice([0, 1])
        self.robots, self.leaves, self.crates, self.drives = [], [], [], []
        self._robots()
        self._leaves()
        turns = [self._turn(k) for k in range(rng.choice([1, 1, 2, 3]))]
        for r in range(len(self.robots)):
            self._chain(r)
        if rng.random() < 0.3:
            drive, turn = rng.choice(self.drives), rng.choice(turns)
            pair = rng.sample([drive.present, turn.present], 2)
            problem.add_constraint(rng.choice([Implies, Iff])(*pair))
        if rng.random() < 0.3:
            first, then = rng.sample([rng.choice(self.drives), rng.choice(turns)], 2)
            scope = [a.present for a in (first, then) if a.optional]
            problem.add_constraint(LE(first.end, then.start), scope)
        problem.add_quality_metric(MinimizeMakespan())

    def _add(self, name, kind, shape, at, **model):
        model = model or {"motion_model": MotionModels.SE2}
        item = MovableObject(name, kind, footprint=list(shape), **model)
        self.problem.add_object(item)
        self.problem.set_initial_configuration(item, self.place[at])
        return item

    def _robots(self):
        rng, kind = self.rng, MovableType("robot")
        self.starts = rng.sample(["a", "b", "d", "c"], rng.choice([1, 2, 2, 3]))
        model = {"motion_model": MotionModels.SE2, "motion_parameters": LIMITS}
        if rng.random() < 0.3:
            car = {**LIMITS, "turning_radius": 0.5}
            model = {"motion_model": MotionModels.REEDSSHEPP, "motion_parameters": car}
        self.at = Fluent("at", self.spot, who=kind)
        if self.told:
            self.problem.add_fluent(self.at)
        for r, start in enumerate(self.starts):
            self.robots.append(self._add(f"r{r}", kind, BOX, start, **model))
            if self.told:
                self.problem.set_initial_value(self.at(self.robots[-1]), self.place[start])

    def _leaves(self):
        rng, kind = self.rng, MovableType("leaf")
        self.shut = rng.random() < 0.75
        self.leaf_at = Fluent("leaf_at", self.spot, who=kind) if rng.random() < 0.6 else None
        if self.leaf_at is not None:
            self.problem.add_fluent(self.leaf_at)
        made = [("door", DOOR, "shut", rng.choice(["away", "aside"]))]
        if rng.random() < 0.4:
            made = [(f"leaf{k}", HALF, f"shut{k}", f"open{k}") for k in (1, 2)]
        for name, shape, *where in made:
            here = where[not self.shut]
            self.leaves.append((self._add(name, kind, shape, here), *where))
            if self.leaf_at is not None:
                self.problem.set_initial_value(self.leaf_at(self.leaves[-1][0]), self.place[here])
        if rng.random() < 0.2:
            here = rng.choice(["corner", "gap"])
            self.crates.append(self._add("crate", MovableType("box"), CRATE, here))

    def _turn(self, k):
        rng = self.rng
        turn = self.problem.add_motion_activity(f"turn{k}", rng.choice([1, 2]), rng.random() < 0.6)
        opens = (k == 0) == self.shut if rng.random() < 0.8 else rng.random() < 0.5
        for leaf, shut, away in self.leaves if rng.random() < 0.7 else [rng.choice(self.leaves)]:
            to = self.place[away if opens else shut]
            turn.add_motion_effect(leaf, to)
            if self.leaf_at is not None:
                turn.add_effect(Timing(-self.early, turn.end), self.leaf_at(leaf), to)
        if self.told and rng.random() < 0.3:
            r = rng.randrange(len(self.robots))
            span = ClosedTimeInterval(Timing(0, turn.start), Timing(0, turn.end))
            turn.add_condition(span, Equals(self.at(self.robots[r]), self.place[self.starts[r]]))
        if rng.random() < 0.2:
            turn.add_release_date(rng.choice([1, 2]))
        return turn

    def _chain(self, r):
        """Add a robot's drives: one after the other, or one of two at last."""
        rng, here = self.rng, self.starts[r]
        for step in range(rng.choice([1, 1, 2])):
            goals = [p for p in (*LEFT, *RIGHT, "also_c") if p != here]
            ways = rng.choice([1, 1, 2])
            made = [self._drive(f"go{r}_{step}_{w}", r, here, goals, ways) for w in range(ways)]
            if ways > 1 and rng.random() < 0.8:
                self.problem.add_constraint(Or([drive.present for drive, _ in made]))
            if ways > 1 or self.style == "parameter":
                return
            here = made[0][1]

    def _drive(self, name, r, here, goals, ways):
        rng, robot = self.rng, self.robots[r]
        drive = self.problem.add_motion_activity(name, 1, ways > 1 or rng.random() < 0.3)
        drive.set_duration_bounds(1, 30)
        goal = rng.choice(goals)
        origin, to = self.place[here], self.place[goal]
        mixed = ["fluent", "constant", "parameter"]
        style = rng.choice(mixed) if self.style == "mixed" else self.style
        if style == "parameter":
            to = drive.add_parameter("to", self.spot)
            some = [Equals(to, self.place[p]) for p in rng.sample(goals, 2)]
            drive.add_constraint(Or(some))
        if style == "fluent" or (style == "parameter" and rng.random() < 0.5):
            origin = self.at(robot)
        drive.add_motion_constraint(ActivityWaypoints(robot, origin, [to], **self._heeded(robot)))
        if self.told:
            drive.add_effect(Timing(-self.early, drive.end), self.at(robot), to)
        if rng.random() < 0.15:
            drive.add_release_date(rng.choice([1, 2]))
        if rng.random() < 0.1:
            drive.add_deadline(rng.choice([4, 7]))
        self.drives.append(drive)
        return drive, goal

    def _heeded(self, robot):
        """Return the obstacles that a drive lists."""
        rng = self.rng
        style = rng.choice(["all", "all", "list", "dict"])
        if style == "all":
            return {}
        fluents = dict.fromkeys((leaf for leaf, *_ in self.leaves), self.leaf_at)
        fluents |= dict.fromkeys(self.robots, self.at if self.told else None)
        moving, still = [r for r in self.robots if r is not robot], []
        for thing in (*(leaf for leaf, *_ in self.leaves), *self.crates):
            rng.choice([still, still, moving, moving, []]).append(thing)
        if style == "dict" and all(fluents.get(x) is not None for x in (*moving, *still)):
            moving, still = ({x: fluents[x](x) for x in some} for some in (moving, still))
        return {"static_obstacles": still, "dynamic_obstacles_at_start": moving}


def gates(seed, folder):
    """Return the problem of a seed, listed anyhow."""
    return shuffled(Gates(seed, folder).problem, seed).problem
