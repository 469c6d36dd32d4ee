"""Occupancy grids and the ROS ``map_server`` files that they come from.

Unknown cells, and everything outside the map, are *not drivable*: a robot may not stand on or drive
over them. They are kept apart from occupied cells only for messages and pictures.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml
from PIL import Image

from up_samp.model import ProblemError, SampError, check_time
from up_samp.model.arrays import BoolArray, FloatArray, IntArray
from up_samp.model.errors import short
from up_samp.model.frames import Frame
from up_samp.system.files import whole, write_whole

Judge = Callable[[FloatArray, BoolArray], tuple[BoolArray, BoolArray]]

FORMATS = ("PNG", "PPM")
"""What Pillow may take an image for, whatever its name (PGM is a kind of PPM)."""


MOST_PIXELS = 100_000_000
"""Of a map."""
MOST_YAML = 1_000_000
"""Bytes of its YAML file."""
MOST_NUMBER = 1e9
"""Any number in it."""
BAND = 1_000_000
"""Pixels that are turned into numbers at a time."""

MODES = ("trinary", "scale", "raw")
KEYS = {"image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode"}


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A map of square cells.

    ``occupied`` and ``unknown`` are bool arrays of shape (rows, cols); row 0 has the lowest y.
    ``resolution`` is the edge of a cell in m. ``origin`` is the pose (x, y, yaw) of the map's
    lower-left corner in the world frame. ``path`` is the YAML file it was read from, if any.
    """

    occupied: BoolArray
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    path: str | None = None
    unknown: BoolArray = field(default=None)  # type: ignore[arg-type]

    def __post_init__(self) -> None:
        occupied = np.ascontiguousarray(self.occupied, dtype=np.bool_)
        blank = np.zeros_like(occupied) if self.unknown is None else self.unknown
        unknown = np.ascontiguousarray(blank, dtype=np.bool_)
        shape = occupied.shape
        for holds, told in (
            (
                len(shape) == 2 and min(shape) > 0,
                f"a map needs a two-dimensional array of cells, not one of shape {shape}",
            ),
            (unknown.shape == shape, "'unknown' and 'occupied' differ in shape"),
            (0 < self.resolution < math.inf, "the resolution must be > 0 m per cell"),
            (
                np.shape(self.origin) == (3,) and np.isfinite(self.origin).all(),
                "the origin must be three finite numbers",
            ),
        ):
            if not holds:
                raise ProblemError(f"{self._label()}: {told}")
        for name, value, given in (
            ("occupied", occupied, self.occupied),
            ("unknown", unknown, self.unknown),
        ):
            if value.flags.writeable and given is not None and np.may_share_memory(value, given):
                value = value.copy()
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def _label(self) -> str:
        return f"map '{self.path}'" if self.path else "map"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        rows, cols = self.occupied.shape
        return rows, cols

    @property
    def size(self) -> tuple[float, float]:
        """Width (along the map's x) and height (along its y) in m."""
        rows, cols = self.shape
        return cols * self.resolution, rows * self.resolution

    @cached_property
    def blocked(self) -> BoolArray:
        """Cells that are not drivable: occupied or unknown."""
        return np.ascontiguousarray(self.occupied | self.unknown)

    @cached_property
    def digest(self) -> str:
        """A hash of everything that motions depend on (cells, resolution, origin)."""
        h = hashlib.sha256()
        h.update(
            repr((self.shape, float(self.resolution), tuple(map(float, self.origin)))).encode()
        )
        h.update(np.packbits(self.occupied).tobytes())
        h.update(np.packbits(self.unknown).tobytes())
        return h.hexdigest()[:32]

    @cached_property
    def corners(self) -> FloatArray:
        """The corners (4, 2) of the map in the world frame (m), counter-clockwise."""
        wide, tall = self.size
        return Frame(*self.origin).points([(0, 0), (wide, 0), (wide, tall), (0, tall)])

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """The least and the largest x and y (m) of the map in the world frame, (2,) each."""
        return self.corners.min(axis=0), self.corners.max(axis=0)

    def cells_of(self, points: npt.ArrayLike) -> IntArray:
        """Return the (row, col) of world ``points`` of shape (n, 2); may lie outside the map."""
        p = np.asarray(points, dtype=np.float64).reshape(-1, 2) - np.array(self.origin[:2])
        c, s = math.cos(self.origin[2]), math.sin(self.origin[2])
        gx = (c * p[:, 0] + s * p[:, 1]) / self.resolution
        gy = (-s * p[:, 0] + c * p[:, 1]) / self.resolution
        return np.stack([np.floor(gy), np.floor(gx)], axis=1).astype(np.int64)

    def point_of(self, row: float, col: float) -> tuple[float, float]:
        """Return the world point of a cell's centre."""
        gx, gy = (col + 0.5) * self.resolution, (row + 0.5) * self.resolution
        c, s = math.cos(self.origin[2]), math.sin(self.origin[2])
        return self.origin[0] + c * gx - s * gy, self.origin[1] + s * gx + c * gy


