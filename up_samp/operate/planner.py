"""The planner's process: what is left of the day as a fleet problem from the cut on, solved under a
budget, and put behind what is kept of the plan that is driven.
"""

from __future__ import annotations

import contextlib
import gc
import math
import os
import pickle
import sys
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from itertools import starmap
from typing import TYPE_CHECKING, Any, BinaryIO

from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import is_same_place
from up_samp.fleet.faults import FleetError, job_faults
from up_samp.fleet.fields import corners_of
from up_samp.fleet.meanings import Written
from up_samp.fleet.outlines import placed
from up_samp.fleet.records import (
    Door,
    FleetRecords,
    Order,
    Place,
    Resource,
    Robot,
    Stop,
    Task,
    Zone,
    can_do,
    visited,
)
from up_samp.fleet.spelled_out import without_repeats
from up_samp.io.plan_dict import PlanDict
from up_samp.model import ProblemError, SampError, UnsupportedError
from up_samp.model.deadline import computing_time
from up_samp.operate.records import Pose, Shape
from up_samp.operate.stitch import BUSY, Question, stitched
from up_samp.operate.upkeep import (
    battery_of,
    charger_of,
    charges,
    is_charge,
    state_charges,
    with_levels,
)
from up_samp.operate.zones import still_counted
from up_samp.system.child import ProcessGroup, command, environment

if TYPE_CHECKING:
    from up_samp.motion.protocol import MotionCache

ABLE = (":able",)
"""What robots have to be to open a door: those that do nothing now would be planned to, too."""
RESTS = 2
"""Places at which who is in the way may rest."""
WRITING, EACH_KEPT = 0.1, 0.03
"""Seconds of a budget that writing a problem, and what comes of it, down takes; and for each
activity that is kept: putting what is new behind it, and all of it in order."""
LEAST = 0.25
"""Share of a budget for which a plan is sought at least."""


@dataclass(frozen=True)
class Answer:
    """A plan (``None``: there is none, and ``why``), and the seconds that it took. ``found``: what
    is new has a plan for itself, whether or not it goes with what is kept.
    """

    number: int
    plan: PlanDict | None
    why: str = ""
    seconds: float = 0.0
    cpu: float = 0.0
    found: bool = True


def _by_machine(job: Order | Task) -> object:
    """Return whether no robot does a job, or one at a machine that is not chosen yet."""
    if isinstance(job, Order):
        return job.pickup.task or job.delivery.task
    return job.modes or not job.at


NOT_YET: tuple[tuple[str, Callable[[Any, FleetRecords], object], str], ...] = (
    ("floors", lambda *_: True, "floor '{}': one floor is operated, the ground"),
    ("doors", lambda door, _: door.closes is not None,
     "door '{}' closes by itself: not operated yet"),
    ("doors", lambda door, _: door.second, "door '{}' has two leaves: not operated yet"),
    ("automatic_doors", lambda door, _: door.shut,
     "automatic door '{}' has a timetable: not operated yet"),
    ("automatic_doors", lambda door, _: door.airlock,
     "automatic door '{}' is one of an airlock: not operated yet"),
    ("robot_types", lambda kind, site: kind.battery is not None and not charger_of(site),
     "robot type '{}' has a battery, and nobody can charge here"),
    ("robot_types", lambda kind, _: kind.unloading != "any",
     "robot type '{}' unloads in an order: not operated yet"),
    ("resources", lambda resource, _: resource != Resource(resource.capacity),
     "resource '{}' is set up or works in batches: not operated yet"),
    ("places", lambda place, _: place.room is not None,
     "place '{}' has room for so many loads: not operated yet"),
    ("zones", lambda zone, _: zone.stopping == "never",
     "zone '{}' forbids to stop in it: not operated yet"),
)  # fmt: skip
"""What of a site cannot be operated: of which records, which ones (of a site), and in words."""

JOBS_NOT_YET: tuple[tuple[Callable[[Any], object], str], ...] = (
    (lambda job: isinstance(job, Order) and job.attached is not None,
     "'{}' has a load with a footprint: not operated yet"),
    (lambda job: isinstance(job, Order) and job.pickup.on,
     "'{}' is on a robot at first: not operated yet"),
    (lambda job: job.together if isinstance(job, Order) else job.crew > 1,
     "'{}' is done by a crew: not operated yet"),
    (_by_machine, "'{}' is done by a machine: not operated yet"),
    (lambda job: is_charge(job.id) and not charges(job),
     "'{}' is called as what robots charge by: call it otherwise"),
)  # fmt: skip


