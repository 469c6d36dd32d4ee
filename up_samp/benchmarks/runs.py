"""What a benchmark run is, and which runs a sweep consists of. Plain values, ready for JSON."""

from __future__ import annotations

import dataclasses
import fnmatch
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from up_samp.benchmarks.builder import Encoding, check_encoding
from up_samp.benchmarks.instances import Instance, families, instance, instances
from up_samp.model import ProblemError

Record = dict[str, Any]
"""The outcome of a run, as one line of JSON.

Always there: ``key`` and the fields of :class:`RunSpec`; ``status`` (a UP status name, or
``CRASH``, ``KILLED``, ``MEMOUT``); ``finished`` (UTC); ``versions``; ``machine``. Where it came so
far: ``activities``; ``seconds_build``, ``seconds`` (the engine's call), ``seconds_cpu`` (its CPU
time, with that of child processes), ``seconds_validation``, ``seconds_process``; ``metrics`` (the
engine's, with rounds, bounds, refinements by layer and times by part); ``messages``, or ``error``
and ``traceback``. With a plan: ``valid`` and
``violations`` (by the independent validator), ``makespan``, and ``sequential`` (units, one thing
after another).
"""


@dataclass(frozen=True)
class RunSpec:
    """One run: an engine on an instance.

    ``optimal`` asks for a proof of optimality; without it the first plan is wanted and the problem
    has no metric. ``timeout`` in s is the engine's; ``memory`` in MB bounds the data of the run's
    process. ``number`` tells repeated runs apart and seeds them.
    """

    instance: str
    engine: str
    encoding: Encoding = "fluents"
    preset: str = "default"
    optimal: bool = True
    number: int = 0
    timeout: float = 60.0
    memory: int = 20_000
    tuning: str = ""
    """Tunables that are not the defaults, as JSON (so that a run's process gets them)."""

    def __post_init__(self) -> None:
        check_encoding(self.encoding)
        if self.timeout <= 0 or self.memory <= 0:
            raise ProblemError("a run needs a positive timeout (s) and memory limit (MB)")

    @property
    def key(self) -> str:
        """What identifies the run in a sweep; limits are part of it."""
        goal = "opt" if self.optimal else "sat"
        return "|".join(
            (
                self.instance,
                self.engine,
                self.encoding,
                self.preset,
                goal,
                f"{self.timeout:g}s",
                f"{self.memory}MB",
                str(self.number),
                *([self.tuning] if self.tuning else []),
            )
        )

    @property
    def column(self) -> str:
        """The heading that the run counts under in a report."""
        preset = "" if self.preset == "default" else f", {self.preset}"
        goal = "optimal" if self.optimal else "first plan"
        tuning = f", {self.tuning}" if self.tuning else ""
        return f"{self.engine}, {self.encoding}{preset}, {goal}, {self.timeout:g} s{tuning}"

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values."""
        return dataclasses.asdict(self)


def select(names: Sequence[str]) -> list[Instance]:
    """Return the instances that ``names`` say: families, ``paper``, instances, or patterns such
    as ``logistics-oc-*-r1-*``; each once, in the order given.

    :raises ProblemError: if a name matches nothing.
    """
    chosen: dict[str, Instance] = {}
    for name in names:
        if name == "paper" or name in families():
            found = instances(name)
        elif any(c in name for c in "*?["):
            everything = itertools.chain.from_iterable(instances(f) for f in families())
            found = [i for i in everything if fnmatch.fnmatchcase(i.name, name)]
            if not found:
                raise ProblemError(f"no instance matches {name!r}")
        else:
            found = [instance(name)]
        chosen.update((i.name, i) for i in found)
    return list(chosen.values())


def sweep(
    chosen: Sequence[Instance],
    engines: Sequence[str],
    *,
    encodings: Sequence[Encoding] = ("fluents",),
    presets: Sequence[str] = ("default",),
    tunings: Sequence[str] = ("",),
    optimal: bool = True,
    runs: int = 1,
    timeout: float = 60.0,
    memory: int = 20_000,
) -> list[RunSpec]:
    """Return all runs of a sweep; repetitions come last, so that an early stop covers most."""
    return [
        RunSpec(i.name, engine, encoding, preset, optimal, number, timeout, memory, tuning)
        for number, i, engine, encoding, preset, tuning in itertools.product(
            range(runs), chosen, engines, encodings, presets, tunings
        )
    ]
