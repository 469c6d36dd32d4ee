"""What is wrong with the records of a fleet problem, told with its place and what to do."""

from __future__ import annotations

import difflib
import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise, starmap
from operator import eq
from typing import Any

from shapely.geometry import Polygon
from shapely.validation import explain_validity

from up_samp.fleet.fields import FILE_LIMITS, Outline, corners_of
from up_samp.fleet.records import (
    GROUND,
    Attached,
    AutomaticDoor,
    Battery,
    Break,
    Charger,
    Door,
    FleetJob,
    FleetRecords,
    Lane,
    Mode,
    Order,
    Place,
    Repeat,
    Resource,
    Robot,
    RobotType,
    Stop,
    Task,
    Zone,
    able,
    carries,
    needs_robot,
)
from up_samp.fleet.spelled_out import how_often, ids_of, with_places
from up_samp.model import ProblemError
from up_samp.model.bodies import same_pose


def earlier_than(records: FleetRecords, job: Order | Task) -> tuple[str, ...]:
    """Return what has ended before a job begins: what it names, who has put down the load that it
    takes on, the task whose part it fetches, and who brings parts to it.
    """
    found = list(job.after)
    if isinstance(job, Order):
        if isinstance(job.attached, str):
            found.append(job.attached)
        if job.pickup.task is not None:
            found.append(job.pickup.task)
    else:
        found += [o.id for o in records.bringers.get(job.id, ())]
    return tuple(dict.fromkeys(found))


# ------------------ What is wrong with the records of a fleet problem


Path = tuple[str | int, ...]
"""Where in a problem file: keys and indices from its top."""


@dataclass(frozen=True)
class Fault:
    """Something wrong at ``path``."""

    path: Path
    what: str

    def __str__(self) -> str:
        return f"{show_path(self.path)}: {self.what}" if self.path else self.what


class FleetError(ProblemError):
    """A fleet problem is wrong; ``faults`` tells all that is."""

    def __init__(self, faults: Iterable[Fault], text: str | None = None) -> None:
        self.faults = tuple(faults)
        super().__init__(text or told(self.faults))


def told(faults: Sequence[Fault], tell: Callable[[Fault], str] = str) -> str:
    """Return faults as text, a line each; of very many only the first."""
    lines = [tell(fault) for fault in faults[: FILE_LIMITS.shown]]
    more = len(faults) - len(lines)
    return "\n".join([*lines, f"... and {more} more"] if more > 0 else lines)


