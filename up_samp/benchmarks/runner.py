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
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from up_samp.benchmarks.one_run import Record, RunSpec, began_file, machine, versions
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

_running: set[subprocess.Popen[bytes]] = set()
_lock = threading.Lock()


def execute(spec: dict[str, Any], grace: float = GRACE, start: float = 600.0) -> Record:
    """Perform one run (:class:`RunSpec` as a dict) in a process of its own; return its record.

    :param start: seconds that it may take to start and build: UP takes minutes for the largest
        problems without fluents on a loaded machine.
    """
    run = RunSpec(**spec)
    with tempfile.TemporaryDirectory(prefix="up-samp-run-") as folder:
        out = Path(folder) / "record.json"
        status, stderr = _in_process(run, out, folder, start, grace)
        if out.exists():
            found: Record = json.loads(out.read_text(encoding="utf-8"))
        elif status is None:
            late = f"still running {grace:g} s after its timeout"
            told = late if began_file(out).exists() else f"not built {start:g} s after its start"
            found = {"status": "KILLED", "error": told}
        else:
            found = {"status": "CRASH", "error": f"exit status {status}: {stderr[-2000:]}"}
    now = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    return {
        "key": run.key,
        **run.to_dict(),
        **found,
        "finished": now,
        "versions": versions(),
        "machine": machine(),
    }


def _in_process(
    run: RunSpec, out: Path, folder: str, start: float, grace: float
) -> tuple[int | None, str]:
    """Start the run and wait for its end; return exit status (None: killed) and stderr."""
    with open(Path(folder) / "stderr", "w+b") as errors:
        process = subprocess.Popen(
            child.command(ENTRY, [str(out)]),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            env=child.environment({"TMPDIR": folder}),
            start_new_session=True,
        )
        with _lock:
            _running.add(process)
        status: int | None
        try:
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError), process.stdin as stream:
                stream.write(json.dumps(run.to_dict()).encode())
            _wait_until(process, start, begun=began_file(out))
            status = process.wait(run.timeout + grace)
        except subprocess.TimeoutExpired:
            status = None
        finally:
            _end(process)
            with _lock:
                _running.discard(process)
        errors.seek(0)
        return status, errors.read().decode(errors="replace")


def _wait_until(process: subprocess.Popen[bytes], limit: float, *, begun: Path) -> None:
    """Return when a run's engine is called, or the run is over; a run's time counts from there: on
    a loaded machine the imports alone may take as long as a small run.
    """
    until = time.monotonic() + limit
    while not begun.exists() and process.poll() is None:
        if time.monotonic() > until:
            raise subprocess.TimeoutExpired(process.args, limit)
        time.sleep(0.1)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill what is left of a run: its process and the session that it leads."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    elif process.poll() is None:
        process.kill()
    process.wait()


def stop_all() -> None:
    """Kill the runs that this process has under way."""
    with _lock:
        processes = list(_running)
    for process in processes:
        _end(process)


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
