"""Measure what must not get worse, and write the tables of the documentation from it.

    python scripts/figures.py --keep --docs       # the whole, on a quiet machine (make figures)
    python scripts/figures.py --short             # a sample, ten minutes (make figures-short)
    python scripts/figures.py --only scale house  # figures, or cases ("scale/5x10")
    python scripts/figures.py --pair COMMIT       # the sample of another commit beside this one
    python scripts/figures.py --docs --none       # only the tables, from the figures kept

Each case is measured by a function of ``measures.py``, in a process of its own with a deadline of
its own: what fails is a row that says why. Results are written after every case, to
``build/figures`` or (``--keep``) to ``benchmarks/figures``, whose last commit is what they are
compared with. The exit code is 1 if anything failed or is worse than its tolerance allows; times
and memory of another machine, or of one that was quicker or slower then, are shown, and not judged.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "benchmarks" / "figures"
SCRATCH = ROOT / "build" / "figures"
Row = dict[str, Any]
Figures = dict[str, dict[str, Row]]
"""Rows by case, by figure."""

NOISE = {"s": 0.1, "ms": 0.5, "MiB": 10.0}
"""Units that hang on the machine, and the differences in them that nobody looks at."""
SAME_PACE = 1.25
"""Times are judged if the machine was as quick both times, up to this factor (``pace``)."""
ABOUT = ("commit", "machine", "load", "pace")
"""What each row tells besides its values."""


@dataclass(frozen=True)
class Value:
    """One number of a figure's rows: ``better`` is "lower", "higher", or "" where neither is;
    ``tolerance`` is the share by which it may be worse.
    """

    name: str
    unit: str = ""
    better: str = "lower"
    tolerance: float = 0.0


@dataclass(frozen=True)
class Figure:
    """A function of ``measures.py``, and the cases that it is called with: ``short`` are those of
    the sample. ``deadline`` is in s by the clock, for one process; numbers are the medians of
    ``runs`` of them.
    """

    name: str
    how: str
    cases: tuple[str, ...]
    short: tuple[str, ...]
    deadline: float
    values: tuple[Value, ...]
    runs: int = 1


CPU = Value("cpu", "s", tolerance=0.25)
PEAK = Value("peak", "MiB", tolerance=0.1)
FOUND = Value("found", "", "higher")
RATIO = Value("ratio", "", tolerance=0.02)
PLAN = (
    Value("valid", "", "higher"),
    Value("makespan", "units", tolerance=0.02),
    Value("bound", "units", "higher"),
)
JOB_SHOPS = ("r1-j1", "r1-j2", "r1-j3", "r2-j1", "r2-j2", "r2-j3", "r3-j1", "r3-j2", "r3-j3")
SITES = ("do-oc", "dc-oc", "do-all", "dc-all")
PUBLISHED = (
    *(f"logistics-{s}-r{r}-i{i}" for s in SITES for r in (1, 2, 3) for i in range(1, 9)),
    *(f"jobshop-{size}-m{m}" for m in (1, 2, 4, 6) for size in JOB_SHOPS),
)
"""The 132 instances of the paper."""
PROOFS = (
    *(f"jobshop-{size}-m4" for size in ("r1-j1", "r1-j2", "r1-j3", "r2-j1", "r2-j2", "r2-j3")),
    *("jobshop-r3-j1-m4", "jobshop-r1-j1-m6", "jobshop-r1-j2-m6", "jobshop-r1-j3-m6"),
    *("jobshop-r2-j1-m6", "jobshop-r3-j1-m6"),
)
"""The twelve whose proofs are looked at: what robots do to each other on the way decides them."""
DRAWN = tuple(
    f"{size}-s{seed}"
    for seed in (3, 4, 5)
    for size in (
        *(f"jobshop-{size}" for size in ("r2-j2-m4", "r3-j3-m5", "r2-j3-m6", "r1-j3-m4")),
        *(f"logistics-{size}" for size in ("do-oc-r2-i8", "dc-all-r3-i8", "dc-oc-r3-i5")),
        *(f"building-{size}" for size in ("rooms-r3-o8", "aisles-r3-o12-c2")),
    )
)
"""Sizes at which gaps were large once, drawn from the seeds on which no method is chosen."""
ANY = ("omni", "car", "differential")
TIGHT = {
    "pocket": ANY,
    "lay-by": ANY,
    "ring of three": ANY,
    "ring of four": ANY,
    "door both ways": ANY,
    "full ring of three": ANY,
    "full ring, three speeds": ANY,
    "full ring of six": ("omni", "car"),
    "carousel of four": ("omni",),
    "square of six": ANY,
    "square of ten": ANY,
    "room of nine, four": ("omni",),
    "room of nine, four small": ("differential",),
    "room of nine, seven": ("omni",),
    "corner": ("omni",),
}
"""The bodies for which each case of ``tests/motion/fleet/tight_places.py`` makes sense."""
FLOORS = (
    *("logistics-dc-all-r2-i3", "logistics-do-oc-r3-i4", "logistics-dc-all-r3-i6"),
    *("jobshop-r2-j2-m2", "jobshop-r3-j3-m2", "jobshop-r3-j3-m4"),
    *("navigation-r3", "kitting-r2-k2-p2-d2", "doors-r2-d2", "warehouse-r3-o5"),
    *("logistics-dc-all-r5-i8", "navigation-r10", "logistics-dc-all-r10-i16"),
)
"""Instances whose plans are executed."""
BUSY, MANY = 360, 440
"""Orders an hour: nine tenths of what ten robots can do, and more than they can."""
WAYS = ("rolling", "token")
DAYS = (
    *(f"rolling, 240 an hour, 1 h, seed {seed}" for seed in range(2)),
    *(
        f"{way}, {MANY} an hour, 0.2 h, seed {seed}, due 120 s, no breakdowns{floor}"
        for seed in (11, 12)
        for floor in ("", *[", Nav2"] * ("NAV2_MAPS" in os.environ))
        for way in WAYS
    ),
    *(f"{way}, {BUSY} an hour, 0.5 h, seeds 20 to 27, due 120 s" for way in WAYS),
    f"anew, {BUSY} an hour, 0.5 h, seed 3",
    "rolling, 180 an hour, 0.5 h, seed 0, 30 robots",
    *(f"rolling, 60 an hour, 8 h, seed {seed}" for seed in range(5)),
    *(f"rolling, 60 an hour, 8 h, seed {n}, Nav2" for n in range(5) if "NAV2_MAPS" in os.environ),
    "rolling, 60 an hour, 2 h, seed 0",
)
"""Days of ten robots with four times as many orders as are usual, with more than they can do and at
nine tenths of that by each of several ways to plan, of thirty robots, whole ones, and a short one.
On Nav2's map only where ``NAV2_MAPS`` says in which folder it is.
"""
OTHERS = tuple(
    f"{name}, 10x30, seed {seed}"
    for name, folder in (("warehouse", "NAV2_MAPS"), ("random-64-64-10", "LORR_MAPS"))
    if folder in os.environ
    for seed in range(2)
)
"""Fleets on maps of Nav2 and the League of Robot Runners, where these variables say in which
folders the maps are.
"""
PLACES = ("hospital", "factory", *["nav2_warehouse"] * ("NAV2_MAPS" in os.environ))
"""Examples whose plans are looked at beside those of a routing solver."""
IDEAS = (
    *("bounds-first", "certificates", "small-cuts", "equivalents", "handovers", "incumbents"),
    *("slack", "single-geometric", "single-temporal"),
)
SHOPS = ("ft06", "la01", "la02", "la05", "ft10", "ta01")
SCHEDULES = (
    *SHOPS,
    *(f"flexible-{size}-0" for size in ("3x3x3", "4x4x3", "5x4x4", "6x5x4", "10x6x5")),
    *(f"transport-{size}-0" for size in ("1-2", "1-3", "2-3", "2-4", "3-8")),
)

FIGURES = (
    Figure("house", "house", ("package",), ("package",), 120, (
        Value("lines", tolerance=0.01),
        Value("files", tolerance=0.01),
        Value("classes", tolerance=0.01),
        Value("class names in two files or more"),
        Value("import circles, type imports counted"),
        Value("rooms with more than 20 files"),
        Value("tunables"),
        Value("branches per 100 lines of code", tolerance=0.02),
    )),
    Figure("start-up", "start_up", (
        "import unified_planning", "import up_samp", "up-samp --version",
        "up-samp solve jobshop-r1-j1-m1", "up-samp demo", "up-samp demo, cold",
    ), ("import up_samp", "up-samp solve jobshop-r1-j1-m1", "up-samp demo, cold"), 900, (
        CPU, Value("seconds", "s", "", 0.0),
    )),
    Figure("memory", "memory", (
        "jobshop-r1-j1-m1", "logistics-dc-all-r3-i6", "48 solves",
    ), ("jobshop-r1-j1-m1",), 900, (
        PEAK, Value("after_6", "MiB", "", 0.0), Value("after_48", "MiB", "lower", 0.1),
    )),
    Figure("first-plans", "first_plan", PUBLISHED, (
        "logistics-do-oc-r3-i8", "logistics-dc-oc-r2-i6", "logistics-do-all-r3-i6",
        "logistics-dc-all-r3-i7", "jobshop-r2-j2-m1", "jobshop-r3-j1-m2", "jobshop-r1-j3-m4",
        "jobshop-r2-j1-m6",
    ), 240, (*PLAN, CPU)),
    Figure("aries", "aries_plan", PUBLISHED, ("jobshop-r2-j1-m4", "logistics-dc-all-r3-i8"), 240, (
        *PLAN, CPU,
    )),
    Figure("drawn-anew", "drawn_anew", DRAWN, DRAWN[:1], 240, (
        Value("proven", "", "higher"), *PLAN, CPU,
    )),
    Figure("proofs", "proof", PROOFS, PROOFS[:2] + PROOFS[3:4], 600, (
        Value("proven", "", "higher"), *PLAN, CPU,
    )),
    Figure("ten-robots", "first_plan", (
        "logistics-dc-all-r10-i16", "kitting-r2-k2-p3-d2", "doors-r3-d2", "navigation-r10",
    ), (), 400, (*PLAN, CPU)),
    Figure("scale", "warehouse_plan", (
        "5x10", "10x30", "20x60", "50x150", "100x300", "10x30, file",
    ), ("5x10", "10x30"), 3600, (
        Value("makespan", "units"), Value("bound", "units", "higher"), CPU, PEAK,
        Value("modules", tolerance=0.01),
    )),
    Figure("better-plans", "better_plans", (
        *(f"10x30, seed {seed}, 100 s" for seed in range(4)),
        "20x60, seed 0, 300 s", "50x150, seed 0, 600 s",
    ), (), 7200, (
        Value("valid", "", "higher"), Value("makespan", "units", tolerance=0.03),
        Value("without_traffic", "units"), Value("bound", "units", "higher"),
    )),
    Figure("sites", "site", PLACES, PLACES[:1], 900, (
        Value("makespan", "s", tolerance=0.05), Value("bound", "s", "higher"),
        Value("without_traffic", "s", "", 0.0),
    )),
    Figure("others-floors", "others_floor", OTHERS, (), 900, (
        Value("makespan", "units", tolerance=0.03), Value("without_traffic", "units"),
        Value("bound", "units", "higher"),
    )),
    Figure("tight-places", "tight_place", tuple(
        f"{case}, {body}" for case, bodies in TIGHT.items() for body in bodies
    ), (
        "pocket, omni", "pocket, car", "pocket, differential", "lay-by, car",
        "door both ways, omni", "full ring, three speeds, omni", "carousel of four, omni",
        "square of ten, omni", "square of ten, car", "room of nine, four, omni", "corner, omni",
    ), 400, (FOUND, RATIO, CPU)),
    Figure("traffic", "errands", tuple(
        f"pillars, {body}, {robots}, {seed}" for body in ANY for robots in (20, 30, 50)
        for seed in range(2) if body == "omni" or robots != 30
    ), ("pillars, omni, 20, 0",), 1500, (
        FOUND, RATIO, Value("first", "", tolerance=0.05), CPU,
    )),
    Figure("drives", "drives", ("car", "omnidirectional", "RRTConnect"), ("car",), 400, (
        FOUND, RATIO, Value("median", "ms", tolerance=0.25),
    )),
    Figure("execution", "floor", tuple(
        f"{name}, {share} %" for share in (30, 10, 50)
        for name in (FLOORS if share == 30 else FLOORS[:4])
    ), ("logistics-do-oc-r3-i4, 30 %",), 1800, (
        Value("unsafe"), Value("staircase", tolerance=0.02), Value("reorder", tolerance=0.02),
        Value("timed", "", ""), Value("timed_collided", "", ""),
    )),
    Figure("days", "day", DAYS, (DAYS[-1],), 7200, (
        Value("done", "", "higher"), Value("wrong"), Value("tardiness", "s", tolerance=0.2),
        Value("flow", "s", tolerance=0.1), Value("dropped"), Value("planning", "s", "lower", 0.3),
        Value("step", "s", "lower", 0.3), Value("held", "MiB", "lower", 0.2), PEAK,
    )),
    Figure("clairvoyant", "clairvoyant", (
        "jobshop-r2-j2-m2", "jobshop-r3-j3-m2", "logistics-dc-all-r2-i3", "logistics-do-oc-r3-i4",
    ), (), 1800, (Value("reorder", tolerance=0.02), Value("worst", tolerance=0.05))),
    Figure("replan", "replan", (
        "logistics-do-oc-r3-i4", "logistics-dc-all-r3-i6", "jobshop-r3-j3-m4", "warehouse-r3-o5",
    ), (), 900, (Value("solved", "", "higher"), CPU)),
    Figure("executor", "executor_time", (
        "10 robots, 200 activities", "50 robots, 1000 activities",
    ), ("10 robots, 200 activities",), 400, tuple(
        Value(name, "ms", "lower", 0.3) for name in ("update", "commands", "forecast")
    )),
    Figure("presets", "preset", (
        "default", "paper", "sequential", *(f"without-{idea}" for idea in IDEAS),
    ), (), 900, (
        Value("solved", "", "higher"), Value("makespans", "units", tolerance=0.02), CPU,
    )),
    Figure("schedulers", "scheduler", SCHEDULES, (), 400, (
        Value("cpsat", "s", "lower", 0.5), Value("makespan", "units"),
    )),
    Figure("relaxations", "relaxation", (
        "jobshop-r1-j3-m6", "jobshop-r2-j3-m6", "jobshop-r3-j3-m6", "logistics-dc-all-r3-i8",
    ), ("jobshop-r1-j3-m6",), 600, (
        Value("bound", "units", "higher"), Value("tour", "units", tolerance=0.02), CPU,
    )),
    Figure("resolving", "resolving", ("logistics-do-oc-r2-i4", "jobshop-r2-j2-m2"), (), 900, (
        Value("ratio", "", "higher", 0.3),
    )),
)  # fmt: skip


# --- measuring


def git(*arguments: str, folder: Path = ROOT) -> str:
    """Return what git says, "" where it fails (no repository, no such file)."""
    command = ["git", "-C", str(folder), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""


def commit_of(tree: Path) -> str:
    """Return the short name of the last commit that changed a checkout's package, with a "+" where
    it has been changed since.
    """
    changed = git("status", "--porcelain", "--", "up_samp", folder=tree)
    last = git("log", "-1", "--abbrev=9", "--format=%h", "--", "up_samp", folder=tree)
    return (last or "unknown") + "+" * bool(changed)


def machine() -> str:
    """Return what the machine is: processor, cores that may be used, Python."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8").splitlines()
        model = next((x.split(":")[1].strip() for x in lines if x.startswith("model name")), model)
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model}, {usable} cores, Python {platform.python_version()}"