def show_path(path: Path) -> str:
    """Return ``orders[3].pickup`` for ``("orders", 3, "pickup")``."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def missing(kind: str, name: str, known: Collection[str]) -> str:
    """Say that there is no such name, and what may have been meant."""
    ranked = [(-difflib.SequenceMatcher(None, name, other).ratio(), other) for other in known]
    far, near = min(ranked, default=(0.0, ""))
    if far <= -0.6:
        return f"no {kind} '{name}'; did you mean '{near}'?"
    there = f"there are {', '.join(sorted(known)[:8])}" if known else f"there is no {kind} at all"
    return f"no {kind} '{name}'; {there}"


NO_ROBOT = Fault(("robots",), "there is no robot; add one")
"""What layouts without robots lack to be problems."""


def find_faults(records: FleetRecords) -> list[Fault]:
    """Return all that is wrong with the names and figures of ``records``."""
    whole = with_places(records)
    said = said_wrong(whole, records, ())
    return [*same_names(whole), *said, *(fault for check in CHECKS for fault in check(whole))]


def job_faults(records: FleetRecords, job: Order | Task) -> Iterator[Fault]:
    """Yield what is wrong with one order or task beside its id and circles of ``after``.

    :param records: with the jobs that it names, and whatever takes the same load on.
    """
    path: Path = ("orders" if isinstance(job, Order) else "tasks",)
    yield from said_wrong(records, job, path)
    yield from _job(records, job, path)


def named_by(job: Order | Task) -> set[str]:
    """Return the jobs that one names: those whose load it takes on, too."""
    stops = (job.pickup, job.delivery) if isinstance(job, Order) else ()
    taken = [job.attached] if isinstance(job, Order) and isinstance(job.attached, str) else []
    named = {*job.after, *taken, *(s.task for s in stops if s.task is not None)}
    return named.union(getattr(job, "together", ()))


NAMED = (
    "robot_types", "robots", "places", "doors", "automatic_doors", "zones", "lanes", "lifts",
    "floors", "resources",
)  # fmt: skip


def same_names(records: FleetRecords) -> Iterator[Fault]:
    """Everything with a name has one of its own: they share the namespace of the UP problem."""
    seen: dict[str, str] = {}
    for kind in NAMED:
        for name in getattr(records, kind):
            if name in seen:
                yield Fault((kind, name), f"the name is taken by {seen[name]}.{name}")
            seen.setdefault(name, kind)
    ids: dict[str, str] = {}
    for position, job in enumerate(records.jobs):
        late = position - len(records.orders)
        where: Path = ("orders", position) if late < 0 else ("tasks", late)
        for name in ids_of(job):
            if name in ids:
                yield Fault((*where, "id"), f"the id '{name}' is taken by {ids[name]}")
            ids.setdefault(name, show_path(where))


# ------------------ What records say by themselves, in tables


def _says(zone: Zone) -> list[bool]:
    """Return of each use that a zone may have whether it has it."""
    return [bool(zone.keep_out), zone.max_robots is not None, zone.has_rules]


def _levels(battery: Battery) -> list[float]:
    """Return from which levels on a battery charges otherwise, between its reserve and full."""
    return [battery.reserve, *(level for level, _ in battery.curve), battery.capacity]


def _shortcut(resource: Resource) -> bool:
    """Return whether setting up for a third kind in between is quicker."""
    lasts = resource.setup_between
    ways = itertools.permutations(sorted(resource.kinds), 3)
    return any(lasts(a, via) + lasts(via, b) < lasts(a, b) for a, via, b in ways)


def _until(again: Repeat) -> float:
    """Return when a job that recurs is released at the latest (s)."""
    return math.inf if again.until is None else again.until


def _lengths(task: Task) -> list[float]:
    """Return how long a task may last (s)."""
    modes = [mode.duration for mode in task.modes.values()]
    return modes if task.duration is None else [*modes, task.duration]


RULES: tuple[tuple[type, str, Callable[[Any], object], str], ...] = (
    (RobotType, "reverse", lambda t: t.model == "omni" and t.reverse != "free",
     "an omni drives in any direction; this is for car and diff"),
    (RobotType, "reverse", lambda t: (t.reverse == "slow") != (t.reverse_v_max is not None),
     "reverse: slow goes with reverse_v_max, in m/s"),
    (RobotType, "reverse_cost",
     lambda t: (t.reverse_cost or 1) > 1 and (t.model == "omni" or t.reverse == "never"),
     "weighs driving backwards, which such robots do not"),
    (RobotType, "", lambda t: t.model == "omni" and (t.lateral_a_max or t.alpha_max),
     "lateral_a_max and alpha_max are for car and diff; give an omni less v_max, a_max, omega_max"),
    (RobotType, "pivoting", lambda t: t.model == "omni" and t.pivoting != "free",
     "an omni may turn where it drives; forbid it to turn on the spot in zones"),
    (Battery, "curve", lambda b: b.curve and any(x >= y for x, y in itertools.pairwise(_levels(b))),
     "has levels that rise from the reserve {0.reserve:g} to the capacity {0.capacity:g}"),
    (Battery, "level", lambda b: b.first > b.capacity,
     "is more than the capacity {0.capacity:g}"),
    (Battery, "reserve", lambda b: b.reserve > b.first,
     "the reserve is {0.reserve:g}, and {0.first:g} are there at first"),
    (Charger, "", lambda c: (c.per_second is None) == (c.swap is None),
     "say what it gives (per_second), or how long a swap takes (swap, s)"),
    (Door, "opened_from", lambda d: not d.opened_from,
     "name the place from which a robot opens the door"),
    (Door, "times", lambda d: d.times > 1 and d.closes is None,
     "a door that stays open is opened once; say closes, in s, if it shuts again"),
    (AutomaticDoor, "closes_in", lambda d: d.closes_in and d.airlock is None,
     "is how long the other door of an airlock waits for this one; name its airlock"),
    (Zone, "", lambda z: not any(_says(z)),
     "say keep_out: [robot types], max_robots: number, v_max: m/s, one_way: heading, "
     "pivoting: never, stopping: never, or avoid: s"),
    (Zone, "", lambda z: sum(_says(z)) > 1,
     "keep_out, max_robots and how to drive are several zones; write each"),
    (Zone, "robot_types", lambda z: z.robot_types and not z.has_rules,
     "is who heeds rules of driving; there are none"),
    (Lane, "points", lambda way: any(starmap(eq, pairwise(way.points))),
     "names a point twice in a row; leave one out"),
    (Stop, "", lambda s: [bool(s.at), s.task is not None, s.on is not None].count(True) != 1,
     "name a place, or several (at), the task to whose machine it belongs, or, of a pickup, "
     "the robot on which the load is at first (on)"),
    (Order, "delivery", lambda o: o.delivery.on is not None,
     "says where the load goes; only a pickup is on a robot"),
    (Order, "pickup", lambda o: o.pickup.on is not None and o.pickup != Stop(on=o.pickup.on),
     "has happened: beside on: {0.pickup.on} there is nothing to say of it"),
    (Order, "pickup",
     lambda o: o.pickup.on and any((o.attached, o.together, o.optional, o.repeat, o.robots)),
     "is on {0.pickup.on}: what is on board at first has no footprint (attached), is delivered by "
     "that robot alone (robots, together), once (repeat), and is not optional"),
    (Task, "duration", lambda t: (t.duration is None) == (not t.modes),
     "say how long it lasts (duration), or give it modes"),
    (Task, "modes", lambda t: t.modes and t.at,
     "modes are of machines; a robot does it at one of the places"),
    (Task, "at", lambda t: t.crew > 1 and len(set(t.at)) != t.crew,
     "a crew of {0.crew} needs a place for each robot: name {0.crew}"),
    (Task, "at", lambda t: not t.at and (t.skills or t.robots),
     "a robot does it, so say where: at: a place, or several"),
    (Place, "holds", lambda p: p.holds > (p.room or 0),
     "is more than there is room for; say room, of how many orders the loads fit"),
    (Resource, "setup", lambda r: all((r.setup, r.capacity > 1, not r.batches)),
     "of {0.capacity} units nobody knows which is set up for what; write them as resources"),
    (Resource, "kind", lambda r: {r.kind} - r.kinds - {""},
     "is none of the kinds that it is set up for"),
    (Resource, "setup", lambda r: _shortcut(r),
     "takes longer from one kind to another than by way of a third one; say all set-ups"),
    (Repeat, "", lambda r: (r.times is None) == (r.until is None),
     "say how often it comes (times), or until when it is released (until, in s): one of the two"),
    (FleetJob, "repeat", lambda j: j.repeat and _until(j.repeat) < j.release,
     "ends at {0.repeat.until:g} s, before the first one is released at {0.release:g} s"),
    (FleetJob, "repeat", lambda j: how_often(j) > FILE_LIMITS.repeats,
     f"comes more than {FILE_LIMITS.repeats} times until {{0.repeat.until:g}} s; the limit of "
     "repeats is that, so say a longer every or an earlier until"),
    (FleetJob, "after", lambda j: j.id in j.after, "'{0.id}' cannot come after itself"),
    (Order, "together", lambda o: {o.id} & {*o.together} or len({*o.together}) < len(o.together),
     "name the other orders that '{0.id}' is carried with, each once"),
    (FleetJob, "penalty", lambda j: j.optional and j.penalty is None,
     "say how many seconds of makespan leaving it out counts as (penalty: 100)"),
    (FleetJob, "penalty", lambda j: j.penalty is not None and not j.optional,
     "only what is optional: true has a penalty"),
)  # fmt: skip
"""Of records of a type: the key that is told of, what must not hold, and what to do then."""

REFERENCES: Mapping[str, Mapping[type, tuple[str, ...]]] = {
    "robot_types": {Robot: ("type",), Zone: ("keep_out", "robot_types"), Lane: ("robot_types",)},
    "robots": {FleetJob: ("robots",), Stop: ("on",)},
    "places": {
        Robot: ("start", "end"), Door: ("opened_from",), Stop: ("at",), Task: ("at",),
        Mode: ("input", "output"),
    },
    "floors": dict.fromkeys((Place, Door, AutomaticDoor, Zone, Lane), ("floor",)),
    "resources": dict.fromkeys((Stop, Task, Mode), ("resources",)),
}  # fmt: skip
"""Where what is named is, by who names it: the keys of records of a type."""

_NAMING = tuple(
    (kind, key, where)
    for where, kinds in REFERENCES.items()
    for kind, keys in kinds.items()
    for key in keys
)

WINDOWS: tuple[tuple[type, str, Callable[[Any], float]], ...] = (
    (Robot, "shift", lambda _: 0.0),
    (Break, "window", lambda b: b.duration),
    (AutomaticDoor, "shut", lambda _: FILE_LIMITS.least),
    (Stop, "window", lambda s: s.service),
    (Task, "window", lambda t: min(_lengths(t), default=0.0)),
)
"""Of records of a type: times, and how long (s) what has to fit into one of them lasts."""

OUTLINES: tuple[tuple[type, str], ...] = (
    (RobotType, "footprint"), (Door, "leaf"), (AutomaticDoor, "polygon"), (Zone, "polygon"),
    (Attached, "footprint"),
)  # fmt: skip
"""Of records of a type: simple polygons of some area, with no more corners than can be checked."""


@cache
def _rows(table: tuple[tuple[type, Any], ...], kind: type) -> list[Any]:
    """Return the rows of a table that are about records of a type, without it."""
    return [row[1:] for row in table if issubclass(kind, row[0])]


def _within(value: Any, path: Path) -> Iterator[tuple[Path, Any]]:
    """Yield all records in a value, with their places."""
    inner: Iterable[tuple[str | int, Any]] = ()
    if is_dataclass(value):
        yield path, value
        inner = ((f.name, getattr(value, f.name)) for f in fields(value))
    elif isinstance(value, Mapping):
        inner = value.items()
    elif isinstance(value, tuple):
        inner = enumerate(value)
    for key, item in inner:
        yield from _within(item, (*path, key))


def said_wrong(records: FleetRecords, value: Any, path: Path) -> Iterator[Fault]:
    """Yield what the records in a value (at ``path``) say wrong by themselves, and which names in
    them are those of nothing in ``records``.
    """
    for here, record in _within(value, path):
        kind: Any = type(record)
        for key, wrong, text in _rows(RULES, kind):
            if wrong(record):
                yield Fault((*here, key) if key else here, text.format(record))
        for key, where in _rows(_NAMING, kind):
            names = getattr(record, key)
            told = here if kind is Stop and key == "at" else (*here, key)  # also in short
            yield from _known(records, where, [names] if isinstance(names, str) else names, told)
        for key, lasts in _rows(WINDOWS, kind):
            windows = getattr(record, key)
            one = key == "shift" or kind is Break
            for opens, closes in (windows,) if one and windows else windows or ():
                if closes - opens < lasts(record):
                    text = f"{opens:g} s to {closes:g} s is too short for {lasts(record):g} s"
                    if closes < opens:
                        text = f"ends at {closes:g} s, before it begins at {opens:g} s"
                    yield Fault((*here, key), text)
        for (key,) in _rows(OUTLINES, kind):
            what = _shape_fault(getattr(record, key))
            if what:
                yield Fault((*here, key), what)


def _known(
    records: FleetRecords, where: str, names: Iterable[Any] | None, path: Path
) -> Iterator[Fault]:
    """Yield which of some names (what else stands there is none) are of nothing."""
    known = getattr(records, where)
    known = (GROUND, *known) if where == "floors" else known
    for name in names or ():
        if isinstance(name, str) and name not in known:
            yield Fault(path, missing(where[:-1].replace("_", " "), name, known))


# ------------------ What they say of each other


def _robots(records: FleetRecords) -> Iterator[Fault]:
    """Robots start at places of their own."""
    starts: dict[str, str] = {}
    for name, robot in records.robots.items():
        if robot.start in starts:
            text = f"robot '{starts[robot.start]}' starts at '{robot.start}', too"
            yield Fault(("robots", name, "start"), text + "; give each a place of its own")
        starts.setdefault(robot.start, name)


def _floors(records: FleetRecords) -> Iterator[Fault]:
    """Floors lie above each other; lifts stop at such, where robots may ride."""
    if GROUND in records.floors:
        yield Fault(("floors", GROUND), "is the floor of the problem's own map; call this another")
    for name, lift in records.lifts.items():
        for floor in lift.stops:
            yield from _known(records, "floors", [floor], ("lifts", name, "stops", floor))
        sizes = {floor: len(cabin) for floor, cabin in lift.stops.items()}
        if len({*sizes.values()}) > 1:
            text = f"a pose for each robot that it takes, as many on each floor, not {sizes}"
            yield Fault(("lifts", name, "stops"), text)
    heights: dict[float, str] = {0.0: GROUND}
    for name, storey in records.floors.items():
        if storey.height in heights:
            text = f"is that of '{heights[storey.height]}'; floors lie above each other"
            yield Fault(("floors", name, "height"), text)
        heights.setdefault(storey.height, name)


def _batteries(records: FleetRecords) -> Iterator[Fault]:
    """What is said of a robot's battery at first fits its type."""
    for name, robot in records.robots.items():
        kind, path = records.robot_types.get(robot.type), ("robots", name, "level")
        if robot.level is None or kind is None:
            continue
        battery = kind.battery
        if battery is None:
            yield Fault(path, "robots of its type have no battery")
        elif robot.level > battery.capacity:
            yield Fault(path, f"is more than the capacity {battery.capacity:g}")
        elif robot.level < battery.reserve:
            text = f"the reserve is {battery.reserve:g}, and {robot.level:g} are there at first"
            yield Fault(path, text)


