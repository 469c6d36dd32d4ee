"""From UP's ``Schedule`` to :class:`CandidateSchedule` (back: ``upio/plan.py``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from up_samp.model import CandidateSchedule
from up_samp.model.schedule import Value

if TYPE_CHECKING:
    from unified_planning.model.scheduling import SchedulingProblem
    from unified_planning.plans import Schedule


def to_candidate(schedule: Schedule) -> CandidateSchedule:
    """Return times of the present activities and values of all parameters of a UP schedule.

    Raises:
        ValueError: a time is no integer.
    """
    from unified_planning.model import Parameter, Timepoint, TimepointKind

    assignment: dict[Any, int] = {}
    parameters: dict[str, Any] = {}
    for variable, value in schedule.assignment.items():
        if isinstance(variable, Timepoint):
            constant = value.constant_value()
            if constant != int(constant):
                raise ValueError(f"{variable} is at {constant}, which is not an integer")
            assignment[variable.container, variable.kind] = int(constant)
        elif isinstance(variable, Parameter):  # cpse lists presences as well
            parameters[variable.name] = (
                value.object().name if value.is_object_exp() else value.constant_value()
            )
    ends = (TimepointKind.START, TimepointKind.END)
    times = {
        a.name: (assignment[a.name, ends[0]], assignment[a.name, ends[1]])
        for a in schedule.activities
    }
    return CandidateSchedule(times, parameters)


def complete(problem: SchedulingProblem, candidate: CandidateSchedule) -> CandidateSchedule:
    """Return the candidate with some value for each variable that has none: engines leave out
    those that nothing constrains.
    """
    values: dict[str, Value] = dict(candidate.parameters)
    present = [a for a in problem.activities if a.name in candidate.times]
    for parameter in [*problem.base_variables, *(p for a in present for p in a.parameters)]:
        if parameter.name not in values:
            values[parameter.name] = _some_value(problem, parameter.type)
    return CandidateSchedule(candidate.times, values)


def _some_value(problem: SchedulingProblem, tpe: Any) -> Value:
    if tpe.is_bool_type():
        return False
    if tpe.is_user_type():
        return str(next(iter(problem.objects(tpe))).name)
    return int(tpe.lower_bound if tpe.lower_bound is not None else min(0, tpe.upper_bound or 0))
