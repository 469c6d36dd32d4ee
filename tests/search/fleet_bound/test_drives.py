"""The planner's own durations of drives, which relative bounds rest on."""

from up_samp.benchmarks.builders.warehouse import warehouse
from up_samp.geometry import lay_out
from up_samp.model import Deadline, PathQuery
from up_samp.search.params import Parameters
from up_samp.search.session import open_service
from up_samp.upio import read_problem


def test_a_drive_takes_no_less_than_its_bound_and_as_long_the_other_way_round():
    snapshot, grid = lay_out(read_problem(warehouse(3, 3, encoding="compact")))
    service = open_service(snapshot, grid, Parameters())
    pose = snapshot.configurations
    for name in ("robot0", "robot1", "robot2"):
        body, start = snapshot.objects[name].body, pose[snapshot.initial[name]]
        ways = (start, pose["slot0"]), (pose["slot0"], start)
        there, back = (service.plan(PathQuery(body, w, ()), Deadline.after(60.0)) for w in ways)
        assert there.complete
        assert abs(there.trajectory.duration - back.trajectory.duration) < 1e-9
        least = service.lower_bound(body, (start, pose["slot0"]))
        assert there.trajectory.duration >= least > 0.0
