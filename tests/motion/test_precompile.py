"""What is compiled before time limits run, and how that is known."""

import logging
import os
import signal
import subprocess
import time

import pytest

from up_samp.geometry import kernel_cache
from up_samp.model import MotionModel
from up_samp.motion import compile as module
from up_samp.system import child, files


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache folder, and parts that compile nothing but leave a file."""
    monkeypatch.setenv(files.VARIABLE, str(tmp_path))
    monkeypatch.setattr(module, "_compiled_here", set())
    kernels = tmp_path / "kernels"

    def compiles(part):
        def work():
            kernel_cache._write(kernels / f"{part}-0.kernel", part.encode() * 100)

        return work

    monkeypatch.setattr(module, "workload", compiles)
    return kernels


def compiled(part, monkeypatch):
    """Compile a part as another process would."""
    module.compile_part(part)
    monkeypatch.setattr(module, "_compiled_here", set())


def test_every_part_is_missing_until_it_was_compiled(folder, monkeypatch):
    assert module.missing(module.SECONDS) == tuple(module.SECONDS)
    compiled("groups", monkeypatch)
    assert "groups" not in module.missing(module.SECONDS)
    assert "paths" in module.missing(module.SECONDS)


@pytest.mark.parametrize("harm", ["gone", "empty", "cut", "bit", "mark"])
def test_a_part_whose_files_are_gone_or_damaged_is_compiled_again(folder, monkeypatch, harm):
    compiled("paths", monkeypatch)
    file = folder / "paths-0.kernel"
    data = file.read_bytes()
    if harm == "gone":
        file.unlink()
    elif harm == "mark":
        next(folder.glob("paths-*.json")).write_text("{")
    else:
        flipped = data[:-1] + bytes([data[-1] ^ 1])
        file.write_bytes({"empty": b"", "cut": data[:60], "bit": flipped}[harm])
    assert module.missing(["paths"]) == ("paths",)
    compiled("paths", monkeypatch)
    assert module.missing(["paths"]) == ()


def test_other_sources_or_another_numba_have_marks_of_their_own(folder, monkeypatch):
    compiled("paths", monkeypatch)
    monkeypatch.setattr(module, "_state_of_code", lambda: "another")
    assert module.missing(["paths"]) == ("paths",)
    compiled("paths", monkeypatch)
    assert module.missing(["paths"]) == ()


@pytest.mark.parametrize("generic", [True, False])
def test_kernels_for_any_processor_are_ready_on_another_one(folder, monkeypatch, generic):
    if generic:
        monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    for processor in ("one", "another"):
        monkeypatch.setattr(module.llvmlite.binding, "get_host_cpu_name", lambda p=processor: p)
        module._state_of_code.cache_clear()
        expected = () if generic and processor == "another" else ("paths",)
        assert module.missing(["paths"]) == expected
        compiled("paths", monkeypatch)
    module._state_of_code.cache_clear()


def test_a_part_that_fails_leaves_no_mark(folder, monkeypatch):
    def fails():
        raise RuntimeError("no compiler")

    monkeypatch.setattr(module, "workload", lambda part: fails)
    with pytest.raises(RuntimeError, match="no compiler"):
        module.compile_part("paths")
    assert module.missing(["paths"]) == ("paths",)
    assert not module.is_compiling()


def test_every_part_has_a_workload():
    assert all(callable(module.workload(part)) for part in module.SECONDS)


KERNELS = """
import importlib, pathlib
from up_samp.motion import compile as module
for part in module.SEVERAL:
    module.workload(part)()
for file in sorted((pathlib.Path(module.__file__).parent / "fleet").glob("*.py")):
    for name, found in vars(importlib.import_module(f"up_samp.motion.fleet.{file.stem}")).items():
        here = getattr(found, "__module__", "").endswith(f".{file.stem}")
        if here and type(getattr(found, "_cache", None)).__name__ == "KernelCache":
            print(name, len(found.signatures))
