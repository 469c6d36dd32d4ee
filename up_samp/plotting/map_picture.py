"""A plan's paths on its map."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox

from up_samp.model.arrays import FloatArray
from up_samp.model.errors import in_words
from up_samp.model.frames import Frame
from up_samp.plotting.background import (
    LANE_FILL,
    Backdrop,
    Corners,
    Zone,
    corners_of,
    ground_of,
    is_lane,
    rules_of,
    told,
)
from up_samp.plotting.gantt import title_of
from up_samp.plotting.style import (
    AREA_FILL,
    FIXTURE,
    INK,
    WRONG,
    PlacedLabel,
    color_of,
    figure_axes,
    mixed,
    place_labels,
    with_short_names,
)
from up_samp.plotting.tracks import ObjectTrack, TrackPiece, flat, stops_of, tracks_of

_Pose = tuple[float, float, float]
AREA_LOOK: dict[str, Any] = {
    "fc": AREA_FILL, "ec": WRONG, "lw": 0.8, "ls": ":", "alpha": 0.6, "zorder": 1.0
}  # fmt: skip
"""Of a zone, and of what a door sweeps: below all else."""


def plot_map(
    plan: dict[str, Any],
    ax: Axes | None = None,
    *,
    places: Mapping[str, tuple[float, ...]] | None = None,
) -> Axes:
    """Draw the map, every object's path, and footprints where motions start, end and on the way.

    ``plan`` is a plan dictionary. ``places`` maps names to poses (:func:`places_of`): those where a
    motion starts or ends are labelled. What is changed rather than driven (doors) is solid as it is
    at first and outlined as it becomes. Several floors have a panel each. Returns the axes (of the
    lowest floor); without ``ax``, those of a new figure; with it, panels take its place.
    """
    laid = ground_of(with_short_names(plan))
    plan, panels = laid.plan, map_panels(laid, ax, title_of(laid.plan))
    tracks = tracks_of(plan)
    movers, still = ([t for t in tracks if bool(t.moves) is moves] for moves in (True, False))
    left, right, bottom, top = laid.floors[0].extent
    step = _spacing(movers, max(right - left, top - bottom))
    rules = rules_of(plan)
    _legend(panels, movers, still, rules)
    for panel in panels:
        labels = _draw_tracks(panel, movers, still, step) + _labels_of(rules, still)
        for track, pose, names in stops_of(movers, laid.places(places)):
            labels.append(label_of(" / ".join(names), track.outline(pose), INK))
        place_labels(panel, labels, avoid=_stops(panel, movers))
    return panels[0]


def _draw_tracks(
    ax: Axes, movers: list[ObjectTrack], still: list[ObjectTrack], step: float
) -> list[PlacedLabel]:
    """Draw what moves and what stands; return what it is called."""
    labels: list[PlacedLabel] = []
    for i, track in enumerate(movers):
        _draw_mover(ax, track, color_of(i), step)
        if track.initial is not None:
            labels.append(
                label_of(track.name, track.outline(track.initial), color_of(i), bold=True)
            )
    for track in still:
        if track.initial is not None:
            labels += _draw_still(ax, track, track.initial)
        _draw_rides(ax, track, step)
    return labels


def map_panels(laid: Backdrop, ax: Axes | None, title: str) -> list[Axes]:
    """Draw a map, a panel for each floor, which has its own coordinates at the axes; without
    ``ax``, on a new figure, else in its place.
    """
    left, right, bottom, top = laid.floors[0].extent
    tall, count = 12.4 * (top - bottom) / (right - left), len(laid.floors)
    # as wide as fits on a page
    columns = next(c for c in range(1, count + 1) if c == count or tall * count / c**2 <= 9.0)
    rows = math.ceil(count / columns)
    if ax is None:
        height = min(max(rows * (tall / columns + 0.6), 2.5), 20.0) + 0.5
        ax = figure_axes(13.0, height)
    panels, figure = [ax], ax.get_figure()
    if count > 1:
        grid = (ax.get_subplotspec() or GridSpec(1, 1)[0]).subgridspec(rows, columns)
        ax.remove()
        panels = [figure.add_subplot(grid[k]) for k in range(count)]  # type: ignore[union-attr]
    for panel, floor in zip(panels, laid.floors, strict=True):
        left, right, bottom, top = floor.extent
        panel.imshow(laid.pixels, extent=laid.extent, interpolation="nearest", zorder=0)
        panel.set(xlim=(left, right), ylim=(bottom, top), xlabel="x [m]", ylabel="y [m]")
        panel.set_aspect("equal")
        panel.set_title(floor.name or title, loc="left", fontsize=11, color=INK)
        if floor.name:
            _own_ticks(panel, floor.frame)
    if count > 1:
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, color=INK)  # type: ignore[union-attr]
    return panels


def _own_ticks(ax: Axes, frame: Frame) -> None:
    """Write at the axes the coordinates that places have on their floor."""
    for axis, limits, shift in (
        (ax.xaxis, ax.get_xlim(), frame.x),
        (ax.yaxis, ax.get_ylim(), frame.y),
    ):
        low, high = limits[0] - shift, limits[1] - shift
        own = [float(v) for v in MaxNLocator(8).tick_values(low, high)]
        shown = [v for v in own if low - 1e-9 <= v <= high + 1e-9]
        axis.set_ticks([v + shift for v in shown], [f"{v:g}" for v in shown])


def label_of(text: str, outline: FloatArray, color: str, *, bold: bool = False) -> PlacedLabel:
    """Return a label that stays outside an outline."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    (x, y), (wide, tall) = (low + high) / 2, (high - low) / 2
    return PlacedLabel(text, float(x), float(y), color, bold, (float(wide), float(tall)))


