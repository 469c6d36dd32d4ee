"""Make a UP plan of a plan dictionary again, to validate or to reuse it."""

from __future__ import annotations

from typing import Any

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.io.files import check_plan
from up_samp.io.plan_dict import PlanDict
from up_samp.io.sampling import rows_trajectory
from up_samp.model import CandidateSchedule, ProblemError, Trajectory
from up_samp.model.errors import short
from up_samp.model.schedule import Value
from up_samp.upio.movers import named_as_planned
from up_samp.upio.plan import SampSchedule, build_plan, trajectory_key
from up_samp.upio.read import read_problem


def plan_from_dict(problem: SchedulingMotionProblem, plan: PlanDict) -> SampSchedule:
    """Return the UP plan that ``plan`` holds, with its trajectories.

    It is read, not judged: use the validator on it. Raises :class:`ProblemError` where names of
    activities, objects or parameters do not fit the problem.
    """
    check_plan(plan, "the plan")
    unit = plan["seconds_per_unit"]
    snapshot = read_problem(named_as_planned(problem, plan), unit)
    known = {a.name: a for a in problem.activities}
    times: dict[str, tuple[int, int]] = {}
    parameters: dict[str, Value] = dict(plan.get("parameters", {}))
    for entry in plan["activities"]:
        name = entry["name"]
        if name in times:
            raise ProblemError(f"the plan has activity '{name}' twice")
        if name not in known:
            raise ProblemError(f"the plan's activity '{name}' is not in problem '{snapshot.name}'")
        times[name] = (_whole(entry, "start"), _whole(entry, "end"))
        given = entry.get("parameters", {})
        for parameter in known[name].parameters:
            own = parameter.name.removeprefix(f"{name}.")
            if own not in given:
                raise ProblemError(f"the plan gives activity '{name}' no parameter '{own}'")
            parameters[parameter.name] = given[own]
            _check_value(problem, parameter.type, f"parameter '{own}' of '{name}'", given[own])
    missing = [v.name for v in problem.base_variables if v.name not in parameters]
    if missing:
        raise ProblemError(f"the plan gives the variable '{missing[0]}' no value")
    for v in problem.base_variables:
        _check_value(problem, v.type, f"variable '{v.name}'", parameters[v.name])
    trajectories: dict[str, Trajectory] = {}
    samples: dict[tuple[str, str], Any] = {}
    for motion in plan["motions"]:
        key = (motion["activity"], motion["object"])
        if key in samples:
            raise ProblemError(f"the plan has two motions of '{key[1]}' in activity '{key[0]}'")
        samples[key] = motion["samples"]
    for task in snapshot.tasks:
        if task.activity in times:
            rows = samples.get((task.activity, task.object))
            if rows is None:
                raise ProblemError(
                    f"the plan has no motion of '{task.object}' in activity '{task.activity}'"
                )
            trajectories[trajectory_key(task.activity, task.index)] = rows_trajectory(rows)
    candidate = CandidateSchedule(times, parameters)
    return build_plan(problem, snapshot, candidate, trajectories, plan.get("margin"))


def _check_value(problem: SchedulingMotionProblem, tpe: Any, what: str, value: Value) -> None:
    """Raise :class:`ProblemError` where ``value`` is none of the type ``tpe``."""
    if tpe.is_user_type():
        known = isinstance(value, str) and problem.has_object(value)
        good = known and tpe.is_compatible(problem.object(value).type)
    elif tpe.is_bool_type():
        good = isinstance(value, bool)
    else:
        good = isinstance(value, int | float) and not isinstance(value, bool)
    if not good:
        raise ProblemError(
            f"the plan gives {what} the value {short(value)}, which is no {tpe} of the problem"
        )


def _whole(entry: dict[str, Any], key: str) -> int:
    value = entry[key]
    if not isinstance(value, int | float) or value != int(value):
        raise ProblemError(f"activity '{entry['name']}' has the {key} {value!r}, no whole number")
    return int(value)
