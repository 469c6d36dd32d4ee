"""Plan what is left anew, and go on: on a simulated floor, leg by leg."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import OneshotPlanner

from up_samp.execution.executor import Executor
from up_samp.execution.files import with_dependencies
from up_samp.execution.remaining import Remaining, Surprise
from up_samp.execution.simulate import Delays, Floor, Simulation, floor_of, simulation_of
from up_samp.io.plan_dict import PlanDict, result_to_dict
from up_samp.model import ProblemError
from up_samp.model.execution_tuning import ExecutionTuning


def joined(
    legs: Sequence[Simulation], since: Sequence[float], problems: Sequence[SchedulingProblem]
) -> Simulation:
    """Return one run of all legs, on the clock of the first; ``since`` are the legs' starts (s). An
    activity that goes on in a later leg is there once for each: ``NAME``, ``NAME (resumed)``.
    """
    first, last = legs[0], legs[-1]
    makespan = since[-1] + last.makespan
    lasted = sum(leg.lasted for leg in legs)
    waited = sum(leg.waiting * leg.lasted for leg in legs)
    return replace(
        last,
        seed=first.seed,
        planned=first.planned,
        makespan=makespan,
        waiting=waited / lasted if lasted else 0.0,
        lasted=lasted,
        overruns=sum(leg.overruns for leg in legs),
        reorders=sum(leg.reorders for leg in legs),
        contacts=tuple(
            replace(c, time=c.time + begin)
            for leg, begin in zip(legs, since, strict=True)
            for c in leg.contacts
        ),
        broken=tuple(text for leg in legs for text in leg.broken),
        missed=tuple(text for leg in legs for text in leg.missed),
        record=_record(legs, since, makespan),
        waits=tuple(
            (who, low + begin, high + begin, whom)
            for leg, begin in zip(legs, since, strict=True)
            for who, low, high, whom in leg.waits
        ),
        replans=len(legs) - 1,
        legs=tuple(zip(since, legs, problems, strict=True)),
    )


def _record(legs: Sequence[Simulation], since: Sequence[float], makespan: float) -> PlanDict:
    """Return the legs' records one after the other."""
    unit = float(legs[0].record["seconds_per_unit"])
    parts: dict[str, list[Any]] = {}
    taken: set[str] = set()
    for leg, begin in zip(legs, since, strict=True):
        names = {a["name"]: _fresh(a["name"], taken) for a in leg.record["activities"]}
        taken.update(names.values())
        for key, entries in _later(leg.record, begin, unit).items():
            parts.setdefault(key, []).extend(_renamed(entries, names))
    if not parts["rides"]:
        del parts["rides"]
    parts["motions"].sort(key=lambda m: m["samples"][0][0])
    return {**legs[0].record, **parts, "makespan": round(makespan / unit, 6)}


def _fresh(name: str, taken: set[str]) -> str:
    count, found = 1, name
    while found in taken:
        found = f"{name} (resumed)" if count == 1 else f"{name} (resumed {count})"
        count += 1
    return found


def _later(record: PlanDict, begin: float, unit: float) -> dict[str, list[dict[str, Any]]]:
    """Return what happened, ``begin`` s later."""
    times = {
        "activities": (("start", "end"), begin / unit, 9),
        "changes": (("time",), begin, 6),
        "waits": (("since", "until"), begin, 6),
    }
    found = {
        part: [{**e, **{key: round(e[key] + by, digits) for key in keys}} for e in record[part]]
        for part, (keys, by, digits) in times.items()
    }
    found["motions"] = [
        {**m, "samples": [[round(r[0] + begin, 6), *r[1:]] for r in m["samples"]]}
        for m in record["motions"]
    ]
    return {**found, "rides": list(record.get("rides", ()))}


