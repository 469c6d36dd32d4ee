"""A memory of planned legs, across calls and restarts, optionally on disk."""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from up_samp.model import Body, Configuration, Placed, Trajectory

FORMAT = 1
"""Part of every key: files of other versions are never read."""

ObstacleKey = frozenset[tuple[object, ...]]
PairKey = tuple[object, ...]


def body_key(body: Body) -> tuple[object, ...]:
    """Return what motions depend on of a body (its control law by identity)."""
    kin = body.kinematics
    limits = (kin.turning_radius, kin.v_max, kin.a_max, kin.omega_max)
    law = None if kin.control is None else (id(kin.control.function), kin.control.bounds)
    return (body.footprint, kin.model.name, *map(float, limits), law, body.mesh)


def obstacle_key(obstacles: Sequence[Placed]) -> ObstacleKey:
    """Return what motions depend on of resting objects: shapes and poses, not names."""
    return frozenset((p.body.footprint, p.body.mesh, tuple(map(float, p.pose))) for p in obstacles)


@dataclass(frozen=True)
class Entry:
    """A leg that was planned among the ``among`` obstacles (and keeps clear of them)."""

    among: ObstacleKey
    trajectory: Trajectory
    planner: str


class MotionCache:
    """Legs by (map, planner, margin, body, start, goal), each with the obstacles it was planned
    among.

    A leg and its reverse share an entry (for reversible planners). With a ``folder``, entries are
    kept there, too, one small file each; unreadable files are ignored. Least recently used pairs
    are forgotten beyond ``size``.
    """

    def __init__(self, folder: str | Path | None = None, size: int = 20_000) -> None:
        self.folder = None if folder is None else Path(folder)
        self._size = size
        self._entries: OrderedDict[PairKey, list[Entry]] = OrderedDict()
        self.hits = 0
        self.misses = 0

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

    def get(self, key: PairKey) -> list[Entry]:
        """Return all entries of a pair, those with fewest obstacles first."""
        if key not in self._entries and self.folder is not None and _stable(key):
            self._entries[key] = _read(self._path(key))
        if key in self._entries:
            self._entries.move_to_end(key)
        return self._entries.get(key, [])

    def put(self, key: PairKey, entry: Entry) -> None:
        """Remember an entry (the faster one if there are two for the same obstacles)."""
        entries = [e for e in self.get(key) if e.among != entry.among]
        same = [e for e in self.get(key) if e.among == entry.among]
        entries.append(min([entry, *same], key=lambda e: e.trajectory.duration))
        entries.sort(key=lambda e: (len(e.among), e.trajectory.duration))
        self._entries[key] = entries
        while len(self._entries) > self._size:
            self._entries.popitem(last=False)
        if self.folder is not None and _stable(key):
            _write(self._path(key), entries)

    def _path(self, key: PairKey) -> Path:
        assert self.folder is not None
        return self.folder / f"{hashlib.sha256(repr(key).encode()).hexdigest()[:40]}.npz"


def _stable(key: PairKey) -> bool:
    """Return whether a key means the same in another process (a control law's does not)."""
    body = key[-3]
    return isinstance(body, tuple) and body[-2] is None


def _read(path: Path) -> list[Entry]:
    if not path.is_file():
        return []
    entries = []
    try:
        with np.load(path, allow_pickle=False) as data:
            for i in range(int(data["count"])):
                rows = data[f"samples{i}"]
                among = _parse(str(data[f"among{i}"]))
                trajectory = Trajectory(rows[:, 0].copy(), rows[:, 1:].copy())
                entries.append(Entry(among, trajectory, str(data[f"planner{i}"])))
    except (OSError, ValueError, KeyError, SyntaxError, zipfile.BadZipFile):
        return []
    return entries


def _parse(text: str) -> ObstacleKey:
    import ast

    return frozenset(ast.literal_eval(text))


def _write(path: Path, entries: list[Entry]) -> None:
    arrays: dict[str, object] = {"count": len(entries)}
    for i, entry in enumerate(entries):
        arrays[f"samples{i}"] = np.column_stack([entry.trajectory.times, entry.trajectory.poses])
        arrays[f"among{i}"] = repr(sorted(entry.among, key=repr))
        arrays[f"planner{i}"] = entry.planner
    path.parent.mkdir(parents=True, exist_ok=True)
    # written aside and renamed, so that parallel readers never see half a file
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=".npz")
    os.close(handle)
    np.savez_compressed(name, **arrays)  # type: ignore[arg-type]
    os.replace(name, path)
