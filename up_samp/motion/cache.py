"""A memory of planned legs, across calls and restarts, optionally on disk."""

from __future__ import annotations

import ast
import hashlib
import io
import logging
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from up_samp.geometry.memory import Memory
from up_samp.model import Body, Configuration, Placed, ProblemError, Trajectory
from up_samp.motion.protocol import Leg
from up_samp.system.files import whole

log = logging.getLogger(__name__)

FORMAT = 5
"""Part of every key: files of other versions are never read."""

SUFFIX = ".legs"
LARGEST = 64 * 2**20
"""Files larger than this (bytes) are not ours."""

ObstacleKey = frozenset[tuple[object, ...]]
PairKey = tuple[object, ...]


def body_key(body: Body) -> tuple[object, ...]:
    """Return what motions depend on of a body, its control law (or None) last.

    A mesh counts by what its file holds. A control law counts as the function that it is: the key
    holds it, so that no other function can take its place.
    """
    kin = body.kinematics
    limits = (kin.turning_radius, kin.v_max, kin.a_max, kin.omega_max, kin.reverse)
    law = None if kin.control is None else (kin.control.function, kin.control.bounds)
    return (*shape_key(body), kin.model.name, *map(float, limits), law)


def obstacle_key(obstacles: Sequence[Placed]) -> ObstacleKey:
    """Return what motions depend on of resting objects: shapes and poses, not names."""
    return frozenset((*shape_key(p.body), tuple(map(float, p.pose))) for p in obstacles)


def shape_key(body: Body) -> tuple[object, ...]:
    """Return what a body is to others, in values that can be written and read again."""
    height = float(body.height) if math.isfinite(body.height) else None
    return (body.footprint, mesh_key(body.mesh), height)


def mesh_key(path: str | None) -> str | None:
    """Return a digest of what a mesh file holds."""
    if path is None:
        return None
    try:
        status = os.stat(path)
        return _digest(path, status.st_mtime_ns, status.st_size)
    except OSError as error:
        raise ProblemError(f"the geometric model '{path}' cannot be read: {error}") from error


@lru_cache(maxsize=256)
def _digest(path: str, _modified: int, _size: int) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


@dataclass(frozen=True)
class CachedLeg:
    """A ``leg`` that was planned among the ``among`` obstacles (and keeps clear of them).

    Where it is not complete, its planner had ``limit`` seconds. ``checked`` says whether this
    process has planned it or found it to be sound: what comes from a file may be anything.
    """

    among: ObstacleKey
    leg: Leg
    limit: float = 0.0
    checked: bool = True

    @property
    def trajectory(self) -> Trajectory:
        """The motion (there always is one)."""
        assert self.leg.trajectory is not None
        return self.leg.trajectory

    @property
    def rank(self) -> tuple[bool, float]:
        """Less is better: what a planner finished goes before what it did not."""
        return not self.leg.complete, self.trajectory.duration


