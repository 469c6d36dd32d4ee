"""What is said of things that always move together holds in every state that they can come to."""

import itertools
import random
from types import SimpleNamespace

from up_samp.model.snapshot import ChangeTask, Term, TermKind
from up_samp.search.facts import Facts
from up_samp.search.statements import _instant_states

PLACES = ("p", "q", "s")


def drawn(rng):
    """Some things, where they are at first, and what activities change at their ends."""
    things = [f"leaf{k}" for k in range(rng.randint(1, 4))]
    changes = []
    for number in range(rng.randint(1, 4)):
        some = things if rng.random() < 0.6 else rng.sample(things, rng.randint(1, len(things)))
        for thing in some:
            known = Term(TermKind.CONSTANT, rng.choice(PLACES))
            term = known if rng.random() < 0.8 else Term(TermKind.PARAMETER, "any")
            changes.append(ChangeTask(f"open{number}", thing, term))
    rng.shuffle(changes)
    used = {c.object for c in changes}
    initial = {thing: rng.choice(PLACES) for thing in things if thing in used}
    movers = {t: frozenset(c.activity for c in changes if c.object == t) for t in initial}
    facts = SimpleNamespace(
        snapshot=SimpleNamespace(changes=changes, initial=initial, movers=movers),
        instant=frozenset(initial),
    )
    facts.changed_together = Facts.changed_together.func(facts)
    return facts


def states(facts):
    """All states: whatever of an activity's changes is not constant may be any place."""
    rows = {}
    for change in facts.snapshot.changes:
        known = change.term.kind is TermKind.CONSTANT
        rows.setdefault(change.activity, {})[change.object] = (
            (change.term.name,) if known else PLACES
        )
    names = sorted(facts.snapshot.initial)
    found, new = set(), {tuple(facts.snapshot.initial[n] for n in names)}
    while new:
        found |= new
        moved = (
            {**dict(zip(names, state, strict=True)), **dict(zip(row, put, strict=True))}
            for state in new
            for row in rows.values()
            for put in itertools.product(*row.values())
        )
        new = {tuple(state[n] for n in names) for state in moved} - found
    return [dict(zip(names, state, strict=True)) for state in found]


def test_the_place_of_one_tells_those_of_the_others():
    for seed in range(200):
        check_places(drawn(random.Random(f"together {seed}")))


def check_places(facts):
    said, every = _instant_states(facts), states(facts)
    for thing, places in said:
        assert thing in places
        there = [state for state in every if state[thing] == places[thing]]
        assert all(state.items() >= places.items() for state in there), (thing, places)
    # where each constant place of each thing is, somebody says so
    for change in facts.snapshot.changes:
        if change.term.kind is TermKind.CONSTANT:
            assert any(p.get(change.object) == change.term.name for _, p in said)
