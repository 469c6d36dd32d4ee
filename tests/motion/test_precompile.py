"""What is compiled before time limits run, and how that is known."""

import os

import pytest

from up_samp.model import MotionModel
from up_samp.motion import compile as module


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_cache_folder", lambda: tmp_path)
    monkeypatch.setattr(module, "PARTS", dict.fromkeys(module.PARTS, lambda: None))
    return tmp_path


def test_every_part_is_missing_until_it_was_compiled(folder):
    assert module.missing(module.PARTS) == tuple(module.PARTS)
    module.compile_part("groups")
    assert "groups" not in module.missing(module.PARTS)
    assert "paths" in module.missing(module.PARTS)


def test_a_changed_source_has_to_be_compiled_again(folder, tmp_path, monkeypatch):
    kernels, plain = tmp_path / "kernels.py", tmp_path / "plain.py"
    kernels.write_text("@njit")
    plain.write_text("pass")
    monkeypatch.setattr(module, "_sources", lambda: [kernels, plain])
    module.compile_part("paths")
    assert module.missing(["paths"]) == ()
    os.utime(plain, (1, 1))
    assert module.missing(["paths"]) == ()
    os.utime(kernels, (1, 1))
    assert module.missing(["paths"]) == ("paths",)
    module.compile_part("paths")
    assert module.missing(["paths"]) == ()
    monkeypatch.setattr(module.numba, "__version__", "another")
    assert module.missing(["paths"]) == ("paths",)


def test_a_part_that_fails_leaves_no_mark(folder, monkeypatch):
    def fails():
        raise RuntimeError("no compiler")

    monkeypatch.setitem(module.PARTS, "paths", fails)
    with pytest.raises(RuntimeError, match="no compiler"):
        module.compile_part("paths")
    assert module.missing(["paths"]) == ("paths",)


def test_each_part_is_compiled_once_for_several_motion_models():
    parts = [p for chain in module.chains_for(MotionModel) for p in chain]
    assert sorted(parts) == sorted(module.PARTS)
