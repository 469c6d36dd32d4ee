"""Nothing outlives its service, and nothing grows without bound."""

import gc
import math
import tracemalloc
import weakref

import pytest

from tests.motion.oracle import CAR, RECTANGLE, box_map
from up_samp.geometry.memory import Memory
from up_samp.model import (
    Body,
    Deadline,
    GroupQuery,
    Kinematics,
    MotionModel,
    Outcome,
    Placed,
    TimedMotion,
)
from up_samp.motion import MotionService
from up_samp.motion.fleet import paths
from up_samp.motion.protocol import body_key, obstacle_key

GRID = box_map(20, 10, [(9, 0, 10, 4), (9, 6, 10, 10)])
DOOR = Body(((-0.2, -1.2), (0.2, -1.2), (0.2, 1.2), (-0.2, 1.2)), CAR)


def use(service, body):
    """Ask a service for all that it does."""
    poses = ((4.0, 5.0, 0.0), (16.0, 5.0, 0.0))
    door = Placed("door", DOOR, (9.5, 5.0, 0.0))
    assert service.certificate(body, poses, (door,)) is not None
    motions = (
        TimedMotion("a", "A", body, poses, 0.0, 1e9),
        TimedMotion("b", "B", body, ((16.0, 8.0, math.pi), (4.0, 8.0, math.pi)), 0.0, 1e9),
    )
    report = service.coordinate(GroupQuery(motions), Deadline.after(60))
    assert report.outcome is Outcome.FOUND


@pytest.mark.parametrize("model", [MotionModel.REEDSSHEPP, MotionModel.SE2])
def test_services_are_collected_when_they_are_dropped(model):
    body = Body(RECTANGLE, Kinematics(model, 1.0, 2.0, 0.5))
    seen = []
    for _ in range(5):
        service = MotionService(GRID)
        use(service, body)
        seen += [weakref.ref(service), weakref.ref(service.scene), weakref.ref(service.certifier)]
        del service
    gc.collect()
    assert [ref() for ref in seen] == [None] * len(seen)


def test_memory_stays_flat_over_many_services():
    body = Body(RECTANGLE, CAR)
    use(MotionService(GRID), body)
    sizes = []
    tracemalloc.start()
    for _ in range(4):
        use(MotionService(GRID), body)
        gc.collect()
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert sizes[-1] - sizes[0] < 200_000


def test_shapes_are_forgotten():
    assert paths._hull.cache_info().maxsize == 1024


def test_a_memory_forgets_what_was_used_longest_ago():
    memory = Memory(2)
    made = []
    for key in ("a", "b", "a", "c", "a", "b"):
        memory.get_or(key, lambda key=key: made.append(key) or key)
    assert made == ["a", "b", "c", "b"]
    assert len(memory) == 2
    assert memory.get("c") is None
    with pytest.raises(ValueError, match="room"):
        Memory(0)


def test_a_mesh_counts_by_what_its_file_holds(tmp_path):
    one, two = tmp_path / "one.stl", tmp_path / "two.stl"
    one.write_text("solid a")
    two.write_text("solid a")
    kin = Kinematics(MotionModel.SE3)
    bodies = [Body(RECTANGLE, kin, str(p)) for p in (one, two)]
    assert body_key(bodies[0]) == body_key(bodies[1])
    before = body_key(bodies[0]), obstacle_key([Placed("p", bodies[0], (0.0, 0.0, 0.0))])
    one.write_text("solid another")
    after = body_key(bodies[0]), obstacle_key([Placed("p", bodies[0], (0.0, 0.0, 0.0))])
    assert before[0] != after[0]
    assert before[1] != after[1]


def test_a_control_law_keeps_its_key_for_itself():
    """A key holds the function: no other one can be at the same address meanwhile."""
    from up_samp.model.bodies import ControlLaw

    def key(function):
        law = ControlLaw(function, (("v", -1.0, 1.0),))
        return body_key(Body(RECTANGLE, Kinematics(MotionModel.CONTROL, control=law)))

    keys = []
    for i in range(50):
        keys.append(key(lambda q, u, dq, i=i: None))
    assert len(set(keys)) == 50
