"""The interleaving loop: Algorithm 1 of the paper, with bounds, certificates and incumbents.

``solve`` is the algorithm; each stage is one named call. Line numbers in comments are those of
Algorithm 1 (Tosello et al., ICAPS 2026).
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, replace

from up_samp.model import CandidateSchedule, ScheduleReport, ScheduleStatus, check_time
from up_samp.model.refinement import Refinement, Strength
from up_samp.search.check import Check
from up_samp.search.conclusion import (
    SearchResult,
    conclude,
    conclude_stopped,
    conclude_undoable,
    conclude_without_schedule,
    restart,
    stands,
)
from up_samp.search.cuts import cuts_from, rejecting
from up_samp.search.events import Phase
from up_samp.search.knowledge import (
    BUILDING,
    CHECKING,
    LEARNING,
    REPAIRING,
    SCHEDULING,
    STATING,
    Incumbent,
    Round,
)
from up_samp.search.resolve import begin_near
from up_samp.search.search import Search
from up_samp.upio import Itinerary, read_itinerary

_NEAR = 5
"""Schedules that are tried near a given plan, each with what was learned from those before."""


def solve(search: Search, *, optimal: bool) -> Generator[Incumbent, None, SearchResult]:
    """Search for a plan; with ``optimal`` go on until it meets the lower bound.

    Yields each plan that is better than all before it, and returns how the search ended.
    """
    if search.start is not None:
        begun = begin_from(search, search.start)
        if begun is not None:
            yield begun
            if not optimal:
                return conclude(search)
    if search.easier is not None:
        yield from take_over(search, search.easier(search))
        if not optimal and search.bounds.incumbent is not None:
            return conclude(search)
    with search.history.stages.of(STATING):
        state_what_is_known(search)
    undoable = conclude_undoable(search)
    if undoable is not None:
        return undoable
    while not search.budget.deadline.expired():
        if search.stopped:
            return conclude_stopped(search)
        yield from improve(search, stuck=False)
        with search.history.stages.of(SCHEDULING):
            report = get_schedule(search, optimal=optimal)  # line 4
        if report.schedule is None or not is_better(search, report.schedule):
            ending = conclude_without_schedule(search, report)  # lines 18 to 20
            if ending is not None:
                return ending
            yield from improve(search, stuck=True)
            continue
        tried = try_candidate(search, report)  # lines 6 to 16, 31 and 35
        if tried.better is not None:
            yield tried.better
        if not tried.refused and is_done(search, tried, optimal=optimal) and stands(search):
            break
    return conclude(search, "nothing more is learned from schedules" if optimal else "")


def begin_from(search: Search, start: CandidateSchedule) -> Incumbent | None:
    """Return a plan with the activities of ``start``, if one is found soon."""
    search.tell.stage(Phase.PREPARE, "what the plan drives")
    state_durations_of(search, start)
    for _ in range(_NEAR):
        schedule = begin_near(search, start)
        if schedule is None or search.budget.deadline.expired():
            return None
        itinerary = read_itinerary(search.knowledge.relaxation, shaped(search, schedule))
        check = check_motions(search, itinerary)
        learned = search.learn(check.refinements) if search.components.learns else 0
        found = adopt_or_repair(search, itinerary, check)
        refused = learn_from_refusal(search, found)
        better = None if refused else keep_if_better(search, found)
        report = ScheduleReport(ScheduleStatus.FOUND, itinerary.schedule)
        record(search, report, check, check.refinements)
        if better is not None or not (learned or refused):
            return better
    return None


def take_over(search: Search, plans: Iterator[Incumbent]) -> Iterator[Incumbent]:
    """Yield those of ``plans``, made for another objective, that are better than all before."""
    search.tell.stage(Phase.PREPARE, "plans by nothing but the makespan")
    for one in plans:
        found = search.plan_of(one.schedule, one.trajectories)
        if not learn_from_refusal(search, found) and keep_if_better(search, found):
            yield found


def state_durations_of(search: Search, start: CandidateSchedule) -> None:
    """Tell the scheduler how long the motions of ``start`` take at least."""
    facts, cuts = search.facts, search.checker.cuts
    known = [c for c in facts.cases if c.activity in start.times and not c.given]
    with search.budget.motion_time():
        for case in known:
            if search.budget.deadline.expired():
                return
            told = cuts.unobstructed(search.motions, search.knowledge, facts.same(case))
            search.learn(r for r in told if r.strength is not Strength.HEURISTIC)


def state_what_is_known(search: Search) -> None:
    """Tell the scheduler, before it starts, what holds for any schedule (bounds first)."""
    with search.budget.motion_time():
        for statement in search.components.statements:
            search.tell.stage(Phase.PREPARE, statement.name)
            search.learn(_in_time(statement.find(search)))
    search.tell("round", None, search.knowledge.active, (), search.history)


def _in_time(said: Iterable[Refinement]) -> Iterator[Refinement]:
    """Yield what is ``said`` as long as there is time: of large problems it is a lot to write."""
    for refinement in said:
        check_time()
        yield refinement


def get_schedule(search: Search, *, optimal: bool) -> ScheduleReport:
    """Invoke the scheduler on the relaxation and what was learned (line 4).

    Our own scheduler is asked for good schedules until there is a plan, and then for better ones
    and for proofs, with more and more time.
    """
    search.tell.stage(Phase.SCHEDULE)
    bounds, pace = search.bounds, search.components.pace
    planned = bounds.incumbent is not None
    proving = optimal and (planned or not pace.staged)
    guessing = bool(search.knowledge.guesses)
    report = search.scheduler.solve(
        pace.deadline(search.budget, planned=planned, proving=proving),
        optimal=proving,
        hint=bounds.incumbent.schedule if bounds.incumbent else search.start,
        lower_bound=None if guessing else bounds.told_lower(),
    )
    search.history.seconds_scheduler += report.seconds
    if report.recognised or report.left_over:
        search.history.recognised = report.recognised
        search.history.left_over = report.left_over
    search.history.handed_over += report.handed_over
    if report.bound is not None and not guessing:
        # it was told the bound so far, too
        bounds.raise_lower(report.bound, relative=bounds.stated or bounds.relative)
    search.tell("schedule", report)
    return report


def improve(search: Search, *, stuck: bool) -> Iterator[Incumbent]:
    """Yield plans made of the best one; ``stuck``: the scheduler found nothing better in time."""
    for improver in search.components.improvers if search.bounds.incumbent is not None else ():
        yield from improver(search, stuck)


def is_better(search: Search, schedule: CandidateSchedule) -> bool:
    """Return whether a candidate would be worth more than the best plan, if its motions fit."""
    return not search.components.pace.staged or search.bounds.improves(schedule)


def is_done(search: Search, tried: Tried, *, optimal: bool) -> bool:
    """Return whether there is all that was asked for, or nothing more to come."""
    if not search.components.learns:
        return True
    if search.bounds.incumbent is not None and (not optimal or search.bounds.met):
        return True
    if tried.check.passed:
        return not (optimal and search.components.pace.staged)
    if tried.learned:
        return False
    if search.bounds.incumbent is None and search.restarts.may_begin(search.budget, planned=False):
        restart(search)
        return False
    return True


# ------------------ One candidate (lines 6 to 16, 31 and 35)
# Its motions are checked, what they tell is learned, and a plan is made of it if that can be done.


@dataclass(frozen=True)
class Tried:
    """What came of a candidate: a plan that is ``better`` than all before it, if there is one;
    ``learned``: what rejects the candidate; ``refused``: the validator refused what was made of it.
    """

    check: Check
    learned: list[Refinement]
    better: Incumbent | None
    refused: bool


def try_candidate(search: Search, report: ScheduleReport) -> Tried:
    """Check the motions of the scheduler's candidate, learn from them, and keep what plan comes of
    it, if that is the best so far.
    """
    assert report.schedule is not None
    itinerary = read_itinerary(search.knowledge.relaxation, shaped(search, report.schedule))
    with search.history.stages.of(BUILDING):
        built = build(search, itinerary)
    with search.history.stages.of(CHECKING):
        # lines 6 to 15
        check = Check(dict(built.trajectories)) if built else check_motions(search, itinerary)
    with search.history.stages.of(LEARNING):
        learned = learn_from(search, itinerary, check)  # lines 31 and 35
    with search.history.stages.of(REPAIRING):
        found = built or adopt_or_repair(search, itinerary, check)  # line 16
        if found is None:
            guess_on(search, check.refinements)
    refused = learn_from_refusal(search, found)
    learned += refused
    better = None if refused else keep_if_better(search, found)
    record(search, replace(report, schedule=itinerary.schedule), check, learned)
    return Tried(check, learned, better, bool(refused))


def shaped(search: Search, schedule: CandidateSchedule) -> CandidateSchedule:
    """Return the candidate as it is easier to drive."""
    for shape in search.components.shapers:
        schedule = shape(search, schedule)
    return schedule


def guess_on(search: Search, learned: list[Refinement]) -> None:
    """Tell all that statements guess, once guesses have rejected a candidate of which no plan could
    be made: else they would come a few in each round, and a round for each few.
    """
    if not search.knowledge.may_guess(learned):
        return
    search.knowledge.guessed = True
    with search.budget.motion_time():
        for statement in search.components.statements:
            search.learn(statement.guess(search))


def build(search: Search, itinerary: Itinerary) -> Incumbent | None:
    """Return a plan made of a candidate of many motions, if it is better than all before it."""
    for builder in search.components.builders:
        built = builder(search, itinerary)
        if built is not None and search.bounds.improves(built.schedule):
            return built
    return None


def check_motions(search: Search, itinerary: Itinerary) -> Check:
    """Check the candidate's motions (lines 8 to 15)."""
    search.tell.stage(Phase.MOTIONS, count=len(itinerary.motions))
    return search.checker.check(itinerary)


