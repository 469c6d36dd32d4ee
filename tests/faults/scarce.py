"""Little memory, full disks, disks that are read-only."""

from __future__ import annotations

import random
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.faults.expected import ended, sane
from tests.faults.stage import run
from up_samp.system.files import VARIABLE, cache_folder


def little_memory(folder: Path, rng: random.Random) -> list[str]:
    """Address space for so many MB more than after the imports."""
    megabytes = rng.choice((20, 60, 120, 200, 300, 450, 700))
    engine = rng.choice(("cpsat", "cpsat", "aries"))
    outcome = run(folder, {"memory": megabytes, "engine": engine, "timeout": 30})
    wrong = sane(outcome)
    told = outcome.told or {}
    good = ("SOLVED_OPTIMALLY", "SOLVED_SATISFICING", "INTERNAL_ERROR", "TIMEOUT")
    # numpy and numba say so where they get no memory
    known = ("MemoryError", "OSError", "EngineError", "ImportError", "SystemError")
    if told.get("status") not in good and told.get("exception") not in known:
        wrong.append(f"{megabytes} MB, {engine}: exit {outcome.code}, {told}, {outcome.err[-700:]}")
    return wrong


@contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[Path | None]:
    """Give a folder on a disk of its own, or None where none can be mounted."""
    place = folder / "disk"
    place.mkdir(exist_ok=True)
    options = ["-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(place)]
    done = subprocess.run(["mount", *options], capture_output=True, check=False)
    try:
        yield place if done.returncode == 0 else None
    finally:
        if done.returncode == 0:
            subprocess.run(["umount", str(place)], capture_output=True, check=True)


def full_disk(folder: Path, rng: random.Random) -> list[str]:
    """Temporary files and the plan go to a disk that is full or soon will be."""
    with small_disk(folder, rng.choice((0, 0, 16, 64))) as disk:
        if disk is None:
            return ["no disk can be mounted here: run it as root"]
        (disk / "filler").write_bytes(b"")
        try:
            with (disk / "filler").open("wb") as stream:
                stream.write(b"x" * rng.choice((0, 4096, 12_000)))
        except OSError:
            pass
        spec = {
            "engine": rng.choice(("cpsat", "aries")),
            "timeout": 30,
        }
        where = {"TMPDIR": str(disk)} if rng.random() < 0.5 else {}
        outcome = run(folder, spec, environment=where)
        wrong = sane(outcome)
        told = outcome.told or {}
        solved = told.get("status") in ("SOLVED_OPTIMALLY", "SOLVED_SATISFICING")
        honest = told.get("status") == "INTERNAL_ERROR" or told.get("exception") in (
            "OSError", "EngineError", "FileNotFoundError", "ProblemError",
        )  # fmt: skip
        if not solved and not honest:
            wrong.append(f"{spec}, {where}: exit {outcome.code}, {told}, {outcome.err[-700:]}")
        if not solved and not where:
            wrong.append(f"a full disk ended the solve: {told}")
        return wrong + [f"left: {p}" for p in disk.iterdir() if p.name != "filler"]


def small_files(folder: Path, rng: random.Random) -> list[str]:
    """No file may grow beyond some bytes (what a full disk is to a program)."""
    largest = rng.choice((0, 100, 1000, 5000, 20_000))
    spec: dict[str, object] = {"largest_file": largest, "timeout": 30}
    spec["engine"] = "cpsat"
    ready = folder / "ready"
    outcome = run(folder, spec | {"ready": str(ready)})
    told = outcome.told or {}
    wrong = sane(outcome)
    # the note itself cannot be written then
    if told.get("status") is None and "File too large" not in outcome.err:
        wrong.append(f"exit {outcome.code}: {told}, {outcome.err[-600:]}")
    return wrong


def read_only_cache(folder: Path, _rng: random.Random) -> list[str]:
    """The cache of kernels is on a disk that is read-only."""
    with small_disk(folder, 4096) as disk:
        if disk is None:
            return ["no disk can be mounted here: run it as root"]
        (disk / "kernels").mkdir()
        kernels = cache_folder()
        if kernels is not None and (kernels / "kernels").exists():
            (disk / "kernels").rmdir()
            (disk / "kernels").symlink_to(kernels / "kernels")
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        outcome = run(folder, {}, environment={VARIABLE: str(disk)})
        return ended(outcome, "SOLVED_OPTIMALLY")
