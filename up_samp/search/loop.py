"""The interleaving loop: Algorithm 1 of the paper, with bounds, certificates and incumbents.

``solve`` is the algorithm; each stage is one named call. Line numbers in comments are those of
Algorithm 1 (Tosello et al., ICAPS 2026).
"""

from __future__ import annotations

import time
from collections.abc import Generator
from dataclasses import replace

from up_samp.model import CandidateSchedule, Deadline, ScheduleReport
from up_samp.model.refinement import Refinement
from up_samp.search.check import Check, check_itinerary
from up_samp.search.conclusion import SearchResult, conclude, conclude_without_schedule
from up_samp.search.context import Context, Incumbent
from up_samp.search.cuts.exact import rejects
from up_samp.search.cuts.refused import cuts_from
from up_samp.search.handover import guess_handovers, state_handovers
from up_samp.search.history import Round
from up_samp.search.prepare import (
    state_bounds,
    state_certificates,
    state_durations,
    state_places,
)
from up_samp.search.repair import repair
from up_samp.search.slack import with_slack
from up_samp.search.trace import write_trace
from up_samp.upio import Itinerary, read_itinerary


def solve(context: Context, *, optimal: bool) -> Generator[Incumbent, None, SearchResult]:
    """Search for a plan; with ``optimal`` go on until its makespan meets the lower bound.

    Yields each plan that is better than all before it, and returns how the search ended.
    """
    state_what_is_known(context)
    while not context.deadline.expired():
        report = get_schedule(context, optimal=optimal)  # line 4
        if report.schedule is None or not is_better(context, report.schedule):
            ending = conclude_without_schedule(context, report)  # lines 18 to 20
            if ending is not None:
                return ending
            continue
        itinerary = read_itinerary(context.relaxation, with_slack(context, report.schedule))
        check = check_motions(context, itinerary)  # lines 6 to 15
        learned = learn_from(context, itinerary, check)  # lines 31 and 35
        found = adopt_or_repair(context, itinerary, check)  # line 16
        refused = learn_from_refusal(context, found)
        learned += refused
        better = None if refused else keep_if_better(context, found)
        record(context, replace(report, schedule=itinerary.schedule), check, learned)
        if better is not None:
            yield better
        if not refused and is_done(context, report, check, learned, optimal=optimal):
            break
    return conclude(context)


def state_what_is_known(context: Context) -> None:
    """Tell the scheduler, before it starts, what holds for any schedule (bounds first)."""
    started = time.monotonic()
    params = context.params
    stages = []
    if params.bounds_first:
        stages += [("lower bounds on motions", state_bounds)]
    if params.certificates:
        stages += [("proofs of unreachability", state_certificates)]
        if context.native:
            stages += [("places for one", state_places)]
    if params.bounds_first:
        stages += [("unobstructed motions", state_durations)]
        if params.profiles:
            stages += [("handing over places", state_handovers)]
    for name, stage in stages:
        context.report("prepare", name)
        context.learn(stage(context))
    context.history.seconds_motion = time.monotonic() - started
    write_trace(context, None, context.standing)


def get_schedule(context: Context, *, optimal: bool) -> ScheduleReport:
    """Invoke the scheduler on the relaxation and what was learned (line 4).

    Our own scheduler is asked for good schedules until there is a plan, and then for better ones
    and for proofs, with more and more time.
    """
    context.report("schedule", "scheduling")
    last = context.incumbent.schedule if context.incumbent else None
    proving = optimal and not (context.staged and last is None)
    report = context.scheduler.solve(
        schedule_deadline(context, proving=proving),
        optimal=proving,
        hint=last,
        lower_bound=None if context.heuristic else context.lower_bound,
    )
    context.history.seconds_scheduler += report.seconds
    if report.recognised or report.left_over:
        context.history.recognised = report.recognised
        context.history.left_over = report.left_over
    if report.bound is not None and not context.heuristic:
        context.lower_bound = max(context.lower_bound, report.bound)
    return report