def pace() -> float:
    """Return the CPU milliseconds of a million additions, the median of nine: beside other work the
    same processor may need three times as long.
    """
    times = []
    for _ in range(9):
        began, total = time.process_time(), 0
        for number in range(1_000_000):
            total += number
        times.append(1e3 * (time.process_time() - began))
    return round(statistics.median(times), 1)


def once(figure: Figure, case: str, tree: Path) -> Row:
    """Measure a case of a checkout once; whatever goes wrong is a row with ``failed``."""
    script = Path(__file__).with_name("measures.py")
    command = [sys.executable, str(script), figure.how, case, str(tree)]
    with tempfile.TemporaryDirectory(prefix="figures-") as folder:
        process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "PYTHONPATH": str(tree), "TMPDIR": folder}, start_new_session=True,
        )  # fmt: skip
        try:
            out, errors = process.communicate(timeout=figure.deadline)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return {"failed": f"no answer within {figure.deadline:g} s"}
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
    if process.returncode != 0:
        last = errors.strip().splitlines()[-1:] or ["no word"]
        return {"failed": f"exit status {process.returncode}: {last[0][:300]}"}
    return dict(json.loads(out.splitlines()[-1]))


def merged(figure: Figure, rows: list[Row]) -> Row:
    """Return one row for several runs: medians, and under ``varies`` what should have been the same
    in all of them.
    """
    failed = [row for row in rows if "failed" in row]
    if failed:
        return failed[0]
    found, varies = dict(rows[0]), []
    for value in figure.values:
        seen = [row.get(value.name) for row in rows]
        if any(other != seen[0] for other in seen):
            known = [number for number in seen if number is not None]
            found[value.name] = round(statistics.median(known), 3)
            if value.better and not value.tolerance:
                varies.append(value.name)
    return found | ({"varies": varies} if varies else {})


