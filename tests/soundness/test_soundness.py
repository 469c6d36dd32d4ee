"""Nothing that is called proven, optimal or unsolvable is contradicted by the coarse search."""

import pytest

from tests.soundness.coarse import Coarse, makespan_of
from tests.soundness.judge import judge
from tests.soundness.worlds import Change, Drive, World, build, random_world, write_rooms
from tests.usual import usually
from up_samp.model import CandidateSchedule, Deadline, ScheduledMotion
from up_samp.refinement import rules

SEEDS = (1, 3, 5, 7, 8, 13, 14, 22, 26, 35, 46, 48)
"""Quick ones of all sorts: optimal, unsolvable, cars and free robots, doors opened and closed."""


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    return write_rooms(tmp_path_factory.mktemp("rooms"))


@pytest.mark.parametrize("seed", usually(3, 5, 7, 13, 14, of=[*SEEDS, 7017]))
def test_random_worlds(rooms, seed):
    found = judge(random_world(seed), rooms, samples=10, seconds=4.0)
    assert found.wrong == []
    assert found.motion == []
    assert found.costly == []


@pytest.mark.long
@pytest.mark.parametrize("first", range(0, 200, 10))
def test_many_random_worlds(rooms, first):
    wrong = {}
    for seed in range(first, first + 10):
        found = judge(random_world(seed), rooms, seconds=8.0)
        if found.wrong or found.motion:
            wrong[seed] = found.wrong + found.motion
    assert wrong == {}


def drive(name, robot, start, goal, **options):
    return Drive(name, robot, start, goal, **options)


def world(drives, changes=(), *, door=None, car=True, **options):
    robots = (("r0", "a"), ("r1", "b"))
    return World(0, car, robots, tuple(drives), tuple(changes), door, **options)


def test_a_door_may_be_set_elsewhere_again_behind_a_robot(rooms):
    """Where the way is open, further changes of the door are not kept apart from the motion."""
    changes = [Change("open", "away"), Change("open_more", "aside", release=2)]
    case = world([drive("go", "r0", "a", "c", deadline=4)], changes, door="shut")
    found = judge(case, rooms)
    assert found.status == "SOLVED_OPTIMALLY"
    assert found.wrong == []


def test_a_door_may_close_the_moment_a_motion_ends(rooms):
    """Also where it is a static obstacle of the motion."""
    for static in ((), ("door",)):
        go = drive("go", "r0", "a", "c", heeds=("r1", "door"), static=static)
        changes = [Change("open", "away"), Change("close", "shut", release=2, deadline=4)]
        found = judge(world([go], changes, door="shut"), rooms, samples=60)
        assert found.status == "SOLVED_OPTIMALLY"
        assert found.wrong == []


def test_who_does_not_heed_the_door_is_not_bound_by_it(rooms):
    """A proof for one motion is no proof for an equal one that ignores the obstacle."""
    both = [
        drive("heeding", "r0", "a", "c", optional=True),
        drive("blind", "r0", "a", "c", optional=True, heeds=("r1",)),
    ]
    case = world(both, door="shut", either=(("heeding", "blind"),), crate="gap")
    found = judge(case, rooms)
    assert found.wrong == []
    assert found.status == "SOLVED_OPTIMALLY"


def test_a_door_that_closes_as_a_motion_begins(rooms):
    """A change that touches the motion's start leaves the cut no way out."""
    changes = [Change("close", "shut", release=0, deadline=1), Change("open", "away", release=3)]
    case = world([drive("go", "r0", "a", "c")], changes, door="away")
    found = judge(case, rooms, timeout=4.0)  # it looks for better plans as long as it may
    assert found.wrong == []
    assert found.status in ("SOLVED_OPTIMALLY", "SOLVED_SATISFICING")


def test_the_coarse_search_finds_the_known_optimum(rooms):
    case = world([drive("go", "r0", "a", "c")], [Change("open", "away", release=2)], door="shut")
    coarse = Coarse(case, build(case, rooms))
    times, _ = coarse.better_than(8, Deadline.after(120))
    # it waits before the door; the 4 m behind it take more than a unit, from rest
    assert times["open"] == (2, 3)
    assert makespan_of(times) == 5


def test_a_late_motion_may_pass_when_the_other_takes_its_time():
    """Who was in time may give way if it gets longer: the timing cut must not forbid that."""
    group = [
        ScheduledMotion(n, 0, f"robot_{n}", ("p", "q"), ((0, 0, 0), (1, 0, 0)), start, end)
        for n, start, end in (("a", 0, 10), ("b", 1, 10))
    ]
    cut = rules.group_timing(group, {"b": 12}, {}, {}, "late").statement
    nowhere = lambda *_: ()  # noqa: E731
    assert not cut.holds(CandidateSchedule({"a": (0, 10), "b": (1, 10)}), nowhere)
    assert cut.holds(CandidateSchedule({"a": (0, 11), "b": (1, 10)}), nowhere)


def test_a_timing_cut_gives_way_when_a_robot_drives_on():
    """How long somebody rests in the way is not for its own drive to tell, but for the next."""
    group = [
        ScheduledMotion(n, 0, f"robot_{n}", ("p", "q"), ((0, 0, 0), (1, 0, 0)), start, end)
        for n, start, end in (("a", 0, 2), ("b", 1, 3))
    ]
    cut = rules.group_timing(group, {"b": 4}, {}, {}, "late", rivals=["next"]).statement
    nowhere = lambda *_: ()  # noqa: E731
    assert not cut.holds(CandidateSchedule({"a": (0, 2), "b": (1, 3), "next": (4, 5)}), nowhere)
    assert cut.holds(CandidateSchedule({"a": (0, 2), "b": (1, 3), "next": (2, 3)}), nowhere)
