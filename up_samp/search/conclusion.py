"""How a search ends, and what it means that no better schedule is left (lines 17 to 20)."""

from __future__ import annotations

import contextlib
import enum
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import (
    CandidateSchedule,
    Deadline,
    OutOfTimeError,
    PathQuery,
    ScheduledMotion,
    ScheduleReport,
    ScheduleStatus,
    in_force,
)
from up_samp.model.graphs import reached
from up_samp.model.refinement import Absent, Clause, Refinement, Strength
from up_samp.scheduling.cpsat.session import refuted_by, sooner
from up_samp.search.events import Phase
from up_samp.search.fleet.jobs import clauses_of, needs_in
from up_samp.search.knowledge import SCHEDULING, TOLD, Cost, History
from up_samp.search.proof import SHOWN, listed
from up_samp.search.search import Search
from up_samp.search.world import instant_obstacles
from up_samp.upio import Itinerary, read_itinerary
from up_samp.upio.objective import Number


class Conclusion(enum.Enum):
    """How a search ended."""

    OPTIMAL = "optimal"
    SOLVED = "solved"
    UNSOLVABLE = "unsolvable"
    EXHAUSTED = "exhausted"
    OUT_OF_TIME = "out of time"
    STOPPED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True)
class SearchResult:
    """The end of a search; ``why`` is for people."""

    conclusion: Conclusion
    why: str = ""


def conclude_without_schedule(search: Search, report: ScheduleReport) -> SearchResult | None:
    """Decide what it means that the scheduler found nothing better (lines 17 to 20).

    Returns None to go on: it gets more time, or heuristic refinements were dropped and t_p was
    doubled.
    """
    bounds = search.bounds
    planned = bounds.incumbent is not None
    if search.budget.deadline.expired():
        return conclude(search)
    if bounds.met:
        return conclude(search) if stands(search) else None
    if report.status in (ScheduleStatus.OUT_OF_TIME, ScheduleStatus.FOUND):
        if search.components.pace.more(planned=planned):
            return None
        if planned:
            return conclude(search, "the scheduler found nothing better, and is asked once")
        if search.budget.deadline.lengthen():  # less work was counted on than there is time for
            return None
        why = report.message or "the scheduler gave up before its time was over"
        return SearchResult(Conclusion.OUT_OF_TIME, why)
    if not planned:
        facts = refutation(search, report)
        if facts is not None:
            if not nothing_is_left(search, facts):
                return None
            return SearchResult(Conclusion.UNSOLVABLE, search.prover.because(facts))
    if report.status is ScheduleStatus.ERROR:
        return SearchResult(Conclusion.FAILED, report.message)
    if search.knowledge.guesses and search.restarts.may_begin(search.budget, planned=planned):
        restart(search)
        return None
    if planned:
        return conclude(search, "all better schedules are ruled out, in part by what is not proven")
    return SearchResult(Conclusion.EXHAUSTED, _what_is_not_proven(search, report))


def conclude_undoable(search: Search) -> SearchResult | None:
    """Return the end of a search where proven facts leave nobody to do something that has to be
    done: no scheduler has to be asked, and it is known which facts these are.
    """
    absent = {_ruled_out(fact): fact for fact in search.knowledge.proven}
    absent.pop("", None)
    if not absent or search.bounds.incumbent is not None:
        return None
    source = search.problem.source
    clauses = [*clauses_of(source), *(((a.name,), ()) for a in source.activities if not a.optional)]
    needs = needs_in(clauses)
    for names, conditions in clauses:
        met = [absent.keys() & reached([n], lambda n: needs.get(n, ())) for n in names]
        if conditions or not (met and all(met)):
            continue
        few = [*dict.fromkeys(absent[min(some)] for some in met)]
        if nothing_is_left(search, few):
            more = " and so on" * (len(names) > SHOWN)
            asked = f"one of {', '.join(names[:SHOWN])}{more}" if len(names) > 1 else names[0]
            why = (
                f"these proven facts leave no schedule: {listed(few)}; but {asked} has to be there"
            )
            return SearchResult(Conclusion.UNSOLVABLE, why)
    return None


def _ruled_out(fact: Refinement) -> str:
    """Return the activity of which a fact says that it is absent, and nothing else ("": none)."""
    match fact.statement:
        case Clause((Absent(activity),)):
            return activity
    return ""


def refutation(search: Search, report: ScheduleReport) -> list[Refinement] | None:
    """Return the proven facts if they alone leave no schedule, else None.

    Where something unproven is in play, or the engine's word is no proof, that is tried anew, once
    for the same facts.
    """
    knowledge = search.knowledge
    facts = knowledge.proven
    said = report.status is ScheduleStatus.INFEASIBLE and len(facts) == len(knowledge.active)
    if said and search.problem.native:
        return facts
    if knowledge.feasible_facts == len(facts):
        return None
    search.tell.stage(Phase.PROOF, count=len(facts))
    verdict = search.prover.leaves_nothing(facts)
    if verdict or (said and verdict is None):
        return facts
    knowledge.feasible_facts = len(facts)
    return None


