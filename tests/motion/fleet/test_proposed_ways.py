"""Ways that are proposed around somebody in a building can be driven, whatever the body."""

import itertools
import math
import random

import pytest

from tests.motion.fleet import tight_places as tight
from tests.usual import usually
from up_samp.model import Deadline, Rest, TimedMotion
from up_samp.motion.fleet.space_time import proposer_of
from up_samp.motion.fleet.workspace import rest_run, workspace_of
from up_samp.motion.service import MotionService


def building(rng):
    """Rooms on both sides of a corridor with a door each; also a pose in each room."""
    rooms, width, depth = rng.randint(3, 4), rng.uniform(5.0, 7.0), rng.uniform(4.0, 6.0)
    corridor, door, thick = rng.uniform(3.6, 4.2), rng.uniform(1.7, 2.2), rng.uniform(0.1, 0.4)
    total = rooms * width
    low, high = 0.5 + depth + thick, 0.5 + depth + thick + corridor
    free, poses, doors = [(0.5, low, 0.5 + total, high)], [], []
    for number in range(rooms):
        left, right = 0.5 + number * width + 0.1, 0.5 + (number + 1) * width - 0.1
        middle = 0.5 * (left + right) + rng.uniform(-0.5, 0.5)
        for wall, room in (
            ((low - thick, low), (0.5, low - thick)),
            ((high, high + thick), (high + thick, high + thick + depth)),
        ):
            free.append((left, room[0], right, room[1]))
            doors.append((middle, wall[0]))
            free.append((middle - 0.5 * door, wall[0], middle + 0.5 * door, wall[1]))
            x, y = rng.uniform(left + 1.2, right - 1.2), rng.uniform(room[0] + 1.2, room[1] - 1.2)
            poses.append((x, y, 0.0))
    rng.shuffle(free)
    rng.shuffle(poses)
    height = high + thick + depth + 0.5
    return tight.hall(total + 1.0, height, free), poses, (0.5 * (low + high), doors)


KINDS = ("differential", "omni", "car")


@pytest.mark.parametrize(
    ("seed", "kind"),
    usually(*enumerate(KINDS), of=itertools.product(range(3), KINDS)),
)
def test_ways_around_somebody_in_a_building_can_be_driven(kind, seed):
    rng = random.Random(f"{kind} {seed}")
    body = {
        "omni": tight.omni(tight.SMALL), "car": tight.car(tight.SMALL),
        "differential": tight.differential(tight.SMALL),
    }[kind]  # fmt: skip
    grid, poses, (middle, doors) = building(rng)
    service = MotionService(grid)
    workspace = workspace_of(service)
    asked = found = 0
    for start, goal in itertools.islice(itertools.permutations(poses, 2), 12):
        motion = TimedMotion("go", "mover", body, (start, goal), 0.0, 1e6)
        alone = workspace.path(body, motion.poses, (), Deadline.never())
        amid = [
            tuple(map(float, pose))
            for pose in alone.poses
            if abs(pose[1] - middle) < 0.8 and all(math.dist(pose[:2], d) > 2.2 for d in doors)
        ]
        if not amid:
            continue
        rest = rest_run(workspace, Rest("rests", body, amid[len(amid) // 2], -math.inf))
        way = proposer_of(workspace).propose(motion, [rest])
        asked += 1
        found += way is not None
        if way is not None:
            assert way.poses[-1][:2] == pytest.approx(goal[:2])
            assert way.natural.duration < 3.0 * alone.natural.duration + 20.0
    assert found >= 0.7 * asked > 0  # a corner of the lattice may be too near to a frame
