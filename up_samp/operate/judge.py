"""Was the day as it should have been? Judged on what was driven and done, not on plans.

Contacts are those of the validator's swept check on the robots' real bodies; orders are judged by
where robots really stood while they were picked up and delivered.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from unified_planning.shortcuts import MovableType

from up_samp.execution.floor import Drive, Handled
from up_samp.execution.judge import Contact, contacts_of
from up_samp.fleet.fields import corners_of
from up_samp.fleet.meanings import Kind
from up_samp.fleet.outlines import movable, rules_for
from up_samp.fleet.records import FleetRecords, Order, visited
from up_samp.model.graphs import grouped
from up_samp.operate.records import DayOrder, OrderState, Pose, nothing_planned
from up_samp.validation.collisions import JudgedShape, placed
from up_samp.validation.kinematics import limits_of, speeds_on_way
from up_samp.validation.zones import zone_violations

_ROBOT = MovableType("robot")
THERE = 0.25
"""How far (m) from a place a robot may stand for what is done there: its error, twice, and what it
stops short of the place."""


@dataclass(frozen=True)
class DayVerdict:
    """``contacts``: who met. ``lost``: orders that were taken and not done; ``twice``: done more
    than once; ``elsewhere``: what was done where it should not have been, or too early, in words;
    ``unruly``: who drove as its type or a zone forbids, in words; ``crowded``: zones in which there
    were more robots than they take, in words; ``overfull``: resources that were used by more than
    they have, and robots with more on board than fits, in words.
    """

    contacts: tuple[Contact, ...]
    lost: tuple[str, ...]
    twice: tuple[str, ...]
    elsewhere: tuple[str, ...]
    unruly: tuple[str, ...] = ()
    crowded: tuple[str, ...] = ()
    overfull: tuple[str, ...] = ()

    @property
    def wrong(self) -> dict[str, int]:
        """How many there are of each kind of which there are any."""
        return {kind: len(found) for kind, found in vars(self).items() if found}

    @property
    def good(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def judge_day(
    site: FleetRecords,
    jobs: Mapping[str, DayOrder],
    initial: Mapping[str, Pose],
    drives: Sequence[Drive],
    handled: Sequence[Handled],
) -> DayVerdict:
    """Judge a day by its drives and by what was done at places."""
    over = {h.what: h.end for h in handled if h.kind in ("deliver", "task")}
    lost: list[str] = []
    twice: list[str] = []
    elsewhere: list[str] = []
    for name, job in jobs.items():
        mine = [h for h in handled if h.what == name]
        ends = [h for h in mine if h.kind in ("deliver", "task")]
        if not ends and job.state is not OrderState.CANCELLED:
            lost.append(name)
        if len(ends) > 1:
            twice.append(name)
        early = (h for h in mine if h.start < _may_begin(job, h.kind, over) - 1e-6)
        elsewhere += [f"'{name}' was begun at {h.start:.1f} s, before it might" for h in early]
        if isinstance(job.record, Order) and ends:
            elsewhere += _of_order(site, job.record, mine, initial, drives)
    met = contacts(site, initial, drives, handled)
    rules, crowds = tuple(unruly(site, drives)), tuple(crowded(site, initial, drives))
    full = tuple(overfull(site, jobs, handled))
    return DayVerdict(tuple(met), tuple(lost), tuple(twice), tuple(elsewhere), rules, crowds, full)


def _may_begin(job: DayOrder, kind: str, over: Mapping[str, float]) -> float:
    """Return from when on (s of the day) something of an order may be done. ``over``: when others
    were.
    """
    stop = visited(job.record)[0 if kind == "pick" else -1]
    opens = min((job.came + window[0] for window in stop.window), default=0.0)
    return max(job.record.release, opens, *(over.get(n, 0.0) for n in job.record.after))


def crowded(
    site: FleetRecords, initial: Mapping[str, Pose], drives: Sequence[Drive]
) -> Iterable[str]:
    """Yield in which zones there were more robots than they take, by what was driven."""
    for name, zone in site.zones.items():
        if zone.max_robots is None:
            continue
        area = shapely.Polygon(zone.polygon)
        shapely.prepare(area)
        changes: list[tuple[float, int, str]] = []
        for robot, pose in initial.items():
            corners = corners_of(site.kind_of(robot).footprint)
            rows = np.vstack([[0.0, *pose], *(d.rows for d in drives if d.robot == robot)])
            bodies = shapely.polygons(placed(np.array(corners), rows[:, 1:]))
            here = np.asarray(shapely.intersects(area, bodies))
            steps = np.diff(here.astype(int), prepend=0)
            changes += [(float(rows[k, 0]), int(steps[k]), robot) for k in np.flatnonzero(steps)]
        count = 0
        for when, by, robot in sorted(changes):
            count += by
            if by > 0 and count > zone.max_robots:
                yield f"'{robot}' came into '{name}' at {when:.1f} s as number {count}"


def overfull(
    site: FleetRecords, jobs: Mapping[str, DayOrder], handled: Sequence[Handled]
) -> Iterable[str]:
    """Yield which resources were used by more than they have, and which robots had more on board
    than fits, by what was done.
    """
    for (what, name, most), uses in grouped(_uses(site, jobs, handled), lambda u: u[0]).items():
        count = 0
        for when, by in sorted(change for _, *two in uses for change in two):
            count += by
            if by > 0 and count > most:
                yield f"'{name}' ({what}) had {count} at {when:.1f} s, and takes {most}"


Use = tuple[tuple[str, str, int], tuple[float, int], tuple[float, int]]
"""What is used of what, and how much there is; from when on (s), until when, and how much."""


def _uses(
    site: FleetRecords, jobs: Mapping[str, DayOrder], handled: Sequence[Handled]
) -> Iterable[Use]:
    """Yield what things done at places used, and what picked up was on board of whom until it was
    brought, or picked up again.
    """
    for h in (h for h in handled if h.what in jobs):
        record, picked = jobs[h.what].record, h.kind == "pick"
        for name in visited(record)[0 if picked else -1].resources:
            key = "resource", name, site.resources[name].capacity
            yield key, (h.start, 1), (h.end, -1)
        if isinstance(record, Order) and picked:
            room = site.kind_of(h.robot).capacity
            later = (o.start for o in handled if o.what == h.what and o.start > h.start)
            until = max(h.end, min(later, default=math.inf))
            for load, count in record.load.items():
                yield (load, h.robot, room.get(load, 0)), (h.end, count), (until, -count)


def unruly(site: FleetRecords, drives: Sequence[Drive]) -> Iterable[str]:
    """Yield who drove against its heading, or in a zone, as it must not."""
    for drive in drives:
        name = site.robots[drive.robot].type
        kind = site.robot_types[name]
        limits = limits_of(movable("", _ROBOT, kind, rules_for(site, name)))
        rows, what = drive.rows, f"{drive.robot} in '{drive.activity}'"
        times, poses = rows[:, 0], rows[:, 1:]
        parts = [(JudgedShape(drive.robot, np.array(corners_of(kind.footprint))), poses)]
        found = [*speeds_on_way(what, limits, times, poses)]
        found += zone_violations(what, limits, parts, 0.0, times, poses)
        yield from (v.what for v in found)


def _of_order(
    site: FleetRecords,
    order: Order,
    handled: Sequence[Handled],
    initial: Mapping[str, Pose],
    drives: Sequence[Drive],
) -> Iterable[str]:
    """Yield what is wrong with how an order was done."""
    picks = [h for h in handled if h.kind == "pick"]
    brought = next(h for h in handled if h.kind in ("deliver", "task"))
    if not picks:
        yield f"'{order.id}' was delivered and not picked up"
        return
    if picks[-1].robot != brought.robot or picks[-1].end > brought.start + 1e-6:
        yield f"'{order.id}' was picked up by {picks[-1].robot}, and delivered by {brought.robot}"
    for one, stop in ((picks[-1], order.pickup), (brought, order.delivery)):
        for when in (one.start, one.end):
            here = where(one.robot, when, initial, drives)
            spots = (site.places[p].pose for p in stop.at)
            if min(math.dist(here[:2], spot[:2]) for spot in spots) > THERE:
                yield f"'{order.id}' was handled by {one.robot} at {here[0]:.2f}, {here[1]:.2f}"


def where(
    robot: str, when: float, initial: Mapping[str, Pose], drives: Iterable[Drive]
) -> Sequence[float]:
    """Return where a robot really was."""
    pose: Sequence[float] = initial[robot]
    for drive in drives:
        times = drive.rows[:, 0]
        if drive.robot == robot and len(times) and times[0] <= when:
            pose = drive.rows[np.searchsorted(times, when + 1e-9, side="right") - 1, 1:].tolist()
    return pose


def record_of_day(
    site: FleetRecords, initial: Mapping[str, Pose], drives: Sequence[Drive]
) -> dict[str, Any]:
    """Return a plan-like record of what was driven: it is drawn like a plan."""
    activities: list[dict[str, Any]] = []
    motions: list[dict[str, Any]] = []
    for k, drive in enumerate(d for d in drives if len(d.rows) > 1):
        name = f"{k}: {drive.activity}"
        since, until = drive.rows[[0, -1], 0].tolist()
        activities.append({"name": name, "start": since, "end": until})
        motions.append({"activity": name, "object": drive.robot, "samples": drive.rows.tolist()})
    return nothing_planned(site, initial) | {
        "engine": "a day", "activities": activities, "motions": motions,
        "makespan": max((a["end"] for a in activities), default=0.0),
    }  # fmt: skip


def contacts(
    site: FleetRecords,
    initial: Mapping[str, Pose],
    drives: Sequence[Drive],
    handled: Sequence[Handled] = (),
) -> list[Contact]:
    """Return who met in a day, by what was driven: other robots, and leaves of doors, which stand
    closed until they have been opened.
    """
    record, doors = record_of_day(site, initial, drives), site.doors
    record["objects"] += [
        {"name": n, "footprint": corners_of(d.leaf), "initial": list(d.closed)}
        for n, d in doors.items()
    ]
    record["changes"] += [
        {"activity": "", "object": h.what, "time": h.end, "configuration": doors[h.what].open}
        for h in handled
        if h.kind == Kind.OPEN.value
    ]
    return contacts_of(record)
