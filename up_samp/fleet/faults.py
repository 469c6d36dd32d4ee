"""What is wrong with the records of a fleet problem, told with its place and what to do."""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from typing import Any

from shapely.geometry import Polygon
from shapely.validation import explain_validity

from up_samp.fleet.records import (
    FILE_LIMITS,
    GROUND,
    Attached,
    Battery,
    Charger,
    FleetRecords,
    Order,
    Outline,
    Stop,
    Task,
    Windows,
    able,
    carries,
    corners_of,
    needs_robot,
    with_skills,
)
from up_samp.fleet.spelled_out import ids_of, stop_of, with_places
from up_samp.model import ProblemError


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
    records = with_places(records)
    return [fault for check in CHECKS for fault in check(records)]


def job_faults(records: FleetRecords, job: Order | Task) -> Iterator[Fault]:
    """Yield what is wrong with one order or task beside its id and circles of ``after``.

    :param records: with the jobs that it names, and whatever takes the same load on.
    """
    if isinstance(job, Order):
        yield from _order(records, job, ("orders",))
    else:
        yield from _task(records, job, ("tasks",))


def named_by(job: Order | Task) -> set[str]:
    """Return the jobs that one names: those whose load it takes on, too."""
    stops = (job.pickup, job.delivery) if isinstance(job, Order) else ()
    taken = [job.attached] if isinstance(job, Order) and isinstance(job.attached, str) else []
    return {*job.after, *taken, *(s.task for s in stops if s.task is not None)}


def same_names(records: FleetRecords) -> Iterator[Fault]:
    """Everything with a name has one of its own: they share the namespace of the UP problem."""
    kinds: list[tuple[str, Mapping[str, Any]]] = [
        ("robot_types", records.robot_types),
        ("robots", records.robots),
        ("places", records.places),
        ("doors", records.doors),
        ("automatic_doors", records.automatic_doors),
        ("zones", records.zones),
        ("lifts", records.lifts),
        ("floors", records.floors),
        ("resources", records.resources),
    ]
    seen: dict[str, str] = {}
    for kind, named in kinds:
        for name in named:
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


def _robots(records: FleetRecords) -> Iterator[Fault]:
    for name, kind in records.robot_types.items():
        if (kind.model, kind.reverse) == ("omni", "never"):
            what = "an omni drives in any direction; this is for car and diff"
            yield Fault(("robot_types", name, "reverse"), what)
        if (kind.model, kind.reverse) == ("omni", "slow"):
            what = "an omni drives in any direction; this is for car and diff"
            yield Fault(("robot_types", name, "reverse"), what)
        if (kind.reverse == "slow") != (kind.reverse_v_max is not None):
            what = "reverse: slow goes with reverse_v_max, in m/s"
            yield Fault(("robot_types", name, "reverse"), what)
    starts: dict[str, str] = {}
    for name, robot in records.robots.items():
        path: Path = ("robots", name)
        if robot.type not in records.robot_types:
            text = missing("robot type", robot.type, records.robot_types)
            yield Fault((*path, "type"), text)
        for key in ("start", "end"):
            place = getattr(robot, key)
            if place is not None and place not in records.places:
                yield Fault((*path, key), missing("place", place, records.places))
        if robot.start in starts:
            text = f"robot '{starts[robot.start]}' starts at '{robot.start}', too"
            yield Fault((*path, "start"), text + "; give each a place of its own")
        starts.setdefault(robot.start, name)
        yield from _window((robot.shift,) if robot.shift else (), 0.0, path, "shift")
        for i, rest in enumerate(robot.breaks):
            yield from _window((rest.window,), rest.duration, (*path, "breaks", i))


def _floors(records: FleetRecords) -> Iterator[Fault]:
    """Places, doors and zones are on floors that there are; lifts stop at such."""
    known = (GROUND, *records.floors)
    if GROUND in records.floors:
        yield Fault(("floors", GROUND), "is the floor of the problem's own map; call this another")
    stops = {
        stop_of(name, floor, spot)
        for name, lift in records.lifts.items()
        for floor, cabin in lift.stops.items()
        for spot in range(len(cabin))
    }
    named: list[tuple[Path, str]] = [
        ((kind, name, "floor"), item.floor)
        for kind in ("places", "doors", "automatic_doors", "zones")
        for name, item in getattr(records, kind).items()
        if name not in stops
    ]
    for name, lift in records.lifts.items():
        named += [(("lifts", name, "stops", floor), floor) for floor in lift.stops]
        sizes = {floor: len(cabin) for floor, cabin in lift.stops.items()}
        if len({*sizes.values()}) > 1:
            text = f"a pose for each robot that it takes, as many on each floor, not {sizes}"
            yield Fault(("lifts", name, "stops"), text)
        if records.robots and not with_skills(records, lift.skills, ()):
            yield Fault(("lifts", name, "skills"), f"no robot has {_and(lift.skills)}")
    for path, floor in named:
        yield from _known(known, "floor", [floor], path)
    heights: dict[float, str] = {0.0: GROUND}
    for name, storey in records.floors.items():
        if storey.height in heights:
            text = f"is that of '{heights[storey.height]}'; floors lie above each other"
            yield Fault(("floors", name, "height"), text)
        heights.setdefault(storey.height, name)