def _chargers(records: FleetRecords) -> Iterator[Fault]:
    batteries = [(n, kind.battery) for n, kind in records.robot_types.items() if kind.battery]
    for name, place in records.places.items():
        charger = place.charger
        path: Path = ("places", name, "charger")
        for kind, battery in batteries if charger is not None else ():
            assert charger is not None
            if (charger.per_second is None) == (charger.swap is None):
                break  # told of by itself
            given = (charger.per_second or 0.0) * charger.step  # where it is quickest
            room = battery.capacity - battery.reserve
            least = given * min((share for _, share in battery.curve), default=1.0)
            if given > room:
                text = f"a step gives {given:g}; the battery of '{kind}' takes {room:g} from its "
                yield Fault(path, text + "reserve on: say step, in s")
            elif charger.swap is None and least * battery.grains < battery.capacity:
                text = f"a step gives {least:g}, less than 1/{battery.grains} of what the battery "
                text += f"of '{kind}' holds ({battery.capacity:g}): say a longer step, in s"
                yield Fault(path, text)


def _docks(records: FleetRecords) -> Iterator[Fault]:
    """A dock binds whoever ends at its pose, whatever the place there is called."""
    ahead = [name for name, kind in records.robot_types.items() if kind.reverse == "never"]
    for name, place in records.places.items():
        path: Path = ("places", name, "docking")
        if place.docking is not None and place.docking.backwards and ahead:
            text = f"robots of type '{ahead[0]}' never drive backwards (reverse: never)"
            yield Fault((*path, "backwards"), text)
        for other, there in records.places.items() if place.docking is not None else ():
            alike = place.floor == there.floor and same_pose(place.pose, there.pose, 1e-3)
            if alike and place.docking != there.docking:
                text = f"'{other}' is at the same pose, and is docked at otherwise, or not at all"
                yield Fault(path, text)


