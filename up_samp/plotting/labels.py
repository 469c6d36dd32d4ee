"""Put labels next to points so that they cover neither each other nor what must stay visible."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox


@dataclass(frozen=True)
class Label:
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
    ax: Axes, labels: Iterable[Label], *, avoid: Sequence[Bbox] = (), size: float = 8.0
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
        note = _place(ax, label, taken, frame, size)
        if note is not None:
            taken.append(_box(note))
            placed.append(note)
    return placed


def drawn(ax: Axes) -> None:
    """Lay the figure out, so that texts and data have their final places on it."""
    figure = ax.get_figure(root=True)
    if figure is not None:
        if figure.canvas.manager is None and not hasattr(figure.canvas, "get_renderer"):
            # else each look at a text's size makes a whole picture: gigabytes for 200 names
            FigureCanvasAgg(figure)
        figure.draw_without_rendering()


def _place(
    ax: Axes, label: Label, taken: Sequence[Bbox], frame: Bbox, size: float
) -> Annotation | None:
    for distance in (3, 8, 14, 22, 32, 44):
        for right, up, across, along in _PLACES:
            note = ax.annotate(
                label.text,
                (label.x + right * label.half[0], label.y + up * label.half[1]),
                xytext=(right * distance, up * distance),
                textcoords="offset points",
                ha=across,
                va=along,
                fontsize=size,
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
