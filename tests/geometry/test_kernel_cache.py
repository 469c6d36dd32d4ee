"""Kernels on disk: found again, never trusted blindly, never in the way."""

import ast
import hashlib
import heapq
import importlib
import logging
import math
import os
import pkgutil
import shutil
import subprocess
import sys
import time
import types
import typing
from functools import partial
from pathlib import Path

import numba
import numpy as np
import pytest

import up_samp.geometry
import up_samp.motion
from tests.oracles.clocks import Watch
from up_samp.geometry import kernel_cache, records
from up_samp.model import Deadline
from up_samp.system import child, files

SOURCE = """
from up_samp.geometry.records import kernel

STEP = {step}

@kernel
def inner_sum(values):
    total = 0.0
    for v in values:
        total += STEP * v
    return total

@kernel
def outer(values):
    return inner_sum(values) + {extra}

def main():
    import logging
    import numpy as np
    from up_samp.geometry import kernel_cache
    kernel_cache._LONGEST_WAIT = 1e6
    logging.basicConfig()
    print(outer(np.ones(3)), sum(outer.stats.cache_hits.values()))
"""

NO_BYTECODE = {"PYTHONDONTWRITEBYTECODE": "1"}
"""Python takes a module's kept bytecode for its own while size and second of the two agree."""

STEM = """
import importlib, os, sys, traceback
from up_samp.geometry import records  # which takes a second; nothing is compiled or loaded yet

for folder in map(str.strip, sys.stdin):
    branch = os.fork()
    if branch == 0:
        code = 1
        try:
            for stream, name in ((1, "out"), (2, "err")):
                os.dup2(os.open(os.path.join(folder, name), os.O_CREAT | os.O_WRONLY), stream)
            os.environ["{variable}"] = os.path.join(folder, "cache")
            os.umask(int(open(os.path.join(folder, "umask")).read()))
            sys.path.insert(0, folder)
            importlib.import_module("outer_module").main()
            code = 0
        except Exception:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(code)
    print(os.waitpid(branch, 0)[1], flush=True)
"""