def _skills(records: FleetRecords) -> Iterator[Fault]:
    """Who opens a door, or rides a lift, has to be one of the robots."""
    known = [set(robot.skills) for robot in records.robots.values()]
    for kind in ("lifts", "doors") if known else ():
        for name, item in getattr(records, kind).items():
            if not any(skills.issuperset(item.skills) for skills in known):
                yield Fault((kind, name, "skills"), f"no robot has {both(item.skills)}")


def _airlocks(records: FleetRecords) -> Iterator[Fault]:
    locks = [door.airlock for door in records.automatic_doors.values()]
    for name, door in records.automatic_doors.items():
        if door.airlock is not None and locks.count(door.airlock) == 1:
            text = f"only '{name}' is of the airlock '{door.airlock}'; an airlock has two or more"
            yield Fault(("automatic_doors",), text)  # the other one may be added next


def _jobs(records: FleetRecords) -> Iterator[Fault]:
    for kind in ("orders", "tasks"):
        for i, job in enumerate(getattr(records, kind)):
            yield from _job(records, job, (kind, i))


def _machine(records: FleetRecords, order: Order, task: str, path: Path) -> Iterator[Fault]:
    """A stop at the machine of a task: each mode of that has a place."""
    found = records.task_of.get(task)
    if found is None:
        yield Fault(path, missing("task", task, records.task_of))
        return
    if not found.modes:
        yield Fault(path, f"task '{task}' has no modes; say where with at: a place, or several")
    nowhere = [name for name, m in found.modes.items() if not (m.input or m.output)]
    if nowhere:
        yield Fault(path, f"mode '{nowhere[0]}' of task '{task}' has no place; give it an input")
    if order.attached is not None:
        yield Fault(path, "a load with a footprint goes to places; name them with at")


