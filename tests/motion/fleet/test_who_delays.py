"""Who is named as what a late motion rests on: without anybody else it is as late."""

import random

import pytest

from tests.motion.fleet import tight_places as tight
from up_samp.model import Deadline, GroupQuery, Outcome, PathQuery, Placed, Rest, TimedMotion
from up_samp.motion.fleet import coordinate
from up_samp.motion.service import MotionService

START, GOAL = (2.0, 5.0, 0.0), (18.0, 5.0, 0.0)


def crowded(seed):
    """Return who plans, and a drive as quick as it is alone, past robots that stand here and there,
    on its way and beside: some all the time, some that leave or come meanwhile.
    """
    rng = random.Random(f"crowded {seed}")
    service = MotionService(tight.hall(20, 10, [(0.2, 0.2, 19.8, 9.8)]))
    body = tight.BODIES[rng.choice(["omni", "differential"])]()
    rests = []
    for n in range(rng.choice([1, 2, 3, 4])):
        pose = (
            rng.uniform(4.5, 15.5),
            rng.choice([5.0, rng.uniform(1, 9)]),
            rng.choice([0.0, 1.57]),
        )
        times = rng.choice(
            [(), (), (), {"until": rng.uniform(2, 12)}, {"since": rng.uniform(2, 12)}]
        )
        there = [Placed(r.name, r.body, r.pose) for r in rests]
        if not service.pose_blockers(body, pose, there)[1]:
            rests.append(Rest(f"r{n}", body, pose, **dict(times)))
    alone = service.plan(PathQuery(body, (START, GOAL), ()), Deadline.after(60))
    go = TimedMotion("go", "robot", body, (START, GOAL), 0.0, alone.trajectory.duration + 1e-6)
    return service, go, rng.sample(rests, len(rests))


def late(service, motion, rests):
    """Return when a motion arrives that is late (None: it is not), and who is named."""
    report = coordinate(service, GroupQuery((motion,), tuple(rests)), Deadline.after(300))
    assert report.outcome is Outcome.FOUND
    assert report.complete
    return report.late.get("go"), report.blockers


def unnamed(seed):
    """Return whether a motion is late, and by how much (s) less without those who are not named."""
    service, motion, rests = crowded(seed)
    arrival, named = late(service, motion, rests)
    if arrival is None:
        return False, 0.0
    alone, _ = late(service, motion, [r for r in rests if r.name in named])
    return True, arrival - (alone or motion.due)


@pytest.mark.parametrize(
    "first", [0, *(pytest.param(n, marks=pytest.mark.long) for n in (50, 100))]
)
def test_nobody_else_makes_a_motion_late(first):
    rows = {seed: unnamed(seed) for seed in range(first, first + (8 if first == 0 else 50))}
    assert {seed: less for seed, (_, less) in rows.items() if less > 0.05} == {}
    assert sum(is_late for is_late, _ in rows.values()) > 3
