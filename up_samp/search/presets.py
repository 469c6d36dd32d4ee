"""Presets: which components a search is made of, by the ideas that are not left out.

Each part names the ideas that it belongs to; a preset (or an ablation) without one of them leaves
the part out. This is nearly the only place that asks for ideas.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TypeVar

from up_samp.extensions import parts
from up_samp.model.refinement import Refinement, Strength
from up_samp.search.budget import SchedulerPace
from up_samp.search.check import CheckAlone, check_duration, check_path
from up_samp.search.cuts import Attempt, PaperCuts, SmallCuts
from up_samp.search.due import due_too_soon
from up_samp.search.events import Phase
from up_samp.search.facts import Facts, just_this
from up_samp.search.fleet.improve import in_order, in_order_at_last
from up_samp.search.params import IDEAS, Parameters
from up_samp.search.resolve import (
    begin_soon,
    least_work,
    prune_motions,
    repair_durations,
    serialize_motions,
    slack,
)
from up_samp.search.search import Components, Search, Statement
from up_samp.search.statements import (
    fastest_durations,
    kept_orders,
    lower_bounds,
    proven_handovers,
    unary_places,
    unreachable,
)

Part = TypeVar("Part")
Ideas = tuple[str, ...]

LAYERS: Sequence[tuple[CheckAlone, Ideas]] = (
    (check_path, ("single_geometric",)),
    (check_duration, ("single_temporal",)),
)


def _statements() -> Sequence[tuple[Statement, Ideas]]:
    """Return what is told to the scheduler before the first schedule."""

    def durations(search: Search, *, guesses: bool = False) -> list[Refinement]:
        def tell(count: int, total: int) -> None:
            search.tell.stage(Phase.PREPARE, "unobstructed motions", count, total)

        told = fastest_durations(search.motions, search.knowledge, tell)
        return [r for r in told if guesses or r.strength is not Strength.HEURISTIC]

    return (
        (
            Statement("lower bounds on motions", lambda s: lower_bounds(s.motions, s.knowledge)),
            ("bounds_first",),
        ),
        (
            Statement("what is due too soon", lambda s: due_too_soon(s.problem.source, s.motions)),
            ("bounds_first",),
        ),
        (
            Statement("proofs of unreachability", lambda s: unreachable(s.motions)),
            ("certificates",),
        ),
        (
            Statement("unary places", lambda s: unary_places(s.motions)),
            ("certificates", "native"),
        ),
        (
            Statement("orders on rings", lambda s: kept_orders(s.motions)),
            ("certificates",),
        ),
        (
            Statement("unobstructed motions", durations, partial(durations, guesses=True)),
            ("bounds_first",),
        ),
        (
            Statement("handing over places", lambda s: proven_handovers(s.motions)),
            ("bounds_first", "handovers"),
        ),
        *((Statement(name, told), ("refine",)) for name, told in parts("statements").items()),
    )


def components_of(params: Parameters, *, native: bool) -> Components:
    """Return the components that parameters ask for.

    ``native``: the scheduler is our own, which knows unary places and goes on from what it knows,
    if only to draw what another one is handed over.
    """
    if params.components is not None:
        return params.components
    ideas = IDEAS.keys() - params.without | ({"native"} if native else set())

    # what parts from outside know comes first
    outside = tuple(parts("cuts").values()) if "refine" in ideas else ()
    repair = partial(repair_durations, loose="slack" in ideas)

    def with_ideas(some: Sequence[tuple[Part, Ideas]]) -> tuple[Part, ...]:
        return tuple(part for part, needed in some if ideas.issuperset(needed))

    return Components(
        statements=with_ideas(_statements()),
        layers=with_ideas(LAYERS),
        cuts=_cuts(ideas, outside, params.seed),
        pace=SchedulerPace(ideas >= {"native", "incumbents"}),
        shapers=with_ideas(((slack, ("slack",)),)),
        builders=with_ideas(((in_order, ("incumbents",)),)),
        repairs=with_ideas(
            tuple(
                (one, ("incumbents",))
                for one in (repair, in_order_at_last, serialize_motions, least_work)
            )
        ),
        improvers=tuple(parts("improvers").values()),
        finishers=with_ideas(((prune_motions, ("tidy",)), (begin_soon, ("tidy",)))),
        learns="refine" in ideas,
    )


def _cuts(ideas: set[str], attempts: tuple[Attempt, ...], seed: int) -> SmallCuts:
    alike = Facts.like if "equivalents" in ideas else just_this
    if "small_cuts" in ideas:
        return SmallCuts(alike, attempts)
    return PaperCuts(alike, widened="equivalents" in ideas, seed=seed)