def _attached(records: FleetRecords, order: Order, path: Path) -> Iterator[Fault]:
    """A load with a footprint stands somewhere, and is brought elsewhere."""
    if isinstance(order.attached, str):
        yield from _taken_on(records, order, order.attached, path)
    elif len(order.pickup.at) > 1:
        text = "its load stands at one place; name that one"
        yield Fault((*path, "pickup"), text)
    if isinstance(order.attached, Attached):
        yield from _carriers(records, order, len(order.attached.carriers), path)
    places = [
        records.places[p] for p in (*order.pickup.at, *order.delivery.at) if p in records.places
    ]
    if len({place.floor for place in places}) > 1:
        text = "a load with a footprint stays on its floor: lifts take robots without one"
        yield Fault((*path, "delivery"), text)
    same = sorted(set(order.pickup.at) & set(order.delivery.at))
    if same:
        text = f"its load stands at '{same[0]}' already; deliver it elsewhere"
        yield Fault((*path, "delivery"), text)


def _carriers(records: FleetRecords, order: Order, others: int, path: Path) -> Iterator[Fault]:
    """A load that several robots carry in formation, ``others`` beside the first one."""
    if not others:
        return
    key = (*path, "attached", "carriers")
    types = Counter(records.robots[name].type for name in able(records, order))
    models = {name: kind.model for name, kind in records.robot_types.items()}
    many = [name for name in types if types[name] > others and models.get(name) == "omni"]
    if records.robots and not many:
        text = f"asks for {others + 1} robots of one type, which moves in any direction (omni)"
        yield Fault(key, text)
    if order.optional or records.takers.get(order.id):
        yield Fault(key, "what several robots carry is not optional, and nobody takes it on")
    rules = {n: z for n, z in records.zones.items() if z.has_rules} | dict(records.lanes)
    bind = [name for name, rule in rules.items() if any(map(rule.heeded_by, many))]
    bind += [name for name, zone in records.zones.items() if zone.max_robots is not None]
    bind += [name for name, place in records.places.items() if place.docking is not None]
    if bind:
        text = f"robots in formation do not heed '{bind[0]}': zones with max_robots, docking, and "
        yield Fault(key, text + "rules of driving and lanes of their type are not supported here")