def adopt_or_repair(search: Search, itinerary: Itinerary, check: Check) -> Incumbent | None:
    """Return the candidate as a plan if its motions fit, else what can be made of it."""
    if check.passed:
        return search.plan_of(itinerary.schedule, check.trajectories)
    for repair in search.components.repairs:
        found = repair(search, itinerary.schedule, check)
        if found is not None:
            return found
    return None


def learn_from_refusal(search: Search, found: Incumbent | None) -> list[Refinement]:
    """Let the independent validator judge a plan; learn cuts that forbid it if it is refused.

    Raises :class:`InvalidPlanError` where nothing new can be learned from the refusal.
    """
    refusals = search.judged(found.plan) if found is not None else []
    if found is None or not refusals:
        return []
    cuts = []
    if search.components.learns:
        relaxation, times = search.knowledge.relaxation, found.schedule.times
        own = {name: times[name] for name in times if name in relaxation.activities}
        itinerary = read_itinerary(relaxation, replace(found.schedule, times=own))
        cuts = cuts_from(search.facts, itinerary, refusals)
    texts = [f"{r.kind}: {r.what}" for r in refusals]
    search.tell("refusal", refusals)
    search.history.refused += texts
    if not search.learn(cuts):
        raise InvalidPlanError("; ".join(texts[:3]))
    return cuts