def _batteries(records: FleetRecords) -> Iterator[Fault]:
    told: list[tuple[Path, Battery | None, float | None]] = [
        (("robot_types", name, "battery"), kind.battery, None)
        for name, kind in records.robot_types.items()
    ]
    for name, robot in records.robots.items():
        kind = records.robot_types.get(robot.type)
        if robot.level is not None and kind is not None:
            told.append((("robots", name), kind.battery, robot.level))
    for path, battery, own in told:
        if battery is None and own is not None:
            yield Fault((*path, "level"), "robots of its type have no battery")
        if battery is None:
            continue
        levels = [battery.reserve, *(level for level, _ in battery.curve), battery.capacity]
        if own is None and any(b <= a for a, b in itertools.pairwise(levels)) and battery.curve:
            text = f"has levels that rise from the reserve to the capacity, not {levels}"
            yield Fault((*path, "curve"), text)
        usual = battery.capacity if battery.level is None else battery.level
        first = usual if own is None else own
        if first > battery.capacity:
            yield Fault((*path, "level"), f"is more than the capacity {battery.capacity:g}")
        if battery.reserve > first:
            key = "reserve" if own is None else "level"
            text = f"the reserve is {battery.reserve:g}, and {first:g} are there at first"
            yield Fault((*path, key), text)


def _chargers(records: FleetRecords) -> Iterator[Fault]:
    batteries = [(n, kind.battery) for n, kind in records.robot_types.items() if kind.battery]
    for name, place in records.places.items():
        charger = place.charger
        path: Path = ("places", name, "charger")
        if charger is not None and (charger.per_second is None) == (charger.swap is None):
            yield Fault(path, "say what it gives (per_second), or how long a swap takes (swap, s)")
            continue
        for kind, battery in batteries if charger is not None else ():
            assert charger is not None
            given, room = _step(charger), battery.capacity - battery.reserve
            least = given * min((share for _, share in battery.curve), default=1.0)
            if given > room:
                text = f"a step gives {given:g}; the battery of '{kind}' takes {room:g} from its "
                yield Fault(path, text + "reserve on: say step, in s")
            elif charger.swap is None and least * battery.grains < battery.capacity:
                text = f"a step gives {least:g}, less than 1/{battery.grains} of what the battery "
                text += f"of '{kind}' holds ({battery.capacity:g}): say a longer step, in s"
                yield Fault(path, text)


def _step(charger: Charger) -> float:
    """Return what a step gives where it is quickest; nothing, where batteries are swapped."""
    return (charger.per_second or 0.0) * charger.step


def _doors(records: FleetRecords) -> Iterator[Fault]:
    for name, door in records.doors.items():
        path: Path = ("doors", name, "opened_from")
        if not door.opened_from:
            yield Fault(path, "name the place from which a robot opens the door")
        yield from _known(records.places, "place", door.opened_from, path)
        if door.times > 1 and door.closes is None:
            text = "a door that stays open is opened once; say closes, in s, if it shuts again"
            yield Fault(("doors", name, "times"), text)
        if door.opened_from and records.robots and not with_skills(records, door.skills, ()):
            yield Fault(("doors", name, "skills"), f"no robot has {_and(door.skills)}")


def _automatic_doors(records: FleetRecords) -> Iterator[Fault]:
    locks = [door.airlock for door in records.automatic_doors.values()]
    for name, door in records.automatic_doors.items():
        path: Path = ("automatic_doors", name)
        if door.closes_in and door.airlock is None:
            text = "is how long the other door of an airlock waits for this one; name its airlock"
            yield Fault((*path, "closes_in"), text)
        if door.airlock is not None and locks.count(door.airlock) == 1:
            text = f"only '{name}' is of the airlock '{door.airlock}'; an airlock has two or more"
            yield Fault(("automatic_doors",), text)  # the other one may be added next
        yield from _window(door.shut, FILE_LIMITS.least, path, "shut")