def _taken_on(records: FleetRecords, order: Order, name: str, path: Path) -> Iterator[Fault]:
    """Who takes a load on takes it where another order has put it."""
    key = (*path, "attached")
    before = records.order_of.get(name)
    if before is None or before is order:
        known = [o.id for o in records.orders if o is not order]
        yield Fault(key, missing("other order", name, known))
        return
    if before.attached is None:
        yield Fault(key, f"order '{name}' has no load with a footprint (attached)")
    others = [o.id for o in records.takers[name] if o is not order]
    if others:
        yield Fault(key, f"order '{others[0]}' takes the load of '{name}', too; only one can")
    odd = [p for p in order.pickup.at if p not in before.delivery.at]
    if odd:
        at = both(before.delivery.at)
        yield Fault((*path, "pickup"), f"'{name}' does not put its load at '{odd[0]}', but at {at}")


def _job(records: FleetRecords, job: Order | Task, path: Path) -> Iterator[Fault]:
    """What an order or a task asks of robots and of other jobs."""
    for key, what, known in (
        ("after", "order or task", records.job_of),
        ("together", "order", records.order_of),
    ):
        for name in getattr(job, key, ()):
            if name not in known:
                yield Fault((*path, key), missing(what, name, known))
    if records.robots and job.skills and needs_robot(job) and not able(records, job):
        text = f"it needs {both(job.skills)}, which "
        text += f"{both(job.robots)} does not have" if job.robots else "no robot has"
        yield Fault((*path, "skills"), text)
    others = [records.order_of.get(name, job) for name in getattr(job, "together", ())]
    fit = dict.fromkeys(r for one in (job, *others) for r in able(records, one))
    many = getattr(job, "crew", 1 + len(others))
    if records.robots and 0 < len(fit) < many:
        text = f"{len(fit)} of {many} robots may do it ({', '.join(fit)})"
        yield Fault((*path, "together" if others else "crew"), text)
    if isinstance(job, Task):
        return
    for key, stop in (("pickup", job.pickup), ("delivery", job.delivery)):
        if stop.task is not None:
            yield from _machine(records, job, stop.task, (*path, key, "task"))
    yield from _loads(records, job, path)
    if job.attached is not None:
        yield from _attached(records, job, path)


