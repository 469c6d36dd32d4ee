"""The day's store: every order, report, decision and plan is in it before anything comes of it.

SQLite, write-ahead, one writer: whoever opens it for writing holds a lock on a file beside it, and
a second one is refused. What is written in one ``with store:`` is there as a whole or not at all,
however the process ends. Readers (``up-samp why``, the page) need no lock.
"""

from __future__ import annotations

import json
import os
import sqlite3
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from up_samp.execution.reports import Report
from up_samp.model import SampError
from up_samp.operate.records import DayOrder, OrderState, job_data, job_record

MIGRATIONS = (
    """
    CREATE TABLE day (key TEXT PRIMARY KEY, value TEXT NOT NULL);
    CREATE TABLE jobs (
        id TEXT PRIMARY KEY, record TEXT NOT NULL, came REAL NOT NULL, state TEXT NOT NULL,
        robot TEXT NOT NULL, begun REAL, done REAL, note TEXT NOT NULL
    );
    CREATE TABLE audit (
        seq INTEGER PRIMARY KEY, time REAL NOT NULL, kind TEXT NOT NULL, about TEXT NOT NULL,
        what TEXT NOT NULL, why TEXT NOT NULL
    );
    CREATE INDEX audit_about ON audit (about, time);
    CREATE TABLE plans (
        number INTEGER PRIMARY KEY, time REAL NOT NULL, origin REAL NOT NULL, plan BLOB NOT NULL
    );
    CREATE TABLE snapshots (
        seq INTEGER PRIMARY KEY, number INTEGER NOT NULL, report INTEGER NOT NULL,
        saved BLOB NOT NULL
    );
    CREATE TABLE reports (
        seq INTEGER PRIMARY KEY, time REAL NOT NULL, robot TEXT NOT NULL, activity TEXT NOT NULL,
        progress REAL, pose TEXT, done INTEGER NOT NULL
    );
    """,
)
"""One script for each version; ``user_version`` says how many have been run."""


class StoreError(SampError):
    """The store cannot be used: another one has it, or it is of a later version."""