def load_map(yaml_path: str | Path) -> OccupancyGrid:
    """Read a ROS ``map_server`` map (YAML beside a PNG or PGM image).

    ``image`` is relative to the YAML's folder; ``origin`` is ``[x, y]`` or ``[x, y, yaw]``. With
    ``negate: 0`` dark pixels are occupied: with p = (255 - value) / 255 a cell is occupied if
    p > ``occupied_thresh``, free if p < ``free_thresh`` and unknown between (modes ``trinary`` and
    ``scale``). In mode ``raw`` a pixel value of 0..100 is the occupancy in per cent, larger ones
    are unknown. Transparent pixels are unknown. Raises ``ProblemError`` naming the file.
    """
    path = Path(yaml_path)
    data = _read_yaml(path)
    unknown_keys = sorted({short(key, 30) for key in data} - KEYS)[:5]
    if unknown_keys:
        raise ProblemError(
            f"map '{path}': unknown keys {unknown_keys}; known are {', '.join(sorted(KEYS))}"
        )
    resolution = _number(path, data, "resolution")
    if resolution <= 0:
        raise ProblemError(f"map '{path}': 'resolution' must be > 0 m per pixel, not {resolution}")
    occupied_thresh = _number(path, data, "occupied_thresh", 0.65)
    free_thresh = _number(path, data, "free_thresh", 0.196)
    if not 0 <= free_thresh <= occupied_thresh <= 1:
        raise ProblemError(
            f"map '{path}': needs 0 <= free_thresh <= occupied_thresh <= 1, not "
            f"{free_thresh} and {occupied_thresh}"
        )
    mode = data.get("mode", "trinary")
    if mode not in MODES:
        raise ProblemError(
            f"map '{path}': mode must be one of {', '.join(MODES)}, not {short(mode)}"
        )
    negate = _negate(path, data)

    def judged(value: FloatArray, transparent: BoolArray) -> tuple[BoolArray, BoolArray]:
        """Return which pixels are occupied and which unknown."""
        share = _occupancy(value, mode, negate)
        occupied = (share > occupied_thresh) & ~transparent
        return occupied, ~occupied & (~(share < free_thresh) | transparent)

    occupied, unknown = _read_image(path, data, judged)
    # image rows run downwards, ours run upwards
    return OccupancyGrid(
        occupied[::-1], resolution, _origin(path, data), str(path), unknown=unknown[::-1]
    )