def check_site(site: FleetRecords, otherwise: float = TOLERANCES.localisation) -> None:
    """Raise :class:`UnsupportedError`, by name, for what cannot be operated yet, or not at all;
    ``otherwise``: how far (m) robots that say nothing may be from where they tell to be.
    """
    _check_errors(site, otherwise)
    for records, is_so, text in NOT_YET:
        for name, record in getattr(site, records).items():
            if is_so(record, site):
                raise UnsupportedError(text.format(name))
    for job in site.jobs:
        check_job(job)


def least_margin(site: FleetRecords, otherwise: float) -> float:
    """Return the margin (m) that covers how wrong any two robots are; ``otherwise``: those that say
    nothing.
    """
    errors = [site.senses(n).get("localisation", otherwise) for n in site.robots]
    return round(sum(sorted(errors)[-2:]) + TOLERANCES.margin, 6)


def _check_errors(site: FleetRecords, otherwise: float) -> None:
    """Raise :class:`UnsupportedError` where a robot says how wrong it is, and the margin does not
    cover what the two are that are most so.
    """
    said = {n: e for n in site.robots if (e := site.senses(n).get("localisation")) is not None}
    least = least_margin(site, otherwise)
    if said and site.margin < least:
        name = max(said, key=said.__getitem__)
        raise UnsupportedError(
            f"robot '{name}' may be {said[name]:g} m from where it tells to be: that needs a "
            f"margin of {least:g} m, and the site's is {site.margin:g}"
        )


def check_job(job: Order | Task) -> None:
    """Raise :class:`UnsupportedError` for orders that cannot be operated yet."""
    for is_so, text in JOBS_NOT_YET:
        if is_so(job):
            raise UnsupportedError(text.format(job.id))


def check_fits(site: FleetRecords, record: Order | Task) -> None:
    """Raise :class:`FleetError` where an order speaks of what the site has not."""
    alone = replace(record, after=())
    faults = [*job_faults(_with_jobs(site, [alone]), alone)]
    if faults:
        raise FleetError(faults)


def each_time(record: Order | Task) -> tuple[Order | Task, ...]:
    """Return the orders, or tasks, that a recurring one stands for, or the one that it is."""
    return without_repeats(_with_jobs(FleetRecords(map=""), [record])).jobs


def _with_jobs(site: FleetRecords, jobs: Collection[Order | Task]) -> FleetRecords:
    """Return a site with some orders and tasks instead of its own."""
    orders = tuple(job for job in jobs if isinstance(job, Order))
    return replace(site, orders=orders, tasks=tuple(j for j in jobs if isinstance(j, Task)))


# ------------------ The problem from the cut on


def problem_records(ask: Question) -> FleetRecords:
    """Return what is left of the day as a fleet problem from the cut on."""
    site, places = ask.site, dict(ask.site.places)
    robots: dict[str, Robot] = {}
    for name, robot in site.robots.items():
        if name not in ask.cut.poses:
            continue
        spot = place_at(places, ask.cut.poses[name], name)
        there = name in ask.robots
        skills = (
            robot.skills if name in ask.cut.away.difference(ask.robots) else robot.skills + ABLE
        )
        end = robot.end if there else None
        robots[name] = replace(robot, start=spot, end=end, shift=None, skills=skills)
    loaded = {name for name, _ in ask.held}
    idle = [r for r in ask.robots if r not in loaded]
    jobs: list[Order | Task] = [_brought(o, name) for name, o in ask.held if name in ask.robots]
    known = {j.id for j in (*ask.jobs, *jobs)}
    sure = {j.id for j in ask.kept_jobs} - ask.cut.carrying.keys()
    for job in ask.jobs:
        if never := {*job.after} - known - sure:
            raise ProblemError(f"'{job.id}' comes after '{min(never)}', which nobody ends")
        able = tuple(r for r in idle if can_do(site, r, job) and _time_left(ask, r) > 0.0)
        if not able:
            raise ProblemError(f"nobody is there to do '{job.id}'")
        for name in able:  # home too; whom nothing is given goes there late rather than never
            shift = site.robots[name].shift and (0.0, _time_left(ask, name))
            robots[name] = replace(robots[name], shift=shift)
        after = tuple(n for n in job.after if n in known)
        jobs.append(replace(job, robots=able, after=after))
    full = {  # who only charges may drive there by what is reserved: else it never could
        r: battery_of(site, r).capacity
        for r in idle
        if {is_charge(j.id) for j in jobs if r in j.robots} == {True}
    }
    for name in idle if len(ask.robots) > 1 else ():
        units = math.ceil(ask.cut.free.get(name, 0.0) / site.seconds_per_unit)
        if units >= 1 and any(name in job.robots for job in jobs):
            jobs.append(_busy(name, robots[name].start, units * site.seconds_per_unit))
    for name in ask.beside:
        _let_rest(ask, places, ask.cut.poses[name])
    zones, doors = _floor(ask)
    left = replace(site, places=places, robots=robots, zones=zones, doors=doors)
    return with_levels(_with_jobs(left, jobs), {**ask.levels, **full})


