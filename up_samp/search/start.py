"""Begin from a plan: the first step of a search that is given one (an old plan, or another's).

What the plan does is kept: its activities are scheduled anew, as near to their old times as the
problem asks, their motions are checked, and given the time that they need now. Only what the plan
drives is looked at before, so that this takes a fraction of a second where the plan still fits;
where it does not, the search begins as if there were none, with the plan as the scheduler's hint.
"""

from __future__ import annotations

from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Plan, Schedule

from up_samp.model import CandidateSchedule, ProblemError, ScheduledMotion
from up_samp.model.snapshot import TermKind
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.schedules import to_candidate
from up_samp.search.events import Phase
from up_samp.search.search import Search
from up_samp.upio import Relaxation
from up_samp.upio.restrict import restrict


def start_of(problem: SchedulingProblem, plan: Plan) -> CandidateSchedule:
    """Return a UP plan as what to begin from: what it says of activities that the problem has.

    Activities that have to be present and are not in the plan are to begin at 0. Raises
    :class:`ProblemError` where the plan is no schedule.
    """
    if not isinstance(plan, Schedule):
        raise ProblemError(f"a search begins from schedules only, not from a {type(plan).__name__}")
    told = to_candidate(problem, plan)
    known = {a.name for a in problem.activities}
    times = {name: span for name, span in told.times.items() if name in known}
    for activity in problem.activities:
        if not activity.optional and activity.name not in times:
            least = activity.duration.lower
            times[activity.name] = (0, int(least.constant_value()) if least.is_constant() else 1)
    names = {p.name for p in problem.base_variables}
    names |= {p.name for a in problem.activities if a.name in times for p in a.parameters}
    values = {name: value for name, value in told.parameters.items() if name in names}
    return CandidateSchedule(times, values)


def motions_of(relaxation: Relaxation, start: CandidateSchedule) -> list[ScheduledMotion]:
    """Return the motions of a schedule from which values may be missing: those that can be told
    without them.
    """
    found = []
    for task in relaxation.snapshot.tasks:
        span = start.times.get(task.activity)
        if span is not None and all(t.kind is TermKind.CONSTANT for t in task.terms):
            names = tuple(t.name for t in task.terms)
            poses = tuple(relaxation.snapshot.configurations[n] for n in names)
            static = task.static or frozenset()
            found.append(
                ScheduledMotion(
                    task.activity, task.index, task.object, names, poses, *span, task.avoid, static
                )
            )
    return found


def near(search: Search, start: CandidateSchedule) -> CandidateSchedule | None:
    """Return a schedule of the relaxation with the activities of ``start``, near its times; None
    where there is none or it is not found in little time.
    """
    search.tell.stage(Phase.SCHEDULE)
    relaxation, snapshot = search.knowledge.relaxation, search.facts.snapshot
    # nothing decides the places of motions but the plan itself
    problem = restrict(relaxation, snapshot, start)
    session = CpsatSession(
        problem, seed=search.seed, workers=1, effort=search.tuning.start.effort, tuning=search.cpsat
    )
    report = session.solve(search.budget.deadline, optimal=False, hint=start)
    search.budget.seconds_scheduler += report.seconds
    if report.schedule is None:
        return None
    return CandidateSchedule(
        report.schedule.times, {**start.parameters, **report.schedule.parameters}
    )
