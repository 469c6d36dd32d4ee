"""Durations of drives, asked for one by one."""

from up_samp.benchmarks.warehouse import warehouse
from up_samp.geometry import lay_out
from up_samp.model import Deadline
from up_samp.search.fleet_bound.bound import DriveTimes
from up_samp.search.params import Parameters
from up_samp.search.session import open_service
from up_samp.upio import read_problem


def test_a_drive_takes_no_less_than_its_bound_and_is_asked_for_once():
    snapshot, grid = lay_out(read_problem(warehouse(3, 3, encoding="compact")))
    drives = DriveTimes(open_service(snapshot, grid, Parameters()))
    pose = snapshot.configurations
    for name in ("robot0", "robot1", "robot2"):
        body, start = snapshot.objects[name].body, pose[snapshot.initial[name]]
        there = drives.drive(body, start, pose["slot0"], Deadline.after(60.0))
        back = drives.drive(body, pose["slot0"], start, Deadline.after(60.0))
        assert there is not None
        assert back is not None
        assert there.complete
        # the same motion, the other way round
        assert abs(there.seconds - back.seconds) < 1e-9
        assert there.seconds >= drives.service.lower_bound(body, start, pose["slot0"]) > 0.0
        asked = drives.asked
        assert drives.drive(body, start, pose["slot0"], Deadline.after(60.0)) == there
        assert drives.asked == asked


def test_there_is_no_drive_into_a_wall():
    snapshot, grid = lay_out(read_problem(warehouse(2, 2, encoding="compact")))
    drives = DriveTimes(open_service(snapshot, grid, Parameters()))
    body, pose = snapshot.objects["robot0"].body, snapshot.configurations
    assert drives.drive(body, pose["slot0"], (0.0, 0.0, 0.0), Deadline.after(60.0)) is None
    assert drives.drive(body, pose["slot0"], pose["slot0"], Deadline.after(0.0)).seconds == 0.0
