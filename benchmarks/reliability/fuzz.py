"""Hunt for invalid plans, false proofs, exceptions, lateness and leftovers among random problems.

    python benchmarks/reliability/fuzz.py --first 0 --count 1000 --out fuzz.jsonl
    python benchmarks/reliability/fuzz.py --merge fuzz.jsonl more.jsonl

Every finding is printed with its seed, which makes it again. A run goes on where its output file
ended. Problems are solved in a process that is watched: one that dies or hangs costs its problem
only. ``--merge`` makes one table of several files.
"""

from __future__ import annotations

import argparse
import functools
import os
import signal
import sys
import tempfile
import time
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.fuzz import herd
from tests.fuzz.table import report


def run(args: argparse.Namespace) -> list[dict]:
    """Have the seeds that are not in the output file solved; return all rows."""
    known = {r["seed"] for r in herd.read_rows(args.out)}
    seeds = [s for s in range(args.first, args.first + args.count) if s not in known]
    stop = time.monotonic() + args.minutes * 60
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that what was started is ended
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        os.environ["TMPDIR"] = folder  # so that what is left behind is ours
        herd.watch(herd.again(Path(__file__), sys.argv[1:]), seeds, args.out, stop)
    return herd.read_rows(args.out)


def work(args: argparse.Namespace) -> None:
    """Be the watched process: the seeds come on standard input."""
    from tests.fuzz.rows import ENGINES, SORTS, Mix, row_of
    from up_samp.model import MotionModel
    from up_samp.motion.compile import precompile

    warnings.simplefilter("ignore")
    precompile(MotionModel)
    mix = Mix(args.sorts or SORTS, args.engines or ENGINES, args.attacks, args.timeout, args.maps)
    with tempfile.TemporaryDirectory(prefix="maps-") as folder:
        told = functools.partial(_told, folder=Path(folder), mix=mix, row_of=row_of)
        herd.work(map(int, sys.stdin.read().split()), told, args.out)


def _told(seed: int, *, folder: Path, mix, row_of) -> dict:
    row = row_of(seed, folder, mix)
    findings = [*row["wrong"], *(f"(other motions are faster) {x}" for x in row["faster"])]
    findings += [f"(refused) {row['refused']}"] if row.get("refused") else []
    for line in findings:
        print(f"seed {seed} {row['sort']} {row['engine']}: {line}", file=sys.stderr, flush=True)
    return row


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--timeout", type=float, default=6.0)
    parser.add_argument("--minutes", type=float, default=1e6)
    parser.add_argument("--engines", nargs="+", help="drawn as often as named")
    parser.add_argument(
        "--sorts", nargs="+", help="small, wide, first, decisions, coarse: likewise"
    )
    parser.add_argument("--attacks", type=int, default=2, help="for each proof, by chance")
    parser.add_argument("--maps", type=Path, help="folder with ROS maps to be drawn from, too")
    parser.add_argument("--out", type=Path, default=Path("fuzz.jsonl"))
    parser.add_argument("--merge", type=Path, nargs="+", help="only report on these files")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    args.maps = tuple(sorted(map(str, args.maps.rglob("*.yaml")))) if args.maps else ()
    if args.child:
        work(args)
        return 0
    rows = [r for f in args.merge for r in herd.read_rows(f)] if args.merge else run(args)
    print("\n".join(report(rows)))
    return 1 if any(r["wrong"] for r in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
