"""Sweeps: what is run, limits, resuming, reports."""

import json
import os
import time

import pytest

from tests.benchmarks import sweep_doubles
from up_samp.benchmarks import report, runner
from up_samp.benchmarks.runner import RunSpec, select, sweep
from up_samp.cli import main
from up_samp.model import EngineError, ProblemError


def specs(*names, **options):
    return sweep(select(names), ["engine"], **options)


def test_selection():
    assert len(select(["paper"])) == 132
    names = [i.name for i in select(["logistics-do-oc-r1-i[12]", "logistics-do-oc-r1-i1"])]
    assert names == ["logistics-do-oc-r1-i1", "logistics-do-oc-r1-i2"]
    with pytest.raises(ProblemError, match="nothing-"):
        select(["nothing-*"])


def test_sweep_and_keys():
    runs = specs(
        "jobshop", encodings=("fluents", "no-fluents"), presets=("default", "paper"), runs=3
    )
    assert len(runs) == 36 * 2 * 2 * 3 == len({r.key for r in runs})
    assert [r.number for r in runs[:144]] == [0] * 144
    assert json.loads(json.dumps(runs[0].to_dict())) == runs[0].to_dict()
    with pytest.raises(ProblemError, match="timeout"):
        RunSpec("x", "engine", timeout=0)


def test_records_are_appended_and_resumed(tmp_path):
    calls = []

    def work(run):
        calls.append(run.instance)
        return sweep_doubles.instant(run)

    runs = specs("jobshop-r1-*", timeout=1)
    first = runner.run_sweep(runs[:4], tmp_path, 2, work=work, progress=False)
    with open(tmp_path / runner.RECORDS, "a") as stream:
        stream.write('{"half a rec')
    assert len(runner.read_records(tmp_path)) == 4
    every = runner.run_sweep(runs, tmp_path, 2, work=work, progress=False)
    assert len(calls) == len(runs) == len(every) == 12
    assert every[:4] == first
    assert len((tmp_path / runner.RECORDS).read_text().splitlines()) == 12


def test_damaged_records_are_named(tmp_path):
    (tmp_path / runner.RECORDS).write_text('oops\n{"key": "a"}\n')
    with pytest.raises(EngineError, match=r"runs\.jsonl:1"):
        runner.read_records(tmp_path)


def test_an_unknown_engine_is_part_of_the_record():
    record = runner.execute(RunSpec("jobshop-r1-j1-m1", "no-such-engine"))
    assert record["status"] == "CRASH"
    assert "no-such-engine" in record["error"]
    assert record["activities"] == 8
    assert record["versions"]["unified-planning"]
    assert record["machine"]["cores"] >= 1
    json.dumps(record)


def test_a_run_that_does_not_end_is_killed_with_its_children(monkeypatch, tmp_path):
    pid_file = tmp_path / "pid"
    script = (
        "import subprocess, sys, time;"
        "p = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']);"
        f"open({str(pid_file)!r}, 'w').write(str(p.pid)); time.sleep(60)"
    )
    monkeypatch.setattr(runner, "ENTRY", script)
    record = runner.execute(RunSpec("jobshop-r1-j1-m1", "x", timeout=1.0), grace=2.0)
    assert record["status"] == "KILLED"
    assert "after its timeout" in record["error"]
    for _ in range(600):
        if not is_running(int(pid_file.read_text())):
            break
        time.sleep(0.1)
    assert not is_running(int(pid_file.read_text()))
    assert not runner._running


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as stream:
        return stream.read().split()[2] != "Z"


def test_memory_is_limited(monkeypatch):
    script = (
        "import sys, json; from up_samp.system.child import limit_memory;"
        "limit_memory(json.loads(sys.argv[1])['memory'] * 1_000_000, 'DATA');"
        "x = bytearray(2_000_000_000)"
    )
    monkeypatch.setattr(runner, "ENTRY", script)
    record = runner.execute(RunSpec("jobshop-r1-j1-m1", "x", memory=1000))
    assert record["status"] == "CRASH"
    assert "MemoryError" in record["error"]


def test_report(tmp_path):
    runs = specs("paper", "logistics-dc-all-r4-i8") + specs("jobshop", optimal=False)
    records = [sweep_doubles.instant(s) for s in runs]
    records[0] |= {"valid": False, "violations": ["overlap: a and b"]}
    text = report.write(records, tmp_path).read_text()
    row = next(line for line in text.splitlines() if line.startswith("| engine, fluents, opt"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[0] == "engine, fluents, optimal, 60 s"
    assert cells[1:] == ["2 / 2", "3 / 3", "3 / 3", "3 / 3", "12 / 12", "23 / 23", "1.5"]
    assert "| paper: Aries, fluents | 18.3 | 19.3 | 17 | 16 | 17 | 87.7 | 343 |" in text
    assert "1 invalid plans" in text
    assert "no plan \\| in time" in text
    assert "logistics-dc-all-r4-i8" in text
    # every instance has a row, those of the paper first
    rows = text.partition("## Every instance")[2].partition("##")[0].strip().splitlines()
    assert rows[-1] == "| logistics-dc-all-r4-i8 | - (2 s) |  |"
    assert "| jobshop-r2-j1-m1 | 50, 1.5 s | 50, 1.5 s |" in text


def test_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        runner.run_sweep,
        "__kwdefaults__",
        {
            **runner.run_sweep.__kwdefaults__,
            "work": sweep_doubles.instant,
            "progress": False,
        },
    )

    def bench(*arguments):
        return main(["bench", *arguments])

    out = str(tmp_path / "o")
    assert bench("run", "jobshop-r1-j1-*", "--engines", "a", "b", "--out", out) == 0
    assert "8 of 8 runs found a valid plan, 8 proven optimal." in capsys.readouterr().out
    assert bench("report", out, "--out", str(tmp_path / "r")) == 0
    assert (tmp_path / "r" / "report.md").exists()
    assert bench("list", "jobshop") == 0
    assert len(capsys.readouterr().out.splitlines()) == 36 + 2
    assert bench("run", "nothing", "--out", str(tmp_path)) == 2
    assert bench("report", str(tmp_path / "empty")) == 2
    assert "nothing" in capsys.readouterr().err
