"""Runs, and sweeps of them: one process per run with its own limits, some of them at a time.

``execute`` starts a fresh Python process for one run, waits for it, and kills it with all its
children when it outlives its time. The process reads a :class:`RunSpec` as JSON from its argument
and writes the record as a line of JSON: whatever goes wrong becomes part of it; a process that dies
leaves none, and its parent says so. ``run_sweep`` appends each record to ``runs.jsonl`` as it comes
and skips runs that are there already: a sweep that was stopped goes on where it was.
"""

from __future__ import annotations

import dataclasses
import datetime
import fnmatch
import importlib.metadata
import itertools
import json
import math
import os
import platform
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from up_samp.benchmarks.instances import (
    Encoding,
    Instance,
    check_encoding,
    families,
    instance,
    instances,
)
from up_samp.model import EngineError, ProblemError
from up_samp.system import child
from up_samp.system.child import die_with, limit_memory

Record = dict[str, Any]
"""The outcome of a run, as one line of JSON.

Always there: ``key`` and the fields of :class:`RunSpec`; ``status`` (a UP status name, or
``CRASH``, ``KILLED``, ``MEMOUT``); ``finished`` (UTC); ``versions``; ``machine``. Where it came so
far: ``activities``; ``seconds_build``, ``seconds`` (the engine's call), ``seconds_cpu`` (its CPU
time, with that of child processes), ``seconds_validation``, ``seconds_process``; ``metrics`` (the
engine's, with rounds, bounds, refinements by layer and times by part); ``messages``, or ``error``
and ``traceback``. With a plan: ``valid`` and
``violations`` (by the independent validator), ``makespan``, and ``sequential`` (units, one thing
after another).
"""


@dataclass(frozen=True)
class RunSpec:
    """One run: an engine on an instance.

    ``optimal`` asks for a proof of optimality; without it the first plan is wanted and the problem
    has no metric. ``timeout`` in s is the engine's; ``memory`` in MB bounds the data of the run's
    process. ``number`` tells repeated runs apart and seeds them.
    """

    instance: str
    engine: str
    encoding: Encoding = "fluents"
    preset: str = "default"
    optimal: bool = True
    number: int = 0
    timeout: float = 60.0
    memory: int = 20_000
    tuning: str = ""
    """Tunables that are not the defaults, as JSON (so that a run's process gets them)."""

    def __post_init__(self) -> None:
        check_encoding(self.encoding)
        if min(self.timeout, self.memory) <= 0:
            raise ProblemError("a run needs a positive timeout (s) and memory limit (MB)")

    @property
    def key(self) -> str:
        """What identifies the run in a sweep; limits are part of it."""
        goal = "opt" if self.optimal else "sat"
        return "|".join(
            (
                self.instance,
                self.engine,
                self.encoding,
                self.preset,
                goal,
                f"{self.timeout:g}s",
                f"{self.memory}MB",
                str(self.number),
                *([self.tuning] if self.tuning else []),
            )
        )

    @property
    def column(self) -> str:
        """The heading that the run counts under in a report."""
        preset = "" if self.preset == "default" else f", {self.preset}"
        goal = "optimal" if self.optimal else "first plan"
        tuning = f", {self.tuning}" if self.tuning else ""
        return f"{self.engine}, {self.encoding}{preset}, {goal}, {self.timeout:g} s{tuning}"

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values."""
        return dataclasses.asdict(self)


def select(names: Sequence[str], seeds: Sequence[int] = (0,)) -> list[Instance]:
    """Return the instances that ``names`` say: families, ``paper``, instances, or patterns such
    as ``logistics-oc-*-r1-*``; each once, in the order given, and drawn from each of ``seeds`` (0:
    as it is).

    :raises ProblemError: if a name matches nothing.
    """
    chosen: dict[str, Instance] = {}
    for name in names:
        if name == "paper" or name in families():
            found = instances(name)
        elif any(c in name for c in "*?["):
            everything = itertools.chain.from_iterable(instances(f) for f in families())
            found = [i for i in everything if fnmatch.fnmatchcase(i.name, name)]
            if not found:
                raise ProblemError(f"no instance matches {name!r}")
        else:
            found = [instance(name)]
        both = itertools.product(seeds, found)
        drawn = (instance(f"{i.name}-s{seed}") if seed else i for seed, i in both)
        chosen.update((i.name, i) for i in drawn)
    return list(chosen.values())


def sweep(
    chosen: Sequence[Instance],
    engines: Sequence[str],
    *,
    encodings: Sequence[Encoding] = ("fluents",),
    presets: Sequence[str] = ("default",),
    tunings: Sequence[str] = ("",),
    optimal: bool = True,
    runs: int = 1,
    timeout: float = 60.0,
    memory: int = 20_000,
) -> list[RunSpec]:
    """Return all runs of a sweep; repetitions come last, so that an early stop covers most."""
    return [
        RunSpec(i.name, engine, encoding, preset, optimal, number, timeout, memory, tuning)
        for number, i, engine, encoding, preset, tuning in itertools.product(
            range(runs), chosen, engines, encodings, presets, tunings
        )
    ]


# ------------------ One benchmark run in a process of its own

VERSIONS = ("up-samp", "unified-planning", "ortools", "up-aries", "up-cpse", "ompl", "numba")


def versions() -> dict[str, str]:
    """Return the versions of what matters for a result, where installed."""
    found = {"python": platform.python_version()}
    for name in VERSIONS:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, Any]:
    """Return what the run's machine is."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"system": platform.system(), "processor": platform.machine(), "cores": usable}


