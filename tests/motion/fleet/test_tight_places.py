"""Groups that no order of priorities gets through, for every kind of body."""

import pytest

from tests.motion.fleet import tight_places as tight
from tests.motion.fleet.independent import judge
from up_samp.model import Deadline, Outcome
from up_samp.motion.fleet import coordinate
from up_samp.motion.fleet.deadlocks import Agent, Joint
from up_samp.motion.fleet.roadmap import Roadmap
from up_samp.motion.service import MotionService

SLOW = {"square of ten", "full ring of six"}
SLOW |= {f"room of nine, {sort}" for sort in ("four", "four small", "seven")}
SLOWER = {("differential", "door both ways"), ("differential", "square of six")}
SLOWER |= {("omni", "door both ways")}
SLOWER |= {("differential", "full ring of three"), ("omni", "pocket")}
SLOWER |= {("differential", case) for case in ("lay-by", "ring of three", "ring of four")}
SLOWER |= {("differential", "full ring, three speeds"), ("omni", "full ring, three speeds")}


def solve(traffic, seconds=300.0):
    service = MotionService(traffic.grid)
    return coordinate(service, traffic.query, Deadline.after(seconds))


def everything():
    for name, case in tight.CASES.items():
        for kind in case.bodies:
            slow = (kind == "car" and name != "pocket") or name in SLOW or (kind, name) in SLOWER
            yield pytest.param(name, kind, marks=[pytest.mark.long] if slow else [])


@pytest.mark.parametrize(("case", "kind"), list(everything()))
def test_everybody_gets_through(case, kind, tmp_path):
    traffic = tight.CASES[case].build(tight.BODIES[kind]())
    total = judge(traffic, solve(traffic), tmp_path)
    if case == "pocket" and kind != "differential":
        # alone both need 15.4 s; one of them has to get out of the way for the other
        assert 2 * 15.4 < total < 41.0


def test_an_l_slides_round_a_corner_wherever_it_starts(tmp_path):
    grid = tight.corner().grid
    for start, goal in (((1.9, 1.013), (6.987, 5.5)), ((2.9, 1.028), (6.973, 6.4))):
        ends = [((*start, 0.0), (*goal, 0.0))]
        traffic = tight.Traffic("corner", grid, tight.drives(tight.omni(tight.ELL), ends))
        judge(traffic, solve(traffic), tmp_path)


@pytest.mark.long
def test_no_room_at_all_is_not_called_impossible():
    grid = tight.hall(20, 10, [(0, 4.2, 20, 5.8)])
    body = tight.omni()
    ends = [((2.0, 5.0, 0.0), (18.0, 5.0, 0.0)), ((18.0, 5.0, 0.0), (2.0, 5.0, 0.0))]
    report = solve(tight.Traffic("corridor", grid, tight.drives(body, ends)), 60.0)
    assert report.outcome is Outcome.NOT_FOUND  # nobody has proven it
    assert report.conflict == {"go0", "go1"}


def joint(traffic, body, cell=1.0):
    service = MotionService(traffic.grid)
    ends = [pose for m in traffic.query.motions for pose in m.poses]
    roadmap = Roadmap(service.scene, body, ends, (), cell)
    agents = []
    for m in traffic.query.motions:
        goal = roadmap.place(m.poses[-1])
        agents.append(Agent(roadmap, roadmap.place(m.poses[0]), goal, roadmap.to_go(goal)))
    heeds = [[i != j for j in range(len(agents))] for i in range(len(agents))]
    return Joint(agents, heeds, 0.01)


def test_joint_moves_lead_from_start_to_goal_one_by_one():
    search = joint(tight.puzzle(tight.omni()), tight.omni())
    steps = search.search(10_000, Deadline.never())
    assert steps is not None
    at = [agent.start for agent in search.agents]
    for step in steps:
        order = search.in_turns(step)
        assert order is not None
        for i in order:
            assert step[i].source == at[i]
            rests = [(j, search.agents[j].roadmap.rest(at[j])) for j in range(len(at)) if j != i]
            assert not any(search.overlap(i, step[i], j, rest) for j, rest in rests)
            at[i] = step[i].target
    assert at == [agent.goal for agent in search.agents]


def test_same_seed_same_answer():
    traffic = tight.puzzle(tight.omni())
    first, second = (solve(traffic).trajectories for _ in "ab")
    for name in first:
        assert (first[name].times == second[name].times).all()
        assert (first[name].poses == second[name].poses).all()