def _zones(records: FleetRecords) -> Iterator[Fault]:
    for name, zone in records.zones.items():
        path: Path = ("zones", name)
        told = (bool(zone.keep_out), zone.max_robots is not None, zone.has_rules)
        if not any(told):
            what = "say keep_out: [robot types], max_robots: number, v_max: m/s, one_way: heading, "
            yield Fault(path, f"{what}or pivoting: never")
        if sum(told) > 1:
            yield Fault(path, "keep_out, max_robots and how to drive are several zones; write each")
        if zone.robot_types and not zone.has_rules:
            yield Fault((*path, "robot_types"), "is who heeds rules of driving; there are none")
        for key in ("keep_out", "robot_types"):
            named = getattr(zone, key)
            yield from _known(records.robot_types, "robot type", named, (*path, key))


def _orders(records: FleetRecords) -> Iterator[Fault]:
    for i, order in enumerate(records.orders):
        yield from _order(records, order, ("orders", i))


def _order(records: FleetRecords, order: Order, path: Path) -> Iterator[Fault]:
    for key, stop in (("pickup", order.pickup), ("delivery", order.delivery)):
        yield from _stop(records, stop, (*path, key))
        if stop.task is not None:
            yield from _machine(records, order, stop.task, (*path, key, "task"))
    yield from _job(records, order, path)
    yield from _loads(records, order, path)
    yield from _attached(records, order, path)
    if isinstance(order.attached, Attached):
        yield from _outline(order.attached.footprint, (*path, "attached", "footprint"))


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
    if order.attached is None:
        return
    if isinstance(order.attached, str):
        yield from _taken_on(records, order, order.attached, path)
    elif len(order.pickup.at) > 1:
        text = "its load stands at one place; name that one"
        yield Fault((*path, "pickup"), text)
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
        at = _and(before.delivery.at)
        yield Fault((*path, "pickup"), f"'{name}' does not put its load at '{odd[0]}', but at {at}")


def _tasks(records: FleetRecords) -> Iterator[Fault]:
    for i, task in enumerate(records.tasks):
        yield from _task(records, task, ("tasks", i))


def _task(records: FleetRecords, task: Task, path: Path) -> Iterator[Fault]:
    yield from _known(records.places, "place", task.at, (*path, "at"))
    yield from _known(records.resources, "resource", task.resources, (*path, "resources"))
    lengths = [m.duration for m in task.modes.values()]
    if (task.duration is None) == (not task.modes):
        yield Fault((*path, "duration"), "say how long it lasts (duration), or give it modes")
    if task.duration is not None:
        lengths.append(task.duration)
    yield from _window(task.window, min(lengths, default=0.0), path)
    yield from _modes(records, task, path)
    if task.crew > 1:
        yield from _crew(records, task, path)
    if not task.at and (task.skills or task.robots):
        yield Fault((*path, "at"), "a robot does it, so say where: at: a place, or several")
    yield from _job(records, task, path)


def _crew(records: FleetRecords, task: Task, path: Path) -> Iterator[Fault]:
    if len(set(task.at)) != task.crew:
        text = f"a crew of {task.crew} needs a place for each robot: name {task.crew}"
        yield Fault((*path, "at"), text)
    fit = able(records, task)
    if records.robots and 0 < len(fit) < task.crew:
        text = f"{len(fit)} of {task.crew} robots may do it ({', '.join(fit)})"
        yield Fault((*path, "crew"), text)


def _modes(records: FleetRecords, task: Task, path: Path) -> Iterator[Fault]:
    if task.modes and task.at:
        yield Fault((*path, "modes"), "modes are of machines; a robot does it at one of the places")
    for name, mode in task.modes.items():
        here: Path = (*path, "modes", name)
        yield from _known(records.places, "place", mode.input, (*here, "input"))
        yield from _known(records.places, "place", mode.output, (*here, "output"))
        yield from _known(records.resources, "resource", mode.resources, (*here, "resources"))


def _stop(records: FleetRecords, stop: Stop, path: Path) -> Iterator[Fault]:
    if bool(stop.at) == (stop.task is not None):
        yield Fault(path, "name a place, or several (at), or the task to whose machine it belongs")
    yield from _known(records.places, "place", stop.at, path)
    yield from _known(records.resources, "resource", stop.resources, (*path, "resources"))
    yield from _window(stop.window, stop.service, path)