def stands(search: Search) -> bool:
    """Return whether the lower bound stands, where doubting it is cheap: the plain model, with
    nothing recognised, is asked for a schedule that cannot be.

    If there is one, that is an error of ours; it is told, and the search goes on with nothing
    recognised.
    """
    bounds, best = search.bounds, search.bounds.incumbent
    claim, cost = bounds.told_lower(), bounds.upper
    if search.plain or claim is None or not search.problem.native:
        return True
    # what was doubted and stood may still be beaten by a plan that came later
    if best is None or cost is None or claim <= cost:
        if claim <= max(bounds.stood, bounds.beside):
            return True  # it stood, or rests on more than what the scheduler is told
        found = _cheaper(search, search.knowledge.relaxation.problem, claim)
    elif bounds.relative and bounds.lower <= bounds.beside:
        bounds.forget_relative()  # a plan may drive faster than the planner drives alone
        return False
    else:
        found = best.schedule
    if found is not None:
        return _refute(search, claim, found)
    bounds.stood = bounds.lower
    return True


def nothing_is_left(search: Search, facts: Sequence[Refinement]) -> bool:
    """Return whether it stands that these facts leave no schedule, doubted in the same way."""
    if search.plain:
        return True
    found = _cheaper(search, search.prover.problem_with(facts), None)
    return found is None or _refute(search, None, found)


def _cheaper(
    search: Search, problem: SchedulingProblem, claim: Number | None
) -> CandidateSchedule | None:
    """Return a schedule that costs less than is claimed (None: any one), if there is one."""
    limit = search.budget.part("doubt")
    return sooner(problem, claim, limit, seed=search.seed, tuning=search.tuning)


def _refute(search: Search, claim: Number | None, found: CandidateSchedule) -> bool:
    search.refute(refuted_by(claim, found))
    search.recognise_nothing()
    return False


def restart(search: Search) -> None:
    """Drop what was only guessed, and allow motion queries twice the time (line 19)."""
    search.restarts.begin(search.knowledge.guesses)
    search.history.restarts = search.restarts.done
    search.budget.double_queries()
    search.tell("restart", search.budget.query_seconds)
    search.start_over()


def _what_is_not_proven(search: Search, report: ScheduleReport) -> str:
    """Return which unproven statements leave no schedule, as text."""
    text = "no schedule is left, but not all that was learned is proven"
    doubtful = [r for r in search.knowledge.active if r.strength is not Strength.PROVEN]
    if report.status is not ScheduleStatus.INFEASIBLE:
        text = report.message or "the scheduler found no schedule"
    elif not doubtful:
        text = "the wrapped engine finds no schedule; our own does: its word is not believed"
    if doubtful:
        few = search.prover.few_of(doubtful, given=search.knowledge.proven)
        text += ": " + listed(few)
    return text


def conclude_stopped(search: Search) -> SearchResult:
    """Return what the search has, now that a stopping criterion is met."""
    if search.bounds.incumbent is None:
        return SearchResult(Conclusion.STOPPED, "stopped as asked for, before there was a plan")
    return conclude(search)


def _stopped_early(search: Search) -> str:
    """Return in words that patience ended the search, if it did."""
    budget, at = search.budget, search.history.last_plan_at
    if not budget.impatient or at is None:
        return ""
    more = budget.deadline.elapsed() - at
    return (
        f"nothing better came for {more:.1f} s after the best plan, found after {at:.1f} s: that "
        f"was all the patience asked for ({budget.patience:g} of the time so far)"
    )


def what_was_hard(history: History) -> str:
    """Return in one sentence what a search that ran out of time failed on most often, the last of
    such if there are several, and what took the most of its time.
    """
    told = "no schedule was found whose motions could be driven"
    for most, times in Counter(reversed(history.missed)).most_common(1):
        told = f"{times} of {len(history.missed)} checks failed on {most}"
    seconds = history.stages.seconds
    longest = max(seconds, key=seconds.__getitem__, default=SCHEDULING)
    told += f"; most of the time went to {TOLD.get(longest, longest)}"
    return f"{told} ({seconds.get(longest, 0.0):.1f} of {sum(seconds.values()):.1f} s)"


def conclude_with_what_was_given(search: Search, ending: SearchResult) -> SearchResult:
    """Return how a search ends that has no plan: with the one that it began from, if that is a plan
    of this problem as it is.
    """
    if search.start is None:
        return ending
    try:
        given = search.plan_of(search.start, search.driven)
    except KeyError:  # it leaves open a choice, or what is driven
        return ending
    if search.judged(given.plan):
        return ending
    search.bounds.keep(given)
    return SearchResult(Conclusion.SOLVED, f"the plan to begin from, as it is; {ending.why}")


