"""From UP's ``Schedule`` to :class:`CandidateSchedule` (back: ``upio/plan.py``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from up_samp.model import CandidateSchedule

if TYPE_CHECKING:
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
