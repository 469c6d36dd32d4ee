"""Plan files of motion effects whose configuration a fluent tells."""

import pytest
from unified_planning.shortcuts import LE, OneshotPlanner

from tests.upio.hall import Hall
from up_samp.io import contradictions, plan_from_dict, read_plan, result_to_dict, write_plan
from up_samp.validation import validate_plan


@pytest.mark.parametrize("late", [False, True])
def test_a_fluent_tells_where_a_door_goes(tmp_path, late):
    hall = Hall(tmp_path, door=True)
    problem = hall.problem
    hall.pose("aside", 10.0, 8.5, 0.0)
    to = problem.add_fluent("to", hall.place, default_initial_value=hall.poses["away"])
    tell = problem.add_activity("tell", 3)
    tell.add_effect(tell.end, to, hall.poses["aside"])
    opening = problem.add_motion_activity("open", 1)
    opening.add_motion_effect(hall.door, to())
    first, then = (tell, opening) if late else (opening, tell)
    problem.add_constraint(LE(first.end, then.start))
    hall.move("go", 0, "left0", "right0")
    with OneshotPlanner(name="samp-refine[cpsat]", params={"first_plan": True}) as planner:
        result = planner.solve(problem, timeout=60)
    data = result_to_dict(problem, result)
    (change,) = data["changes"]
    assert change["configuration"] == ([10.0, 8.5, 0.0] if late else [10.0, 1.5, 0.0])
    again = read_plan(write_plan(tmp_path / "plan.json", data))
    assert contradictions(problem, again) == []
    assert validate_plan(problem, plan_from_dict(problem, again)).valid
    # one of the other poses is not what the fluent told
    wrong = "right0" if late else "aside"
    pose = hall.poses[wrong].configuration
    change["configuration"] = [pose.x, pose.y, pose.theta]
    (said,) = contradictions(problem, data)
    assert said.startswith("the change of 'door' by activity 'open' has configuration")