def legend_below(panels: Sequence[Axes], keys: Iterable[tuple[object, Artist]]) -> None:
    """Explain, below a map, what there is of some keys."""
    handles = [key for is_there, key in keys if is_there]
    style: dict[str, Any] = {"frameon": False, "ncols": min(len(handles), 7), "fontsize": 8}
    figure = panels[0].get_figure(root=True)
    if figure is not None and figure.axes == [*panels]:  # nobody else's: its layout makes room
        figure.legend(handles=handles, loc="outside lower center", **style)
        return
    panels[0].legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=5.0, **style
    )


def places_of(problem: Any) -> dict[str, tuple[float, ...]]:
    """Return the named configurations of a UP problem, for the labels of :func:`plot_map`.

    Those on maps that are higher than the ground are in space, at their map's height. Names with
    ``@`` are left out: ``Fleet`` gives them to poses that share a place.
    """
    found: dict[str, tuple[float, ...]] = {}
    for obj in problem.all_objects:
        configuration = getattr(obj, "configuration", None)
        if configuration is not None and "@" not in obj.name:
            frame = tuple(obj.type.occupancy_map.reference_frame)
            height = float(frame[2]) if len(frame) == 7 else 0.0
            pose = tuple(float(v) for v in configuration)
            if height and len(pose) == 3:
                x, y, theta = pose
                pose = (x, y, height, 0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
            found[obj.name] = pose
    return found


def _spacing(movers: list[ObjectTrack], longest: float) -> float:
    """Return a distance between footprints at which they stay apart and do not clutter, m."""
    sizes = [np.ptp(np.asarray(t.footprint), axis=0).max() for t in movers if t.footprint]
    return float(max([longest / 30, *(2.0 * s for s in sizes)]))


def _draw_mover(ax: Axes, track: ObjectTrack, color: str, step: float) -> None:
    casing = [patheffects.Stroke(linewidth=3.4, foreground="white"), patheffects.Normal()]
    for leg in track.legs:
        ax.plot(
            leg.poses[:, 0], leg.poses[:, 1], color=color, lw=1.7, zorder=3, path_effects=casing,
            solid_capstyle="round",
        )  # fmt: skip
        for pose in _along(leg, step):
            _draw_body(ax, track, pose, fc=mixed(color, 0.7), ec=color, lw=0.6, zorder=2, alpha=0.7)
        _draw_direction(ax, leg, color)
    for leg in track.legs:
        for pose in map(flat, leg.poses[[0, -1]]):
            _draw_body(ax, track, pose, fc=mixed(color, 0.35), ec=color, lw=1.1, zorder=4)
    if track.initial is not None:
        _draw_body(ax, track, track.initial, fc=color, ec=INK, lw=1.2, zorder=5)


def _labels_of(rules: Sequence[Zone], still: Sequence[ObjectTrack]) -> list[PlacedLabel]:
    """Return what zones are called, and what they ask of robots."""
    named: dict[Corners, list[str]] = defaultdict(list)
    asked: dict[Corners, list[str]] = defaultdict(list)
    for track in still:
        if track.area and track.initial is not None and not _is_reach(track):
            named[corners_of(track.outline(track.initial))].append(track.name)
    for zone in rules:
        asked[corners_of(zone["polygon"])].append(told(zone))
    labels = []
    for corners in named | asked:
        parts = (", ".join(filter(None, some[corners])) for some in (named, asked))
        text = ": ".join(filter(None, parts))
        if text:
            labels.append(label_of(text, np.array(sorted(corners)), WRONG))
    return labels


def _is_reach(area: ObjectTrack) -> bool:
    """Return whether an area is what a door sweeps (``reach@DOOR``), as its name in words says."""
    return area.name.startswith(in_words("reach@_")[:-1])


def _draw_rides(ax: Axes, track: ObjectTrack, step: float) -> None:
    """Draw where a load is on its robot's way."""
    style = {"fc": mixed(FIXTURE, 0.6), "ec": FIXTURE, "lw": 0.6, "alpha": 0.5}
    for pose in chain.from_iterable(_along(leg, step) for leg in track.legs):
        ax.add_patch(Polygon(track.outline(pose), closed=True, zorder=1.9, **style))


def _draw_body(ax: Axes, track: ObjectTrack, pose: _Pose, **style: Any) -> None:
    """Draw a footprint with a stroke from its centre to its front."""
    outline = track.outline(pose)
    ax.add_patch(Polygon(outline, closed=True, **style))
    front = max((c[0] for c in track.footprint), default=0.2)
    tip = (pose[0] + front * np.cos(pose[2]), pose[1] + front * np.sin(pose[2]))
    ax.plot(
        [pose[0], tip[0]], [pose[1], tip[1]], color=style["ec"], lw=style["lw"],
        zorder=style["zorder"] + 0.1,
    )  # fmt: skip


def _after(leg: TrackPiece, shares: FloatArray) -> FloatArray:
    """Return the poses (k, 3) after some shares (k,) of the way of a leg."""
    gone = _gone(leg)
    return np.column_stack([np.interp(shares * gone[-1], gone, leg.poses[:, k]) for k in range(3)])


def _gone(leg: TrackPiece) -> FloatArray:
    """Return the distance driven (m) up to each sample."""
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(leg.poses[:, :2], axis=0).T)))