class Store:
    """One day. ``durable``: what is written outlives a loss of power, too, not only of the process.

    Use ``with store:`` around what belongs together.

    :raises StoreError: where another process writes to it, or a later version has made it.
    """

    def __init__(
        self, file: str | os.PathLike[str], *, write: bool = True, durable: bool = True
    ) -> None:
        self.file = Path(file)
        if not write and not self.file.exists():
            raise StoreError(f"there is no store '{self.file}'")
        self._lock = _locked(self.file) if write else None
        try:
            self._base = self._open(write, durable)
        except sqlite3.Error as error:
            self.close()
            raise StoreError(f"'{self.file}' is no store of a day: {error}") from error
        except StoreError:
            self.close()
            raise

    def _open(self, write: bool, durable: bool) -> sqlite3.Connection:
        mode = "rwc" if write else "ro"
        base = sqlite3.connect(
            f"{self.file.absolute().as_uri()}?mode={mode}", uri=True, isolation_level=None,
            check_same_thread=False,
        )  # fmt: skip
        self._base = base
        if write:
            base.execute("PRAGMA journal_mode = WAL")
            base.execute(f"PRAGMA synchronous = {'FULL' if durable else 'NORMAL'}")
        (version,) = base.execute("PRAGMA user_version").fetchone()
        if version > len(MIGRATIONS):
            raise StoreError(f"'{self.file}' was made by a later version ({version})")
        if not write and version < len(MIGRATIONS):
            raise StoreError(f"'{self.file}' is of an older version: operate it once")
        for number, script in enumerate(MIGRATIONS[version:], start=version + 1):
            base.executescript(f"BEGIN; {script} PRAGMA user_version = {number}; COMMIT;")
        return base

    def close(self) -> None:
        """Close it, and let others have it."""
        if getattr(self, "_base", None) is not None:
            self._base.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def __enter__(self) -> Store:
        self._base.execute("BEGIN IMMEDIATE")
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._base.execute("COMMIT" if kind is None else "ROLLBACK")

    # ------------------------------------------------------------------ the day

    def day(self, key: str, value: Any = None) -> Any:
        """Return what is kept of the day under a key, with tuples for lists; with a value: keep
        it, if there is none.
        """
        if value is not None:
            self._base.execute("INSERT OR IGNORE INTO day VALUES (?, ?)", (key, json.dumps(value)))
        row = self._base.execute("SELECT value FROM day WHERE key = ?", (key,)).fetchone()
        return None if row is None else _frozen(json.loads(row[0]))

    def keep(self, key: str, value: Any) -> None:
        """Keep a value of the day under a key, whatever was there."""
        self._base.execute("INSERT OR REPLACE INTO day VALUES (?, ?)", (key, json.dumps(value)))

    # ------------------------------------------------------------------ orders

    def put_job(self, job: DayOrder) -> None:
        """Keep an order as it is now."""
        row = (
            job.id, json.dumps(job_data(job.record)), job.came, job.state.value, job.robot,
            job.begun, job.done, job.note,
        )  # fmt: skip
        self._base.execute("INSERT OR REPLACE INTO jobs VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)

    def jobs(self) -> dict[str, DayOrder]:
        """Return all orders of the day, by when they came."""
        found = {}
        query = "SELECT record, came, state, robot, begun, done, note FROM jobs ORDER BY came, id"
        for record, came, state, *rest in self._base.execute(query):
            job = DayOrder(job_record(json.loads(record)), came, OrderState(state), *rest)
            found[job.id] = job
        return found

    # ------------------------------------------------------------------ what was told, and why

    def note(self, time: float, kind: str, about: str, what: str, why: str = "") -> None:
        """Write a line of the audit log: who was told what at which time (s), and why."""
        self._base.execute(
            "INSERT INTO audit (time, kind, about, what, why) VALUES (?, ?, ?, ?, ?)",
            (time, kind, about, what, why),
        )

    def notes(
        self, about: str | None = None, until: float | None = None, most: int = 100
    ) -> list[tuple[float, str, str, str, str]]:
        """Return lines (time, kind, about, what, why) of the log, the last ``most``, in order."""
        query, values = "SELECT time, kind, about, what, why FROM audit WHERE 1", []
        for condition, value in (("about = ?", about), ("time <= ?", until)):
            if value is not None:
                query += f" AND {condition}"
                values.append(value)
        rows = self._base.execute(f"{query} ORDER BY seq DESC LIMIT ?", (*values, most))
        return list(rows)[::-1]

    # ------------------------------------------------------------------ plans and reports

    def put_plan(self, number: int, time: float, origin: float, plan: dict[str, Any]) -> None:
        """Keep a plan that is taken over; ``origin``: when its clock began (s of the day)."""
        packed = zlib.compress(json.dumps(plan).encode(), 1)
        row = (number, time, origin, packed)
        self._base.execute("INSERT OR REPLACE INTO plans VALUES (?, ?, ?, ?)", row)

    def plan(self, number: int) -> tuple[float, dict[str, Any]]:
        """Return when the clock of a plan began (s of the day), and the plan, by its number."""
        query = "SELECT origin, plan FROM plans WHERE number = ?"
        row = self._base.execute(query, (number,)).fetchone()
        if row is None:
            raise StoreError(f"there is no plan {number} in '{self.file}'")
        return row[0], json.loads(zlib.decompress(row[1]))

    def last_plan(self) -> int:
        """Return the largest number of a plan."""
        (found,) = self._base.execute("SELECT max(number) FROM plans").fetchone()
        return int(found)

    def put_snapshot(self, number: int, saved: dict[str, Any]) -> None:
        """Keep an executor's state; what was reported before is not needed to go on any more."""
        (last,) = self._base.execute("SELECT coalesce(max(seq), 0) FROM reports").fetchone()
        packed = zlib.compress(json.dumps(saved).encode(), 1)
        self._base.execute("DELETE FROM snapshots")
        row = (number, last, packed)
        self._base.execute("INSERT INTO snapshots (number, report, saved) VALUES (?, ?, ?)", row)
        self._base.execute("DELETE FROM reports WHERE seq < ?", (last,))

    def snapshot(self) -> tuple[int, dict[str, Any], list[Report]] | None:
        """Return the number of the plan that is driven, its executor's state, and all reports
        since; None where nothing was planned yet.
        """
        query = "SELECT number, report, saved FROM snapshots ORDER BY seq DESC LIMIT 1"
        row = self._base.execute(query).fetchone()
        if row is None:
            return None
        number, last, packed = row
        return number, json.loads(zlib.decompress(packed)), list(self.reports(last))

    def put_report(self, report: Report) -> None:
        """Keep what a robot tells."""
        pose = None if report.pose is None else json.dumps(report.pose)
        self._base.execute(
            "INSERT INTO reports (time, robot, activity, progress, pose, done) "
            "VALUES (?, ?, ?, ?, ?, ?)",
            (report.time, report.robot, report.activity, report.progress, pose, report.done),
        )

    def reports(self, after: int = 0) -> Iterator[Report]:
        """Yield reports after one by its number."""
        query = "SELECT robot, time, activity, progress, pose, done FROM reports WHERE seq > ?"
        for robot, time_, activity, progress, pose, done in self._base.execute(query, (after,)):
            where = None if pose is None else tuple(json.loads(pose))
            yield Report(robot, time_, activity, progress, where, bool(done))


def _locked(file: Path) -> int:
    """Return a descriptor that holds the store's lock as long as this process lives."""
    try:
        descriptor = os.open(f"{file}.lock", os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise StoreError(f"'{file}' cannot be opened: {error.strerror}") from error
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except ImportError:  # not a POSIX system
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except OSError as error:
        os.close(descriptor)
        raise StoreError(f"'{file}' is operated by another process already") from error
    return descriptor


def clock_text(seconds: float, epoch: float | None) -> str:
    """Return a time of the day: by the clock where the day has one, else since its start."""
    if epoch is not None:
        return time.strftime("%H:%M:%S", time.localtime(epoch + seconds))
    whole = int(seconds)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def _frozen(value: Any) -> Any:
    """Return what JSON held with tuples for its lists."""
    if isinstance(value, dict):
        return {k: _frozen(v) for k, v in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value