def schedule_deadline(context: Context, *, proving: bool) -> Deadline:
    """Return by when the scheduler has to answer.

    Another's scheduler would have to begin anew after a limit; ours goes on from what it knows.
    """
    if not context.staged:
        return context.deadline
    if proving:
        return context.deadline.within(context.proof_seconds)
    if context.incumbent is None:
        return context.deadline.within(context.schedule_share * context.deadline.remaining())
    return context.deadline


def is_better(context: Context, schedule: CandidateSchedule) -> bool:
    """Return whether a candidate would be worth more than the best plan, if its motions fit."""
    upper = context.upper_bound
    return not context.staged or upper is None or schedule.makespan < upper


def check_motions(context: Context, itinerary: Itinerary) -> Check:
    """Check the candidate's motions (lines 8 to 15)."""
    context.report("motions", f"checking {len(itinerary.motions)} motions")
    return check_itinerary(context, itinerary, first_only=not context.params.small_cuts)


def adopt_or_repair(context: Context, itinerary: Itinerary, check: Check) -> Incumbent | None:
    """Return the candidate as a plan if its motions fit, else what can be made of it."""
    if check.passed:
        return Incumbent(itinerary.schedule, check.trajectories)
    if context.params.incumbents and not check.failed:
        context.report("repair", "giving motions the time they need")
        return repair(context, itinerary.schedule, check)
    return None


def learn_from_refusal(context: Context, found: Incumbent | None) -> list[Refinement]:
    """Let the independent validator judge a plan; learn cuts that forbid it if it is refused.

    Raises :class:`InvalidPlanError` where nothing new can be learned from the refusal.
    """
    refusals = context.validate(found) if found is not None else []
    if found is None or not refusals:
        return []
    texts = [f"{r.kind}: {r.what}" for r in refusals]
    cuts = cuts_from(context, found.schedule, refusals) if context.params.refine else []
    context.report("refused", texts[0])
    context.history.refused += texts
    if not context.learn(cuts):
        raise InvalidPlanError("; ".join(texts[:3]))
    return cuts


def keep_if_better(context: Context, found: Incumbent | None) -> Incumbent | None:
    """Make a valid plan the incumbent and return it, if it is the best so far."""
    upper = context.upper_bound
    if found is None or (upper is not None and found.schedule.makespan >= upper):
        return None
    context.incumbent = found
    context.report("plan", f"plan with makespan {found.schedule.makespan}")
    return found


class InvalidPlanError(RuntimeError):
    """The independent validator rejected a plan, and there is nothing new to learn from that."""


def learn_from(context: Context, itinerary: Itinerary, check: Check) -> list[Refinement]:
    """Write the candidate's refinements; return those that reject it."""
    if not context.params.refine:
        return []
    context.learn(check.refinements)
    if not check.passed and context.params.bounds_first and context.params.profiles:
        context.learn(guess_handovers(context))
    return [r for r in check.refinements if rejects(context, itinerary, r)]


def record(
    context: Context, report: ScheduleReport, check: Check, learned: list[Refinement]
) -> None:
    """Write the round into the history, and the trace if asked for."""
    history = context.history
    schedule = report.schedule
    history.rounds.append(
        Round(
            number=len(history.rounds) + 1,
            makespan=None if schedule is None else schedule.makespan,
            lower_bound=context.lower_bound,
            upper_bound=context.upper_bound,
            refinements=len(learned),
            seconds_scheduler=history.seconds_scheduler,
            seconds_motion=history.seconds_motion,
            elapsed=context.deadline.elapsed(),
            outcome="fits" if check.passed else "refined",
        )
    )
    context.report("round", f"{len(learned)} refinements" if learned else "candidate fits")
    write_trace(context, report, check.refinements, learned)


def is_done(
    context: Context,
    report: ScheduleReport,
    check: Check,
    learned: list[Refinement],
    *,
    optimal: bool,
) -> bool:
    """Return whether there is all that was asked for, or nothing more to come."""
    if not context.params.refine:
        return True
    if context.incumbent is not None and (not optimal or context.is_optimal):
        return True
    if check.passed and optimal and context.staged:
        return False
    return check.passed or not learned