def measured(figure: Figure, case: str, tree: Path = ROOT) -> Row:
    """Measure a case of a checkout as often as its figure says."""
    about = {"commit": commit_of(tree), "machine": machine()}
    about |= {"load": round(os.getloadavg()[0], 1), "pace": pace()}
    return {**merged(figure, [once(figure, case, tree) for _ in range(figure.runs)]), **about}


def chosen(short: bool, only: Iterable[str]) -> list[tuple[Figure, str]]:
    """Return the cases that are asked for: ``only`` names figures, or cases ("scale/5x10")."""
    every = [(f, case) for f in FIGURES for case in f.cases]
    known = {f.name for f in FIGURES} | {f"{f.name}/{case}" for f, case in every}
    wanted = set(only)
    if wanted - known:
        unknown = ", ".join(sorted(wanted - known))
        raise SystemExit(f"no figure {unknown}; there are {', '.join(f.name for f in FIGURES)}")
    return [
        (f, case)
        for f, case in every
        if (not short or case in f.short)
        and (not wanted or f.name in wanted or f"{f.name}/{case}" in wanted)
    ]


# --- what is kept


def read(folder: Path) -> Figures:
    """Return the figures in a folder."""
    files = {f.name: folder / f"{f.name}.json" for f in FIGURES}
    return {n: json.loads(p.read_text(encoding="utf-8")) for n, p in files.items() if p.exists()}


