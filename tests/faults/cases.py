"""The faults, one after the other: how each is made, and what has to come of it.

Each case is a function of a folder and random numbers that returns what is wrong, a line each;
``benchmarks/reliability/faults.py`` runs them all and makes the table of docs/reliability.md.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.faults.engines import FAULTS, GOOD
from tests.faults.stage import Act, Outcome, after, run, when, with_token
from up_samp.system.folders import VARIABLE, cache_folder

BEST = "11"
"""Makespan of the best plan of the problem ``rooms``."""
SLOWLY = {"bounds_first": False, "optimal": True}
"""With these the best plan of ``rooms`` is the third candidate, and the second is a plan, too."""
LATE = 2.0


@dataclass(frozen=True)
class Fault:
    """``make`` returns what is wrong (nothing, where all is well)."""

    name: str
    expected: str
    make: Callable[[Path, random.Random], list[str]]
    runs: int = 1
    quick: bool = False


# ------------------------------------------------------------------------------------ what is right
def sane(outcome: Outcome) -> list[str]:
    """Return what is wrong about any run: things left behind, invalid plans, false claims."""
    wrong = list(outcome.left)
    if "hung for" in outcome.err:
        wrong.append(outcome.err.splitlines()[-1])
    told = outcome.told or {}
    results = [told, told.get("kept"), *told.get("events", []), told.get("child")]
    for result in filter(None, results):
        if result.get("valid") is False:
            wrong.append(f"invalid plan: {result}")
    return wrong


def ended(outcome: Outcome, *statuses: str) -> list[str]:
    """Return what is wrong where the run should end in one of the statuses."""
    wrong = sane(outcome)
    told = outcome.told or {}
    if told.get("status") not in statuses:
        wrong.append(f"exit {outcome.code}, {told or outcome.err[-600:]}, not {statuses}")
    return wrong


# ---------------------------------------------------------------------------------- wrapped engines
def bad_engines(names: list[str], *, later: bool, timeout: float = 8.0):
    def make(folder: Path, _rng: random.Random) -> list[str]:
        spec = {
            "api": "batch",
            "engines": [n + "Later" * later for n in names],
            "timeout": timeout,
            "params": SLOWLY,
        }
        outcome = run(folder, spec, timeout=60 + 40 * len(names))
        wrong = sane(outcome)
        events = (outcome.told or {}).get("events", [])
        if len(events) != len(names):
            wrong.append(f"only {len(events)} of {len(names)} ran: {outcome.err[-600:]}")
        for name, event in zip(names, events, strict=False):
            wrong += _after_kept(event, name) if later else _after_nothing(event, name)
            if event.get("seconds", 0) > timeout + LATE:
                wrong.append(f"{name} took {event['seconds']:.1f} s")
        return wrong

    return make


def _after_nothing(event: dict, name: str) -> list[str]:
    if event.get("status") not in FAULTS[name].ends:
        return [f"{event}, not {FAULTS[name].ends}"]
    bad = FAULTS[name].ends != GOOD
    return [f"no reason: {event}"] if bad and not any(event["messages"]) else []


def _after_kept(event: dict, name: str) -> list[str]:
    """The plan of the second candidate is there, and called no better than it is."""
    status, best = event.get("status"), event.get("makespan") == BEST
    if not event.get("valid"):
        return [f"the plan is lost: {event}"]
    if status == "SOLVED_OPTIMALLY" and not best:
        return [f"called optimal: {event}"]
    return [] if FAULTS[name].ends != GOOD or best else [f"{event}"]


def killed_server(folder: Path, rng: random.Random) -> list[str]:
    """One of the processes that the solve has started is killed at a random instant."""

    def act(process: subprocess.Popen, token: str) -> None:
        until, wait = time.monotonic() + 30, rng.uniform(0.0, 2.0)
        while process.poll() is None and time.monotonic() < until:
            others = [p for p in with_token(token) if p.pid != process.pid]
            if others:
                time.sleep(wait)
                others = [p for p in with_token(token) if p.pid != process.pid]
                if others:
                    rng.choice(sorted(others, key=lambda p: p.pid)).kill()
                return
            time.sleep(0.02)

    engine = rng.choice(("aries", "aries-opt"))
    outcome = run(folder, {"engine": engine, "params": SLOWLY, "timeout": 20}, during=act)
    good = ("SOLVED_OPTIMALLY", "SOLVED_SATISFICING", "INTERNAL_ERROR", "TIMEOUT")
    return ended(outcome, *good)


# -------------------------------------------------------------------------------- in the process
def broken(where: str, at: int, error: str = "RuntimeError"):
    """A part of the search raises from its ``at``-th call on."""

    def make(folder: Path, _rng: random.Random) -> list[str]:
        sabotage = {"raising": {"where": where, "at": at, "error": error}}
        outcome = run(folder, {"sabotage": sabotage, "params": SLOWLY})
        wrong = ended(outcome, "INTERNAL_ERROR", "SOLVED_SATISFICING", "SOLVED_OPTIMALLY")
        told = outcome.told or {}
        failed = told.get("status") == "INTERNAL_ERROR" or any(told.get("messages", []))
        if failed and not any(error in m and "a wheel came off" in m for m in told["messages"]):
            wrong.append(f"the reason is not told: {told}")
        if at == 1 and not failed:
            wrong.append(f"nothing was injected: {told}")
        return wrong

    return make


def kept_after_a_plan(folder: Path, _rng: random.Random) -> list[str]:
    """The last pass over the best plan raises: the plan is there all the same."""
    sabotage = {"raising": {"where": "tidy", "at": 1}}
    outcome = run(folder, {"sabotage": sabotage, "params": SLOWLY})
    wrong = ended(outcome, "SOLVED_SATISFICING")
    return wrong if (outcome.told or {}).get("makespan") == BEST else [*wrong, "plan lost"]


def raising_law(problem: str, error: str):
    def make(folder: Path, _rng: random.Random) -> list[str]:
        outcome = run(folder, {"problem": problem, "timeout": 30})
        told = outcome.told or {}
        wrong = sane(outcome)
        said = told.get("said", "")
        if told.get("exception") != "ProblemError" or "r7" not in said or error not in said:
            wrong.append(f"not named: {told or outcome.err[-400:]}")
        return wrong

    return make


# ------------------------------------------------------------------------------------------ signals
def signalled(number: signal.Signals, api: str):
    """A signal at a random instant of a solve, from its start to its end."""

    def make(folder: Path, rng: random.Random) -> list[str]:
        ready = folder / "ready"
        spec = {"api": api, "params": SLOWLY, "ready": str(ready)}
        spec["engine"] = rng.choice(("cpsat", "cpsat", "aries-opt"))
        ready.unlink(missing_ok=True)
        outcome = run(folder, spec, during=when(ready, after(rng.uniform(0.0, 4.0), number)))
        return sane(outcome) + _ending_of(outcome, number)

    return make


def _ending_of(outcome: Outcome, number: signal.Signals) -> list[str]:
    told = outcome.told or {}
    if outcome.code == 0:
        return []  # it was done before
    if number is signal.SIGTERM:
        return [] if outcome.code == -signal.SIGTERM else [f"exit {outcome.code}"]
    if outcome.code == -signal.SIGINT:
        return []  # in the interpreter's first or last moments
    wrong = []
    if told.get("exception") not in ("KeyboardInterrupt", "InterruptedSearch"):
        wrong.append(f"Ctrl-C ended in {told or outcome.err[-600:]}")
    if told.get("exception") == "InterruptedSearch" and not (told.get("kept") or {}).get("valid"):
        wrong.append(f"the plan is lost: {told}")
    return wrong


def signalled_command(number: signal.Signals, *, late: bool):
    """The same for ``up-samp solve --out``; ``late``: once there is a plan."""

    def make(folder: Path, rng: random.Random) -> list[str]:
        out = folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        found = folder / "stderr"
        wait = rng.uniform(0.0, 2.0) if late else rng.uniform(0.0, 9.0)
        command = [sys.executable, "-c", _COMMAND, "solve", "jobshop-r1-j2-m2", "--optimal"]
        with found.open("w") as stream:
            outcome = run(
                folder,
                command=[*command, "--out", str(out)],
                during=_once_said(found, "plan with makespan", wait, number, late=late),
                stderr=stream,
            )
        said = found.read_text()
        wrong = [*outcome.left, *_half_written(out)]
        plan = out / "plan.json"
        had_plan = "plan with makespan" in said
        codes = {0, 128 + number, -number} if number is signal.SIGTERM else {0, 130, -number}
        if outcome.code not in codes:
            wrong.append(f"exit {outcome.code}: {said[-600:]}")
        if "Traceback" in said and outcome.code not in (-number,):
            wrong.append(f"traceback: {said[-900:]}")
        if late and had_plan and not plan.exists():
            wrong.append(f"the plan is lost (exit {outcome.code}): {said[-600:]}")
        if plan.exists():
            json.loads(plan.read_text())
        return wrong

    return make


_COMMAND = (
    "import signal, sys\n"
    "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "from up_samp.cli import main\n"
    "sys.exit(main())\n"
)


def _once_said(file: Path, text: str, wait: float, number: signal.Signals, *, late: bool) -> Act:
    def act(process: subprocess.Popen, token: str) -> None:
        until = time.monotonic() + 120
        while late and process.poll() is None and time.monotonic() < until:
            if text in file.read_text():
                break
            time.sleep(0.02)
        after(wait, number)(process, token)

    return act


def _half_written(folder: Path) -> list[str]:
    if not folder.exists():
        return []
    return [f"half-written: {p.name}" for p in folder.iterdir() if p.name.startswith(".")]


# -------------------------------------------------------------------------------------- mem., disk
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
    """Temporary files, motions and the plan go to a disk that is full or soon will be."""
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
            "params": {"cache": str(disk / "motions")},
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
            wrong.append(f"a full cache folder ended the solve: {told}")
        return wrong + [f"left: {p}" for p in disk.iterdir() if p.name not in ("filler", "motions")]


def small_files(folder: Path, rng: random.Random) -> list[str]:
    """No file may grow beyond some bytes (what a full disk is to a program)."""
    largest = rng.choice((0, 100, 1000, 5000, 20_000))
    spec = {"params": {"cache": str(folder / "motions")}, "largest_file": largest, "timeout": 30}
    spec["engine"] = "cpsat"
    ready = folder / "ready"
    outcome = run(folder, spec | {"ready": str(ready)})
    told = outcome.told or {}
    wrong = sane(outcome)
    # the note itself cannot be written then: what counts is that the motions do not end the solve
    if told.get("status") is None and "File too large" not in outcome.err:
        wrong.append(f"exit {outcome.code}: {told}, {outcome.err[-600:]}")
    return wrong


def read_only_cache(folder: Path, _rng: random.Random) -> list[str]:
    """Both caches are on a disk that is read-only."""
    with small_disk(folder, 4096) as disk:
        if disk is None:
            return ["no disk can be mounted here: run it as root"]
        for name in ("kernels", "motions"):
            (disk / name).mkdir()
        kernels = cache_folder()
        if kernels is not None and (kernels / "kernels").exists():
            (disk / "kernels").rmdir()
            (disk / "kernels").symlink_to(kernels / "kernels")
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        spec = {"params": {"cache": str(disk / "motions")}}
        outcome = run(folder, spec, environment={VARIABLE: str(disk)})
        return ended(outcome, "SOLVED_OPTIMALLY")


# ------------------------------------------------------------------------------------------- caches
def harm(rng: random.Random, file: Path) -> None:
    """Harm a file in one of the ways in which files are harmed."""
    data = file.read_bytes()
    how = rng.choice(("empty", "cut", "flip", "noise", "gone", "long", "swap"))
    if how == "gone":
        file.unlink()
    elif how == "empty":
        file.write_bytes(b"")
    elif how == "cut":
        file.write_bytes(data[: rng.randrange(max(1, len(data)))])
    elif how == "noise":
        file.write_bytes(rng.randbytes(len(data)))
    elif how == "long":
        file.write_bytes(data + rng.randbytes(100))
    elif how == "swap":
        other = rng.choice(sorted(file.parent.iterdir()))
        file.write_bytes(other.read_bytes() if other.is_file() else b"")
    elif data:
        at = rng.randrange(len(data))
        file.write_bytes(data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :])


def harmed_kernels(folder: Path, rng: random.Random) -> list[str]:
    """Some files of the cache of kernels are harmed: they are compiled again."""
    own = folder / "cache"
    if not own.exists():
        known = cache_folder()
        if known is None or not (known / "kernels").exists():
            return ["there are no kernels yet to be harmed: solve anything first"]
        shutil.copytree(known / "kernels", own / "kernels")
    files = sorted(p for p in (own / "kernels").iterdir() if p.is_file())
    for file in rng.sample(files, min(3, len(files))):
        harm(rng, file)
    outcome = run(folder, {"timeout": 30}, environment={VARIABLE: str(own)}, timeout=600)
    wrong = ended(outcome, "SOLVED_OPTIMALLY")
    litter = [p.name for p in (own / "kernels").iterdir() if p.suffix in (".part", ".lock")]
    return wrong + [f"left in the cache: {litter}"] * bool(litter)


def harmed_motions(folder: Path, rng: random.Random) -> list[str]:
    """Some files of the cache of motions are harmed: the motions are planned again."""
    motions = folder / "motions"
    spec = {"params": {"cache": str(motions)}}
    wrong = []
    if not motions.exists():
        wrong += ended(run(folder, spec), "SOLVED_OPTIMALLY")
    files = sorted(p for p in motions.rglob("*") if p.is_file())
    if not files:
        return [*wrong, "no motions were kept"]
    for file in rng.sample(files, min(4, len(files))):
        harm(rng, file)
    outcome = run(folder, spec)
    wrong += ended(outcome, "SOLVED_OPTIMALLY")
    if (outcome.told or {}).get("makespan") != BEST:
        wrong.append(f"another makespan: {outcome.told}")
    return wrong


def cold_cache(folder: Path, _rng: random.Random) -> list[str]:
    """Two processes start on an empty cache of kernels at once."""
    cold = {VARIABLE: str(folder / "cold")}
    shutil.rmtree(folder / "cold", ignore_errors=True)
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(2) as pool:
        runs = [
            pool.submit(run, folder / str(k), {"timeout": 60}, environment=cold, timeout=900)
            for k in range(2)
        ]
        wrong = [w for r in runs for w in ended(r.result(), "SOLVED_OPTIMALLY")]
    litter = [p.name for p in (folder / "cold" / "kernels").iterdir() if p.suffix == ".part"]
    return wrong + [f"left in the cache: {litter}"] * bool(litter)


# -------------------------------------------------------------------------- threads, forks, streams
def two_threads(folder: Path, rng: random.Random) -> list[str]:
    engine = rng.choice(("cpsat", "aries-opt"))
    outcome = run(folder, {"api": "threads", "engine": engine, "params": SLOWLY})
    wrong = sane(outcome)
    events = (outcome.told or {}).get("events", [])
    good = [e for e in events if e.get("status") == "SOLVED_OPTIMALLY" and e["makespan"] == BEST]
    return wrong if len(good) == 2 else [*wrong, f"{engine}: {events} {outcome.err[-600:]}"]


def forks(*, warm: bool):
    def make(folder: Path, rng: random.Random) -> list[str]:
        for note in folder.glob("told.json.*"):
            note.unlink()
        engine = rng.choice(("cpsat", "aries-opt"))
        outcome = run(folder, {"api": "forked", "warm": warm, "engine": engine})
        told = outcome.told or {}
        wrong = ended(outcome, "SOLVED_OPTIMALLY")
        if (told.get("child") or {}).get("status") != "SOLVED_OPTIMALLY":
            wrong.append(f"the child: {told} {outcome.err[-600:]}")
        return wrong

    return make


def streams(how: str):
    """Standard streams that are closed, or read no further."""

    def make(folder: Path, _rng: random.Random) -> list[str]:
        out = folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        inner = [sys.executable, "-m", "up_samp", "solve", "jobshop-r1-j1-m1", "--out", str(out)]
        shells = {
            "stdin": '"$@" <&-',
            "stdout": '"$@" >&-',
            "stderr": '"$@" 2>&-',
            "all": '"$@" <&- >&- 2>&-',
            "head": '"$@" | head -c 1',
            "full": '"$@" >/dev/full',
        }
        outcome = run(folder, command=["sh", "-c", shells[how], "sh", *inner])
        wrong = [*outcome.left, *_half_written(out)]
        if not (out / "plan.json").exists():
            wrong.append(f"no plan: exit {outcome.code}, {outcome.err[-600:]}")
        if "Traceback" in outcome.err:
            wrong.append(f"traceback: {outcome.err[-600:]}")
        if how in ("stdin", "stdout", "stderr", "all") and outcome.code != 0:
            wrong.append(f"exit {outcome.code}: {outcome.err[-600:]}")
        return wrong

    return make


ENDING = [n for n, f in FAULTS.items() if "TIMEOUT" in f.ends]
DYING = ["DiesAtOnce", "LeavesQuietly", "KilledByItself", "Aborts", "LeavesBySystemExit",
         "Interrupts", "ShutsDescriptors"]  # fmt: skip
RAISING = ["RaisesAtOnce", "OutOfMemory", "Recursion"]
LYING = [n for n in FAULTS if n not in (*ENDING, *DYING, *RAISING)]
INT, TERM = signal.SIGINT, signal.SIGTERM


def table() -> list[Fault]:
    """Return all faults."""
    kept = "; the plan found before is returned"
    found = []
    for names, what, expected in (
        (DYING, "engine's process ends", "`INTERNAL_ERROR` with its last words"),
        (RAISING, "engine raises", "`INTERNAL_ERROR`, the error named"),
        (LYING, "engine lies or is odd", "`INTERNAL_ERROR`, or no proof"),
        (ENDING, "engine hangs, starts processes", "`TIMEOUT`, all of them ended"),
    ):
        found += [
            Fault(f"{what} ({len(names)} kinds)", expected, bad_engines(names, later=False)),
            Fault(
                f"{what}, third call ({len(names)} kinds)",
                expected + kept,
                bad_engines(names, later=True),
            ),
        ]
    found.append(
        Fault(
            "engine's server killed at a random instant", "any ending but a lie", killed_server, 10
        )
    )
    for where in ("car", "planar", "leg", "coordinate", "certificate", "repair"):
        found.append(
            Fault(
                f"motion planning raises: {where}", "`INTERNAL_ERROR`, or the plan until then",
                lambda folder, rng, where=where: [
                    w
                    for at in (1, rng.randint(2, 6))
                    for w in broken(where, at, rng.choice(("RuntimeError", "MemoryError")))(
                        folder, rng
                    )
                ],
                2,
            )
        )  # fmt: skip
    found += [
        Fault("the last pass over a plan raises", "the plan", kept_after_a_plan, 1, quick=True),
        Fault(
            "control model raises", "`ProblemError`, object named",
            lambda folder, rng: [
                w
                for n, e in (("law-0", "RuntimeError"), ("law-50", "ZeroDivisionError"),
                             ("law-5000", "KeyError"))
                for w in raising_law(n, e)(folder, rng)
            ],
        ),
    ]  # fmt: skip
    interrupted = "`KeyboardInterrupt`; the best plan in its `result`, once there is one"
    for number, expected in ((INT, interrupted), (TERM, "the process ends")):
        for api in ("oneshot", "anytime"):
            name = f"{number.name} at a random instant, {api}"
            found.append(Fault(name, expected, signalled(number, api), 15))
        name = f"{number.name} at a random instant, `up-samp solve`"
        exit_code = f"exit code {130 if number is INT else 143}"
        found += [
            Fault(name, exit_code, signalled_command(number, late=False), 10),
            Fault(
                f"{number.name} once there is a plan, `up-samp solve --out`",
                f"{exit_code}, plan.json written",
                signalled_command(number, late=True),
                10,
            ),
        ]
    found += [
        Fault("memory limit", "a plan, `INTERNAL_ERROR` or `MemoryError`", little_memory, 12),
        Fault("full disk", "a plan, or the error told", full_disk, 8),
        Fault("files of limited size", "a plan, or the error told", small_files, 5),
        Fault("read-only caches", "a plan", read_only_cache, 1),
        Fault("harmed kernel cache", "a plan, compiled anew", harmed_kernels, 6),
        Fault("harmed motion cache", "the same plan", harmed_motions, 10),
        Fault("two processes on a cold cache", "two plans", cold_cache, 1),
        Fault("two threads", "two plans", two_threads, 4),
        Fault("fork after import", "two plans", forks(warm=False), 3),
        Fault("fork after a solve", "two plans", forks(warm=True), 3),
    ]
    for how in ("stdin", "stdout", "stderr", "all"):
        found.append(Fault(f"closed: {how}", "plan.json written, exit code 0", streams(how)))
    found += [
        Fault("output read no further (`| head`)", "plan.json written", streams("head")),
        Fault("output to a full device", "plan.json written", streams("full")),
    ]
    return found


FAULT_TABLE = table()
assert os.name == "posix"
