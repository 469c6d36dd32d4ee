"""How long motions take: lower bounds for any planner, and the planner's own fastest ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from up_samp.model import Deadline, Outcome, PathQuery, avoids
from up_samp.model.refinement import Refinement, Strength
from up_samp.model.snapshot import MotionTask
from up_samp.refinement import rules
from up_samp.search.facts import Facts, MotionCase
from up_samp.search.knowledge import Knowledge
from up_samp.search.motions import Motions, touching

QUERY = 2.0
"""s for one motion: what takes longer may never be needed."""
PROBE = 30
"""Motions after which is told whether all can be asked for..."""
HOPELESS = 4.0
"""...which they are not where all would take so many times the time that there is: others are left
to be learned when a candidate uses them, and most never are."""


def lower_bounds(motions: Motions, knowledge: Knowledge) -> list[Refinement]:
    """Return a lower bound on every motion's duration, admissible for any planner: for whatever
    is decided, and (where that tells more) for each choice of its decisions.
    """
    why = "no motion between these poses is faster, whatever else stands there"
    bounds: dict[MotionTask, dict[MotionCase, int]] = {}
    for signature, cases in motions.facts.by_signature.items():
        units = motions.facts.units(motions.service.lower_bound(*signature))
        knowledge.stated[signature] = units if units > 1 else 0
        for case in cases:
            bounds.setdefault(case.task, {})[case] = units
    found = []
    for task, units_of in bounds.items():
        least = min(units_of.values())
        if least > 1:
            found.append(rules.lasts(task.activity, least, why))
        found += [
            rules.only_given(rules.lasts(task.activity, units, why), case.given)
            for case, units in units_of.items()
            if units > max(least, 1)
        ]
    return found


def fastest_durations(
    motions: Motions,
    knowledge: Knowledge,
    tell: Callable[[int, int], None],
) -> list[Refinement]:
    """Return the planner's own best duration of every motion, as far as time allows: guesses, where
    the planner may have missed a faster way.

    Where they are far too many for that, few of them are asked for. They are found among the fixed
    obstacles alone: objects that move only make motions slower.
    ``tell`` is called with how many of how many motions are done.
    """
    found = []
    signatures = motions.facts.by_signature
    seconds = min(QUERY, motions.budget.query_seconds)
    deadline = motions.budget.part("unobstructed motions")
    whole = deadline.remaining()
    for count, cases in enumerate(signatures.values()):
        if deadline.expired():
            break
        spent = whole - deadline.remaining()
        if count >= PROBE and spent * len(signatures) > HOPELESS * whole * count:
            break
        if count % 10 == 0:
            tell(count, len(signatures))
        limit = motions.budget.deadline.within(seconds)
        found += duration_of(motions, knowledge, cases, limit)
    return found


def duration_of(
    motions: Motions, knowledge: Knowledge, cases: Sequence[MotionCase], deadline: Deadline
) -> list[Refinement]:
    """Plan a motion among fixed obstacles; return what that tells of ``cases``, all of which are
    this motion.
    """
    facts = motions.facts
    signature = facts.signature(cases[0])
    if signature in knowledge.durations:
        return []
    report, strength = motions.fastest(_among_fixed(facts, cases), deadline)
    if report.outcome is Outcome.IMPOSSIBLE:
        return [
            rules.only_given(rules.impossible(c.activity, c.why_not(report)), c.given)
            for c in cases
        ]
    if report.trajectory is None:
        knowledge.history.missed.append(str(cases[0]) + touching(report.reason))
        return []
    if strength is Strength.RELATIVE:
        knowledge.durations[signature] = report.trajectory.duration
    units = facts.units(report.trajectory.duration)
    if units <= knowledge.stated.get(signature, 0):
        return []
    why = f"the planner's fastest unobstructed motion takes {report.trajectory.duration:.2f} s"
    return [
        rules.only_given(rules.lasts(c.activity, units, why, strength=strength), c.given)
        for c in cases
    ]


def _among_fixed(facts: Facts, cases: Sequence[MotionCase]) -> PathQuery:
    """Return the question for the motion that all of ``cases`` are, among the fixed obstacles."""
    # what is said of all equivalent motions may count on what all of them heed only
    obstacles = tuple(o for o in facts.fixed if all(avoids(c.task.avoid, o.name) for c in cases))
    return PathQuery(*facts.signature(cases[0]), obstacles)
