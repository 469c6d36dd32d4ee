"""Run a subject in a process of its own, do something to it, and look at what it leaves behind.

All that it starts is known by a token in its environment, whatever session or parent it has; all
that it writes to the temporary folder is there to be seen, since the folder is its own.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parents[2]
TOKEN = "UP_SAMP_TEST_TOKEN"
PATIENCE = 60.0
"""Seconds in which processes have to be gone after their parent."""


@dataclass
class Outcome:
    """``told``: what the subject wrote about its run (None: it did not get so far)."""

    code: int
    out: str
    err: str
    seconds: float
    told: dict[str, Any] | None
    processes: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)

    @property
    def left(self) -> list[str]:
        """What was left behind, a line each."""
        return [f"process left: {p}" for p in self.processes] + [
            f"file left: {f}" for f in self.files
        ]


Act = Callable[[subprocess.Popen, str], None]
"""What is done to a running subject, given its process and its token."""


def run(
    folder: Path,
    spec: Mapping[str, Any] | None = None,
    *,
    command: list[str] | None = None,
    during: Act | None = None,
    environment: Mapping[str, str] | None = None,
    timeout: float = 240.0,
    **popen: Any,
) -> Outcome:
    """Run ``python -m tests.faults.subject SPEC`` (or ``command``) and return what came of it."""
    folder.mkdir(parents=True, exist_ok=True)
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    note = folder / "told.json"
    note.unlink(missing_ok=True)
    token = uuid.uuid4().hex
    env = os.environ | {
        TOKEN: token,
        "TMPDIR": str(temporary),
        "PYTHONPATH": str(ROOT),
        **(environment or {}),
    }
    if command is None:
        given = json.dumps({"folder": str(folder), "note": str(note)} | dict(spec or {}))
        command = [sys.executable, "-m", "tests.faults.subject", given]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | popen
    began = time.monotonic()
    process = subprocess.Popen(
        command, env=env, text=True, errors="replace", cwd=folder, start_new_session=True, **pipes
    )
    try:
        if during is not None:
            during(process, token)
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        hung = [f"{p.pid} {p.name()}" for p in with_token(token)]
        for other in with_token(token):
            other.kill()
        out, err = process.communicate()
        err += f"\nhung for {timeout} s: {hung}"
    seconds = time.monotonic() - began
    told = json.loads(note.read_text()) if note.exists() and note.stat().st_size else None
    return Outcome(
        process.returncode,
        out or "",
        err or "",
        seconds,
        told,
        _processes(token),
        _files(temporary),
    )


def with_token(token: str) -> list[psutil.Process]:
    """Return the live processes that were started by the subject, directly or not."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.environ().get(TOKEN) == token:
                alive = process.status() != psutil.STATUS_ZOMBIE
                found += [process] if alive else []
        except (psutil.Error, OSError):
            continue
    return found


def _processes(token: str) -> list[str]:
    until = time.monotonic() + PATIENCE
    while (left := with_token(token)) and time.monotonic() < until:
        time.sleep(0.05)
    told = []
    for process in left:
        try:
            told.append(f"{process.pid} {' '.join(process.cmdline())[:80]}")
            process.kill()
        except psutil.Error:
            continue
    return told


def _files(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())


def after(seconds: float, number: signal.Signals) -> Act:
    """Return what sends a signal to the subject after some time."""

    def act(process: subprocess.Popen, _token: str) -> None:
        until = time.monotonic() + seconds
        while process.poll() is None and time.monotonic() < until:
            time.sleep(0.01)
        if process.poll() is None:
            process.send_signal(number)

    return act


def when(path: Path, then: Act) -> Act:
    """Return what waits for a file before it does ``then``."""

    def act(process: subprocess.Popen, token: str) -> None:
        until = time.monotonic() + 120
        while process.poll() is None and not path.exists() and time.monotonic() < until:
            time.sleep(0.01)
        then(process, token)

    return act
