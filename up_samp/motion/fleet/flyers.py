"""Several free flyers (SE3) at once: one after the other, each as early as those before it allow.

Prioritised planning (Erdmann & Lozano-Perez 1987): every flyer takes its planner's best path among
what rests and leaves when it meets nobody on it, or a path around where it would meet somebody.
Other orders, and paths that keep out of the places where the others start and end, are tried where
somebody is late. Nobody steps aside for another: finding nothing proves nothing.

Bodies that drive in the plane among them are decided already: groups of both kinds are planned by
:mod:`up_samp.motion.fleet.mixed`.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from up_samp.model import (
    Deadline,
    FixedMotion,
    GroupQuery,
    GroupReport,
    Outcome,
    PathReport,
    Rest,
    TimedMotion,
)
from up_samp.motion.fleet.cell_times import TIMES
from up_samp.motion.fleet.flyer_contacts import Flight
from up_samp.motion.fleet.one_flyer import PrioritisedFlyers, decided, resting
from up_samp.motion.fleet.workspace import PathPlanner, fleet_tuning


def coordinate_flights(service: PathPlanner, query: GroupQuery, deadline: Deadline) -> GroupReport:
    """Find flights for all motions of ``query`` (free flyers): clear of each other, of what rests
    and of what is decided; late if there is no other way found. Deterministic, but for the
    deadline.
    """
    began = time.monotonic()
    world = [*map(resting, query.rests), *map(decided, query.fixed)]
    motions = {m.name: m for m in query.motions}
    tuning = fleet_tuning(service).flights
    space = PrioritisedFlyers(service, tuning, motions, query.rests, world, deadline)
    best: dict[str, Flight] | None = None
    least, stuck = math.inf, ""
    for wide, order in itertools.product((False, True), _orders(motions, tuning.orders)):
        if deadline.expired() or least <= TIMES.on_time or (wide and len(motions) < 2):
            break
        flights, failed = _one_by_one(space, order, wide)
        late = sum(max(0.0, f.trajectory.end - motions[n].due) for n, f in flights.items())
        if failed:
            stuck = failed
        elif late < least - TIMES.on_time:
            best, least = flights, late
    seconds = time.monotonic() - began
    complete = space.complete and not deadline.expired()
    if best is None:
        return replace(_nothing(space, stuck, seconds), complete=complete)
    return replace(_found(space, best, seconds), complete=complete)


def _orders(motions: Mapping[str, TimedMotion], most: int) -> Iterator[tuple[str, ...]]:
    """Yield so many orders of priority at most, by release first; one object's motions stay in
    order.
    """
    first = sorted(motions, key=lambda n: (motions[n].release, motions[n].due, n))
    rank = {name: i for i, name in enumerate(first)}

    def fits(order: Sequence[str]) -> bool:
        return all(
            rank[a] < rank[b]
            for a, b in itertools.combinations(order, 2)
            if motions[a].object == motions[b].object
        )

    some = itertools.islice(itertools.permutations(first), 20 * most)
    yield from itertools.islice(filter(fits, some), most)


def _one_by_one(
    space: PrioritisedFlyers, order: Sequence[str], wide: bool
) -> tuple[dict[str, Flight], str]:
    """Return the flights of an order, and who has none (then the others are incomplete)."""
    flights: dict[str, Flight] = {}
    space.virtual.clear()
    for index, name in enumerate(order):
        flight = space.fly(name, flights, wide, order[index + 1 :])
        if flight is None:
            return flights, name
        for other, known in flights.items():
            if known.object == flight.object and flight.trajectory.start > known.trajectory.end:
                # it rests where it arrived until it flies on
                flights[other] = replace(known, until=min(known.until, flight.trajectory.start))
        flights[name] = flight
    return flights, ""


def _nothing(space: PrioritisedFlyers, stuck: str, seconds: float) -> GroupReport:
    conflict = {stuck, *(space.met.get(stuck, set()) & set(space.motions))} - {""}
    why = space.report.reason if space.report is not None else "it would always meet somebody"
    return GroupReport(
        Outcome.OUT_OF_TIME if space.deadline.expired() else Outcome.NOT_FOUND,
        conflict=frozenset(conflict or space.motions),
        blockers=frozenset(r.name for r in space.rests),
        reason=f"{stuck}: {why}" if stuck else "out of time",
        seconds=seconds,
    )


def _found(space: PrioritisedFlyers, flights: Mapping[str, Flight], seconds: float) -> GroupReport:
    ends = {name: flights[name].trajectory.end for name in sorted(flights)}
    late = {n: end for n, end in ends.items() if end > space.motions[n].due + TIMES.on_time}
    met = set().union(*(space.met.get(n, set()) for n in late), late)
    return GroupReport(
        Outcome.FOUND,
        {name: flights[name].trajectory for name in sorted(flights)},
        late,
        frozenset(met & set(space.motions)) if late else frozenset(),
        frozenset(r.name for r in space.rests) if late else frozenset(),
        f"late: {', '.join(late)}" if late else "",
        seconds,
    )


def earliest_flight(
    service: PathPlanner,
    motion: TimedMotion,
    rests: Sequence[Rest],
    fixed: Sequence[FixedMotion],
    deadline: Deadline,
) -> PathReport:
    """Return the earliest found arrival of one flyer (in plan time; perhaps after its due)."""
    began = time.monotonic()
    report = coordinate_flights(
        service, GroupQuery((motion,), tuple(rests), tuple(fixed)), deadline
    )
    return PathReport(
        report.outcome,
        report.trajectories.get(motion.name),
        report.blockers,
        reason=report.reason,
        planner="flights",
        seconds=time.monotonic() - began,
        complete=report.complete,
    )
