"""Proofs that a motion cannot be made while an object like a door is where it is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from up_samp.model import Placed, avoids
from up_samp.model.refinement import Refinement, Strength, end_of, start_of
from up_samp.model.snapshot import TermKind
from up_samp.refinement import rules
from up_samp.search.facts import Facts, MotionCase, Signature
from up_samp.search.motions import Motions


def unreachable(motions: Motions) -> list[Refinement]:
    """Return proofs of what is unreachable while a door-like object is where it may be."""
    found: list[Refinement] = []
    for obstacle, configuration in _instant_places(motions.facts):
        placed = motions.facts.placed(obstacle, configuration)
        for signature, cases in motions.facts.by_signature.items():
            heeding = [c for c in cases if avoids(c.task.avoid, obstacle)]
            if heeding and not (signature[0].flies or placed.body.flies):
                found += _certify(motions, signature, heeding, placed, configuration)
    return found


def _certify(
    motions: Motions,
    signature: Signature,
    cases: list[MotionCase],
    placed: Placed,
    configuration: str,
) -> list[Refinement]:
    facts, service = motions.facts, motions.service
    body, poses = signature
    why = f"{placed.name} at {configuration} blocks the way"
    _, at_start = service.pose_blockers(body, poses[0], (placed,))
    if at_start:
        why = f"{placed.name} at {configuration} lies on the first pose"
        if facts.returns_to(placed.name, configuration):
            return blocked_while(facts, cases, {placed.name: configuration}, why)
        changes = facts.snapshot.movers[placed.name]
        return [_gone_from_the_start(c, changes, why) for c in cases]
    proof = service.certificate(body, poses, (placed,))
    if proof is None:
        return []
    # a static obstacle stays all the time: then it must be gone from the start
    static = [c for c in cases if placed.name in (c.task.static or ())]
    others = [c for c in cases if c not in static]
    found = [
        rules.needs_away(c.activity, placed.name, configuration, why) for c in static if not c.given
    ]
    static = [c for c in static if c.given]  # a condition cannot hang on decisions
    if facts.returns_to(placed.name, configuration):
        places = {placed.name: configuration}
        return found + blocked_while(facts, static + others, places, why)
    changes = facts.snapshot.movers[placed.name]
    found += [_gone_from_the_start(c, changes, why) for c in static]
    if others:
        found += [_opened(facts, c, placed.name, configuration, why) for c in others]
    return found


def _gone_from_the_start(case: MotionCase, changes: Iterable[str], why: str) -> Refinement:
    cut = rules.gone_before(start_of(case.activity), changes, 0, why)
    return rules.only_given(cut, case.given)


def blocked_while(
    facts: Facts,
    cases: Iterable[MotionCase],
    places: Mapping[str, str],
    why: str,
    strength: Strength = Strength.PROVEN,
) -> list[Refinement]:
    """State that motions must not be made while objects rest at these ``places``."""
    movers = facts.snapshot.movers
    return [
        rules.only_given(
            rules.blocked_while(c.activity, places, movers, why, strength=strength), c.given
        )
        for c in cases
    ]


def _opened(
    facts: Facts, case: MotionCase, obstacle: str, configuration: str, why: str
) -> Refinement:
    """State that an obstacle which does not come back has left before the end."""
    changes = facts.snapshot.movers[obstacle]
    if len(changes) <= 1 and not case.given:
        return rules.needs_open(case.activity, obstacle, configuration, why)
    # a condition would forbid further changes in its interval, although the obstacle has gone
    cut = rules.gone_before(end_of(case.activity), changes, 1, why)
    return rules.only_given(cut, case.given)


def _instant_places(facts: Facts) -> Iterator[tuple[str, str]]:
    snapshot = facts.snapshot
    for obstacle in sorted(facts.instant):
        places = {snapshot.initial[obstacle]}
        places |= {
            c.term.name
            for c in snapshot.changes
            if c.object == obstacle and c.term.kind is TermKind.CONSTANT
        }
        for place in sorted(places):
            yield obstacle, place
