"""What was recognised in a problem and what was left over, in words: why a bound may be weak."""

from __future__ import annotations

from collections import Counter

from up_samp.scheduling.cpsat.encode.states import Key
from up_samp.scheduling.cpsat.encode.timeline import Timeline
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import refusals
from up_samp.scheduling.cpsat.routing.dispatch import find_unit_places
from up_samp.scheduling.cpsat.routing.route import Route


def explain(model: ScheduleModel, routes: list[Route]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return sentences about what was recognised in a model, and about what was left over;
    ``routes`` are those that were found in it.
    """
    found = [
        *(_route(model, route) for route in routes),
        *_cliques(model),
        *_alternatives(model),
        *_states(model, routes),
    ]
    return tuple(found), tuple(_left(model, routes))


def name_of(model: ScheduleModel, key: Key) -> str:
    """Return a ground fluent as it is written."""
    fluent, *arguments = key
    names = {code: name for name, code in model.world.objects.items()}
    if str(fluent).startswith("#"):
        return "a state said with precedences"
    return (
        f"{fluent}({', '.join(str(names.get(a, a)) for a in arguments)})" if arguments else fluent
    )


def _route(model: ScheduleModel, route: Route) -> str:
    doors = len({e.state for entries in route.entries.values() for e in entries})
    names = {move.name for move in route.moves} - route.odd.keys()
    parts = [f"{len(names)} moves", f"{len(route.stops)} stops"]
    if route.visits:
        parts.append(f"{len(route.visits)} places to come to")
    if doors:
        parts.append(f"{doors} needed open on the way")
    if route.home is not None:
        parts.append("a way home")
    return f"route {name_of(model, route.key)}: {', '.join(parts)}"


def _cliques(model: ScheduleModel) -> list[str]:
    sizes = sorted((len(members) for _, members in model.disjunctions.cliques), reverse=True)
    large = [size for size in sizes if size > 2]
    if not large:
        return []
    return [f"one thing at a time: {len(large)} sets of {large[-1]} to {large[0]} activities"]


def _alternatives(model: ScheduleModel) -> list[str]:
    counts = Counter(len(members) for members in model.disjunctions.groups if len(members) > 1)
    return [f"exactly one of {size} activities: {n} times" for size, n in sorted(counts.items())]


def _states(model: ScheduleModel, routes: list[Route]) -> list[str]:
    known = {route.key for route in routes}
    circuits = [
        key
        for key, timeline in model.timelines.items()
        if isinstance(timeline, Timeline) and timeline.linked and key not in known
    ]
    replaced = [key for key in model.replaced if not str(key[0]).startswith("#")]
    counts = {
        "unary places": find_unit_places(model, routes),
        "state variables with transitions": circuits,
        "resources and flags that are for one": replaced,
    }
    return [f"{what}: {len(some)}" for what, some in counts.items() if some]


def _left(model: ScheduleModel, routes: list[Route]) -> list[str]:
    found = [
        f"{name_of(model, key)} is no route: {why}"
        for key, why in sorted(refusals(model, routes).items(), key=str)
    ]
    several = [p for p in model.unread if p.initially is not None or any(p.helpers.values())]
    if several:
        found.append(
            f"{len(several)} preconditions said with precedences (of {several[0].activity} and "
            "others) are stated as written: helpers and rivals may overlap, or some are not named"
        )
    whole = {route.key for route in routes}
    stops = {name for route in routes for name, _ in route.stops}
    moves = {name for route in routes for name in route.movers}
    found += [
        f"beside route {name_of(model, route.key)}: {name} {why}"
        for route in routes
        for name, why in sorted(route.odd.items())
    ]
    odd = {name for route in routes for name in route.odd}
    if whole:
        others = [
            name
            for name, activity in model.world.activities.items()
            if name not in stops | moves | odd and not model.store.never(activity.present)
        ]
        if others:
            found.append(f"{len(others)} activities are on no route ({others[0]} and others)")
    return found