def _loads(records: FleetRecords, order: Order, path: Path) -> Iterator[Fault]:
    types = {records.robots[r].type for r in able(records, order) if r in records.robots}
    known = [records.robot_types[t] for t in sorted(types) if t in records.robot_types]
    if known and not any(carries(t, order.load) for t in known):
        load = ", ".join(f"{n} {k}" for k, n in order.load.items())
        text = f"no robot that may do it can carry {load}; see capacity of its robot type"
        yield Fault((*path, "load"), text)


def _on_board(records: FleetRecords) -> Iterator[Fault]:
    """What is on a robot at first fits on it, and it is clear what is unloaded first."""
    for name, robot in records.robots.items():
        kind, mine = records.robot_types.get(robot.type), records.on_board(name)
        if kind is None or not mine:
            continue
        load = sum((Counter(order.load) for order in mine), Counter[str]())
        if not carries(kind, load):
            there = ", ".join(f"{amount} {what}" for what, amount in load.items())
            text = f"has {there} on board at first; see capacity of its robot type"
            yield Fault(("robots", name), text)
        for one, other in itertools.combinations(mine, 2):
            free = one.id not in other.after and other.id not in one.after
            if kind.unloading == "lifo" and free:
                text = f"which lies above, '{one.id}' or '{other.id}'? Say of the one below that "
                yield Fault(("robots", name), text + "it is delivered after it: after")


def both(names: Iterable[str]) -> str:
    """Return ``'one' and 'other'``."""
    return " and ".join(f"'{n}'" for n in names)


def _circles(records: FleetRecords) -> Iterator[Fault]:
    """``after`` leads nowhere back."""
    after = {j.id: [n for n in earlier_than(records, j) if n != j.id] for j in records.jobs}
    try:
        TopologicalSorter(after).prepare()
    except CycleError as error:
        circle = error.args[1]
        yield Fault((), f"'after' goes round in a circle: {' after '.join(reversed(circle))}")


@cache
def _shape_fault(outline: Outline) -> str | None:
    corners = corners_of(outline)
    if len(corners) > FILE_LIMITS.corners:
        return (
            f"has {len(corners)} corners; the limit is {FILE_LIMITS.corners}: leave out small ones"
        )
    why = explain_validity(Polygon(corners))
    if why == "Valid Geometry" and Polygon(corners).area > 0.0:
        return None
    at = re.search(r"\[(\S+) (\S+)\]", why)
    if at is None:
        return "has no area; give three or more corners that are not on one line"
    point = ", ".join(f"{float(v):g}" for v in at.groups())
    return f"touches or crosses itself at ({point}); list its corners in order, once around"


def _weights(records: FleetRecords) -> Iterator[Fault]:
    """An objective of several terms weighs one of them at least, and knows what robots cost and
    what drives take from batteries; of several, no two weigh the same.
    """
    free = not any(kind.costs for kind in records.robot_types.values())
    endless = not any(kind.battery for kind in records.robot_types.values())
    listed, seen = isinstance(records.objective, tuple), []
    for number, weights in enumerate(records.weighed):
        path: Path = ("objective", number) if listed else ("objective",)
        if weights.cost and free:
            text = "say what robots cost, as costs of a type: {used: 20, per_km: 0.5, per_hour: 3}"
            yield Fault((*path, "cost"), text)
        if weights.energy and endless:
            text = "say what drives take, as battery of a type: {capacity: 300, per_metre: 1}"
            yield Fault((*path, "energy"), text)
        if not any(vars(weights).values()):
            text = f"give a weight above 0 to one of {', '.join(vars(weights))}, or say none"
            yield Fault(path, text)
        if weights in seen:
            yield Fault(path, "is there before: among plans as good in it, it decides nothing")
        seen.append(weights)


CHECKS: tuple[Callable[[FleetRecords], Iterator[Fault]], ...] = (
    _floors,
    _robots,
    _batteries,
    _chargers,
    _docks,
    _skills,
    _airlocks,
    _jobs,
    _on_board,
    _circles,
    _weights,
)
