"""What is done with the problem of a seed, and the row that tells what came of it."""

from __future__ import annotations

import random
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from tests.fuzz.attack import ATTACKERS, Attacker, Findings, attack
from tests.fuzz.cases import Case, random_case
from tests.fuzz.small import small_case
from tests.fuzz.wide import wide_case
from tests.oracles.clocks import Watch
from tests.soundness import decisions, judge, worlds
from tests.soundness.test_decisions import judge as judge_decisions
from up_samp.search.params import ABLATIONS

ENGINES = ("cpsat",) * 38 + ("aries", "aries-opt")
PRESETS = ("default",) * 20 + ("paper", "sequential", *ABLATIONS)
"""For the package's own scheduler; others run the default preset."""
SORTS = ("small",) * 56 + ("wide",) * 2 + ("decisions", "coarse")
"""``small``, ``wide`` and ``first`` are attacked by other engines, seeds, parameters and styles;
``decisions`` with every choice of values made; ``coarse`` by an exhaustive search of a coarse
model. Each is drawn as often as it is named.
"""
OWN = (
    *(a for a in ATTACKERS if a.engine == "cpsat"),
    Attacker("cpsat", {"preset": "sequential"}),
    Attacker("cpsat", {"without": ("small_cuts", "handovers")}),
)
STARTING = 9.0
"""Seconds more for engines in processes of their own, which have to be started."""


@dataclass(frozen=True)
class Mix:
    """What is drawn from, and how long it may take. ``attacks``: for each proof."""

    sorts: Sequence[str] = SORTS
    engines: Sequence[str] = ENGINES
    attacks: int = 2
    timeout: float = 6.0
    maps: tuple[str, ...] = ()


def row_of(seed: int, folder: Path, mix: Mix) -> dict:
    """Solve and attack the problem of a seed; return its row."""
    rng = random.Random(f"mix {seed}")
    sort, engine = rng.choice(mix.sorts), rng.choice(mix.engines)
    preset = rng.choice(PRESETS) if engine == "cpsat" else "default"
    if sort in ("decisions", "coarse"):
        return _against_truth(seed, sort, folder)
    case = _case(sort, seed, mix.maps)
    timeout = mix.timeout + (0.0 if engine == "cpsat" else STARTING)
    attackers = draw(rng, case, mix)
    found = attack(case, folder, engine=engine, timeout=timeout, attackers=attackers, preset=preset)
    return asdict(found) | {
        "sort": sort,
        "style": asdict(case.style),
        "robots": len(case.robots),
        "jobs": sum(len(r.goals) for r in case.robots),
        "bodies": sorted({r.moves for r in case.robots}),
        "map": case.floor.kind,
        "loads": [_kind(load) for load in case.loads],
        "attackers": [a.told() for a in attackers[: found.attacks]],
    }


def _case(sort: str, seed: int, maps: tuple[str, ...]) -> Case:
    if sort == "first":
        return random_case(seed)
    return (small_case if sort == "small" else wide_case)(seed, maps)


def draw(rng: random.Random, case: Case, mix: Mix) -> list[Attacker]:
    """Return different attackers by chance; own ones are drawn more often than those that have to
    start a process.
    """
    found: list[Attacker] = []
    while len(found) < mix.attacks:
        basis = rng.choice(OWN if rng.random() < 0.95 else ATTACKERS[2:3])
        style = related(rng, case) if rng.random() < 0.5 else None
        seconds = mix.timeout + (0.0 if basis.engine == "cpsat" else STARTING)
        one = replace(basis, style=style, timeout=seconds)
        if one not in found:
            found.append(one)
    return found


def related(rng: random.Random, case: Case):
    """Return another style that says the same: what is possible in it is so in the case's own.

    A door that is listed has to stand still, one in a dictionary to stand where its fluent says;
    who lists obstacles leaves out what he carries himself.
    """
    style = case.style
    others = {
        "state": ("fluents", "order"),
        "limit": ("deadline", "constraint"),
        "order": ("or", "implies"),
        "durations": ("wide", "close"),
    }
    if style.obstacles != "dict":
        others["offset"] = (0, 1)
    if not case.loads and case.door is None:
        others["obstacles"] = ("list", "all")
    if style.one_at_a_time != "all":
        others["one_at_a_time"] = ("pairs", "uses")
    return replace(style, **{k: rng.choice(v) for k, v in others.items()})


def _kind(load) -> str:
    carriers = len({name for name, _ in load.carried})
    how = "relay" if carriers > 1 else "rides" if len(load.carried) > 1 else "ride"
    return f"{load.side} {how}{', put down by other means' * load.turned}"


def _against_truth(seed: int, sort: str, folder: Path) -> dict:
    """Hold a small world against all of its decisions, or against a coarse exhaustive search."""
    found, watch = Findings(seed, "cpsat"), Watch()
    rooms = worlds.write_rooms(folder)
    if sort == "decisions":
        found.engine = "aries-opt" if zlib.crc32(b"%d" % seed) % 6 == 0 else "cpsat"
        verdict = judge_decisions(decisions.random_world(seed), rooms, found.engine)
        found.status, found.makespan = verdict.status, verdict.makespan
        found.wrong, found.attacks = list(verdict.wrong), verdict.attacks
    else:
        told = judge.judge(worlds.random_world(seed), rooms, samples=10, seconds=4.0)
        found.status, found.makespan = told.status, told.makespan
        found.wrong, found.attacks = told.wrong + told.motion, told.plans
        if told.costly and told.best is not None and len(told.wrong) == 1:
            # what is beaten is a relative proof: the coarse model knows a faster motion
            found.faster, found.wrong = told.wrong, told.motion
    found.seconds = watch.seconds
    return asdict(found) | {"sort": sort}
