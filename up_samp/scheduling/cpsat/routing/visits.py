"""Where a traveller has to arrive some time although nothing happens there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from up_samp.scheduling.cpsat.encode.forms import TRUE, Form, Literal, value_told
from up_samp.scheduling.cpsat.routing.route import Move, Route

if TYPE_CHECKING:
    from up_samp.scheduling.cpsat.model import ScheduleModel


def find_visits(model: ScheduleModel, route: Route) -> None:
    """Find the places to which one of some moves has to be made.

    A visit begins when such a move ends, so nothing may need a rest after it.

    Assumes: one of some moves is there in every schedule, all of them lead to one place, and none
    is odd.
    """
    if route.gap > 0:
        return
    moves: dict[Literal, list[Move]] = {}
    for move in route.moves:
        if move.name not in route.odd:
            moves.setdefault(model.world.activities[move.name].present, []).append(move)
    clauses = [form[1:] if form.__class__ is tuple and form[0] == "|" else (form,)
               for form in model.stated]  # fmt: skip
    clauses += [*model.exact.values(), *((p,) for p in moves if p == TRUE)]
    visited = set()
    for every in clauses:
        places = set[int]()
        for part in every:
            some = _leading(model, part, moves)
            if some is None:
                break
            places |= some
        else:
            visited |= places if len(places) == 1 else set()
    known = {next(iter(places)) for _, places in route.stops if len(places) == 1}
    for place in sorted(visited - known):
        route.visits.append((f"visit {place} of {route.key}", frozenset((place,))))
    route.late |= {name for name, _ in route.visits}


def _leading(
    model: ScheduleModel, part: Form, moves: dict[Literal, list[Move]]
) -> frozenset[int] | None:
    """Return where the traveller has come if ``part`` holds: "this move is made" (with these
    values of its parameters); nowhere, if it cannot hold; ``None``, if it says anything else.
    """
    parts = part[1:] if part.__class__ is tuple and part[0] == "&" else (part,)
    literals = [p for p in parts if p.__class__ is int]
    values = [v for p in parts if (v := value_told(p, "==")) is not None]
    if any(model.store.never(literal) for literal in literals):
        return frozenset()
    mine = next((moves[literal] for literal in literals if literal in moves), None)
    if mine is None:
        return None
    # whatever else it says, one of the moves is made that it does not exclude
    return frozenset(
        m.to for m in mine if all(dict(m.values).get(var, v) == v for var, v in values)
    )