def _along(leg: TrackPiece, step: float) -> list[_Pose]:
    """Return poses about every ``step`` m along the leg, without its ends."""
    count = int(_gone(leg)[-1] / step)
    return [flat(pose) for pose in _after(leg, (np.arange(count) + 0.5) / max(count, 1))]


def _draw_direction(ax: Axes, leg: TrackPiece, color: str) -> None:
    """Draw an arrow head along the leg, off its middle: the way back often is the same."""
    length = _gone(leg)[-1]
    if length <= 0:
        return
    before, tip = _after(leg, np.array([max(0.0, 0.45 - 0.5 / length), 0.45]))[:, :2]
    ax.annotate(
        "", xy=tip, xytext=before, zorder=6,
        arrowprops={
            "arrowstyle": "-|>,head_length=0.5,head_width=0.28", "color": color, "lw": 0,
            "mutation_scale": 13, "shrinkA": 0, "shrinkB": 0,
        },
    )  # fmt: skip


def _draw_still(ax: Axes, track: ObjectTrack, initial: _Pose) -> list[PlacedLabel]:
    """Draw an object that nobody drives: solid where it starts, outlined where it is put."""
    here = track.outline(initial)
    if track.area:
        ax.add_patch(Polygon(here, **AREA_LOOK))
        return []
    ax.add_patch(Polygon(here, fc=FIXTURE, ec=INK, lw=0.8, zorder=2.6))
    labels = [label_of(track.name, here, FIXTURE, bold=True)]
    for t, pose in track.changes:
        there = track.outline(pose)
        ax.add_patch(Polygon(there, fc="none", ec=FIXTURE, lw=1.4, ls=(0, (3, 2)), zorder=2.6))
        labels.append(label_of(f"{track.name} from {t:g} s", there, FIXTURE))
    return labels


def _stops(ax: Axes, movers: list[ObjectTrack]) -> list[Bbox]:
    """Return what labels must not cover: the places where motions start and end, display units."""
    boxes = []
    for track in movers:
        for leg in track.legs:
            for pose in map(flat, leg.poses[[0, -1]]):
                corners = ax.transData.transform(track.outline(pose))
                boxes.append(Bbox([corners.min(axis=0), corners.max(axis=0)]))
    return boxes


def _legend(
    panels: Sequence[Axes],
    movers: list[ObjectTrack],
    still: list[ObjectTrack],
    rules: list[Zone],
) -> None:
    drives = [Line2D([], [], color=color_of(i), lw=2.4, label=t.name) for i, t in enumerate(movers)]
    names = dict.fromkeys("what a door sweeps" if _is_reach(t) else "zone" for t in still if t.area)
    areas = [Patch(fc=AREA_FILL, ec=WRONG, ls=":", label=name) for name in names]
    ruled = Patch(fc=AREA_FILL, label="rules of driving")
    lane = Patch(fc=LANE_FILL, label="preferred lane")
    door = Patch(fc=FIXTURE, ec=INK, label="door, or other object, at first")
    load = Patch(fc=mixed(FIXTURE, 0.6), ec=FIXTURE, label="load on its robot")
    changed = Patch(fc="none", ec=FIXTURE, ls="--", label="after a change")
    keys = [
        *((True, key) for key in drives),
        (True, Patch(fc=INK, ec=INK, label="robot at the start")),
        (True, Patch(fc=mixed(INK, 0.5), ec=INK, label="a motion's start or end")),
        *((True, key) for key in areas),
        ("zone" not in names and not all(map(is_lane, rules)), ruled),
        (any(map(is_lane, rules)), lane),
        (not all(t.area for t in still), door),
        (any(t.legs for t in still), load),
        (any(t.changes for t in still), changed),
    ]
    legend_below(panels, keys)