def conclude(search: Search, nothing_left: str = "") -> SearchResult:
    """Return what the search has, now that it ends; ``nothing_left``: why it does while there is
    time, and a better plan was asked for.
    """
    bounds = search.bounds
    if bounds.incumbent is None:
        if search.budget.deadline.expired():
            why = f"no plan found in time: {what_was_hard(search.history)}"
            if search.history.refused:  # the plan and its judge do not agree: that is our fault
                why += f"; the validator refused what was found: {search.history.refused[-1]}"
            return SearchResult(Conclusion.OUT_OF_TIME, why)
        return SearchResult(
            Conclusion.EXHAUSTED,
            "the motions of the last candidate do not fit, and nothing more was learned from it",
        )
    if not bounds.met:
        if not search.budget.whole.expired():
            tell_what_may_be_shorter(search)
        why = _stopped_early(search)
        if nothing_left and not why and not search.budget.whole.expired():
            after = search.budget.deadline.elapsed()
            why = f"nothing was left to try after {after:.1f} s: {nothing_left}"
        return SearchResult(Conclusion.SOLVED, why)
    active, prover = search.knowledge.active, search.prover
    bound, cost, makespan = bounds.lower, bounds.upper, bounds.incumbent.schedule.makespan
    native = search.problem.native
    believed = stands(search) if native else not prover.sooner_than(active, makespan)
    assert cost is not None
    if believed and bound <= cost:
        return called_optimal(search, cost)
    bounds.forget()
    what = "plan" if bound > cost else "schedule that agrees with all that is known"
    return SearchResult(
        Conclusion.SOLVED, f"the lower bound {bound} is not believed: there is a better {what}"
    )


# ------------------ Whether a bound that rests on the planner's motions is enough

NEAR = 0.05
"""A plan by a relative bound is called optimal where each of its motions takes no more than this
share of its time longer than is proven to be needed.
"""


def called_optimal(search: Search, cost: Cost) -> SearchResult:
    """Return how a search ends whose best plan meets the lower bound: with an optimal plan, unless
    the bound rests on motions that may be much shorter, and nobody asked for a relative one.
    """
    tell_what_may_be_shorter(search)
    bounds, worst = search.bounds, max(search.history.may_be_shorter.values(), default=0.0)
    if search.problem.params.relative or bounds.absolute >= cost or worst < NEAR:
        return SearchResult(Conclusion.OPTIMAL)
    assert bounds.incumbent is not None
    facts = search.knowledge.proven  # which may be enough: what counts need not be motions
    bounds.raise_absolute(search.prover.bound_by(facts, bounds.incumbent.schedule))
    if bounds.absolute >= cost:
        search.history.may_be_shorter.clear()
        return SearchResult(Conclusion.OPTIMAL)
    why = f"no plan is better by the planner's own motions, not all of which are within {NEAR:.0%}"
    return SearchResult(
        Conclusion.SOLVED, f"{why} of what is proven to be needed (relative=True asks for no more)"
    )


def tell_what_may_be_shorter(search: Search) -> None:
    """Note which motions of the best plan, if a relative bound speaks of it, may be shorter than
    the planner's own, and by what share of its time each (1: that is not known within 2 s and
    the time that is left).
    """
    best = search.bounds.incumbent
    if best is None or not search.bounds.relative:
        return
    itinerary = read_itinerary(search.knowledge.relaxation, best.schedule)
    found = {str(search.facts.case(motion)): 1.0 for motion in itinerary.motions}
    limit = search.budget.whole.within(2.0)
    with in_force(limit), contextlib.suppress(OutOfTimeError):
        for motion in itinerary.motions:
            found[str(search.facts.case(motion))] = _share_left(search, itinerary, motion, limit)
    worst = sorted(found.items(), key=lambda item: (-item[1], item[0]))
    search.history.may_be_shorter = {name: share for name, share in worst if share > 0}


def _share_left(
    search: Search, itinerary: Itinerary, motion: ScheduledMotion, limit: Deadline
) -> float:
    """Return by what share of its time a motion past what rests in its way may be shorter than the
    planner's own. Where no unit would be saved that is 0; so it is where the planner's was not
    finished, on which no bound rests.
    """
    facts, service = search.facts, search.motions.service
    obstacles = instant_obstacles(facts, itinerary, motion)
    query = PathQuery(facts.body(motion), motion.poses, obstacles)
    report = service.plan(query, limit)
    seconds = search.knowledge.durations.get((query.body, query.poses), 0.0)
    if report.complete and report.trajectory is not None:
        seconds = report.trajectory.duration
    for among in ((), obstacles):
        least = service.lower_bound(query.body, query.poses, among)
        if facts.units(least) >= facts.units(seconds):
            return 0.0
        if 1 - least / seconds < NEAR:
            break
    return 1 - least / seconds
