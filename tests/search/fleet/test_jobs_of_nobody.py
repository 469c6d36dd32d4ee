"""Large problems with a job that nobody can do: that is proven, and said by the place's name."""

import random

from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.shortcuts import OneshotPlanner

from up_samp import Fleet


def site(place, seed=0):
    """Return the problem of a fleet in two rooms, of whose orders one waits at ``place``."""
    rng = random.Random(seed)
    fleet = Fleet("examples/maps/two_rooms.yaml")
    fleet.add_robot_type("amr", (0.8, 0.6), model="omni")
    spots = {f"p{i}": (2.0 + 2.0 * (i % 3), 9.0 + 2.0 * (i // 3)) for i in range(5)}
    spots |= {"odd": place, "station": (11.0, 8.0), "first": (3.0, 3.0), "second": (11.0, 3.0)}
    for name in rng.sample(sorted(spots), len(spots)):
        fleet.add_place(name, *spots[name])
    for name, start in rng.sample([("r0", "first"), ("r1", "second"), ("r2", "station")], 3):
        fleet.add_robot(name, "amr", start=start)
    for name in rng.sample(["odd", *(f"p{i}" for i in range(5))], 6):
        fleet.add_order(f"from_{name}", name, "station")
    problem = fleet.problem
    rng.shuffle(problem.activities)
    return problem


def test_a_place_in_a_wall_is_named():
    problem = site((0.1, 8.0))
    assert sum(a.optional for a in problem.activities) >= 100
    with OneshotPlanner(name="samp-refine[cpsat]", params={"seed": 0}) as planner:
        result = planner.solve(problem, timeout=60)
    assert result.status is Status.UNSOLVABLE_PROVEN
    told = " ".join(message.message for message in result.log_messages)
    assert "'odd'" in told
    assert "'p0'" not in told