"""


def test_every_kernel_for_several_robots_is_compiled_by_a_workload():
    ran = subprocess.run(child.command(KERNELS), env=child.environment(), capture_output=True)
    compiled = dict(line.split() for line in ran.stdout.decode().splitlines())
    assert {"search", "distances", "pulled", "reachable"} <= compiled.keys()
    assert [name for name, count in compiled.items() if count == "0"] == []


def test_parts_are_those_that_a_problem_needs():
    assert sorted(module.parts_for(MotionModel)) == sorted(module.SECONDS)
    assert module.parts_for([MotionModel.REEDSSHEPP], several=False) == [
        "paths",
        "shortcuts",
        "bounds",
    ]
    assert module.parts_for([MotionModel.SE3]) == []


def test_each_processor_gets_about_the_same_to_compile():
    for processes in range(1, 8):
        shares = module.shared_out(module.SECONDS, processes)
        assert sorted(part for share in shares for part in share) == sorted(module.SECONDS)
        assert len(shares) == min(processes, len(module.SECONDS))
        loads = [sum(module.SECONDS[p] for p in share) for share in shares]
        assert max(loads) <= max(4 / 3 * sum(loads) / processes, max(module.SECONDS.values()))


def test_what_few_problems_need_is_compiled_when_it_is_needed(folder, monkeypatch):
    monkeypatch.setattr(module, "_start", lambda parts: None)
    assert set(module.begin([MotionModel.REEDSSHEPP], several=False).parts) == {
        "paths",
        "shortcuts",
        "bounds",
    }
    assert "knots" not in set(module.begin(MotionModel, several=True).parts)


def test_a_child_that_fails_is_told_of_and_its_work_done_here(folder, monkeypatch, caplog):
    monkeypatch.setattr(module.child, "bare", lambda name: "import sys; sys.exit('out of memory')")
    told = []
    with caplog.at_level(logging.WARNING):
        module.precompile(several=False, report=lambda *ready: told.append(ready))
    assert "exit status 1, out of memory" in caplog.text
    assert (folder / "paths-0.kernel").exists()
    assert module.missing(["paths"]) == ()
    assert told == [(3, 3)]


def test_a_folder_that_cannot_be_written_costs_a_word_and_no_more(tmp_path, monkeypatch, caplog):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv(files.VARIABLE, str(blocked / "cache"))
    monkeypatch.setattr(module, "_compiled_here", set())
    ran = []
    monkeypatch.setattr(module, "workload", lambda part: lambda: ran.append(part))
    with caplog.at_level(logging.WARNING):
        module.precompile(several=False)
        module.precompile(several=False)
    assert ran == ["paths", "shortcuts", "bounds"]
    assert "set UP_SAMP_CACHE_DIR to a writable folder" in caplog.text


PARENT = """
import sys
from up_samp.motion import compile as module
module.parts_for = lambda *a, **k: ["paths", "groups", "knots"]
module.shared_out = lambda parts, processes: [[part] for part in parts]
module.precompile()
"""


@pytest.mark.skipif(not os.path.isdir("/proc"), reason="looks into /proc")
@pytest.mark.parametrize(
    "how", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.long)]
)
def test_nothing_is_left_when_the_first_compile_is_ended(tmp_path, how):
    parent = subprocess.Popen(
        child.command("import signal; signal.signal(2, signal.default_int_handler)" + PARENT),
        env=child.environment({files.VARIABLE: str(tmp_path), "UP_SAMP_TEST": str(tmp_path)}),
        stderr=subprocess.DEVNULL,
    )
    until = time.monotonic() + 240
    while len(family(tmp_path)) < 4 and time.monotonic() < until:
        time.sleep(0.05)
    assert len(family(tmp_path)) == 4
    parent.send_signal(how)
    parent.wait(timeout=120)
    until = time.monotonic() + 120
    while family(tmp_path) and time.monotonic() < until:
        time.sleep(0.05)
    assert family(tmp_path) == []


def family(mark):
    """The processes that have this test's mark in their environment."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{pid}/environ", "rb") as stream:
                if f"UP_SAMP_TEST={mark}".encode() in stream.read():
                    found.append(int(pid))
        except OSError:
            continue
    return found
