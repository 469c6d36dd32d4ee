"""Look at a fleet problem before any solving: poses, doors, and what can be reached at all."""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from shapely import STRtree, box
from shapely.geometry import Polygon

from up_samp.fleet.faults import NO_ROBOT, both
from up_samp.fleet.fields import Pose, Windows
from up_samp.fleet.floors import (
    FloorMaps,
    floor_of,
    legs_between,
    lift_between,
    ride_seconds,
    way_between,
)
from up_samp.fleet.loads import ends_of, load_of, load_pose, loads_of, place_of, with_load
from up_samp.fleet.meanings import Kind
from up_samp.fleet.outlines import area_of, body_of, front_of, kept_out, placed, ruled, still
from up_samp.fleet.records import Attached, FleetRecords, Order, Task, can_do, needs_robot
from up_samp.fleet.spelled_out import spelled_out
from up_samp.fleet.visits import in_doorways, visits_of
from up_samp.model import Body, Deadline, Outcome, PathQuery, Placed
from up_samp.motion.compile import precompile


class Level(enum.Enum):
    """How bad a finding is."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """Something that was found about ``subject`` (a place, a robot, an order); at a place perhaps
    about robots of a ``type`` alone.
    """

    level: Level
    subject: str
    what: str
    type: str | None = None

    def __str__(self) -> str:
        return f"{self.level.value}: {self.subject}: {self.what}"


def check_fleet(records: FleetRecords, folder: Path) -> list[Finding]:
    """Return what is wrong or remarkable, errors first.

    An error is a proof: no schedule can be right. A warning is something that was not found in 2 s.
    """
    if not records.robots:
        return [Finding(Level.ERROR, "robots", NO_ROBOT.what)]
    checker = _Checker(spelled_out(records), folder)
    stages = (
        checker.poses(), checker.pairs(), checker.left_behind(), checker.loads(), checker.ways(),
        checker.one_ways(), checker.windows(), checker.objective(),
    )  # fmt: skip
    findings = list(itertools.chain(*stages))
    return sorted(findings, key=lambda f: list(Level).index(f.level))


ENDS = ("pickup", "delivery")


class _Halt(NamedTuple):
    """A part of a job: what it is called, where it is done, how long (s), and within which windows
    (s).
    """

    what: str
    places: tuple[str, ...]
    lasts: float
    windows: Windows


def _begin(windows: Windows, ready: float, lasts: float) -> float:
    """Return when (s) what lasts so long begins at the earliest; after the last window where it
    fits into none.
    """
    spans = windows or ((0.0, math.inf),)
    fits = [
        max(ready, opens) for opens, closes in spans if max(ready, opens) + lasts <= closes + 1e-6
    ]
    return min(fits, default=max(ready, spans[-1][0]))


class _Checker:
    def __init__(self, records: FleetRecords, folder: Path) -> None:
        self.records = records
        self.floors = FloorMaps(records, folder)
        self.seconds = 2.0  # for one drive
        self.bodies = {name: body_of(kind) for name, kind in records.robot_types.items()}
        precompile({body.kinematics.model for body in self.bodies.values()})
        self.places = {name: p.pose for name, p in records.places.items()}
        self.visits = {robot: visits_of(records, robot) for robot in records.robots}
        self.used: dict[str, set[str]] = {}
        self.least: dict[tuple[str, str, str], float] = {}
        self.bound: dict[str, set[str]] = {}
        """By type, the places where robots of it surely are: at first, and in the end."""
        for robot, mine in records.robots.items():
            for visit in self.visits[robot]:
                self.used.setdefault(mine.type, set()).update(map(place_of, visit.places))
            ends = {mine.start, mine.end} - {None}
            self.bound.setdefault(mine.type, set()).update(p for p in ends if p is not None)

    def doors(self, floor: str) -> tuple[Placed, ...]:
        """Return the doors of a floor, closed."""
        return tuple(
            Placed(name, still(d.leaf), tuple(closed))
            for name, d in self.records.doors.items()
            for closed, _ in d.leaves
            if d.floor == floor
        )

    def floor(self, place: str) -> str:
        return floor_of(self.records, place)

    def poses(self) -> Iterator[Finding]:
        """Where robots would stand in walls, doors, doorways or zones."""
        found: dict[str, dict[str, list[str]]] = {}
        for kind, places in sorted(self.used.items()):
            for name in sorted(places):
                pose = self.places[name]
                if abs(pose[2]) > math.tau:
                    text = f"its heading {pose[2]:g} is more than a full turn: headings are in rad"
                    yield Finding(Level.WARNING, name, text)
                at = f"at {_show(pose)} a robot of type '{kind}'"
                floor = self.floor(name)
                around = (*self.doors(floor), *kept_out(self.records, kind, floor))
                service = self.floors.service(floor)
                wall, hit = service.pose_blockers(self.bodies[kind], pose, around)
                blocked = found.setdefault(name, {}).setdefault(kind, [])
                if wall:
                    blocked.append(
                        f"{at} would stand in a wall, in unknown cells or outside the map"
                    )
                elif not self._docks(kind, name):
                    text = f"{at} would touch a wall, or a zone it must keep out of, on its"
                    blocked.append(f"{text} straight way in (docking)")
                for area in in_doorways(self.records, kind, name):
                    text = f"{at} would stand in '{area}': drive through it only"
                    yield Finding(Level.ERROR, name, text, kind)
                for other in sorted(hit):
                    if other in self.records.zones:
                        text = f"{at} would be in the zone '{other}', which it must keep out of"
                        blocked.append(text)
                    else:
                        text = f"{at} would stand in the closed door '{other}'"
                        yield Finding(Level.WARNING, name, text, kind)
        for name, kinds in found.items():
            nobody = name in self.wanted and all(kinds.values())
            for kind, texts in kinds.items():
                needed = nobody or name in self.bound[kind]
                for text in texts:
                    yield Finding(Level.ERROR if needed else Level.WARNING, name, text, kind)

    def _docks(self, kind: str, name: str) -> bool:
        """Return whether nothing stands where a robot has to come straight to a place."""
        place = self.records.places[name]
        front = front_of(place)
        if front is None:
            return True
        body = ruled(self.records, kind, place.floor, self.bodies[kind])
        query = PathQuery(body, (front, place.pose), kept_out(self.records, kind, place.floor))
        found = self.floors.service(place.floor).plan(query, Deadline.after(self.seconds))
        return found.outcome not in (Outcome.NOT_FOUND, Outcome.IMPOSSIBLE)

    @cached_property
    def wanted(self) -> set[str]:
        """Places at which something has to be done, and nowhere else."""
        jobs = [job for job in self.records.jobs if not job.optional]
        halts = [halt for job in jobs for halt in self._stops(job)]
        return {halt.places[0] for halt in halts if len(halt.places) == 1}

    def pairs(self) -> Iterator[Finding]:
        """Which places hold one robot between them."""
        uses = [(k, p) for k, places in sorted(self.used.items()) for p in sorted(places)]
        bodies = [(self.bodies[k], self.places[p], self.floor(p)) for k, p in uses]
        starts = {r.start for r in self.records.robots.values()}
        ends = {r.end for r in self.records.robots.values()} - {None}
        yield from self._same_ends()
        seen: set[frozenset[str]] = set()
        for one, other in self._meeting(bodies):
            a, b = uses[one][1], uses[other][1]
            both = frozenset((a, b))
            if a == b or both in seen:
                continue
            seen.add(both)
            if both <= starts:
                text = f"robots that start here and at '{b}' would overlap; move one of them"
                yield Finding(Level.ERROR, a, text)
            elif both <= ends:
                text = f"robots that end here and at '{b}' would overlap; move one of them"
                yield Finding(Level.ERROR, a, text)
            elif len(self.records.robots) > 1:
                text = f"overlaps '{b}': one robot at a time is at one of them"
                yield Finding(Level.NOTE, a, text)

    def _same_ends(self) -> Iterator[Finding]:
        """Robots that have to be at one place in the end."""
        owners: dict[str, list[str]] = {}
        for name, robot in self.records.robots.items():
            if robot.end is not None:
                owners.setdefault(robot.end, []).append(f"'{name}'")
        for place, robots in owners.items():
            if len(robots) > 1:
                text = f"robots {' and '.join(robots)} have to end here; give each its own end"
                yield Finding(Level.ERROR, place, text)

    def _meeting(self, bodies: Sequence[tuple[Body, Pose, str]]) -> Iterator[tuple[int, int]]:
        """Yield the pairs of bodies (each at a pose of a floor) that overlap, by their numbers; far
        ones cost nothing.
        """
        shapes = [Polygon(placed(tuple(body.footprint), pose)) for body, pose, _ in bodies]
        boxes = [box(*s.bounds).buffer(0.01) for s in shapes]
        near = STRtree(boxes).query(boxes, predicate="intersects").T
        for one, other in sorted((int(a), int(b)) for a, b in near if a < b):
            (body, pose, floor), (body_2, pose_2, floor_2) = bodies[one], bodies[other]
            service = self.floors.service(floor)
            if floor == floor_2 and service.overlap(body, pose, body_2, pose_2):
                yield one, other

    def left_behind(self) -> Iterator[Finding]:
        """Robots without an end that stand where others have to end."""
        ending = [(n, r.end, r.type) for n, r in self.records.robots.items() if r.end is not None]
        staying = [(n, r) for n, r in self.records.robots.items() if r.end is None]
        at = [(kind, end) for _, end, kind in ending] + [(r.type, r.start) for _, r in staying]
        bodies = [(self.bodies[k], self.places[p], self.floor(p)) for k, p in at]
        for one, other in self._meeting(bodies) if staying else ():
            if one >= len(ending) or other < len(ending):
                continue
            name, end, _ = ending[one]
            stays, mine = staying[other - len(ending)]
            places = {place_of(p) for v in self.visits[stays] for p in v.places}
            there = [(self.bodies[mine.type], self.places[p], self.floor(p)) for p in places]
            away = any(not any(self._meeting([bodies[one], body])) for body in there)
            text = f"robot '{name}' ends here, where '{stays}' stands at first, which has no end: "
            text += f"give '{stays}' an end, or add a place to be out of the way (park: 1)"
            yield Finding(Level.WARNING if away else Level.ERROR, end, text)

    def windows(self) -> Iterator[Finding]:
        """Windows and shifts that close before anybody can have done what they are for."""
        for job in filter(needs_robot, self.records.jobs):
            text = self._too_late(job)
            if text is not None:
                yield Finding(Level.NOTE if job.optional else Level.ERROR, job.id, text)

    def objective(self) -> Iterator[Finding]:
        """Tardiness that is weighed where nothing is due."""
        weighs = any(weights.tardiness for weights in self.records.weighed)
        if weighs and self.records.jobs and all(job.due is None for job in self.records.jobs):
            text = "weighs tardiness, of which there is none: say when orders and tasks are due"
            yield Finding(Level.WARNING, "objective", text)

    def _too_late(self, job: Order | Task) -> str | None:
        """Return why no robot can do a job in time, even by the shortest drives."""
        stops, robots = self._stops(job), self._fit(job)
        ends = {r: self.records.robots[r].hours[1] for r in robots}
        if not any(windows for *_, windows in stops) and {*ends.values()} <= {math.inf}:
            return None
        courses = {robot: self._earliest(robot, job, stops) for robot in robots}
        for number, (what, *_, windows) in enumerate(stops):
            ready = min((course[number] for course in courses.values()), default=0.0)
            if windows and ready > windows[-1][1] + 1e-6:
                text = f"the window of its {what} closes at {windows[-1][1]:g} s; by the shortest "
                return text + f"drives it ends at {ready:.1f} s or later"
        if robots and all(courses[r][-1] > ends[r] + 1e-6 for r in robots):
            first = min(course[-1] for course in courses.values())
            text = f"by the shortest drives it ends at {first:.1f} s or later: the shifts of "
            return text + f"{', '.join(robots)} end before they could"
        return None

    def _fit(self, job: Order | Task) -> list[str]:
        return [robot for robot in self.records.robots if can_do(self.records, robot, job)]

    def _stops(self, job: Order | Task) -> list[_Halt]:
        """Return what a robot does for a job, one after the other."""
        if isinstance(job, Task):
            modes = [m.duration for m in job.modes.values()]
            lasts = job.duration if job.duration is not None else min(modes, default=0.0)
            return [_Halt("place", job.at, lasts, job.window)] if needs_robot(job) else []
        ends = zip(ENDS, ends_of(self.records, job), (job.pickup, job.delivery), strict=True)
        return [
            _Halt(what, tuple(map(place_of, places)), stop.service, stop.window)
            for what, places, stop in ends
            if places
        ]

    def _earliest(self, robot: str, job: Order | Task, stops: Sequence[_Halt]) -> list[float]:
        """Return when a robot may have done what a job is made of, at the earliest (s): it drives
        straight there, through all doors, and nobody is in its way.
        """
        mine = self.records.robots[robot]
        at, done = [(mine.hours[0], mine.start)], []
        for _, places, lasts, windows in stops:
            came = [(min(t + self._least(robot, p, to) for t, p in at), to) for to in places]
            at = [(_begin(windows, max(t, job.release), lasts) + lasts, to) for t, to in came]
            done.append(min(t for t, _ in at))
        return done

    def _least(self, robot: str, origin: str, to: str) -> float:
        """Return how long a robot drives from one place to another at least (s)."""
        key = self.records.robots[robot].type, origin, to
        if key not in self.least:
            ways = legs_between(self.records, origin, to)
            sums = [sum(self._leg(key[0], *leg) for leg in way) for way in ways]
            self.least[key] = 0.0 if origin == to else min(sums, default=math.inf)
        return self.least[key]

    def _leg(self, kind: str, origin: str, to: str) -> float:
        """Return how long a robot drives or rides at least (s)."""
        lift = lift_between(self.records, origin, to)
        if lift is not None:
            return ride_seconds(self.records, lift, self.floor(origin), self.floor(to))
        poses = way_between(self.records, origin, to)
        return self.floors.at(origin).lower_bound(self.bodies[kind], poses)

    @cached_property
    def shut(self) -> frozenset[str]:
        """The doors that provably nobody can ever open.

        The first of some shut doors to be opened is opened by a robot that gets to its button past
        all of them; doors that are open count as no obstacle, so none is called shut that is not.
        """
        buttons = {
            (visit.what, robot, place_of(p))
            for robot, visits in self.visits.items()
            for visit in visits
            if visit.kind is Kind.OPEN
            for p in visit.places
        }
        shut = frozenset(self.records.doors)
        while opened := {
            door for door, who, at in buttons if door in shut and self._reaches(who, at, shut)
        }:
            shut -= opened
        return shut

    def _reaches(self, robot: str, place: str, shut: frozenset[str]) -> bool:
        """Return whether no proof says that the robot cannot get there past doors that are shut."""
        mine = self.records.robots[robot]
        kind, body = mine.type, self.bodies[mine.type]
        ways = legs_between(self.records, mine.start, place)
        return any(not any(self._is_stuck(kind, body, *leg, shut) for leg in way) for way in ways)

    def _is_stuck(self, kind: str, body: Body, origin: str, to: str, shut: frozenset[str]) -> bool:
        """Return whether provably no robot of a type drives there as ``body`` past doors that are
        shut.
        """
        if lift_between(self.records, origin, to) is not None:
            return False
        floor, ends = self.floor(origin), (self.places[origin], self.places[to])
        doors = (door for door in self.doors(floor) if door.name in shut)
        around = (*kept_out(self.records, kind, floor), *doors)
        return self.floors.service(floor).certificate(body, ends, around) is not None

    def ways(self) -> Iterator[Finding]:
        """What robots can reach, and who can do what."""
        reach: dict[str, set[str]] = {}
        for robot in self.records.robots:
            reach[robot] = set()
            yield from self._ways(robot, reach[robot])
        for job in self.records.jobs:
            yield from self._job(job, reach)

    def _ways(self, robot: str, reach: set[str]) -> Iterator[Finding]:
        mine = self.records.robots[robot]
        used: dict[str, set[Kind]] = {}
        for visit in self.visits[robot]:
            for place in map(place_of, visit.places):
                used.setdefault(place, set()).add(visit.kind)
        for place, roles in used.items():
            if self._reaches(robot, place, self.shut):
                reach.add(place)
            else:
                level = Level.ERROR if Kind.END in roles else Level.WARNING
                text = f"robot '{robot}' can never get there from '{mine.start}' (proven)"
                if self._reaches(robot, place, frozenset()):
                    text += f": nobody can open {both(sorted(self.shut))}"
                yield Finding(level, place, text)
                continue
            for door in self.records.doors:
                if not self._reaches(robot, place, frozenset({door})):
                    text = f"robot '{robot}' gets there only once door '{door}' is open"
                    yield Finding(Level.NOTE, place, text)
            ways = legs_between(self.records, mine.start, place)
            if all(any(self._in_vain(mine.type, *leg) for leg in way) for way in ways):
                text = f"no drive of robot '{robot}' from '{mine.start}' was found in time"
                yield Finding(Level.WARNING, place, text)

    def _in_vain(self, kind: str, origin: str, to: str) -> bool:
        """Return whether a drive was looked for until time ran out."""
        if lift_between(self.records, origin, to) is not None:
            return False
        floor, poses = self.floor(origin), way_between(self.records, origin, to)
        body = ruled(self.records, kind, floor, self.bodies[kind])
        query = PathQuery(body, poses, kept_out(self.records, kind, floor))
        report = self.floors.at(origin).plan(query, Deadline.after(self.seconds))
        return report.outcome is Outcome.OUT_OF_TIME

    def one_ways(self) -> Iterator[Finding]:
        """One-way zones past which there is no way, and through which none was found, where one
        was if nobody heeds them: it may be that their direction lets nobody back.
        """
        told: set[tuple[str, frozenset[str]]] = set()
        until = Deadline.after(10 * self.seconds)  # for all: searches that find nothing are long
        for robot, kind, origin, to in self._through():
            zones = self._in_the_way(kind, origin, to)
            if not zones or (kind, zones) in told or until.expired():
                continue
            free, floor = self.bodies[kind], self.floor(origin)
            around, service = kept_out(self.records, kind, floor), self.floors.service(floor)
            poses = way_between(self.records, origin, to)
            heeding, other = (
                service.plan(PathQuery(body, poses, around), until).outcome
                for body in (ruled(self.records, kind, floor, free), free)
            )
            none = heeding in (Outcome.NOT_FOUND, Outcome.IMPOSSIBLE)  # the search ended by itself
            if not none or other is not Outcome.FOUND:
                continue
            told.add((kind, zones))
            text = f"robot '{robot}' has to drive through from '{origin}' to '{to}', and no way was"
            text += " found that heeds its direction (one_way); without it there is one"
            yield Finding(Level.WARNING, ", ".join(sorted(zones)), text)

    def _through(self) -> Iterator[tuple[str, str, str, str]]:
        """Yield ways that robots take on one floor: to where they have to do with, and back to
        their end, if they have one (robot, type, from, to).
        """
        for robot, mine in self.records.robots.items():
            for place in dict.fromkeys(place_of(p) for v in self.visits[robot] for p in v.places):
                for origin, to in ((mine.start, place), (place, mine.end)):
                    if to is not None and origin != to and self.floor(origin) == self.floor(to):
                        yield robot, mine.type, origin, to

    def _in_the_way(self, kind: str, origin: str, to: str) -> frozenset[str]:
        """Return the one-way zones that a robot provably has to drive through."""
        floor, ends = self.floor(origin), (self.places[origin], self.places[to])
        zones = [
            area_of(self.records, name)
            for name, zone in self.records.zones.items()
            if zone.one_way is not None and zone.floor == floor and zone.heeded_by(kind)
        ]
        around = kept_out(self.records, kind, floor)
        prove, body = self.floors.service(floor).certificate, self.bodies[kind]
        if not zones or prove(body, ends, around) is not None:
            return frozenset()
        proof = prove(body, ends, (*around, *zones))
        return frozenset() if proof is None else proof.blockers & {z.name for z in zones}

    def _job(self, job: Order | Task, reach: dict[str, set[str]]) -> Iterator[Finding]:
        if not needs_robot(job):
            return
        stops = [(halt.what, set(halt.places)) for halt in self._stops(job)]
        fit = self._fit(job)
        able_to = [r for r in fit if all(reach[r] & at for _, at in stops)]
        if able_to:
            load = load_of(self.records, job) if isinstance(job, Order) else None
            if isinstance(job, Order) and load is not None:
                yield from self._rides(job, load, able_to)
            return
        lost = [what for what, at in stops if not any(reach[r] & at for r in fit)]
        what = f"its {' and its '.join(lost)}" if lost else "both its ends"
        text = f"no robot that may do it ({', '.join(fit)}) can reach {what}"
        yield Finding(Level.NOTE if job.optional else Level.ERROR, job.id, text)

    def _rides(self, order: Order, load: Attached, fit: list[str]) -> Iterator[Finding]:
        """Whether robots get through with a load that is as large as theirs."""
        level = Level.NOTE if order.optional else Level.ERROR
        stands, outline = self.places[order.pickup.at[0]], still(load.footprint)
        service = self.floors.at(order.pickup.at[0])
        wall, _ = service.pose_blockers(outline, load_pose(load, stands), ())
        if wall and isinstance(order.attached, Attached):
            yield Finding(level, order.id, "its load would stand in a wall or outside the map")
            return
        ways = list(itertools.product(order.pickup.at, order.delivery.at))
        kinds = {r: self.records.robots[r].type for r in fit}
        ridden = {k: with_load(self.records.robot_types[k], load) for k in {*kinds.values()}}
        stuck = [
            robot
            for robot, kind in kinds.items()
            if all(self._is_stuck(kind, ridden[kind], *way, self.shut) for way in ways)
        ]
        for robot in stuck if len(stuck) < len(fit) else ():
            text = f"robot '{robot}' does not get through with its load (proven)"
            yield Finding(Level.NOTE, order.id, text)
        if len(stuck) == len(fit):
            text = f"no robot that may do it ({', '.join(fit)}) gets through with its load (proven)"
            yield Finding(level, order.id, text)

    def loads(self) -> Iterator[Finding]:
        """Loads that stand in each other or on robots."""
        bodies, loads = [], loads_of(self.records)
        for order, load in loads:
            pose = load_pose(load, self.places[order.pickup.at[0]])
            name = f"the load of '{order.id}'"
            floor = self.floor(order.pickup.at[0])
            bodies.append((name, order.id, still(load.footprint), pose, floor))
        for name, robot in self.records.robots.items():
            pose = self.places[robot.start]
            body, floor = self.bodies[robot.type], self.floor(robot.start)
            bodies.append((f"robot '{name}'", "", body, pose, floor))
        for i, j in self._meeting([(b, p, f) for _, _, b, p, f in bodies]) if loads else ():
            (one, subject, *_), (other, *_) = bodies[i], bodies[j]
            if subject:
                yield Finding(Level.ERROR, subject, f"{one} and {other} would overlap at first")


def _show(pose: Pose) -> str:
    return "(" + ", ".join(f"{v:g}" for v in pose) + ")"
