"""What is not operated yet is refused by name, before a day begins."""

import pytest

from tests.operate.sites import hall
from up_samp.fleet.records import Order, Stop, Task
from up_samp.model import UnsupportedError
from up_samp.operate.planner import check_job, check_site

REFUSED = {
    "lifts": (lambda f: f.add_floor("first", "hall.yaml", 4.0), "floor 'first'"),
    "timetables": (
        lambda f: f.add_automatic_door("gate", [(1, 1), (2, 1), (2, 2)], shut=(9, 99)),
        "automatic door 'gate' has a timetable",
    ),
    "airlocks": (
        lambda f: f.add_automatic_door("gate", [(1, 1), (2, 1), (2, 2)], airlock="lock"),
        "automatic door 'gate' is one of an airlock",
    ),
    "batteries": (
        lambda f: f.add_robot_type("small", (0.5, 0.5), battery={"capacity": 9}),
        "robot type 'small' has a battery",
    ),
    "forks": (
        lambda f: f.add_robot_type("fork", (0.5, 0.5), unloading="lifo"),
        "robot type 'fork' unloads in an order",
    ),
    "set-ups": (
        lambda f: f.add_resource("press", setup={"red": {"blue": 9}}),
        "resource 'press' is set up",
    ),
    "batches": (lambda f: f.add_resource("oven", 3, batches=True), "or works in batches"),
    "buffers": (lambda f: f.add_place("shelf", 3, 11, room=2), "'shelf' has room for so many"),
    "stops": (
        lambda f: f.add_zone("x", [(1, 1), (2, 1), (2, 2)], stopping="never"),
        "zone 'x' forbids to stop",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused_by_name(what, tmp_path):
    fleet = hall(tmp_path)
    check_site(fleet.records)
    add, text = REFUSED[what]
    add(fleet)
    with pytest.raises(UnsupportedError, match=text):
        check_site(fleet.records)


@pytest.mark.parametrize(
    "job",
    [
        Order(id="beam", pickup=Stop(("a",)), delivery=Stop(("b",)), together=("front",)),
        Task(id="beam", at=("a", "b"), duration=3.0, crew=2),
    ],
)
def test_what_several_robots_do_together_is_refused_by_name(job):
    with pytest.raises(UnsupportedError, match="'beam' is done by a crew"):
        check_job(job)
