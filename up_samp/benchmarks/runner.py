"""Runs sweeps: one process per run with its own limits, on any ``concurrent.futures.Executor``.

``execute`` is what an executor's worker does for one run: it starts a fresh Python process
(:mod:`up_samp.benchmarks.one_run`), waits for it, and kills it with all its children when it
outlives its time. ``run_sweep`` hands runs out, appends each record to ``runs.jsonl`` as it comes,
and skips runs that are there already: a sweep that was stopped goes on where it was.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from up_samp.benchmarks.one_run import BEGINS, Record, RunSpec, machine, versions
from up_samp.model import EngineError
from up_samp.system import child

RECORDS = "runs.jsonl"
"""Name of the file of records in a sweep's folder."""

WARM_UP = "logistics-dc-oc-r2-i2"
"""The instance that warms up."""

GRACE = 60.0
"""Seconds beyond its engine's timeout that a run may take to compile, validate and end."""

ENTRY = "from up_samp.benchmarks.one_run import main\nmain()"
"""What a run's process does."""

Work = Callable[[dict[str, Any]], Record]

_running: set[child.ProcessGroup] = set()
_lock = threading.Lock()


def execute(spec: dict[str, Any], grace: float = GRACE, start: float = 600.0) -> Record:
    """Perform one run (:class:`RunSpec` as a dict) in a process of its own; return its record.

    :param start: seconds that it may take to start and build: UP takes minutes for the largest
        problems without fluents on a loaded machine.
    """
    run = RunSpec(**spec)
    with tempfile.TemporaryDirectory(prefix="up-samp-run-") as folder:
        found = _performed(run, folder, start, grace)
    now = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    return {
        "key": run.key,
        **run.to_dict(),
        **found,
        "finished": now,
        "versions": versions(),
        "machine": machine(),
    }


def _performed(run: RunSpec, folder: str, start: float, grace: float) -> Record:
    """Return what a run's process tells: that it begins (a run's time counts from there: on a
    loaded machine the imports alone may take as long as a small run), and its record.
    """
    late = ""
    with open(Path(folder) / "stderr", "w+b") as errors:
        group = child.ProcessGroup(
            child.command(ENTRY),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=child.environment({"TMPDIR": folder}),
        )
        process = group.process
        assert process.stdin is not None
        assert process.stdout is not None

        def told(seconds: float, why: str) -> bytes:
            """Return a line that comes within some seconds; else the run is ended."""

            def end() -> None:
                nonlocal late
                late = why
                group.end()

            overdue = threading.Timer(seconds, end)
            overdue.daemon = True
            overdue.start()
            try:
                return process.stdout.readline()  # type: ignore[union-attr]
            finally:
                overdue.cancel()

        with _lock:
            _running.add(group)
        try:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(json.dumps(run.to_dict()).encode() + b"\n")
                process.stdin.flush()
            line = told(start, f"not built {start:g} s after its start")
            if line == BEGINS:
                line = told(run.timeout + grace, f"still running {grace:g} s after its timeout")
            group.settle(grace)
        finally:
            status = group.end()
            child.close_pipes(process)
            with _lock:
                _running.discard(group)
        if line:
            found: Record = json.loads(line)
            return found
        if late:
            return {"status": "KILLED", "error": late}
        errors.seek(0)
        text = errors.read().decode(errors="replace")
        return {"status": "CRASH", "error": f"exit status {status}: {text[-2000:]}"}


def stop_all() -> None:
    """Kill the runs that this process has under way."""
    with _lock:
        groups = list(_running)
    for group in groups:
        group.end()


def read_records(*folders: Path) -> list[Record]:
    """Return the records of sweeps; of several with one key the last. Half a last line, left by a
    sweep that was killed, is skipped.
    """
    records: dict[str, Record] = {}
    for folder in folders:
        path = folder / RECORDS
        if not path.exists():
            continue
        lines = path.read_text(encoding="utf-8").splitlines()
        for i, line in enumerate(lines):
            try:
                record = json.loads(line)
            except json.JSONDecodeError:
                if i == len(lines) - 1:
                    continue
                raise EngineError(f"{path}:{i + 1} is not a record") from None
            records[record["key"]] = record
    return list(records.values())


def run_sweep(
    specs: Sequence[RunSpec],
    out: Path,
    executor: Executor,
    *,
    work: Work = execute,
    again: Iterable[str] = (),
    progress: bool = True,
) -> list[Record]:
    """Perform ``specs`` that ``out`` has no record of; return the records of all of them.

    :param work: what the executor calls with each run's dict.
    :param again: statuses whose runs are done again, such as ``CRASH``.
    :param progress: show a bar on stderr.
    """
    out.mkdir(parents=True, exist_ok=True)
    _mend(out / RECORDS)
    repeat = set(again)
    known = {r["key"]: r for r in read_records(out) if r.get("status") not in repeat}
    todo = [s for s in specs if s.key not in known]
    bar = tqdm(total=len(specs), initial=len(specs) - len(todo), disable=not progress, unit="run")
    with bar, open(out / RECORDS, "a", encoding="utf-8") as stream:
        for spec, record in _results(todo, executor, work):
            stream.write(json.dumps(record) + "\n")
            stream.flush()
            known[spec.key] = record
            bar.set_postfix_str(f"{spec.instance} {record.get('status')}", refresh=False)
            bar.update()
    return [known[s.key] for s in specs]


def _results(
    todo: Sequence[RunSpec], executor: Executor, work: Work
) -> Iterator[tuple[RunSpec, Record]]:
    """Hand out runs and yield records as they come; drop the rest if the consumer stops."""
    futures: dict[Future[Record], RunSpec] = {}
    try:
        for spec in todo:
            futures[executor.submit(work, spec.to_dict())] = spec
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        for future in futures:
            future.cancel()


def _mend(path: Path) -> None:
    """Cut off a last line that a killed sweep left half written; its run is done again."""
    if path.exists():
        content = path.read_bytes()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            os.truncate(path, whole)


def warm_up(specs: Sequence[RunSpec], executor: Executor) -> None:
    """Do one small run per engine and preset and forget it, so that no run that counts has to
    compile kernels first (they are cached on disk).
    """
    ways = {(s.engine, s.preset): s for s in specs}.values()
    first = [replace(s, instance=WARM_UP, timeout=600.0, number=0).to_dict() for s in ways]
    for spec in first:  # one after another: they would compile the same kernels
        executor.submit(execute, spec).result()


@contextlib.contextmanager
def executor_for(jobs: int = 1, cluster: str | None = None) -> Iterator[Executor]:
    """Give the executor for a sweep: ``jobs`` local processes at a time, or a Dask cluster.

    Local runs are processes of their own already, so threads wait for them.
    """
    if cluster is not None:
        try:
            from distributed import Client
        except ImportError:
            raise EngineError("--cluster needs Dask: pip install distributed") from None
        with Client(cluster) as client:
            yield client.get_executor()
        return
    with ThreadPoolExecutor(jobs) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            stop_all()
            raise


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