def committed() -> Figures:
    """Return the figures of the last commit (of the folder, where there is no repository)."""
    if not git("rev-parse", "HEAD"):
        return read(KEPT)
    texts = {f.name: git("show", f"HEAD:benchmarks/figures/{f.name}.json") for f in FIGURES}
    return {name: json.loads(text) for name, text in texts.items() if text}


def put(folder: Path, figure: Figure, case: str, row: Row) -> None:
    """Write a case's row beside those that are there, in the order of the list."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{figure.name}.json"
    rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    rows[case] = row
    lines = [f" {json.dumps(c)}: {json.dumps(rows[c])}" for c in figure.cases if c in rows]
    scratch = path.with_suffix(".part")
    scratch.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    scratch.replace(path)


# --- comparing


def shown(value: object) -> str:
    """Return a cell."""
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def is_worse(value: Value, before: float, now: float) -> bool:
    """Return whether a number got worse by more than its tolerance, and by more than noise."""
    if not value.better:
        return False
    loss = now - before if value.better == "lower" else before - now
    return loss > value.tolerance * abs(before) + NOISE.get(value.unit, 1e-9)


def compared(figure: Figure, case: str, before: Row, now: Row) -> Iterator[tuple[str, bool]]:
    """Yield the lines of a comparison, and whether each is for the worse."""
    name = f"{figure.name}/{case}"
    if "failed" in now:
        yield f"| {name} | | | FAILED: {now['failed']} | |", True
        return
    paces = [row.get("pace", 1.0) for row in (before, now)]
    alike = before.get("machine") == now["machine"] and max(paces) < SAME_PACE * min(paces)
    for value in figure.values:
        new, old = now.get(value.name), before.get(value.name)
        ratio, verdict = "", False
        if isinstance(old, (int, float)) and isinstance(new, (int, float)):
            ratio = f"{new / old:.2f}" if old else ""
            verdict = (alike or value.unit not in NOISE) and is_worse(value, old, new)
        elif isinstance(old, (int, float)) and new is None:
            verdict = bool(value.better)
        if new is None and old is None:
            continue
        mark = "  WORSE" if verdict else ""
        label = f"{value.name} ({value.unit})" if value.unit else value.name
        if value.name in (*before.get("varies", ()), *now.get("varies", ())):
            label += ", not the same in all runs"
        yield f"| {name} | {label} | {shown(old)} | {shown(new)} | {ratio}{mark} |", verdict


def report(rows: Mapping[tuple[str, str], Row], before: Figures) -> int:
    """Print what was measured beside what was kept; return how many are for the worse."""
    print("\n| figure | value | before | now | ratio |\n|---|---|---|---|---|")
    worse = 0
    by_name = {f.name: f for f in FIGURES}
    for (name, case), row in rows.items():
        for line, verdict in compared(by_name[name], case, before.get(name, {}).get(case, {}), row):
            print(line)
            worse += verdict
    print(f"\n{worse} of them worse or failed" if worse else "\nnothing is worse")
    return worse


def run(cases: list[tuple[Figure, str]], folder: Path, resume: bool) -> dict[tuple[str, str], Row]:
    """Measure the cases, and write each as it comes; ``resume`` leaves out what this commit and
    machine have there already.
    """
    there, here = (read(folder) if resume else {}), (commit_of(ROOT), machine())
    rows: dict[tuple[str, str], Row] = {}
    warm = False
    for number, (figure, case) in enumerate(cases, start=1):
        row = there.get(figure.name, {}).get(case, {})
        if "failed" in row or (row.get("commit"), row.get("machine")) != here:
            if not warm and figure.name != "house":
                compile_kernels(ROOT)
                warm = True
            row = measured(figure, case)
            put(folder, figure, case, row)
        rows[figure.name, case] = row
        told = {k: v for k, v in row.items() if k not in ABOUT}
        print(f"{number}/{len(cases)} {figure.name}/{case}: {told}", flush=True)
    return rows


def compile_kernels(tree: Path) -> None:
    """Have a checkout's kernels compiled and kept, so that nobody's time counts that."""
    found = once(Figure("warm-up", "warm_up", (), (), 1800, ()), "", tree)
    if "failed" in found:
        print(f"kernels are not compiled: {found['failed']}", flush=True)


def run_pair(other: str, cases: list[tuple[Figure, str]], rounds: int) -> int:
    """Measure another commit in a worktree beside this one, in turns; print both and the ratios of
    medians; return how many are worse now.
    """
    with tempfile.TemporaryDirectory(prefix="figures-pair-") as name:
        tree = Path(name) / "tree"
        subprocess.run(["git", "-C", str(ROOT), "worktree", "add", "--detach", str(tree), other],
                       check=True, capture_output=True)  # fmt: skip
        try:
            for each in (tree, ROOT):
                compile_kernels(each)
            old: Figures = {}
            new: dict[tuple[str, str], Row] = {}
            for figure, case in cases:
                sides: dict[Path, list[Row]] = {tree: [], ROOT: []}
                for turn in range(1 if figure.name == "house" else rounds):
                    for side in (tree, ROOT) if turn % 2 == 0 else (ROOT, tree):
                        sides[side].append(once(figure, case, side))
                ends = {side: merged(figure, rows) for side, rows in sides.items()}
                old.setdefault(figure.name, {})[case] = {**ends[tree], "machine": machine()}
                new[figure.name, case] = {**ends[ROOT], "machine": machine()}
                print(f"{figure.name}/{case}: {ends[tree]} -> {ends[ROOT]}", flush=True)
            return report(new, old)
        finally:
            subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(tree)],
                           check=True, capture_output=True)  # fmt: skip


def main() -> int:
    """Measure, compare, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="a sample of ten minutes")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="figures or cases")
    parser.add_argument("--none", action="store_true", help="measure nothing")
    parser.add_argument("--keep", action="store_true", help=f"write to {KEPT.relative_to(ROOT)}")
    parser.add_argument("--resume", action="store_true", help="not again what is there already")
    parser.add_argument("--docs", action="store_true", help="write the tables of docs/ anew")
    parser.add_argument("--pair", metavar="COMMIT", help="beside another commit, in turns")
    parser.add_argument("--rounds", type=int, default=3, help="turns of a pair")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that what was started is ended
    cases = [] if options.none else chosen(options.short or bool(options.pair), options.only)
    worse = 0
    if options.pair:
        worse = run_pair(options.pair, cases, options.rounds)
    elif cases:
        before = committed()
        worse = report(run(cases, KEPT if options.keep else SCRATCH, options.resume), before)
    if options.docs:
        from figure_tables import rewrite

        rewrite(ROOT / "docs", read(KEPT))
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
