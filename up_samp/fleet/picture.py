"""A picture of a fleet problem: the map with all places, doors, zones and robots."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Polygon

from up_samp.fleet.checks import Finding, Level
from up_samp.fleet.fields import Outline
from up_samp.fleet.floors import height_of, map_of
from up_samp.fleet.loads import load_pose, loads_of
from up_samp.fleet.outlines import placed, rules_for, zone_of
from up_samp.fleet.records import GROUND, FleetRecords
from up_samp.fleet.spelled_out import in_numbers, spelled_out
from up_samp.io.plan_dict import zone_entry
from up_samp.model.arrays import FloatArray
from up_samp.model.frames import Frame
from up_samp.plotting.background import ground_of, told
from up_samp.plotting.map_picture import AREA_LOOK, label_of, legend_below, map_panels
from up_samp.plotting.style import FIXTURE, INK, WRONG, color_of, mixed, place_labels

Shape = tuple[str, str, str, FloatArray, dict[str, Any]]
"""The floor of something, its kind, its name, its corners (n, 2), and how it differs from others of
its kind.
"""
LOOKS: dict[str, dict[str, Any]] = {
    "place": {"fc": mixed(INK, 0.85), "ec": INK, "zorder": 2},
    "zone": AREA_LOOK,
    "rules of driving": {"fc": "none", "ec": WRONG, "lw": 0.8, "ls": ":"},
    "door, automatic": {"fc": mixed(FIXTURE, 0.7), "ec": FIXTURE, "ls": ":"},
    "door, open": {"fc": "none", "ec": FIXTURE, "ls": "--"},
    "door, closed": {"fc": FIXTURE, "ec": INK},
    "load": {"fc": mixed(FIXTURE, 0.6), "ec": FIXTURE, "zorder": 1.5},
    "robot that does not fit there": {"fc": "none", "ec": WRONG, "lw": 1.6, "ls": "--"},
}
"""What is drawn, by kind; others have a look of their own."""


def draw_fleet(records: FleetRecords, folder: Path, findings: Iterable[Finding] = ()) -> Axes:
    """Draw what ``records`` say; what errors and warnings are about is red. Returns the axes."""
    records = spelled_out(records)
    heights = {floor: height_of(records, floor) for floor in (GROUND, *records.floors)}
    maps = [{"yaml": str(folder / map_of(records, f)), "height": h} for f, h in heights.items()]
    rules = [
        {
            "name": kind,
            "initial": None,
            "footprint": [],
            "zones": [zone_entry(zone) for zone in rules_for(records, kind)],
        }
        for kind in records.robot_types or ("",)
    ]
    site = {"map": maps[0], "maps": maps, "objects": rules, "motions": [], "changes": []}
    backdrop = ground_of(site)
    if records.floors:  # by their names here, in the order of their heights
        named = zip(backdrop.floors, sorted(heights, key=heights.__getitem__), strict=False)
        floors = tuple(dataclasses.replace(floor, name=name) for floor, name in named)
        backdrop = dataclasses.replace(backdrop, floors=floors)
    panels = map_panels(backdrop, None, f"{records.name}: {in_numbers(records)}")
    serious = [f for f in findings if f.level is not Level.NOTE]
    bad = {f.subject for f in serious}
    tight = dict.fromkeys((f.type, f.subject) for f in serious if f.type is not None)
    shapes = [*_fixtures(records), *_places(records, bad)]
    for kind, place in tight:
        there = placed(records.robot_types[kind].footprint, records.places[place].pose)
        floor = records.places[place].floor
        shapes.append((floor, "robot that does not fit there", "", there, {"zorder": 5}))
    labels = []
    for floor, kind, name, corners, own in shapes:
        shift = backdrop.shifts.get(heights[floor], Frame())
        outline, look = shift.points(corners), {**LOOKS.get(kind, {}), **own}
        for ax in panels:
            ax.add_patch(Polygon(outline, **look))
        if name:
            labels.append(label_of(name, outline, look["ec"]))
    kinds = {kind for _, kind, *_ in shapes}
    keys: list[tuple[object, Artist]] = [
        (kind in kinds, Patch(**look, label=kind)) for kind, look in LOOKS.items()
    ]
    legend_below(panels, [*keys, (bad, Patch(fc=WRONG, label="wrong: see the list"))])
    for ax in panels:
        place_labels(ax, labels)
    return panels[0]


def _fixtures(records: FleetRecords) -> Iterator[Shape]:
    """Yield zones, lanes, doors and loads."""
    for name, zone in records.zones.items():
        asked = told(zone_entry(zone_of(zone))) if zone.has_rules else ""
        kind = "rules of driving" if zone.has_rules else "zone"
        yield zone.floor, kind, f"{name}: {asked}" if asked else name, np.array(zone.polygon), {}
    for name, lane in records.lanes.items():
        yield lane.floor, "lane", name, np.array(lane.points[:1]), {"ec": FIXTURE}
    for name, doorway in records.automatic_doors.items():
        yield doorway.floor, "door, automatic", name, np.array(doorway.polygon), {}
    for name, door in records.doors.items():
        for closed, opened in door.leaves:
            yield door.floor, "door, open", "", placed(door.leaf, opened), {}
            called = name if closed == door.closed else ""
            yield door.floor, "door, closed", called, placed(door.leaf, closed), {}
    for order, attached in loads_of(records):
        place = records.places[order.pickup.at[0]]
        at = load_pose(attached, place.pose)
        yield place.floor, "load", "", placed(attached.footprint, at), {}


def _places(records: FleetRecords, bad: set[str]) -> Iterator[Shape]:
    """Yield places, each with a stroke ahead, and the robots that start there."""
    starts = {r.start: name for name, r in records.robots.items()}
    order, usual = list(records.robots), _usual(records)
    for name, place in records.places.items():
        robot, color = starts.get(name), WRONG if name in bad else INK
        if robot is None:
            kind, text, outline = "place", name, placed(usual, place.pose)
            look: dict[str, Any] = {"fc": mixed(color, 0.85), "ec": color}
        else:
            footprint = records.kind_of(robot).footprint
            kind, text, outline = "robot", f"{robot} at {name}", placed(footprint, place.pose)
            fill = WRONG if name in bad else color_of(order.index(robot))
            look = {"fc": fill, "ec": color, "zorder": 3}
        yield place.floor, kind, text, outline, look
        x, y, theta = place.pose
        reach = float(np.abs(outline - (x, y)).max())
        ahead = np.array([(x, y), (x + reach * math.cos(theta), y + reach * math.sin(theta))])
        stroke = {"closed": False, "fill": False, "ec": color, "lw": 1.2, "zorder": 4}
        yield place.floor, "stroke", "", ahead, stroke


def _usual(records: FleetRecords) -> Outline:
    """Return the footprint of most robots."""
    kinds = [r.type for r in records.robots.values()] or list(records.robot_types)
    if not kinds:
        return (0.5, 0.5)
    most = max(sorted(set(kinds)), key=kinds.count)
    return records.robot_types[most].footprint