def _read_yaml(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        raise ProblemError(f"map '{path}' does not exist; give the path of a map_server YAML file")
    try:
        if path.stat().st_size > MOST_YAML:
            raise ProblemError(f"map '{path}' is larger than {MOST_YAML} bytes: no map file is")
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        if isinstance(error, ProblemError):
            raise
        said = short(" ".join(str(error).split()), 200)
        raise ProblemError(f"map '{path}' is not readable YAML: {said}") from error
    if not isinstance(data, dict):
        raise ProblemError(f"map '{path}' must hold keys such as image, resolution and origin")
    return data


def _number(path: Path, data: Mapping[str, Any], key: str, default: float | None = None) -> float:
    value = data.get(key, default)
    if value is None:
        raise ProblemError(f"map '{path}': the key '{key}' is missing")
    # compared, not converted: a whole number in YAML may be too long for a float
    if isinstance(value, bool) or not (
        isinstance(value, int | float) and abs(value) <= MOST_NUMBER
    ):
        raise ProblemError(f"map '{path}': '{key}' must be a finite number, not {short(value)}")
    return float(value)


def _negate(path: Path, data: Mapping[str, Any]) -> bool:
    value = data.get("negate", 0)
    if value not in (0, 1):
        raise ProblemError(f"map '{path}': 'negate' must be 0 or 1, not {short(value)}")
    return bool(value)


def _origin(path: Path, data: Mapping[str, Any]) -> tuple[float, float, float]:
    value = data.get("origin", [0.0, 0.0, 0.0])
    if not isinstance(value, (list, tuple)) or len(value) not in (2, 3):
        raise ProblemError(f"map '{path}': 'origin' must be [x, y, yaw], not {short(value)}")
    named = dict(zip(("origin x", "origin y", "origin yaw"), value, strict=False))
    numbers = [_number(path, named, key) for key in named]
    return numbers[0], numbers[1], numbers[2] if len(numbers) == 3 else 0.0


def _read_image(path: Path, data: Mapping[str, Any], judged: Judge) -> tuple[BoolArray, BoolArray]:
    """Return what ``judged`` says of an image's grey values in 0..255 (mean of the colours) and of
    where it is transparent.
    """
    name = data.get("image")
    if not isinstance(name, str) or not name:
        raise ProblemError(f"map '{path}': the key 'image' must name a PNG or PGM file")
    image_path = path.parent / name
    if not image_path.is_file():
        raise ProblemError(
            f"map '{path}': its image '{image_path}' does not exist "
            "('image' is relative to the YAML)"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # judged here
            opened = Image.open(image_path, formats=FORMATS)
        with opened as image:
            width, height = image.size
            if width * height > MOST_PIXELS:
                raise ProblemError(
                    f"map '{path}': its image '{image_path}' has {width} x {height} pixels; "
                    f"{MOST_PIXELS} are the most"
                )
            check_time()
            image.load()
            return _judge_pixels(image, judged)
    except SampError:
        raise
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        said = short(str(error), 200)
        raise ProblemError(
            f"map '{path}': its image '{image_path}' cannot be read as PNG or PGM: {said}"
        ) from error


def _judge_pixels(image: Image.Image, judged: Judge) -> tuple[BoolArray, BoolArray]:
    """Judge an image's pixels, a band of rows at a time: large ones are larger still as numbers."""
    if image.mode in ("I", "I;16", "I;16B", "I;16L"):
        grey = np.asarray(image, dtype=np.float64)
        full = 65535.0 if grey.max(initial=0.0) > 255 or image.mode != "I" else 255.0
        return judged(grey * (255.0 / full), np.zeros(grey.shape, dtype=np.bool_))
    if image.mode in ("1", "L") and "transparency" not in image.info:
        levels = judged(np.arange(256, dtype=np.float64), np.zeros(256, dtype=np.bool_))
        return _by_bands(image, "L", lambda grey: (levels[0][grey], levels[1][grey]))

    def judged_colours(colours: npt.NDArray[np.uint8]) -> tuple[BoolArray, BoolArray]:
        values = colours.astype(np.float64)
        return judged(values[:, :, :3].mean(axis=2), values[:, :, 3] < 255)

    return _by_bands(image, "RGBA", judged_colours)


def _by_bands(
    image: Image.Image,
    mode: str,
    judged: Callable[[npt.NDArray[np.uint8]], tuple[BoolArray, BoolArray]],
) -> tuple[BoolArray, BoolArray]:
    width, height = image.size
    occupied, unknown = (np.empty((height, width), dtype=np.bool_) for _ in range(2))
    step = max(1, BAND // max(1, width))
    for first in range(0, height, step):
        check_time()
        rows = slice(first, min(height, first + step))
        part = image.crop((0, rows.start, width, rows.stop)).convert(mode)
        occupied[rows], unknown[rows] = judged(np.asarray(part))
    return occupied, unknown


def _occupancy(value: FloatArray, mode: str, negate: bool) -> FloatArray:
    """Return the occupancy (0 free .. 1 occupied, NaN unknown) of grey values 0..255."""
    if mode == "raw":
        return np.where(value <= 100, value / 100.0, np.nan)
    return value / 255.0 if negate else (255.0 - value) / 255.0


def write_map(
    folder: str | Path,
    name: str,
    occupied: npt.ArrayLike,
    resolution: float,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    unknown: npt.ArrayLike | None = None,
) -> Path:
    """Write ``name.yaml`` and ``name.png`` into ``folder`` and return the YAML's path.

    ``occupied`` (and ``unknown``) are bool arrays of shape (rows, cols), row 0 lowest y. Black is
    occupied, white free, grey unknown; reading it back gives the same grid. Who reads the files
    meanwhile never sees half of one.
    """
    cells = np.asarray(occupied, dtype=np.bool_)
    grid = OccupancyGrid(
        cells,
        resolution,
        origin,
        unknown=np.zeros_like(cells) if unknown is None else np.asarray(unknown, dtype=np.bool_),
    )
    pixels = np.where(grid.occupied, 0, np.where(grid.unknown, 205, 255)).astype(np.uint8)
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    with whole(target / f"{name}.png") as stream:
        Image.fromarray(pixels[::-1].copy()).save(stream, format="PNG", optimize=True)
    return write_whole(
        target / f"{name}.yaml",
        f"image: {name}.png\n"
        f"resolution: {resolution!r}\n"
        f"origin: [{', '.join(repr(float(v)) for v in origin)}]\n"
        "negate: 0\noccupied_thresh: 0.3\nfree_thresh: 0.1\n",
    )
