"""From a sequence of tasks that bounds were sought among to a schedule."""

from __future__ import annotations

from up_samp.model import CandidateSchedule
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.decoder import Step
from up_samp.scheduling.cpsat.routing.dispatch import Work
from up_samp.scheduling.cpsat.routing.expand import changes_by_name, expand
from up_samp.scheduling.cpsat.routing.sequences import Found, Sequences


def steps_of(work: Work, sequences: Sequences, found: Found) -> list[Step]:
    """Return who does which task, in the order of a sequence."""
    rules = sequences.rules
    numbers = {id(task): number for number, task in enumerate(work.tasks)}
    steps = []
    for choice in (rules.choices[number] for number, _ in found):
        task = rules.programme.tasks[choice.task]
        place = rules.ways[choice.traveller].places[choice.place]
        ways = enumerate(task.ways)
        way = next(w for w, (r, _, some) in ways if r == choice.traveller and place in some)
        steps.append((numbers[id(task)], way))
    return steps


def times_of(
    model: ScheduleModel, work: Work, sequences: Sequences, found: Found
) -> CandidateSchedule:
    """Return the schedule of a sequence, with moves put in. It may break what sequences leave out;
    mostly it does not.
    """
    times = {}
    steps = steps_of(work, sequences, found)
    for (number, way), (_, start) in zip(steps, found, strict=True):
        task = work.tasks[number]
        times[task.ways[way][1]] = (start, start + task.length)
    return expand(work.routes, CandidateSchedule(times), changes_by_name(model))
