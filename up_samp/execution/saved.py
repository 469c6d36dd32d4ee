"""What has happened to a plan so far, kept and taken up again, or told by those who were there."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from up_samp.execution.build import with_sides
from up_samp.execution.files import event_from_list, event_to_list
from up_samp.execution.forecast import routes_of
from up_samp.execution.graph import At, Event, Graph
from up_samp.execution.reports import is_number
from up_samp.execution.state import Phase, Way
from up_samp.execution.tolerances import TOLERANCES
from up_samp.model import ProblemError

if TYPE_CHECKING:
    from up_samp.execution.executor import Executor

FORMAT, VERSION = "up-samp-execution", 1


def saved(executor: Executor) -> dict[str, Any]:
    """Return an executor's state as JSON would hold it."""
    state = executor.state
    begun = [w for w in state.ways.values() if state.phase[w.activity] is not Phase.WAITING]
    return {
        "format": FORMAT,
        "version": VERSION,
        "problem": executor.plan.get("problem"),
        "now": state.now,
        "tolerance": state.tolerance,
        "localisation": state.localisation,
        "running": list(executor._running),
        "done": [n for n, phase in state.phase.items() if phase is Phase.DONE],
        "fired": [[event_to_list(event), time] for event, time in state.fired.items()],
        "motions": [
            {
                "activity": w.activity,
                "object": w.object,
                "progress": w.progress,
                "told": w.told,
                "since": w.since,
                "at_end": w.at_end,
            }
            for w in begun
        ],
        "heard": dict(executor._told),
        "held": dict(executor._held),
        "sides": [[*key, side] for key, side in executor.sides.items()],
        "turned": sorted(executor.turned),
        "pace": executor.pace.saved(),
    }


def resume(executor: Executor, known: Mapping[str, Any], graph: Graph | None = None) -> None:
    """Let a fresh executor go on from a saved state; ``graph`` is that of its orders, if known."""
    if (known.get("format"), known.get("version")) != (FORMAT, VERSION):
        raise ProblemError(
            f"this is no saved execution of version {VERSION}: {known.get('format')!r}, "
            f"version {known.get('version')!r}"
        )
    if known["problem"] != executor.plan.get("problem"):
        raise ProblemError(
            f"what was saved is of a plan of {known['problem']!r}, not of "
            f"{executor.plan.get('problem')!r}"
        )
    state = executor.state
    for name in (*known["running"], *known["done"]):
        if name not in state.phase:
            raise ProblemError(f"what was saved speaks of '{name}', which the plan has not")
    executor.sides = {(one, other, int(c)): side for one, other, c, side in known["sides"]}
    executor.turned = frozenset(known["turned"])
    if graph is None and (executor.sides or executor.turned):
        graph = with_sides(executor.dependencies, executor.sides, executor.turned)
    state.now = float(known["now"])
    state.fired = {event_from_list(event): float(time) for event, time in known["fired"]}
    for entry in known["motions"]:
        way = state.ways.get((entry["activity"], entry["object"]))
        if way is None:
            raise ProblemError(
                f"what was saved speaks of '{entry['activity']}' of '{entry['object']}', which the "
                "plan has not"
            )
        way.progress, way.told = float(entry["progress"]), float(entry["told"])
        way.since, way.at_end = float(entry["since"]), bool(entry["at_end"])
    _begun(executor, known["running"], known["done"])
    executor._told = {robot: float(time) for robot, time in known["heard"].items()}
    executor._held = dict(known["held"])
    executor.pace.load(known["pace"])
    state.load(state.graph if graph is None else graph)
    executor.routes = routes_of(state.graph, state.ways)
    executor._bar()


def _begun(executor: Executor, running: Collection[str], done: Collection[str]) -> None:
    state = executor.state
    for name in (*running, *done):
        del executor._ready[name]
        state.phase[name] = Phase.RUNNING if name in running else Phase.DONE
    executor._running = dict.fromkeys(running)
    state.of_object = {w.object: w for name in running for w in state.ways_of[name]}


def join(
    executor: Executor,
    now: float,
    done: Collection[str],
    under_way: Mapping[str, Mapping[str, Sequence[float] | float]],
    times: Mapping[str, tuple[float, float | None]],
) -> None:
    """Let a fresh executor go on from what is told, see :meth:`Executor.join`."""
    state = executor.state
    for name in (*done, *under_way, *times):
        if name not in state.phase:
            raise ProblemError(f"the plan has no activity '{name}'")
    both = sorted(set(done) & set(under_way))
    if both:
        raise ProblemError(f"'{both[0]}' is told to be over, and to be under way")
    if not is_number(now) or now < 0.0:
        raise ProblemError(f"the time cannot be {now!r}: at least 0 s")
    here = {
        way.activity + way.object: _where(executor, way, under_way[way.activity])
        for name in under_way
        for way in state.ways_of[name]
    }
    _begun(executor, list(under_way), done)
    state.now = float(now)
    for name in (*done, *under_way):
        start, end = times.get(name, (now, None))
        state.fired[Event(At.START, name)] = float(start)
        for way in state.ways_of[name]:
            executor._told[way.object] = way.since = float(now)
            way.told = way.progress = here.get(name + way.object, way.length)
        if name in done:
            state.fired[Event(At.END, name)] = float(now if end is None else end)
    _as_planned(executor, done)
    for way in state.ways.values():
        if way.activity in under_way:
            way.progress = 0.0  # believed as far as its gates are open
    state.load(state.graph)
    before: list[float] = []
    while before != (here_now := [w.progress for w in state.of_object.values()]):
        before = here_now  # where one is opens the gates of others
        for way in state.of_object.values():
            state.follow(way)
    executor._bar()


def _where(executor: Executor, way: Way, told: Mapping[str, Sequence[float] | float]) -> float:
    """Return the progress (m) of a robot under way."""
    at = told.get(way.object)
    if at is None:
        raise ProblemError(f"'{way.activity}' is under way: where is '{way.object}'?")
    if isinstance(at, Sequence):
        if len(at) != 3 or not all(map(is_number, at)):
            raise ProblemError(f"a pose of '{way.object}' cannot be {at!r}: three finite numbers")
        place = executor.progress_of(way.activity, way.object, at)
        if place.off > 2 * executor.state.localisation + TOLERANCES.place:
            raise ProblemError(
                f"'{way.object}' is {place.off:.3f} m off the path of '{way.activity}'"
            )
        return place.progress
    slack = executor.state.localisation + TOLERANCES.progress
    if not is_number(at) or not -slack <= at <= way.length + slack:
        raise ProblemError(
            f"'{way.object}' cannot be at {at!r} m of '{way.activity}', which is "
            f"{way.length:.3f} m long"
        )
    return float(at)


def _as_planned(executor: Executor, done: Collection[str]) -> None:
    """Raise :class:`ProblemError` where something has begun, or is over, before what it has to
    wait for. Of points on the paths of motions that are over all have been passed.
    """
    state, graph = executor.state, executor.state.graph
    for event in graph.events:
        if event.at in (At.REACH, At.LEAVE) and event.activity in done:
            state.fired[event] = state.fired[Event(At.END, event.activity)]
    for edge in graph.edges:
        first, then = graph.events[edge.first], graph.events[edge.then]
        if then not in state.fired or first in state.fired or first.at is At.ORIGIN:
            continue
        if first.at is At.REACH and first.activity not in done:
            way = state.ways[first.activity, first.object]
            running = state.phase[first.activity] is Phase.RUNNING
            if running and way.told + state.localisation >= first.progress:
                continue
        raise ProblemError(f"{then} cannot be told: {first} comes before it ({edge.why})")