def _floor(ask: Question) -> tuple[dict[str, Zone], dict[str, Door]]:
    """Return the zones, with what nobody may enter, and the doors that are still to be opened."""
    zones = still_counted(ask.site, ask.cut.poses, ask.robots)
    everybody = tuple(ask.site.robot_types)
    for number, corners in enumerate(ask.areas.values()):  # people call areas as they like
        zones[f"area:{ask.number}:{number}"] = Zone(polygon=corners, keep_out=everybody)
    doors = {n: replace(door, skills=door.skills + ABLE) for n, door in ask.site.doors.items()}
    for name, leaves in _still_leaves(ask).items():
        for number, leaf in enumerate(leaves):
            zones[f"leaf:{ask.number}:{name}:{number}"] = Zone(leaf, everybody)
        del doors[name]
    return zones, doors


def _time_left(ask: Question, robot: str) -> float:
    """Return how long (s) before a robot's shift ends the new plan begins, for that robot."""
    return ask.site.robots[robot].hours[1] - max(ask.settings.lead, ask.cut.free.get(robot, 0.0))


def _still_leaves(ask: Question) -> dict[str, list[Shape]]:
    """Return the leaves that nobody moves: they are in the way where they stand, and those out of
    order where they stand closed, too.
    """
    found = {}
    for name, door in ask.site.doors.items():
        shut = name in ask.shut
        pose = ask.cut.poses.get(name, door.closed)
        if shut or is_open(door, pose):
            poses = dict.fromkeys((pose, *[door.closed] * shut))
            found[name] = [leaf_at(door, p) for p in poses]
    return found


def is_open(door: Door, pose: Pose) -> bool:
    """Return whether a door stands open."""
    return math.dist(pose, door.open) <= TOLERANCES.place


def leaf_at(door: Door, pose: Pose) -> Shape:
    """Return the corners of a door's leaf at a pose."""
    return tuple((float(x), float(y)) for x, y in placed(door.leaf, pose))


def place_at(places: dict[str, Place], pose: Pose, who: str) -> str:
    """Return the name of the place at a pose; where there is none, one is added."""
    for name, place in places.items():
        if is_same_place(pose, place.pose):
            return name
    name = f"now:{who}"  # what people give a name has no colon in it
    places[name] = Place(pose=pose, park=0)  # nobody comes back to where it happens to stand
    return name


def _let_rest(ask: Question, places: dict[str, Place], pose: Pose) -> None:
    """Let robots come to rest at the places nearest to a pose at which nobody stands, and which
    nobody that is planned goes to.
    """
    stops = [s for j in ask.jobs for s in visited(j)]
    ends = {p for s in (*stops, *(o.delivery for _, o in ask.held)) for p in s.at}
    ends |= {end for r in ask.robots if (end := ask.site.robots[r].end) is not None}
    taken = [*ask.cut.poses.values(), *(places[p].pose for p in ends)]
    corners = [c for kind in ask.site.robot_types.values() for c in corners_of(kind.footprint)]
    apart = 2 * max(starmap(math.hypot, corners)) + ask.site.margin
    free = [
        (math.dist(place.pose[:2], pose[:2]), name)
        for name, place in places.items()
        if all(math.dist(place.pose[:2], other[:2]) > apart for other in taken)
    ]
    for _, name in sorted(free)[:RESTS]:
        places[name] = replace(places[name], park=1)


def _brought(order: Order, robot: str) -> Task:
    """Return what is left of an order that a robot has already: rather late than never, but not
    between two of its windows.
    """
    stop: Stop = order.delivery
    windows = stop.window or ((0.0, math.inf),)
    *sooner, (opens, _) = windows
    window = (*sooner, (opens, opens + 86400.0)) if sooner else ()
    return Task(
        id=order.id, at=stop.at, duration=stop.service, resources=stop.resources, robots=(robot,),
        due=order.due, weight=order.weight, release=windows[0][0], window=window,
    )  # fmt: skip


