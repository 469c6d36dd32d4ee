"""What a search that found no plan in its time failed on is told in one sentence."""

from shapely.geometry import box

from up_samp import Fleet
from up_samp.fleet.importers import map_from_polygons
from up_samp.search.conclusion import what_was_hard
from up_samp.search.knowledge import CHECKING, SCHEDULING, History


def without_plan(tmp_path, floor, footprint, places, **tasks):
    """Return what is told of robots that start at the first places and find no plan."""
    fleet = Fleet(map_from_polygons(floor, tmp_path / "floor"))
    fleet.add_robot_type("agv", footprint=footprint, model="diff")
    for name, pose in places.items():
        fleet.add_place(name, *pose)
    for robot, (start, goal) in tasks.items():
        fleet.add_robot(robot, "agv", start=start)
        fleet.add_task(f"visit_{goal}", at=goal, duration=1, robots=robot)
    result = fleet.solve(timeout=2, reproducible=True, query_seconds=0.3)
    assert result.plan is None
    assert result.status == "TIMEOUT", result.explain()
    return result.outcome.log_messages[0].message


def test_a_drive_that_cannot_be_made_though_nothing_proves_it(tmp_path):
    bend = box(0, 0, 6, 4).union(box(5, 1.5, 10, 2.5)).union(box(9, 1.5, 10, 8))
    places = {"home": (3, 2), "far": (9.5, 6, 1.5708)}
    told = without_plan(tmp_path, bend, (3.0, 0.8), places, long=("home", "far"))
    assert told.startswith("no plan found in time: ")
    # on a busy machine only one of the two drives is looked at in this time
    ways = ("home_to_far (long from home to far)", "far_to_home (long from far to home)")
    assert any(f"checks failed on move_long_{way}" in told for way in ways)
    assert "most of the time went to" in told


def test_two_robots_that_cannot_pass_each_other(tmp_path):
    corridor = box(0, 0, 9, 1)
    places = {"left": (1, 0.5), "right": (8, 0.5), "west": (1.5, 0.5), "east": (7.5, 0.5)}
    tasks = {"r1": ("left", "east"), "r2": ("right", "west")}
    told = without_plan(tmp_path, corridor, (0.8, 0.6), places, **tasks)
    assert "checks failed on" in told
    assert "r1 from left to east" in told
    assert "r2 from right to west" in told


def test_a_robot_that_starts_in_touch_with_the_wall(tmp_path):
    places = {"home": (0.5, 2), "far": (5, 2)}
    told = without_plan(tmp_path, box(0, 0, 8, 4), (1.0, 0.8), places, long=("home", "far"))
    assert "touches the map or an obstacle: leave a millimetre" in told


def test_what_failed_most_often_and_what_took_the_time():
    history = History()
    assert what_was_hard(history).startswith("no schedule was found whose motions could be driven")
    history.stages.seconds |= {SCHEDULING: 1.0, CHECKING: 3.0}
    history.missed += ["a", "b", "a", "c"]
    assert what_was_hard(history) == (
        "2 of 4 checks failed on a; most of the time went to motions (3.0 of 4.0 s)"
    )
