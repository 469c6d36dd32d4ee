"""Loads that ride: search, validator and a judge of samples agree before, during and after."""

import itertools
import math

import numpy as np
import pytest
import shapely
from unified_planning.engines import PlanGenerationResultStatus as Status

from tests.soundness.coarse import Coarse
from tests.soundness.judge import judge, solve
from tests.soundness.worlds import (
    BOX,
    CRATE,
    DOOR,
    PACK,
    PLACES,
    SECONDS,
    build,
    pack_at,
    placed,
    random_ride,
    write_rooms,
)
from tests.usual import usually
from up_samp.model import CandidateSchedule
from up_samp.upio import build_plan
from up_samp.validation import validate_plan

SEEDS = (1, 5, 12)
LARGE = tuple((4 * x, 4 * y) for x, y in PACK)
"""A pack that reaches far out to the sides of who carries it."""
DEEP = 0.02
"""Metres that bodies are into each other by where samples surely show it."""
WALLS = shapely.union_all(
    [
        shapely.box(-1, -1, 0.1, 7),
        shapely.box(9.9, -1, 11, 7),
        shapely.box(-1, -1, 11, 0.1),
        shapely.box(-1, 5.9, 11, 7),
        shapely.box(4.9, 0, 5.1, 2.2),
        shapely.box(4.9, 3.8, 5.1, 6),
    ]
)


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    return write_rooms(tmp_path_factory.mktemp("rooms"))


class Film:
    """Where everything is at each time of a plan, by its activities and trajectories alone."""

    def __init__(self, world, plan, pack):
        self.world, self.plan, self.pack = world, plan, pack
        self.ends = {a.name: int(plan.get(a.end).constant_value()) for a in plan.activities}
        self.drives = [d for d in world.drives if d.name in self.ends]

    def robot(self, name, time):
        mine = [self.plan.trajectories[d.name] for d in self.drives if d.robot == name]
        begun = [t for t in sorted(mine, key=lambda t: t.start) if t.start <= time]
        return begun[-1].at(time) if begun else PLACES[dict(self.world.robots)[name]]

    def rides(self, drive, time):
        own = self.plan.trajectories[drive.name]
        return drive.name in self.world.carried and own.start < time < own.end

    def bodies(self, time):
        found = {n: placed(BOX, self.robot(n, time)) for n, _ in self.world.robots}
        spots = {"door": self.world.door, "crate": self.world.crate}
        for change in sorted(self.world.changes, key=lambda c: self.ends.get(c.name, math.inf)):
            if self.ends.get(change.name, math.inf) * SECONDS <= time:
                spots["door"] = change.goal
        shapes = {"door": DOOR, "crate": CRATE}
        found |= {n: placed(shapes[n], PLACES[p]) for n, p in spots.items() if p is not None}
        carried = [d for d in self.drives if d.name in self.world.carried]
        pose = pack_at(carried[0].start)
        for drive in sorted(carried, key=lambda d: self.plan.trajectories[d.name].start):
            if self.rides(drive, time):
                x, y, turn = self.robot(drive.robot, time)
                pose = x + 0.5 * math.cos(turn), y + 0.5 * math.sin(turn), turn
            elif self.plan.trajectories[drive.name].end <= time:
                pose = pack_at(drive.goal)
        return found | {"pack": placed(self.pack, pose)}

    def crashes(self, step=0.05):
        """Yield (time, drive, what) for each sample at which a drive has met what it heeds."""
        for drive in self.drives:
            own = self.plan.trajectories[drive.name]
            for time in np.arange(own.start + step, own.end, step):
                bodies = self.bodies(time)
                mine = {drive.robot} | ({"pack"} if drive.name in self.world.carried else set())
                others = {"walls": WALLS} | {
                    n: b
                    for n, b in bodies.items()
                    if n not in mine and (drive.heeds is None or n in drive.heeds)
                }
                for part, (name, other) in itertools.product(mine, others.items()):
                    if bodies[part].buffer(-DEEP).intersects(other):
                        yield time, drive.name, name


def agree(rooms, seed):
    """Solve the world of a seed; return what the judges do not agree about, and how many plans
    they refuse with a larger pack.
    """
    world = random_ride(seed)
    problem, larger = (build(world, rooms, pack=shape) for shape in (PACK, LARGE))
    coarse = Coarse(world, problem)
    plans = [
        build_plan(problem, coarse.snapshot, CandidateSchedule(times), found)
        for times, found in coarse.sample(7, 3, 4.0)
    ]
    result = solve(problem)
    assert result.status is not Status.INTERNAL_ERROR, result.log_messages
    plans += [result.plan] if result.plan is not None else []
    wrong, refused = [], 0
    for plan in plans:
        verdict = validate_plan(problem, plan, seconds_per_unit=SECONDS)
        crash = next(Film(world, plan, PACK).crashes(), None)
        if not verdict.valid or crash is not None:
            wrong.append((seed, verdict.violations[:1], crash))
        crash = next(Film(world, plan, LARGE).crashes(), None)
        verdict = validate_plan(larger, plan, seconds_per_unit=SECONDS)
        refused += not verdict.valid
        if crash is not None and verdict.valid:
            wrong.append((seed, "a larger pack", crash))
    return wrong, refused, len(plans)


@pytest.mark.parametrize("seed", usually(12, of=SEEDS))
def test_worlds_with_a_ride(rooms, seed):
    found = judge(random_ride(seed), rooms, samples=10, seconds=4.0)
    assert found.wrong == []
    assert found.motion == []


@pytest.mark.parametrize("seed", usually(5, of=SEEDS))
def test_judges_agree_about_rides(rooms, seed):
    wrong, _, plans = agree(rooms, seed)
    assert wrong == []
    assert plans > 1


@pytest.mark.long
@pytest.mark.parametrize("first", range(0, 200, 20))
def test_many_worlds_with_a_ride(rooms, first):
    wrong, refused, plans = [], 0, 0
    for seed in range(first, first + 20):
        if random_ride(seed) is None:
            continue
        found = judge(random_ride(seed), rooms, seconds=8.0)
        wrong += [(seed, w) for w in found.wrong + found.motion]
        differ, some, count = agree(rooms, seed)
        wrong, refused, plans = wrong + differ, refused + some, plans + count
    assert wrong == []
    assert 0 < refused < plans  # larger packs are in the way of some