def perform(spec: RunSpec) -> Record:
    """Solve the instance and judge the plan; return what the run found."""
    record: Record = {}
    began = time.perf_counter()
    try:
        _solve(spec, record)
    except MemoryError:
        record |= {"status": "MEMOUT", "error": "out of memory"}
    except Exception as error:
        record["status"] = "CRASH"
        record["error"] = f"{type(error).__name__}: {error}"
        record["traceback"] = traceback.format_exc()[-4000:]
    record["seconds_process"] = round(time.perf_counter() - began, 3)
    return record


def _solve(spec: RunSpec, record: Record) -> None:
    import unified_planning
    from unified_planning.exceptions import UPNoRequestedEngineAvailableException
    from unified_planning.shortcuts import OneshotPlanner

    import up_samp  # noqa: F401  (registers the engines)
    from up_samp.benchmarks.instances import instance
    from up_samp.model import EngineError
    from up_samp.upio.plan import figures_told

    unified_planning.environment.get_environment().credits_stream = None
    began = time.perf_counter()
    problem = instance(spec.instance).build(spec.encoding, spec.optimal)
    record["seconds_build"] = round(time.perf_counter() - began, 3)
    record["activities"] = len(problem.activities)
    parameters: dict[str, Any] = {
        "preset": spec.preset,
        "seed": spec.number,
        ("optimal" if spec.optimal else "first_plan"): True,
    }
    if spec.tuning:
        parameters["tuning"] = json.loads(spec.tuning)
    began, cpu = time.perf_counter(), _cpu()
    try:
        planner = OneshotPlanner(name=spec.engine, params=parameters)
    except UPNoRequestedEngineAvailableException as error:
        raise EngineError(f"there is no engine {spec.engine!r} here ({error})") from error
    with planner:
        result = planner.solve(problem, timeout=spec.timeout)
    record["seconds"] = round(time.perf_counter() - began, 3)
    record["seconds_cpu"] = round(_cpu() - cpu, 3)
    record["status"] = result.status.name
    record["metrics"] = {k: _plain(v) for k, v in figures_told(result).items()}
    if result.log_messages:
        record["messages"] = [m.message[:500] for m in result.log_messages[:5]]
    if result.plan is not None:
        record |= _judge(problem, result.plan)


def _cpu() -> float:
    """Return the CPU time (s) of this process and of its children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _judge(problem: Any, plan: Any) -> Record:
    """Return what the independent validator says, and figures of the plan."""
    from up_samp.validation import validate_plan

    began = time.perf_counter()
    verdict = validate_plan(problem, plan)
    judged: Record = {
        "valid": verdict.valid,
        "violations": [str(v) for v in verdict.violations[:5]],
        "seconds_validation": round(time.perf_counter() - began, 3),
    }
    times = {
        a.name: (int(str(plan.get(a.start))), int(str(plan.get(a.end)))) for a in plan.activities
    }
    judged["makespan"] = max((end for _, end in times.values()), default=0)
    judged["sequential"] = _sequential(plan, times)
    return judged


def _sequential(plan: Any, times: dict[str, tuple[int, int]]) -> int:
    """Return the makespan, units, if the plan's activities came one after another.

    Motions count with the whole units that their trajectories need: waiting for others falls away
    when nothing is parallel.
    """
    moves = getattr(plan, "trajectories", None) or {}
    needed = [
        math.ceil(round(moves[name].duration, 6)) if name in moves else end - start
        for name, (start, end) in times.items()
    ]
    return sum(needed)


def _plain(value: object) -> Any:
    """Return a metric as the number that it says, if it says one."""
    text = str(value)
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def main() -> None:
    """Run the spec that is the argument, and tell its record."""
    # whatever libraries print must not get between the lines that are told
    channel = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    spec = RunSpec(**json.loads(sys.argv[1]))
    die_with(sys.stdin.fileno())
    limit_memory(spec.memory * 1_000_000, "DATA")
    channel.write(json.dumps(perform(spec)).encode() + b"\n")
    channel.flush()


if __name__ == "__main__":
    main()


# ------------------ Sweeps


RECORDS = "runs.jsonl"
"""Name of the file of records in a sweep's folder."""

