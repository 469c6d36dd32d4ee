"""A picture of a fleet problem: the map with all places, doors, zones and robots."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
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
from up_samp.model.frames import Frame
from up_samp.plotting.background import ground_of, told
from up_samp.plotting.map_picture import draw_area, label_of, legend_below, map_panels
from up_samp.plotting.style import (
    FIXTURE,
    INK,
    WRONG,
    PlacedLabel,
    color_of,
    mixed,
    place_labels,
)


def draw_fleet(records: FleetRecords, folder: Path, findings: Iterable[Finding] = ()) -> Axes:
    """Draw what ``records`` say; what errors and warnings are about is red. Returns the axes."""
    records = spelled_out(records)
    maps = [
        {"yaml": str(folder / map_of(records, floor)), "height": height_of(records, floor)}
        for floor in (GROUND, *records.floors)
    ]
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
    records = _laid_out(records, backdrop.shifts)
    if records.floors:  # by their names here, in the order of their heights
        names = sorted((GROUND, *records.floors), key=lambda floor: height_of(records, floor))
        named = zip(backdrop.floors, names, strict=False)
        floors = tuple(dataclasses.replace(floor, name=name) for floor, name in named)
        backdrop = dataclasses.replace(backdrop, floors=floors)
    panels = map_panels(backdrop, None, f"{records.name}: {in_numbers(records)}")
    serious = [f for f in findings if f.level is not Level.NOTE]
    bad = {f.subject for f in serious}
    tight = dict.fromkeys((f.type, f.subject) for f in serious if f.type is not None)
    _draw_legend(panels, records, bad, bool(tight))
    for ax in panels:
        labels = [*_draw_fixtures(ax, records), *_draw_places(ax, records, bad)]
        for kind, place in tight:
            shape = placed(records.robot_types[kind].footprint, records.places[place].pose)
            ax.add_patch(Polygon(shape, fc="none", ec=WRONG, lw=1.6, ls="--", zorder=5))
        place_labels(ax, labels, avoid=[])
    return panels[0]


_DRAWN = {
    "places": ("pose",),
    "doors": ("closed", "open", "second"),
    "zones": ("polygon",),
    "automatic_doors": ("polygon",),
    "lanes": ("points",),
}
"""What of records says where they are: poses and points, or several of them."""


def _laid_out(records: FleetRecords, shifts: Mapping[float, Frame]) -> FleetRecords:
    """Return the records with everything where it is drawn: floors lie side by side."""

    def moved(value: Any, shift: Frame) -> Any:
        if value is None or isinstance(value[0], tuple):
            return value and tuple(moved(one, shift) for one in value)
        return (value[0] + shift.x, value[1] + shift.y, *value[2:])

    changed: dict[str, Any] = {kind: {} for kind in _DRAWN}
    for kind, keys in _DRAWN.items():
        for name, one in getattr(records, kind).items():
            shift = shifts.get(height_of(records, one.floor), Frame())
            told = {key: moved(getattr(one, key), shift) for key in keys}
            changed[kind][name] = dataclasses.replace(one, **told)
    return dataclasses.replace(records, **changed)


def _draw_fixtures(ax: Axes, records: FleetRecords) -> list[PlacedLabel]:
    """Draw zones, doors and loads; return what they are called."""
    labels: list[PlacedLabel] = []
    for name, zone in records.zones.items():
        here = np.asarray(zone.polygon, dtype=np.float64)
        if not zone.has_rules:
            draw_area(ax, here)
        x, y = (float(v) for v in here.mean(axis=0))
        asked = told(zone_entry(zone_of(zone))) if zone.has_rules else ""
        text = f"{name}: {asked}" if asked else name
        labels.append(PlacedLabel(text, x, y, WRONG, False, (0.3, 0.3)))
    for name, lane in records.lanes.items():
        labels.append(PlacedLabel(name, *lane.points[0], FIXTURE, False, (0.3, 0.3)))
    for name, doorway in records.automatic_doors.items():
        here = np.asarray(doorway.polygon, dtype=np.float64)
        ax.add_patch(Polygon(here, fc=mixed(FIXTURE, 0.7), ec=FIXTURE, ls=":"))
        x, y = (float(v) for v in here.mean(axis=0))
        labels.append(PlacedLabel(name, x, y, FIXTURE, False, (0.3, 0.3)))
    for name, door in records.doors.items():
        for ends in door.leaves:
            leaf, opened = placed(door.leaf, ends[0]), placed(door.leaf, ends[1])
            ax.add_patch(Polygon(opened, fc="none", ec=FIXTURE, ls="--"))
            ax.add_patch(Polygon(leaf, fc=FIXTURE, ec=INK))
        labels.append(label_of(name, placed(door.leaf, door.closed), FIXTURE))
    for order, attached in loads_of(records):
        at = load_pose(attached, records.places[order.pickup.at[0]].pose)
        load = placed(attached.footprint, at)
        ax.add_patch(Polygon(load, fc=mixed(FIXTURE, 0.6), ec=FIXTURE, zorder=1.5))
    return labels


def _draw_places(ax: Axes, records: FleetRecords, bad: set[str]) -> list[PlacedLabel]:
    """Draw places, with the robots that start there; return what they are called."""
    labels: list[PlacedLabel] = []
    starts = {r.start: name for name, r in records.robots.items()}
    order = list(records.robots)
    shape = _usual(records)
    for name, place in records.places.items():
        color = WRONG if name in bad else INK
        robot = starts.get(name)
        if robot is not None:
            shape_here = records.robot_types[records.robots[robot].type].footprint
            outline = placed(shape_here, place.pose)
            fill = color_of(order.index(robot))
            ax.add_patch(Polygon(outline, fc=WRONG if name in bad else fill, ec=INK, zorder=3))
        else:
            outline = placed(shape, place.pose)
            ax.add_patch(Polygon(outline, fc=mixed(color, 0.85), ec=color, lw=1.0, zorder=2))
        x, y, theta = place.pose
        reach = float(np.abs(outline - (x, y)).max())
        tip = (x + reach * math.cos(theta), y + reach * math.sin(theta))
        ax.plot([x, tip[0]], [y, tip[1]], color=color, lw=1.2, zorder=4)
        text = name if robot is None else f"{robot} at {name}"
        labels.append(label_of(text, outline, color))
    return labels


def _draw_legend(panels: list[Axes], records: FleetRecords, bad: set[str], tight: bool) -> None:
    doorway, load = mixed(FIXTURE, 0.7), mixed(FIXTURE, 0.6)
    keys = [
        (True, Patch(fc=mixed(INK, 0.85), ec=INK, label="place")),
        (records.automatic_doors, Patch(fc=doorway, ec=FIXTURE, ls=":", label="door, automatic")),
        (records.doors, Patch(fc=FIXTURE, label="door, closed")),
        (loads_of(records), Patch(fc=load, ec=FIXTURE, label="load")),
        (bad, Patch(fc=WRONG, label="wrong: see the list")),
        (tight, Patch(fc="none", ec=WRONG, ls="--", label="robot that does not fit there")),
    ]
    legend_below(panels, keys)


def _usual(records: FleetRecords) -> Outline:
    """Return the footprint of most robots."""
    kinds = [r.type for r in records.robots.values()] or list(records.robot_types)
    if not kinds:
        return (0.5, 0.5)
    most = max(sorted(set(kinds)), key=kinds.count)
    return records.robot_types[most].footprint
