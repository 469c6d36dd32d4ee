"""The wheel holds all that the package needs, and works where the sources are not."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = """
import os, sys
sources, target = sys.argv[1:3]
sys.path[:] = [target] + [p for p in sys.path if os.path.realpath(p or ".") != sources]
import up_samp
assert os.path.realpath(up_samp.__file__).startswith(os.path.realpath(target)), up_samp.__file__
from up_samp.cli import main
sys.exit(main(["solve", "jobshop-r1-j1-m1", "--out", "out", "--timeout", "120"]))
"""


@pytest.mark.long
def test_a_wheel_works_without_the_sources(tmp_path):
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    # a copy: setuptools leaves a build folder beside the sources
    sources = tmp_path / "sources"
    sources.mkdir()
    names = ("up_samp", "pyproject.toml", "setup.py", "README.md", "LICENSE")
    subprocess.run(["cp", "-r", *(str(ROOT / n) for n in names), str(sources)], check=True)
    subprocess.run(
        [*pip, "wheel", str(sources), "--no-deps", "--no-build-isolation", "-w", str(tmp_path)],
        check=True,
    )
    (wheel,) = tmp_path.glob("up_samp-*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    ours = subprocess.run(
        ["git", "ls-files", "up_samp"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    assert sorted(f for f in ours if f not in held) == []
    target = tmp_path / "installed"
    subprocess.run([*pip, "install", "--no-deps", "--target", str(target), str(wheel)], check=True)
    done = subprocess.run(
        [sys.executable, "-P", "-c", CODE, str(ROOT), str(target)],
        cwd=tmp_path, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {f.name for f in (tmp_path / "out").iterdir()} >= {"plan.json", "animation.html"}