class MotionCache:
    """Legs by (map, planner, margin, body, start, goal), each with the obstacles it was planned
    among.

    A leg and its reverse share an entry (for reversible planners). With a ``folder``, entries are
    kept there, too, one small file each, whole or not at all. Nothing that is wrong with the
    folder or a file in it is fatal: damaged files are ignored, and where it cannot be written to,
    the log says so once. Least recently used pairs are forgotten beyond ``size``.
    """

    def __init__(self, folder: str | Path | None = None, size: int = 20_000) -> None:
        self.folder = None if folder is None else Path(folder)
        self._entries: Memory[list[CachedLeg]] = Memory(size)
        self._writes = True
        self.hits = 0

    def __len__(self) -> int:
        return sum(map(len, self._entries.values()))

    @staticmethod
    def key(
        scope: tuple[object, ...],
        body: Body,
        start: Configuration,
        goal: Configuration,
        reversible: bool,
    ) -> tuple[PairKey, bool]:
        """Return the key of a leg, and whether it is stored the other way round."""
        a, b = tuple(map(float, start)), tuple(map(float, goal))
        swap = reversible and b < a
        return (FORMAT, *scope, body_key(body), *((b, a) if swap else (a, b))), swap

    def get(self, key: PairKey) -> list[CachedLeg]:
        """Return all entries of a pair, those with fewest obstacles first."""
        known = self._entries.get(key)
        if known is None and self.folder is not None and _stable(key):
            known = self._entries.put(key, _read(self._path(key)))
        return known or []

    def put(self, key: PairKey, entry: CachedLeg) -> None:
        """Remember an entry (the better one if there are two for the same obstacles)."""
        known = self.get(key)
        same = [e for e in known if e.among == entry.among]
        best = min([entry, *same], key=lambda e: e.rank)
        self._set(key, [*(e for e in known if e.among != entry.among), best])

    def accept(self, key: PairKey, entry: CachedLeg) -> CachedLeg:
        """Take an entry from a file for sound from now on."""
        sound = replace(entry, checked=True)
        self._entries.put(key, [sound if e is entry else e for e in self.get(key)])
        return sound

    def drop(self, key: PairKey, entry: CachedLeg) -> None:
        """Forget an entry that turned out to be wrong, on disk, too."""
        self._set(key, [e for e in self.get(key) if e is not entry])

    def _set(self, key: PairKey, entries: list[CachedLeg]) -> None:
        entries = sorted(entries, key=lambda e: (len(e.among), e.rank))
        self._entries.put(key, entries)
        if self.folder is None or not self._writes or not _stable(key):
            return
        try:
            _write(self._path(key), entries)
        except OSError as error:
            self._writes = False
            log.warning("motions are not kept in '%s' any more: %s", self.folder, error)

    def _path(self, key: PairKey) -> Path:
        assert self.folder is not None
        return self.folder / f"{hashlib.sha256(repr(key).encode()).hexdigest()[:40]}{SUFFIX}"


def _stable(key: PairKey) -> bool:
    """Return whether a key means the same in another process (a control law's does not)."""
    body = key[-3]
    return isinstance(body, tuple) and body[-1] is None


def _read(path: Path) -> list[CachedLeg]:
    """Return the entries of a file; none if it is missing, damaged, or holds no motions."""
    try:
        if not path.is_file() or path.stat().st_size > LARGEST:
            return []
        stated, _, data = path.read_bytes().partition(b"\n")
        if hashlib.sha256(data).hexdigest().encode() != stated:
            log.warning("the motion cache's file '%s' is damaged and not used", path)
            return []
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return [_entry(arrays, i) for i in range(int(arrays["count"]))]
    except Exception as error:  # a file may hold anything: nothing in it may end a solve
        log.warning("the motion cache's file '%s' cannot be used: %s", path, error)
        return []


def _entry(arrays: np.lib.npyio.NpzFile, i: int) -> CachedLeg:
    rows = np.asarray(arrays[f"samples{i}"], dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] not in (4, 8) or not np.isfinite(rows).all():
        raise ValueError(f"motion {i} has no samples of a pose")
    corners = np.asarray(arrays[f"corners{i}"], dtype=np.float64).reshape(-1, 3)
    complete, limit = (float(x) for x in arrays[f"search{i}"])
    motion = Trajectory(rows[:, 0].copy(), rows[:, 1:].copy())
    leg = Leg(motion, complete=complete == 1.0, corners=corners if len(corners) else None)
    among = frozenset(ast.literal_eval(str(arrays[f"among{i}"])))
    return CachedLeg(among, leg, limit, checked=False)


def _write(path: Path, entries: list[CachedLeg]) -> None:
    arrays: dict[str, object] = {"count": len(entries)}
    for i, entry in enumerate(entries):
        arrays[f"samples{i}"] = np.column_stack([entry.trajectory.times, entry.trajectory.poses])
        arrays[f"among{i}"] = repr(sorted(entry.among, key=repr))
        arrays[f"search{i}"] = np.array([float(entry.leg.complete), entry.limit])
        corners = entry.leg.corners
        arrays[f"corners{i}"] = np.zeros((0, 3)) if corners is None else corners
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    data = buffer.getvalue()
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path, 0o600) as file:  # parallel readers never see half of it
        file.write(hashlib.sha256(data).hexdigest().encode() + b"\n" + data)