@pytest.fixture(scope="module")
def stem():
    """A process that has imported what kernels need, of which others branch off."""
    with subprocess.Popen(
        child.command(STEM.format(variable=files.VARIABLE)),
        env=child.environment(NO_BYTECODE),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield process
        process.stdin.close()


def asked(stem, folder, step=1, extra=0):
    """Run a kernel in a process that has compiled and loaded nothing yet; return its value, its
    hits in the cache and stderr.
    """
    (folder / "outer_module.py").write_text(SOURCE.format(step=step, extra=extra))
    os.umask(mask := os.umask(0))
    (folder / "umask").write_text(str(mask))
    for name in ("out", "err"):
        (folder / name).write_text("")
    stem.stdin.write(f"{folder}\n")
    stem.stdin.flush()
    ended = stem.stdout.readline()
    out, said = ((folder / name).read_text() for name in ("out", "err"))
    assert ended == "0\n", said
    value, hits = out.split()
    return float(value), int(hits), said


@pytest.fixture
def ask(stem, tmp_path):
    """Ask with nothing in the cache."""
    return partial(asked, stem, tmp_path)


@pytest.fixture(scope="module")
def compiled(stem, tmp_path_factory):
    """Return a folder whose cache has the kernels."""
    folder = tmp_path_factory.mktemp("compiled")
    assert asked(stem, folder)[:2] == (3.0, 0)
    return folder


@pytest.fixture
def again(stem, tmp_path, compiled):
    """Ask with the kernels in the cache."""
    shutil.copytree(compiled / "cache", tmp_path / "cache")
    return partial(asked, stem, tmp_path)


def test_kernels_are_found_again_and_changed_ones_are_not(again, tmp_path):
    ask = again
    assert ask(step=2)[:2] == (6.0, 0)  # inlined into the other one
    for file in (tmp_path / "cache" / "kernels").iterdir():
        data = file.read_bytes()
        for harmed in (b"", data[:40], data[: len(data) // 2], data[:-1] + bytes([data[-1] ^ 1])):
            file.write_bytes(harmed)
            assert not kernel_cache.is_whole(harmed)
    value, hits, said = ask()
    assert (value, hits) == (3.0, 0)
    assert "is damaged and compiled again" in said
    assert ask()[:2] == (3.0, 1)
    assert not list((tmp_path / "cache" / "kernels").glob("*.part"))
    assert not list((tmp_path / "cache" / "kernels").glob("*.lock"))


def test_a_lock_whose_process_was_killed_holds_nobody_up(again, tmp_path):
    for kernel in (tmp_path / "cache" / "kernels").iterdir():
        kernel.unlink()
        kernel.with_suffix(".lock").touch()
    assert again()[:2] == (3.0, 0)
    assert not list((tmp_path / "cache" / "kernels").glob("*.lock"))


def test_what_does_not_compile_holds_nobody_up(tmp_path, monkeypatch):
    monkeypatch.setenv(files.VARIABLE, str(tmp_path))
    (tmp_path / "kernels").mkdir(mode=0o700)

    def never(value):
        return value.such_a_thing_is_not()

    kernel, watch = records.kernel(never), Watch()
    for _ in range(2):
        with pytest.raises(numba.TypingError):
            kernel(1.0)
        assert not list((tmp_path / "kernels").glob("*.lock"))
    assert watch.own < kernel_cache._LONGEST_WAIT / 2
    assert kernel._cache._missed == []


def test_a_kernel_heeds_the_order_of_a_record_s_fields(tmp_path):
    """It takes them by their places, and the types of two may be the same."""
    records = tmp_path / "records.py"
    records.write_text("class Limits(NamedTuple):\n    v: float\n    a: float\n")
    assert kernel_cache.kernels_need(records)
    records.write_text("@dataclass\nclass Limits:\n    v: float\n")
    kernel_cache.kernels_need.cache_clear()
    assert not kernel_cache.kernels_need(records)
    uses = Path(up_samp.motion.__file__).parent / "planners" / "hybrid_astar.py"
    assert uses.parents[1] / "guides.py" in closure(uses)


def test_a_folder_that_is_left_of_a_module_hides_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "_PACKAGE", tmp_path)
    (tmp_path / "guides" / "__pycache__").mkdir(parents=True)
    (tmp_path / "guides.py").touch()
    assert kernel_cache._files("up_samp.guides", "push") == [tmp_path / "guides.py"]


def test_a_kernel_in_the_place_of_another_is_not_run(again, tmp_path):
    """Both take the same arguments: only their names tell them apart."""
    folder = tmp_path / "cache" / "kernels"
    (inner,), (outer,) = (list(folder.glob(f"*.{n}-*")) for n in ("inner_sum", "outer"))
    outer.write_bytes(inner.read_bytes())
    value, hits, said = again()
    assert (value, hits) == (3.0, 0)
    assert "is damaged and compiled again" in said


EVIL = """
import hashlib, os, pickle, sys
class Evil:
    def __reduce__(self):
        return os.mkdir, (sys.argv[1],)
data = pickle.dumps(Evil())
sys.stdout.buffer.write(hashlib.sha256(data).digest() + data)
"""


@pytest.mark.parametrize("harm", ["folder of others", "open file"])
def test_what_others_may_have_written_is_not_run(harm, again, tmp_path):
    """A kernel's file is a pickle: whoever may write it may run anything in this process."""
    if harm.endswith("of others") and os.geteuid() != 0:
        pytest.skip("only root gives files away")
    folder = tmp_path / "cache" / "kernels"
    command = [sys.executable, "-c", EVIL, str(tmp_path / "was run")]
    evil = subprocess.run(command, capture_output=True, check=True).stdout
    for file in folder.glob("*.kernel"):
        file.write_bytes(evil)
        if harm == "file of others":
            os.chown(file, 12345, 12345)
        if harm == "open file":
            file.chmod(0o666)
    if harm == "folder of others":
        os.chown(folder, 12345, 12345)
    if harm == "open folder":
        folder.chmod(0o777)
    value, hits, said = again()
    assert not (tmp_path / "was run").exists()
    assert (value, hits) == (3.0, 0)
    assert "may be written by others" in said or "others may write" in said or "could write" in said
    assert again()[:2] == (3.0, 0 if harm == "folder of others" else 1)
    assert folder.stat().st_mode & 0o022 == 0


def test_kernels_are_private_whatever_the_umask(ask, tmp_path):
    before = os.umask(0o000)
    try:
        assert ask()[:2] == (3.0, 0)
    finally:
        os.umask(before)
    folder = tmp_path / "cache" / "kernels"
    assert all(p.stat().st_mode & 0o022 == 0 for p in (folder, *folder.glob("*.kernel")))


def test_what_cannot_be_loaded_is_compiled_again(again, tmp_path):
    """Whole, ours, and of another version of what it needs."""
    for file in (tmp_path / "cache" / "kernels").glob("*.kernel"):
        content = b"cno_such_module\nno_such_name\n."
        file.write_bytes(hashlib.sha256(content).digest() + content)
    value, hits, said = again()
    assert (value, hits) == (3.0, 0)
    assert "cannot be loaded (ModuleNotFoundError) and is compiled again" in said
    assert again()[:2] == (3.0, 1)


def test_nowhere_to_keep_them_is_told_and_does_no_harm(ask, tmp_path):
    (tmp_path / "cache").write_text("no folder")
    value, hits, said = ask()
    assert (value, hits) == (3.0, 0)
    assert "set UP_SAMP_CACHE_DIR to a writable folder" in said


def test_no_home_is_no_folder(monkeypatch):
    monkeypatch.delenv(files.VARIABLE, raising=False)
    monkeypatch.setattr(files, "user_cache_path", lambda *a, **k: Path("~/.cache/up-samp"))
    assert kernel_cache.folder() is None
    monkeypatch.setenv(files.VARIABLE, "/somewhere")
    assert kernel_cache.folder() == Path("/somewhere/kernels")


def modules():
    for package in (up_samp.geometry, up_samp.motion):
        for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            module = importlib.import_module(found.name)
            if kernel_cache.kernels_need(Path(module.__file__)):
                yield module


@pytest.mark.parametrize("module", list(modules()), ids=lambda m: m.__name__)
def test_a_kernel_s_key_covers_all_that_it_is_made_of(module):
    """Whatever a kernel takes from another module of ours is in the hash of its file's name."""
    path = Path(module.__file__)
    covered = {path.with_name("?")} | closure(path)
    origins = {}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("up_samp"):
            for alias in node.names:
                origins[alias.asname or alias.name] = (node.module, alias.name)
    for value in vars(module).values():
        if not isinstance(value, numba.core.dispatcher.Dispatcher):
            continue
        if value.py_func.__module__ != module.__name__:
            continue
        for name in names_of(value.py_func.__code__):
            if name in origins:
                origin = importlib.import_module(origins[name][0])
                assert Path(origin.__file__) in covered, (value, name)
            elif name in vars(module):
                made_here = vars(module)[name]
                assert is_plain(made_here) or made_here in (heapq, math, np, numba), (value, name)


@pytest.mark.parametrize("module", list(modules()), ids=lambda m: m.__name__)
def test_who_counts_no_uses_of_arrays_is_given_none_that_are_counted(module):
    """Nobody would give back what one that counts returns to one that does not."""
    for value in vars(module).values():
        if not is_lean(value) or value.py_func.__module__ != module.__name__:
            continue
        for name in names_of(value.py_func.__code__):
            called = vars(module).get(name)
            if isinstance(called, numba.core.dispatcher.Dispatcher) and not is_lean(called):
                returned = typing.get_type_hints(called.py_func)["return"]
                assert holds_no_arrays(returned), (value, name)


def is_lean(value):
    options = getattr(value, "targetoptions", {})
    return isinstance(value, numba.core.dispatcher.Dispatcher) and not options["_nrt"]


def holds_no_arrays(kind):
    if kind in (bool, float, int, type(None)):
        return True
    record = isinstance(kind, type) and issubclass(kind, tuple)
    parts = typing.get_type_hints(kind).values() if record else typing.get_args(kind)
    return len(parts) > 0 and all(map(holds_no_arrays, parts))


def closure(path):
    """The files whose sources make up the key of a module's kernels."""
    seen, todo = set(), [path]
    while todo:
        here = todo.pop()
        if here not in seen:
            seen.add(here)
            todo += kernel_cache._compiled_in(here.read_text())
    return seen


def names_of(code):
    inside = [c for c in code.co_consts if isinstance(c, types.CodeType)]
    return set(code.co_names).union(*map(names_of, inside))


def is_plain(value):
    dispatcher = numba.core.dispatcher.Dispatcher
    if isinstance(value, type):  # a record of the kernel's own module
        return issubclass(value, tuple) and hasattr(value, "_fields")
    return isinstance(value, int | float | str | tuple | np.ndarray | np.generic | dispatcher)


def test_the_word_about_a_full_disk(tmp_path, monkeypatch, caplog):
    def full(path, mode):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kernel_cache, "whole", full)
    with caplog.at_level(logging.WARNING):
        kernel_cache._write(tmp_path / "x.kernel", b"data")
    assert "No space left on device" in caplog.text
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("on_the_clock")
def test_time_limits_stand_still_while_kernels_are_compiled(tmp_path, monkeypatch):
    monkeypatch.setenv(files.VARIABLE, str(tmp_path))
    source = tmp_path / "slow_to_compile.py"
    source.write_text(SOURCE.format(step=1.0, extra=0.25))
    module = types.ModuleType("slow_to_compile")
    exec(compile(source.read_text(), str(source), "exec"), module.__dict__)
    numba.njit(lambda x: x + 1.0)(1.0)  # loads numba's own parts
    deadline, began = Deadline.after(100.0), time.monotonic()
    moment = deadline.moment
    assert module.outer(np.ones(3)) == 3.25
    spent = time.monotonic() - began
    assert deadline.elapsed() < 0.5 * spent
    assert deadline.remaining() > 100.0 - 0.5 * spent
    assert 0.5 * spent < deadline.moment - moment <= spent