def _renamed(
    entries: Sequence[Mapping[str, Any]], names: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Return entries with their activities' names in the whole record."""
    keys = ("name", "activity")
    return [{**e, **{key: names[e[key]] for key in keys if key in e}} for e in entries]


# ------------------ Plan what is left anew, and go on: on a simulated floor, leg by leg


ENGINE = "samp-refine[cpsat]"

LAST_METRES = 30.0
"""Seconds that robots may be late in coming to a stand, beside those in which they are held up."""


def solve_remaining(
    left: Remaining, *, engine: str = ENGINE, seconds: float | None = None
) -> PlanDict:
    """Return a plan of what is left with its dependencies, sought from the rest of the old plan
    (``left.hint``) on, in its units and with its clearance (``left.params``).

    Raises :class:`ProblemError` where the engine finds none within ``seconds``.
    """
    with OneshotPlanner(name=engine, params=dict(left.params)) as planner:
        result = planner.solve(left.problem, timeout=seconds, warm_start_plan=left.hint)
    return with_dependencies(left.problem, result_to_dict(left.problem, result))


@dataclass(frozen=True)
class Incident:
    """At ``time`` (s since the first plan's start) this becomes known. Robots ``broken_down`` are
    out of order from then on, wherever they stand.
    """

    time: float
    surprise: Surprise = field(default_factory=Surprise)
    broken_down: tuple[str, ...] = ()


Told = tuple[Surprise, Mapping[str, float]]
"""What has happened, and how far (m) robots that were under way then still go."""


def simulate_replanned(
    problem: SchedulingProblem,
    plan: PlanDict,
    delays: Delays,
    seed: int = 0,
    *,
    incidents: Sequence[Incident] = (),
    late: float | None = None,
    solve: Callable[[Remaining], PlanDict] = solve_remaining,
    tuning: ExecutionTuning = ExecutionTuning(),
) -> Simulation:
    """Execute a plan; plan the rest anew at each incident, and once when it is forecast to end
    ``late`` s later than planned (with the same choices).

    The new plan begins when all robots under way have come to a stand where they can: where one is
    held up then, deadlines of the rest count from that moment. A leg (``legs`` of what is returned)
    draws its delays from ``seed`` plus its number.
    """
    legs: list[Simulation] = []
    problems, since = [problem], [0.0]
    waiting = sorted(incidents, key=lambda i: i.time)
    while True:
        executor = Executor(plan, problem, tuning=tuning)
        floor = floor_of(executor, delays, seed + len(legs))
        told = _until(floor, since[-1], waiting, None if legs else late)
        if told is None:
            legs.append(simulation_of(floor, plan, "replan", seed))
            return joined(legs, since, problems)
        surprise, stops = told
        left = executor.remaining_problem(surprise)
        start = left.since * float(plan["seconds_per_unit"])
        start = _come_to_a_stand(floor, {**stops, **left.stops}, start)
        legs.append(simulation_of(floor, plan, "replan", seed))
        plan, problem = solve(left), left.problem
        problems.append(problem)
        since.append(since[-1] + start)


def _until(floor: Floor, since: float, waiting: list[Incident], late: float | None) -> Told | None:
    """Execute until something happens; ``None``: until the end."""
    executor = floor.executive
    planned, looked = floor.dependencies.graph.planned, 0.0
    while floor.goes_on:
        if waiting and since + floor.now >= waiting[0].time:
            return _told(executor, waiting.pop(0))
        if late is not None and floor.now >= looked + 1.0:
            looked = floor.now
            if executor.predicted_makespan() > planned + late:
                return Surprise(same_choices=True), {}
        floor.step()
    return None


def remaining_at(problem: SchedulingProblem, plan: PlanDict, incident: Incident) -> Remaining:
    """Return what is left of a plan that was carried out without delays until an incident.

    Raises :class:`ProblemError` where all was over by then.
    """
    executor = Executor(plan, problem)
    floor = floor_of(executor, Delays(), 0)
    while floor.goes_on and floor.now < incident.time - 1e-9:
        floor.step()
    if not floor.goes_on:
        raise ProblemError(
            f"nothing is left at {incident.time:g} s: the plan is over after {floor.now:g} s"
        )
    surprise, _ = _told(executor, incident)
    return executor.remaining_problem(surprise)


def _told(executor: Executor, incident: Incident) -> Told:
    """Return an incident's surprise, with where robots that have broken down come to a stand."""
    surprise = incident.surprise
    if not incident.broken_down:
        return surprise, {}
    broken = dict(surprise.broken)
    here = executor.remaining_problem()
    for name in incident.broken_down:
        if name not in here.poses:
            names = ", ".join(sorted(here.poses))
            raise ProblemError(f"'{name}' cannot break down: what stands on the floor is {names}")
        x, y, theta = here.poses[name]
        broken[name] = (x, y, theta)
    return replace(surprise, broken=broken), here.stops


def _come_to_a_stand(floor: Floor, stops: Mapping[str, float], until: float) -> float:
    """Let robots under way drive on to where they stop; nothing new begins. Return when (s) all
    stand: at ``until``, or later where one is held up on these last metres.
    """
    late = 0.0
    while True:
        left = [
            r
            for r in floor.robots.values()
            if r.motion is not None and max(r.s, r.believed) < stops.get(r.name, 0)
        ]
        if not left and floor.now >= until - 1e-9:
            return floor.now
        held = any(floor.now < r.held_until for r in left)
        late += floor.tick if floor.now >= until and not held else 0.0
        if late > LAST_METRES:
            names = ", ".join(f"'{r.name}'" for r in left)
            raise ProblemError(f"the rest cannot be planned: {names} did not come to a stand")
        for robot in left:
            robot.until, robot.hold = stops[robot.name], False
            robot.step(floor.now, floor.tick)
        floor.now = round(floor.now + floor.tick, 9)
