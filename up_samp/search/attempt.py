"""One candidate schedule: its motions are checked, what they tell is learned, and a plan is made of
it if that can be done (lines 6 to 16, 31 and 35 of Algorithm 1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from up_samp.model import CandidateSchedule, ScheduleReport
from up_samp.model.refinement import Refinement
from up_samp.search.check import Check
from up_samp.search.cuts.protocol import rejecting
from up_samp.search.cuts.refused import cuts_from
from up_samp.search.events import Phase
from up_samp.search.history import BUILDING, CHECKING, LEARNING, REPAIRING, Round
from up_samp.search.knowledge import Incumbent
from up_samp.search.search import Search
from up_samp.upio import Itinerary, read_itinerary


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
        itinerary = read_itinerary(search.knowledge.relaxation, found.schedule)
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
    history.take_times(search.budget)
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
