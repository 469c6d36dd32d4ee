"""How pictures look: colours that people with colour vision deficiency can tell apart, short
names, and labels that cover neither each other nor what they are put beside.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

from up_samp.model.errors import in_words
from up_samp.system.files import whole

# ------------------ Colours that people with colour vision deficiency can tell apart


PALETTE = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#332288",
    "#882255",
    "#999933",
    "#44AA99",
)
"""Okabe & Ito (2008), *Color Universal Design*, without yellow (unreadable on white) and black;
then four of Paul Tol's *muted* scheme for fleets of more than six."""

FIXTURE = "#8C6D31"
WRONG = "#C1121F"
"""What is wrong, and the edge of a zone."""
AREA_FILL = "#F3D0D2"
"""What a zone is filled with."""
OTHER = "#6B7280"
INK = "#1F2933"
FREE = (255, 255, 255)
OCCUPIED = (55, 65, 81)
UNKNOWN = (209, 213, 219)


def color_of(index: int) -> str:
    """Return the colour of the ``index``-th moving object (they repeat after the palette)."""
    return PALETTE[index % len(PALETTE)]


def rgb(color: str) -> tuple[int, int, int]:
    """Return ``#rrggbb`` as three numbers in 0..255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def mixed(color: str, share: float) -> str:
    """Return ``color`` with ``share`` (0..1) of it replaced by white."""
    parts = (round(v + share * (255 - v)) for v in rgb(color))
    return "#" + "".join(f"{p:02X}" for p in parts)


def ink_on(color: str) -> str:
    """Return black or white, whichever is easier to read on ``color`` (WCAG 2 contrast)."""
    linear = [
        c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4
        for c in (v / 255 for v in rgb(color))
    ]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    return "#FFFFFF" if 1.05 / (luminance + 0.05) >= (luminance + 0.05) / 0.05 else INK


# ------------------ Figures of their own, and files of them


def figure_axes(width: float, height: float) -> Axes:
    """Return the axes of a new figure of that size (inches)."""
    return Figure(figsize=(width, height), layout="constrained", dpi=130).add_subplot()


def save_figure(ax: Axes, path: Path) -> Path:
    """Write the figure of some axes to a file, by its ending (PNG without one); return the file."""
    path = path if path.suffix else path.with_suffix(".png")
    figure = ax.get_figure(root=True)
    assert figure is not None
    with whole(path) as stream:
        figure.savefig(stream, format=path.suffix[1:])
    return path


# ------------------ Names short enough to be drawn


def with_short_names(plan: dict[str, Any], most: int = 60) -> dict[str, Any]:
    """Return a plan dictionary whose names can be drawn: in words, and those of more than ``most``
    characters cut, so that they stay different.
    """
    named = [*plan["objects"], *plan["activities"]]
    texts = [plan["problem"], plan["engine"], plan["status"]]
    texts += [entry["name"] for entry in named] + [o["type"] for o in plan["objects"]]
    short = {t: in_words(t) for t in texts if in_words(t) != t and in_words(t) not in texts}
    longer = {t for t in texts if len(short.get(t, t)) > most}
    for i, text in enumerate(sorted(longer), 1):
        short[text] = f"{short.get(text, text)[: most - 6]}...{i}"
    keys = ("name", "type", "object", "activity", "carrier", "for")
    return {
        **plan,
        **{k: short.get(plan[k], plan[k]) for k in ("problem", "engine", "status")},
        **{
            part: [
                {k: short.get(v, v) if k in keys else v for k, v in entry.items()}
                for entry in plan[part]
            ]
            for part in ("objects", "activities", "motions", "changes", "rides", "waits")
            if part in plan
        },
    }


# ------------------ Put labels next to points so that they cover neither each other nor what must


@dataclass(frozen=True)
class PlacedLabel:
    """``text`` for what is at (x, y) and reaches ``half`` to each side (data coordinates); ``bold``
    ones are placed first.
    """

    text: str
    x: float
    y: float
    color: str
    bold: bool = False
    half: tuple[float, float] = (0.0, 0.0)


_PLACES: Sequence[tuple[int, int, str, str]] = (
    (0, 1, "center", "bottom"),
    (0, -1, "center", "top"),
    (1, 1, "left", "bottom"),
    (-1, 1, "right", "bottom"),
    (1, -1, "left", "top"),
    (-1, -1, "right", "top"),
    (1, 0, "left", "center"),
    (-1, 0, "right", "center"),
)


def place_labels(
    ax: Axes, labels: Iterable[PlacedLabel], *, avoid: Sequence[Bbox] = ()
) -> list[Annotation]:
    """Write each label at the first free place around its point, trying ever larger distances.

    ``avoid`` are boxes in display coordinates. A label that fits nowhere is left out: a picture
    with one name less is better than one that cannot be read. Limits of ``ax`` must be final.
    """
    drawn(ax)
    taken = list(avoid)
    frame = ax.get_window_extent()
    placed = []
    for label in sorted(labels, key=lambda item: not item.bold):
        if not ax.viewLim.contains(label.x, label.y):
            continue  # it is on another floor
        note = _place(ax, label, taken, frame)
        if note is not None:
            taken.append(_box(note))
            placed.append(note)
    return placed


def drawn(ax: Axes) -> None:
    """Lay the figure out, so that texts and data have their final places on it."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    if figure.canvas.manager is None and not hasattr(figure.canvas, "get_renderer"):
        # else each look at a text's size makes a whole picture: gigabytes for 200 names
        FigureCanvasAgg(figure)
    images = [image for axes in figure.axes for image in axes.get_images() if image.get_visible()]
    for image in images:  # they move nothing, and take most of the time
        image.set_visible(False)
    figure.draw_without_rendering()
    for image in images:
        image.set_visible(True)


def _place(ax: Axes, label: PlacedLabel, taken: Sequence[Bbox], frame: Bbox) -> Annotation | None:
    for distance, (right, up, across, along) in product((3, 8, 14, 22, 32, 44), _PLACES):
        note = ax.annotate(
            label.text,
            (label.x + right * label.half[0], label.y + up * label.half[1]),
            xytext=(right * distance, up * distance),
            textcoords="offset points",
            ha=across,
            va=along,
            fontsize=8.0,
            fontweight="bold" if label.bold else "normal",
            color=label.color,
            zorder=9,
            bbox={"boxstyle": "round,pad=0.15", "fc": "#FFFFFFD0", "ec": "none"},
            arrowprops={"arrowstyle": "-", "color": label.color, "lw": 0.6}
            if distance > 14
            else None,
        )
        note.set_annotation_clip(False)
        box = _box(note)
        inside = frame.x0 <= box.x0 and box.x1 <= frame.x1
        inside = inside and frame.y0 <= box.y0 and box.y1 <= frame.y1
        if inside and not any(box.overlaps(other) for other in taken):
            return note
        note.remove()
    return None


def _box(note: Annotation) -> Bbox:
    """Return what the words cover, without the line to their point, display units."""
    note.get_window_extent()  # moves the words to where they will be drawn
    return Text.get_window_extent(note).padded(2.0)
