"""Caches with harmed files, and caches that two processes fill at once."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

from tests.faults.expected import ended
from tests.faults.stage import run
from up_samp.system.files import VARIABLE, cache_folder


def harm(rng: random.Random, file: Path) -> None:
    """Harm a file in one of the ways in which files are harmed."""
    data = file.read_bytes()
    how = rng.choice(("empty", "cut", "flip", "noise", "gone", "long", "swap"))
    if how == "gone":
        file.unlink()
    elif how == "empty":
        file.write_bytes(b"")
    elif how == "cut":
        file.write_bytes(data[: rng.randrange(max(1, len(data)))])
    elif how == "noise":
        file.write_bytes(rng.randbytes(len(data)))
    elif how == "long":
        file.write_bytes(data + rng.randbytes(100))
    elif how == "swap":
        other = rng.choice(sorted(file.parent.iterdir()))
        file.write_bytes(other.read_bytes() if other.is_file() else b"")
    elif data:
        at = rng.randrange(len(data))
        file.write_bytes(data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :])


def harmed_kernels(folder: Path, rng: random.Random) -> list[str]:
    """Some files of the cache of kernels are harmed: they are compiled again."""
    own = folder / "cache"
    if not own.exists():
        known = cache_folder()
        if known is None or not (known / "kernels").exists():
            return ["there are no kernels yet to be harmed: solve anything first"]
        passing = shutil.ignore_patterns("*.lock", "*.part")  # of who compiles just now
        shutil.copytree(known / "kernels", own / "kernels", ignore=passing)
    files = sorted(p for p in (own / "kernels").iterdir() if p.is_file())
    for file in rng.sample(files, min(3, len(files))):
        harm(rng, file)
    outcome = run(folder, {"timeout": 30}, environment={VARIABLE: str(own)}, timeout=600)
    wrong = ended(outcome, "SOLVED_OPTIMALLY")
    litter = [p.name for p in (own / "kernels").iterdir() if p.suffix in (".part", ".lock")]
    return wrong + [f"left in the cache: {litter}"] * bool(litter)


def cold_cache(folder: Path, _rng: random.Random) -> list[str]:
    """Two processes start on an empty cache of kernels at once."""
    cold = {VARIABLE: str(folder / "cold")}
    shutil.rmtree(folder / "cold", ignore_errors=True)
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(2) as pool:
        runs = [
            pool.submit(run, folder / str(k), {"timeout": 60}, environment=cold, timeout=900)
            for k in range(2)
        ]
        wrong = [w for r in runs for w in ended(r.result(), "SOLVED_OPTIMALLY")]
    litter = [p.name for p in (folder / "cold" / "kernels").iterdir() if p.suffix == ".part"]
    return wrong + [f"left in the cache: {litter}"] * bool(litter)
