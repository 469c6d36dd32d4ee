"""How much longer a search computes for the way in which a problem is written.

    python benchmarks/search/styles.py [--families shop store] [--seeds 3] [--timeout 60] --out FILE

Each site of ``tests/metamorphic`` is solved in every style, first to last and again for each seed.
Prints, per style, the time to the first plan and to the proof as a ratio to the style of the same
meaning that was fastest on the same site (without a plan or a proof: the time limit), their median
and the worst, and all contradictions. Times are s of computing by all threads; what takes less than
``--least`` of them counts as that. A run that was stopped goes on where its file ended.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import sys
import tempfile
import warnings
from collections import defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import unified_planning
from unified_planning.engines import PlanGenerationResultStatus as Status

import up_samp  # noqa: F401  (registers the engines)
from tests.metamorphic.answers import Answer, answer, contradictions
from tests.metamorphic.motions import ALIKE, OTHERS, MotionStyle
from tests.metamorphic.sites import FAMILIES, shop
from up_samp.model import MotionModel
from up_samp.motion.compile import precompile

warnings.simplefilter("ignore")
STYLES = {str(style): style for style in (*ALIKE, *OTHERS, MotionStyle(moves="go"))}


def main() -> None:
    """Run what has no record yet, and print the tables."""
    options = arguments()
    unified_planning.environment.get_environment().credits_stream = None
    precompile([MotionModel.SE2])
    records = [json.loads(x) for x in options.out.read_text().splitlines()] if (
        options.out.exists()
    ) else []  # fmt: skip
    known = {(r["family"], r["seed"], r["style"]) for r in records}
    todo = set(itertools.product(options.families, range(options.seeds), STYLES)) - known
    with tempfile.TemporaryDirectory(prefix="styles-") as folder, options.out.open("a") as out:
        if todo:  # what is loaded and compiled once must not count for the first style
            answer(shop(0, robots=2, jobs=1), next(iter(STYLES.values())), Path(folder))
        for family in options.families:
            for seed in range(options.seeds):
                site = FAMILIES[family](seed)
                for name, style in STYLES.items():
                    if (family, seed, name) not in todo:
                        continue
                    found = answer(site, style, Path(folder), timeout=options.timeout)
                    records.append({"family": family, "seed": seed, **to_record(found)})
                    out.write(json.dumps(records[-1]) + "\n")
                    out.flush()
    chosen = [r for r in records if r["family"] in options.families and r["seed"] < options.seeds]
    show(chosen, options.timeout, options.least)


def to_record(found: Answer) -> dict:
    """Return an answer as plain values."""
    return {
        "style": str(found.style),
        "status": found.status.name,
        "makespan": found.makespan,
        "bound": found.bound,
        "refused": found.refused,
        "first": found.first,
        "seconds": found.seconds,
        "why": found.why,
    }


def to_answer(record: dict) -> Answer:
    """Return a record as an answer."""
    style: MotionStyle = STYLES[record["style"]]
    rest = {k: v for k, v in record.items() if k not in ("family", "seed", "style", "status")}
    return Answer(style=style, status=Status[record["status"]], **rest)


def show(records: list[dict], limit: float, least: float) -> None:
    """Print ratios per style, over all, and what contradicts itself."""
    by_site = defaultdict(list)
    for r in records:
        by_site[r["family"], r["seed"]].append(to_answer(r))
    first, proof = defaultdict(list), defaultdict(list)
    for answers in by_site.values():
        for units in {a.style.units for a in answers}:
            alike = [a for a in answers if a.style.units == units]
            ratios(first, {str(a.style): a.first or limit for a in alike}, least)
            done = {
                str(a.style): a.seconds if a.status is Status.SOLVED_OPTIMALLY else limit
                for a in alike
            }
            ratios(proof, done, least)
    print("first plan: median  worst   proof: median  worst   style")
    for name in STYLES:
        if name in first:
            print(f"{line(first[name])}          {line(proof[name])}   {name}")
    print(f"{line(flat(first))}          {line(flat(proof))}   all")
    for (family, seed), answers in by_site.items():
        solved = sum(a.makespan is not None for a in answers)
        proven = sum(a.status is Status.SOLVED_OPTIMALLY for a in answers)
        print(f"{family} {seed}: {solved} plans, {proven} proven, of {len(answers)}")
        for text in contradictions(answers):
            print(f"  CONTRADICTION: {text}")


def ratios(found: dict[str, list[float]], times: dict[str, float], least: float) -> None:
    """Add each time's ratio to the best of ``times``."""
    best = max(least, min(times.values()))
    for name, seconds in times.items():
        found[name].append(max(seconds, best) / best)


def flat(by_style: dict[str, list[float]]) -> list[float]:
    """Return all ratios."""
    return [x for some in by_style.values() for x in some]


def line(some: list[float]) -> str:
    """Return median and worst as text."""
    return f"{statistics.median(some):18.2f} {max(some):6.2f}"


def arguments() -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--families", nargs="+", default=list(FAMILIES), choices=list(FAMILIES))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--timeout", type=float, default=60.0, help="s for each run")
    parser.add_argument("--least", type=float, default=1.0, help="s; less is noise")
    parser.add_argument("--out", type=Path, required=True, help="a record a line")
    return parser.parse_args()


if __name__ == "__main__":
    main()
