"""From values of a model's variables to a schedule, and back."""

from __future__ import annotations

from collections.abc import Callable

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.encode.forms import TRUE, Lin
from up_samp.scheduling.cpsat.model import ScheduleModel


def schedule_of(model: ScheduleModel, value: Callable[[int], int]) -> CandidateSchedule:
    """Return the schedule in a solution; ``value(var)`` gives each variable's value."""

    def worth(lin: Lin) -> int:
        return lin.const + sum(c * value(v) for v, c in lin.terms)

    times = {
        a.name: (worth(a.start), worth(a.end))
        for a in model.world.activities.values()
        if value(a.present)
    }
    names = {code: name for name, code in model.world.objects.items()}
    parameters: dict[str, bool | int | str] = {}
    for name, (var, tpe, owner) in model.parameters.items():
        if owner is not None and owner not in times:
            continue
        number = value(var)
        if tpe.is_bool_type():
            parameters[name] = bool(number)
        else:
            parameters[name] = names[number] if tpe.is_user_type() else number
    return CandidateSchedule(times, parameters)


def hint_values(model: ScheduleModel, schedule: CandidateSchedule) -> dict[int, int]:
    """Return variable -> value as ``schedule`` has it (only the main decisions)."""
    values = {model.world.makespan: schedule.makespan}
    for made in model.world.activities.values():
        times = schedule.times.get(made.name)
        if made.present != TRUE:
            values[made.present] = int(times is not None)
        if times is not None:
            values[made.start.terms[0][0]] = times[0]
            if made.size.terms:
                values[made.end.terms[0][0]] = times[1]
                values[made.size.terms[0][0]] = times[1] - times[0]
    for name, (var, tpe, _) in model.parameters.items():
        if name in schedule.parameters:
            value = schedule.parameters[name]
            code = model.world.objects[str(value)] if tpe.is_user_type() else int(value)
            values[var] = code
    return values
