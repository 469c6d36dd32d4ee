"""Proofs that a motion cannot be made while an object like a door is where it is."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence

from up_samp.model import Placed
from up_samp.model.refinement import Refinement, Strength, end_of, start_of
from up_samp.model.snapshot import TermKind
from up_samp.refinement import rules
from up_samp.search.facts import Facts, MotionCase, Signature
from up_samp.search.motions import Motions

Standing = tuple[str, Mapping[str, str]]
"""One of some objects that always change together (the leaves of a door), whose place tells those
of all, and where they are."""


def unreachable(motions: Motions) -> list[Refinement]:
    """Return proofs of what is unreachable while a door-like object is where it may be."""
    found: list[Refinement] = []
    for standing in _instant_states(motions.facts):
        for signature, cases in motions.facts.by_signature.items():
            by_heeded: dict[tuple[Placed, ...], list[MotionCase]] = {}
            for case in cases:
                heeded = motions.facts.heeded(case.task, standing[1])
                by_heeded.setdefault(heeded, []).append(case)
            for placed, heeding in by_heeded.items():
                if placed and not signature[0].flies:
                    found += _certify(motions, signature, heeding, placed, standing)
    return found


def _certify(
    motions: Motions,
    signature: Signature,
    cases: list[MotionCase],
    placed: Sequence[Placed],
    standing: Standing,
) -> list[Refinement]:
    facts, service = motions.facts, motions.service
    obstacle, places = standing
    configuration = places[obstacle]
    body, poses = signature
    _, at_start = service.pose_blockers(body, poses[0], placed)
    if at_start:
        why = f"{_listed(at_start, places, 'lie')} on the first pose"
        if facts.returns_to(obstacle, configuration):
            return blocked_while(facts, cases, {obstacle: configuration}, why)
        movers = facts.snapshot.movers[obstacle]
        return [_gone_from_the_start(c, movers, why) for c in cases]
    if service.certificate(body, poses, placed) is None:
        return []
    names = frozenset(p.name for p in placed)
    why = f"{_listed(names, places, 'block')} the way"
    # a static obstacle stays all the time: then it must be gone from the start
    static = [c for c in cases if names <= (c.task.static or frozenset())]
    others = [c for c in cases if c not in static]
    found = [
        rules.needs_away(c.activity, obstacle, configuration, why) for c in static if not c.given
    ]
    static = [c for c in static if c.given]  # a condition cannot hang on decisions
    if facts.returns_to(obstacle, configuration):
        told = {obstacle: configuration}
        return found + blocked_while(facts, static + others, told, why)
    changes = facts.snapshot.movers[obstacle]
    found += [_gone_from_the_start(c, changes, why) for c in static]
    found += [_opened(facts, c, obstacle, configuration, why) for c in others]
    return found


def _listed(names: Iterable[str], places: Mapping[str, str], verb: str) -> str:
    """Return what is where, with what it does."""
    what = [f"{name} at {places[name]}" for name in sorted(names)]
    return f"{' and '.join(what)} {verb}{'s' if len(what) == 1 else ''}"


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


def _instant_states(facts: Facts) -> list[Standing]:
    """Return where what changes without driving may be: each thing, with all whose places its own
    tells, as they always change together. Of several that tell the same the first one says it.
    """
    snapshot, found = facts.snapshot, dict[frozenset[tuple[str, str]], str]()
    constant = (c for c in snapshot.changes if c.term.kind is TermKind.CONSTANT)
    known = {(c.object, c.activity): c.term.name for c in constant}
    for things in sorted(set(facts.changed_together.values())):
        movers = sorted(snapshot.movers[things[0]])
        rows = {tuple(known.get((t, a), "") for t in things) for a in movers}  # "": any place
        rows.add(tuple(snapshot.initial[t] for t in things))
        for row, k in itertools.product(sorted(rows), range(len(things))):
            columns = zip(*(r for r in rows if r[k] in (row[k], "")), strict=True)
            sure = {t: c[0] for t, c in zip(things, columns, strict=True) if {*c} == {c[0] or None}}
            if row[k]:
                found.setdefault(frozenset({**sure, things[k]: row[k]}.items()), things[k])
    return [(thing, dict(sorted(places))) for places, thing in found.items()]
