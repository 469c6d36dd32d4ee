"""A plan as an animated GIF."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

from up_samp.plotting.background import Background, ground_of
from up_samp.plotting.style import AREA_FILL, FIXTURE, INK, SIZES, color_of, mixed, with_short_names
from up_samp.plotting.tracks import ObjectTrack, horizon, tracks_of
from up_samp.system.files import whole


def write_gif(
    plan: dict[str, Any],
    path: str | os.PathLike[str],
    *,
    width: int = 720,
    seconds: float = 14.0,
    frames_per_second: int = 10,
) -> Path:
    """Write the plan as a GIF of about ``seconds`` s and at most ``width`` pixels, in a loop.

    The plan's time runs faster than life where it is longer than ``seconds``; the clock in the
    picture shows it.
    """
    laid = ground_of(with_short_names(plan))
    plan, ground = laid.plan, laid.background
    still = ground.image(width)
    end = horizon(plan)
    count = max(2, round(min(seconds, end) * frames_per_second))
    tracks = tracks_of(plan)
    _draw_paths(still, ground, tracks)
    frames = [_frame(still, ground, tracks, end * i / (count - 1), end) for i in range(count)]
    palette = frames[0].quantize(64)
    drawn = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    pause = round(1000 / frames_per_second)
    target = Path(path)
    with whole(target) as stream:
        drawn[0].save(
            stream,
            format="GIF",
            save_all=True,
            append_images=drawn[1:],
            duration=[pause] * (count - 1) + [1500],
            loop=0,
            optimize=False,
        )
    return target


def _pixel(ground: Background, picture: Image.Image, x: float, y: float) -> tuple[float, float]:
    left, right, bottom, top = ground.extent
    return (
        (x - left) / (right - left) * picture.width,
        (top - y) / (top - bottom) * picture.height,
    )


def _draw_paths(still: Image.Image, ground: Background, tracks: list[ObjectTrack]) -> None:
    pen = ImageDraw.Draw(still)
    for i, track in enumerate(t for t in tracks if t.moves):
        for leg in track.legs:
            points = [_pixel(ground, still, float(p[0]), float(p[1])) for p in leg.poses]
            pen.line(points, fill=mixed(color_of(i), 0.65), width=1)


def _frame(
    still: Image.Image, ground: Background, tracks: list[ObjectTrack], t: float, end: float
) -> Image.Image:
    frame = Image.new("RGB", (still.width, still.height + SIZES.strip), "white")
    frame.paste(still, (0, 0))
    pen = ImageDraw.Draw(frame)
    movers = [track for track in tracks if track.moves]
    for track in [track for track in tracks if not track.moves] + movers:
        pose = track.at(t)
        if pose is None:
            continue
        color = (
            color_of(movers.index(track)) if track.moves else AREA_FILL if track.area else FIXTURE
        )
        corners = [_pixel(ground, still, float(x), float(y)) for x, y in track.outline(pose)]
        pen.polygon(corners, fill=color, outline=INK)
        if track.moves:
            _write_name(pen, still, track.name, corners, color)
    _write_clock(pen, still, t, end)
    return frame


def _write_name(
    pen: ImageDraw.ImageDraw,
    still: Image.Image,
    name: str,
    corners: list[tuple[float, float]],
    color: str,
) -> None:
    font = ImageFont.load_default(11)
    x = sum(c[0] for c in corners) / len(corners)
    x = min(max(x, 12.0), still.width - 12.0)
    y = min(c[1] for c in corners) - 8
    if y < 8:
        y = max(c[1] for c in corners) + 8
    pen.text((x, y), name, fill=color, font=font, anchor="mm", stroke_width=2, stroke_fill="white")


def _write_clock(pen: ImageDraw.ImageDraw, still: Image.Image, t: float, end: float) -> None:
    top = still.height + 9
    span = still.width - 110
    pen.rectangle([10, top, 10 + span, top + 7], fill="#E4E7EB")
    pen.rectangle([10, top, 10 + span * t / end, top + 7], fill=INK)
    text = f"{t:.1f} s"
    font = ImageFont.load_default(13)
    pen.text((still.width - 12, top + 3.5), text, fill=INK, font=font, anchor="rm")