def _busy(robot: str, place: str, seconds: float) -> Task:
    window = ((0.0, seconds),)
    return Task(id=f"{BUSY}{robot}", at=(place,), duration=seconds, robots=(robot,), window=window)


def answer(ask: Question, cache: MotionCache | None = None) -> Answer:
    """Plan; what goes wrong is the answer's ``why``. ``cache``: what keeps motions."""
    begun, cpu = time.monotonic(), time.process_time()

    def said(plan: PlanDict | None, why: str = "") -> Answer:
        seconds, computed = time.monotonic() - begun, time.process_time() - cpu
        return Answer(ask.number, plan, why, seconds, computed, new is not None)

    new = None
    try:
        with computing_time() if ask.computing else contextlib.nullcontext():
            new = _solved(ask, cache)
            written, plan = new
            return said(stitched(ask, plan, written.meanings))
    except SampError as error:
        return said(None, " ".join(str(error).split())[:500])


def _solved(ask: Question, cache: MotionCache | None) -> tuple[Written, PlanDict]:
    """Return what is planned anew as a problem, and its plan alone."""
    from up_samp.execution.files import with_dependencies
    from up_samp.fleet.build import write_problem
    from up_samp.fleet.fleet import solve_problem

    records = problem_records(ask)
    written = write_problem(records, ask.folder)
    state_charges(ask.site, written)
    params: dict[str, Any] = {"seed": ask.settings.seed, "cache": cache, "patience": 0.0}
    params |= records.settings | {"reproducible": True}  # whatever else this machine does
    beside = WRITING + EACH_KEPT * len(ask.kept.activities)
    seconds = max(LEAST * ask.seconds, ask.seconds - beside)
    result = solve_problem(written, seconds, params)
    if result.plan is None:
        why = result.explain().removeprefix("no plan: ")
        raise ProblemError(f"no plan within {seconds:.3g} s: {why}")
    said = [o | records.senses(o["name"]) for o in result.data["objects"]]
    data = {**result.data, "objects": said}
    return written, with_dependencies(written.problem, data, localisation=ask.settings.localisation)


# ------------------ The process


def serve(source: BinaryIO, sink: BinaryIO) -> None:
    """Answer questions until nobody asks any more; motions between places are kept so long."""
    from up_samp.motion.protocol import MotionCache

    cache = MotionCache()
    gc.freeze()
    gc.disable()
    while True:
        try:
            ask = pickle.load(source)
        except EOFError:
            return
        pickle.dump(answer(ask, cache), sink)
        sink.flush()
        gc.collect()  # while nobody waits for it


def main() -> None:
    """Serve standard input and output; whatever libraries print goes elsewhere."""
    channel = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(sys.stdin.buffer, channel)


class Planner:
    """A planner in a process of its own: one question at a time. A lost process is the answer to
    its question, and the next question starts another.
    """

    def __init__(self) -> None:
        self._group: ProcessGroup | None = None
        self._thread: threading.Thread | None = None
        self._answer: Answer | None = None

    @property
    def busy(self) -> bool:
        """Whether an answer is due that nobody has taken."""
        return self._thread is not None

    def ask(self, question: Question) -> None:
        """Ask; :meth:`taken` tells the answer."""
        if self.busy:
            raise ProblemError("the planner is busy")
        self._thread = threading.Thread(target=self._ask, args=(question,), daemon=True)
        self._thread.start()

    def _ask(self, question: Question) -> None:
        begun = time.monotonic()
        try:
            group = self._come()
            pickle.dump(question, group.sink)
            group.sink.flush()
            self._answer = pickle.load(group.source)
        except Exception as error:  # half an answer may be read as anything; nobody else sees it
            self._leave()
            seconds = time.monotonic() - begun
            self._answer = Answer(
                question.number, None, f"the planner is lost ({error!r})", seconds
            )

    def taken(self, wait: bool = False) -> Answer | None:
        """Return the answer, once it is there; ``wait``: wait for it."""
        if self._thread is None:
            return None
        self._thread.join(None if wait else 0.0)
        if self._thread.is_alive():
            return None
        self._thread = None
        found, self._answer = self._answer, None
        return found

    def _come(self) -> ProcessGroup:
        if self._group is None or self._group.ended():
            code = "from up_samp.operate.planner import main; main()"
            self._group = ProcessGroup(command(code), env=environment())
        return self._group

    def close(self) -> None:
        """End the process; an answer that is due does not come."""
        group = self._group
        if group is not None:
            group.end()
        if self._thread is not None:
            self._thread.join()
        self._leave()

    def _leave(self) -> None:
        group, self._group = self._group, None
        if group is not None:
            group.close()
