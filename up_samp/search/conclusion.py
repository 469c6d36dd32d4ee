"""How a search ends, and what it means that no better schedule is left (lines 17 to 20)."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from up_samp.model import ScheduleReport, ScheduleStatus
from up_samp.model.refinement import Refinement, Strength
from up_samp.search.context import Context
from up_samp.search.prepare import state_places
from up_samp.search.proof import because, few_of, leaves_nothing, listed, proven_facts, sooner_than

UNTIMED_RESTARTS = 3
"""Restarts where there is no time limit."""
STALE_RESTARTS = 8
"""Restarts in a row that may bring nothing but guesses made before, from other random numbers."""
LONGEST_QUERY = 3600.0
"""Limit (s) of one motion query, however often it was doubled."""


class Conclusion(enum.Enum):
    """How a search ended."""

    OPTIMAL = "optimal"
    SOLVED = "solved"
    UNSOLVABLE = "unsolvable"
    EXHAUSTED = "exhausted"
    OUT_OF_TIME = "out of time"
    FAILED = "failed"


@dataclass(frozen=True)
class SearchResult:
    """The end of a search; ``why`` is for people."""

    conclusion: Conclusion
    why: str = ""


def conclude_without_schedule(context: Context, report: ScheduleReport) -> SearchResult | None:
    """Decide what it means that the scheduler found nothing better (lines 17 to 20).

    Returns None to go on: it gets more time, or heuristic refinements were dropped and t_p was
    doubled.
    """
    if context.deadline.expired() or context.is_optimal:
        return conclude(context)
    if report.status in (ScheduleStatus.OUT_OF_TIME, ScheduleStatus.FOUND):
        if not context.staged or (context.incumbent is None and context.schedule_share >= 1):
            return conclude(context)
        if context.incumbent is None:
            context.schedule_share = 1.0
        else:
            context.proof_seconds *= 2
        return None
    if context.incumbent is None:
        facts = refutation(context, report)
        if facts is not None:
            return SearchResult(Conclusion.UNSOLVABLE, because(context, facts))
    if report.status is ScheduleStatus.ERROR:
        return SearchResult(Conclusion.FAILED, report.message)
    if context.heuristic and may_restart(context):
        restart(context)
        return None
    if context.incumbent is not None:
        return conclude(context)
    return SearchResult(Conclusion.EXHAUSTED, _what_is_not_proven(context, report))


def refutation(context: Context, report: ScheduleReport) -> list[Refinement] | None:
    """Return the proven facts if they alone leave no schedule, else None.

    Where something unproven is in play, or the engine's word is no proof, that is tried anew, once
    for the same facts.
    """
    facts = proven_facts(context)
    said = report.status is ScheduleStatus.INFEASIBLE and len(facts) == len(context.standing)
    if said and context.native:
        return facts
    if not context.native and context.params.certificates:
        facts += state_places(context)  # our own scheduler judges: it knows places for one
    if context.feasible_facts == len(facts):
        return None
    context.report("proof", f"trying {len(facts)} proven facts alone")
    verdict = leaves_nothing(context, facts)
    if verdict or (said and verdict is None):
        return facts
    context.feasible_facts = len(facts)
    return None


def may_restart(context: Context) -> bool:
    """Return whether another attempt is worth it: while there is time and it brings new guesses."""
    done, limit = context.history.restarts, context.params.max_restarts
    if limit is not None:
        return done < limit
    if math.isinf(context.deadline.remaining()):
        return done < UNTIMED_RESTARTS
    return context.stale_restarts < STALE_RESTARTS


def restart(context: Context) -> None:
    """Drop what was only guessed, and allow motion queries twice the time (line 19)."""
    context.history.restarts += 1
    guesses = frozenset(r.statement for r in context.standing if r.strength is Strength.HEURISTIC)
    context.stale_restarts = context.stale_restarts + 1 if guesses in context.guesses else 0
    context.guesses.add(guesses)
    context.query_seconds = min(2 * context.query_seconds, LONGEST_QUERY)
    context.report("restart", f"motion queries may take {context.query_seconds:g} s now")
    context.start_over()


def _what_is_not_proven(context: Context, report: ScheduleReport) -> str:
    """Return which unproven statements leave no schedule, as text."""
    text = "no schedule is left, but not all that was learned is proven"
    doubtful = [r for r in context.standing if r.strength is not Strength.PROVEN]
    if report.status is not ScheduleStatus.INFEASIBLE:
        text = report.message or "the scheduler found no schedule"
    elif not doubtful:
        text = "the wrapped engine finds no schedule; our own does: its word is not believed"
    if doubtful:
        facts = proven_facts(context)
        text += ": " + listed(few_of(context, doubtful, given=facts))
    return text


def conclude(context: Context) -> SearchResult:
    """Return what the search has, now that it ends."""
    if context.incumbent is None:
        if context.deadline.expired():
            return SearchResult(Conclusion.OUT_OF_TIME, "no plan found in time")
        return SearchResult(
            Conclusion.EXHAUSTED,
            "the motions of the last candidate do not fit, and nothing more was learned from it",
        )
    if not context.is_optimal:
        return SearchResult(Conclusion.SOLVED)
    makespan, bound = context.incumbent.schedule.makespan, context.lower_bound
    refuted = bound > makespan or (not context.native and sooner_than(context, makespan))
    if not refuted:
        return SearchResult(Conclusion.OPTIMAL)
    context.lower_bound = 0
    what = "plan" if bound > makespan else "schedule that agrees with all that is known"
    return SearchResult(
        Conclusion.SOLVED, f"the lower bound {bound} is not believed: there is a shorter {what}"
    )