def keep_if_better(search: Search, found: Incumbent | None) -> Incumbent | None:
    """Make a valid plan the incumbent and return it, if it is the best so far."""
    if found is None or not search.bounds.keep(found):
        return None
    search.confront(search.knowledge.active)
    search.budget.planned()
    # its round is not in the history yet
    search.history.planned(len(search.history.rounds) + 1, search.budget.deadline.elapsed())
    search.tell("plan", found)
    return found


class InvalidPlanError(RuntimeError):
    """The independent validator rejected a plan, and there is nothing new to learn from that."""


def learn_from(search: Search, itinerary: Itinerary, check: Check) -> list[Refinement]:
    """Write the candidate's refinements; return those that reject it."""
    if not search.components.learns:
        return []
    search.learn(check.refinements)
    snapshot = search.knowledge.relaxation.snapshot
    return rejecting(itinerary, snapshot, check.refinements)


def record(search: Search, report: ScheduleReport, check: Check, learned: list[Refinement]) -> None:
    """Write the round into the history."""
    history, bounds = search.history, search.bounds
    schedule = report.schedule
    history.rounds.append(
        Round(
            number=len(history.rounds) + 1,
            makespan=None if schedule is None else schedule.makespan,
            lower_bound=bounds.told_lower(),
            upper_bound=bounds.upper,
            refinements=len(learned),
            seconds_scheduler=history.seconds_scheduler,
            seconds_motion=history.seconds_motion,
            elapsed=search.budget.deadline.elapsed(),
            outcome="fits" if check.passed else "refined",
        )
    )
    search.tell("round", report, check.refinements, learned, history)