def _window(windows: Windows, length: float, path: Path, key: str = "window") -> Iterator[Fault]:
    for opens, closes in windows:
        if closes - opens < length:
            text = f"{opens:g} s to {closes:g} s is too short for {length:g} s"
            yield Fault((*path, key), text)


def _job(records: FleetRecords, job: Order | Task, path: Path) -> Iterator[Fault]:
    """What orders and tasks have in common."""
    names = [n for n in job.after if n not in records.order_of and n not in records.task_of]
    for name in names:
        known = [*records.order_of, *records.task_of]
        yield Fault((*path, "after"), missing("order or task", name, known))
    if job.id in job.after:
        yield Fault((*path, "after"), f"'{job.id}' cannot come after itself")
    yield from _known(records.robots, "robot", job.robots, (*path, "robots"))
    if records.robots and needs_robot(job) and not with_skills(records, job.skills, job.robots):
        text = f"it needs {_and(job.skills)}, which "
        text += f"{_and(job.robots)} does not have" if job.robots else "no robot has"
        yield Fault((*path, "skills"), text)
    if job.optional and job.penalty is None:
        text = "say how many seconds of makespan leaving it out counts as (penalty: 100)"
        yield Fault((*path, "penalty"), text)
    if job.penalty is not None and not job.optional:
        yield Fault((*path, "penalty"), "only what is optional: true has a penalty")


def _loads(records: FleetRecords, order: Order, path: Path) -> Iterator[Fault]:
    types = {records.robots[r].type for r in able(records, order) if r in records.robots}
    known = [records.robot_types[t] for t in sorted(types) if t in records.robot_types]
    if known and not any(carries(t, order) for t in known):
        load = ", ".join(f"{n} {k}" for k, n in order.load.items())
        text = f"no robot that may do it can carry {load}; see capacity of its robot type"
        yield Fault((*path, "load"), text)


def _known(names: Collection[str], kind: str, wanted: Iterable[str], path: Path) -> Iterator[Fault]:
    for name in wanted:
        if name not in names:
            yield Fault(path, missing(kind, name, names))


def _and(names: Iterable[str]) -> str:
    return " and ".join(f"'{n}'" for n in names)


def _circles(records: FleetRecords) -> Iterator[Fault]:
    """``after`` leads nowhere back."""
    after = {j.id: [n for n in earlier_than(records, j) if n != j.id] for j in records.jobs}
    try:
        TopologicalSorter(after).prepare()
    except CycleError as error:
        circle = error.args[1]
        yield Fault((), f"'after' goes round in a circle: {' after '.join(reversed(circle))}")


def _outlines(records: FleetRecords) -> Iterator[Fault]:
    """Outlines are simple polygons of some area, with no more corners than can be looked at."""
    shapes: list[tuple[Path, Any]] = []
    for name, kind in records.robot_types.items():
        shapes.append((("robot_types", name, "footprint"), kind.footprint))
    shapes += [(("doors", name, "leaf"), door.leaf) for name, door in records.doors.items()]
    shapes += [(("zones", name, "polygon"), zone.polygon) for name, zone in records.zones.items()]
    shapes += [
        (("automatic_doors", name, "polygon"), door.polygon)
        for name, door in records.automatic_doors.items()
    ]
    for path, outline in shapes:
        yield from _outline(outline, path)


def _outline(outline: Outline, path: Path) -> Iterator[Fault]:
    what = _shape_fault(outline)
    if what:
        yield Fault(path, what)


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
    """An objective of several terms weighs one of them at least, and knows what robots cost; of
    several, no two weigh the same.
    """
    free = not any(kind.costs for kind in records.robot_types.values())
    listed, seen = isinstance(records.objective, tuple), []
    for number, weights in enumerate(records.weighed):
        path: Path = ("objective", number) if listed else ("objective",)
        if weights.cost and free:
            text = "say what robots cost, as costs of a type: {used: 20, per_km: 0.5, per_hour: 3}"
            yield Fault((*path, "cost"), text)
        if not any(vars(weights).values()):
            text = f"give a weight above 0 to one of {', '.join(vars(weights))}, or say none"
            yield Fault(path, text)
        if weights in seen:
            yield Fault(path, "is there before: among plans as good in it, it decides nothing")
        seen.append(weights)


CHECKS: tuple[Callable[[FleetRecords], Iterator[Fault]], ...] = (
    same_names,
    _floors,
    _robots,
    _batteries,
    _chargers,
    _doors,
    _automatic_doors,
    _zones,
    _outlines,
    _orders,
    _tasks,
    _circles,
    _weights,
)
