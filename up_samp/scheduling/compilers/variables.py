"""Global decision variables to parameters of an auxiliary activity.

For engines that do not report values of variables that belong to no activity (aries 0.5.0).
"""

from __future__ import annotations

from dataclasses import replace

from up_samp.model import CandidateSchedule
from up_samp.scheduling.compilers.expressions import integer, start
from up_samp.scheduling.compilers.fresh import fresh, names_in_use
from up_samp.scheduling.compilers.plain import Activity, Compiled, PlainProblem


def compile_variables(problem: PlainProblem) -> Compiled:
    """Give all global variables to one activity of no duration at time 0."""
    if not problem.variables:
        return Compiled(problem)
    name = fresh("variables", names_in_use(problem))
    owner = Activity(name, False, integer(0), integer(0), tuple(problem.variables.items()))
    compiled = replace(
        problem,
        activities=(*problem.activities, owner),
        constraints=(*problem.constraints, ("le", start(name), integer(0))),
        variables={},
    )

    def map_back(schedule: CandidateSchedule) -> CandidateSchedule:
        times = {a: t for a, t in schedule.times.items() if a != name}
        return CandidateSchedule(times, schedule.parameters)

    return Compiled(compiled, map_back)


def compile_anchor(problem: PlainProblem) -> Compiled:
    """Add an activity of no duration where none has to be present: cpse 0.1.0 finds no makespan
    in a problem without activities, and calls it unsolvable.
    """
    if any(not a.optional for a in problem.activities):
        return Compiled(problem)
    name = fresh("anchor", names_in_use(problem))
    anchor = Activity(name, False, integer(0), integer(0))
    compiled = replace(problem, activities=(*problem.activities, anchor))

    def map_back(schedule: CandidateSchedule) -> CandidateSchedule:
        times = {a: t for a, t in schedule.times.items() if a != name}
        return CandidateSchedule(times, schedule.parameters)

    return Compiled(compiled, map_back)
