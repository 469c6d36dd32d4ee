"""Runs sweeps: one process per run with its own limits, some of them at a time.

``execute`` starts a fresh Python process (:mod:`up_samp.benchmarks.one_run`) for one run, waits for
it, and kills it with all its children when it outlives its time. ``run_sweep`` appends each record
to ``runs.jsonl`` as it comes and skips runs that are there already: a sweep that was stopped goes
on where it was.
"""

from __future__ import annotations

import datetime
import json
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from tqdm import tqdm

from up_samp.benchmarks.one_run import Record, RunSpec, machine, versions
from up_samp.model import EngineError
from up_samp.system import child

RECORDS = "runs.jsonl"
"""Name of the file of records in a sweep's folder."""

GRACE = 600.0
"""Seconds beyond its engine's timeout that a run may take to start, build, compile and validate: UP
takes minutes for the largest problems without fluents on a loaded machine.
"""

ENTRY = "from up_samp.benchmarks.one_run import main\nmain()"
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
    _mend(out / RECORDS)
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


def _mend(path: Path) -> None:
    """Cut off a last line that a killed sweep left half written; its run is done again."""
    if path.exists():
        content = path.read_bytes()
        os.truncate(path, content.rfind(b"\n") + 1)


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
