"""Colours that people with colour vision deficiency can tell apart."""

from __future__ import annotations

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


def mixed(color: str, share: float, other: tuple[int, int, int] = FREE) -> str:
    """Return ``color`` with ``share`` (0..1) of it replaced by ``other``."""
    parts = (round(a + share * (b - a)) for a, b in zip(rgb(color), other, strict=True))
    return "#" + "".join(f"{p:02X}" for p in parts)


def ink_on(color: str) -> str:
    """Return black or white, whichever is easier to read on ``color`` (WCAG 2 contrast)."""
    linear = [
        c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4
        for c in (v / 255 for v in rgb(color))
    ]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    return "#FFFFFF" if 1.05 / (luminance + 0.05) >= (luminance + 0.05) / 0.05 else INK