GRACE = 600.0
"""Seconds beyond its engine's timeout that a run may take to start, build, compile and validate: UP
takes minutes for the largest problems without fluents on a loaded machine.
"""

ENTRY = "from up_samp.benchmarks.runner import main\nmain()"
"""What a run's process does."""

_running: set[child.ProcessGroup] = set()


def execute(run: RunSpec, grace: float = GRACE) -> Record:
    """Perform one run in a process of its own; return its record."""
    with tempfile.TemporaryDirectory(prefix="up-samp-run-") as folder:
        found = _performed(run, folder, grace)
    now = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    about = {"finished": now, "versions": versions(), "machine": machine()}
    return {"key": run.key, **run.to_dict(), **found, **about}


def _performed(run: RunSpec, folder: str, grace: float) -> Record:
    """Return what a run's process tells in time."""
    with open(Path(folder) / "stderr", "w+b") as errors:
        group = child.ProcessGroup(
            child.command(ENTRY, [json.dumps(run.to_dict())]),
            stderr=errors,
            env=child.environment({"TMPDIR": folder}),
        )
        _running.add(group)
        try:
            with group.within(run.timeout + grace) as late:
                line = group.source.readline()  # the end of its sink tells that we are gone
                if line:
                    group.settle(grace)
        finally:
            status = group.close()
            _running.discard(group)
        if line:
            found: Record = json.loads(line)
            return found
        if late.is_set():
            why = f"still running {grace:g} s after its timeout"
            return {"status": "KILLED", "error": why}
        errors.seek(0)
        text = errors.read().decode(errors="replace")
        return {"status": "CRASH", "error": f"exit status {status}: {text[-2000:]}"}


def read_records(*folders: Path) -> list[Record]:
    """Return the records of sweeps; of several with one key the last. Half a last line, left by a
    sweep that was killed, is skipped.
    """
    records: dict[str, Record] = {}
    for folder in folders:
        path = folder / RECORDS
        lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
        for i, line in enumerate(lines):
            if not line.endswith(b"\n"):
                continue
            try:
                record = json.loads(line)
            except json.JSONDecodeError:
                raise EngineError(f"{path}:{i + 1} is not a record") from None
            records[record["key"]] = record
    return list(records.values())


def run_sweep(
    specs: Sequence[RunSpec],
    out: Path,
    jobs: int = 1,
    *,
    work: Callable[[RunSpec], Record] = execute,
    progress: bool = True,
) -> list[Record]:
    """Perform ``specs`` that ``out`` has no record of; return the records of all of them.

    :param jobs: runs at a time. They are processes of their own: threads wait for them.
    :param work: what is done for each run.
    :param progress: show a bar on stderr.
    """
    out.mkdir(parents=True, exist_ok=True)
    if (out / RECORDS).exists():  # a last line that is half written goes; its run is done again
        os.truncate(out / RECORDS, (out / RECORDS).read_bytes().rfind(b"\n") + 1)
    known = {r["key"]: r for r in read_records(out)}
    todo = [s for s in specs if s.key not in known]
    bar = tqdm(total=len(specs), initial=len(specs) - len(todo), disable=not progress, unit="run")
    pool = ThreadPoolExecutor(jobs)
    with pool, bar, open(out / RECORDS, "a", encoding="utf-8") as stream:
        try:
            for future in as_completed([pool.submit(work, spec) for spec in todo]):
                record = future.result()
                stream.write(json.dumps(record) + "\n")
                stream.flush()
                known[record["key"]] = record
                bar.set_postfix_str(f"{record['instance']} {record.get('status')}", refresh=False)
                bar.update()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for group in list(_running):
                group.end()
            raise
    return [known[s.key] for s in specs]


def describe(record: Mapping[str, Any]) -> str:
    """Return one line about a record, for people."""
    parts = [f"{record['instance']:28} {record.get('status', '?'):20}"]
    if record.get("makespan") is not None:
        bound = record.get("metrics", {}).get("lower_bound")
        parts.append(f"makespan {record['makespan']:4}" + (f" >= {bound}" if bound else ""))
        parts.append("valid" if record.get("valid") else "INVALID")
    if record.get("seconds") is not None:
        parts.append(f"{record['seconds']:.1f} s")
    return "  ".join(parts)
