"""Two robots that meet on one line pass each other where the way is wide enough for both."""

import itertools
import math

import pytest

from tests.motion.fleet import tight_places as tight
from tests.motion.fleet.independent import judge
from up_samp.model import Deadline, GroupQuery, TimedMotion
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.one_robot import pass_by
from up_samp.motion.fleet.timed_path import natural_timing, run_of
from up_samp.motion.fleet.workspace import workspace_of
from up_samp.motion.service import MotionService

TURNS = (0.0, math.pi)
SOME = [("omni", 1.45, 0.0), ("car", 1.45, math.pi), ("differential", 1.45, math.pi)]
SHAPE = ((-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (-0.4, 0.3))


def corridor(kind, width, turned, late=0.0):
    """Return two robots that swap the ends of a straight corridor, ``turned`` to each other or not.
    The second one leaves ``late`` s later.
    """
    grid = tight.hall(20, 4, [(1.0, 1.0, 19.0, 1.0 + width)])
    middle, body = 1.0 + 0.5 * width, tight.BODIES[kind](SHAPE)
    left, right = (2.0, middle, 0.0), (18.0, middle, turned)
    motions = (
        TimedMotion("there", "a", body, (left, (*right[:2], 0.0)), 0.0, 17.0),
        TimedMotion("back", "b", body, (right, (*left[:2], turned)), late, late + 17.0),
    )
    return tight.Traffic("corridor", grid, GroupQuery(motions))


@pytest.mark.parametrize(
    ("kind", "width", "turned"),
    [
        pytest.param(*case, marks=[] if case in SOME else [pytest.mark.long])
        for case in itertools.product(("omni", "car", "differential"), (1.45, 1.6, 2.0), TURNS)
    ],
)
def test_two_pass_each_other(kind, width, turned, tmp_path):
    traffic = corridor(kind, width, turned)
    report = coordinate(MotionService(traffic.grid), traffic.query, Deadline.after(200.0))
    judge(traffic, report, tmp_path)
    # nobody waits for the other one, 17 s is what it takes alone
    assert max(t.end for t in report.trajectories.values()) < 18.0


@pytest.mark.parametrize("late", [3.0, 11.0])
def test_they_pass_wherever_they_meet(late, tmp_path):
    traffic = corridor("differential", 1.5, math.pi, late)
    report = coordinate(MotionService(traffic.grid), traffic.query, Deadline.after(200.0))
    judge(traffic, report, tmp_path)
    assert all(t.end - t.start < 18.0 for t in report.trajectories.values())


@pytest.mark.parametrize(("width", "wide"), [(1.2, False), (1.45, True)])
def test_nobody_passes_where_there_is_no_room(width, wide):
    traffic = corridor("differential", width, 0.0)
    workspace, motions = workspace_of(MotionService(traffic.grid)), traffic.query.motions
    alone = {}
    for m in motions:
        path = workspace.path(m.body, m.poses, (), Deadline.never())
        alone[m.name] = run_of(m, path, natural_timing(path, m.release))
    assert (pass_by(workspace, motions, alone, ()) is not None) == wide
    assert pass_by(workspace, motions[:1], alone, ()) is None
