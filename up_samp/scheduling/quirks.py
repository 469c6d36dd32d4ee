"""What known engines really do, where that differs from what they say."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

_KNOWN = (
    ("aries", "up_aries", "Aries"),
    ("aries-opt", "up_aries", "AriesOpt"),
    ("cpse", "cpse", "CPSE"),
)


@dataclass(frozen=True)
class Quirks:
    """How far an engine can be believed, and what it must not be given.

    Attributes:
        optional: understands optional activities (presence) itself.
        assignments: understands effects that assign values to fluents, and conditions on them.
        hierarchical_types: understands types below other types.
        resources_with_variable_durations: counts resources rightly then.
        intervals_of_numbers: takes conditions on numbers over intervals.
        empty_intervals: takes a condition over an empty interval as none.
        times_of_others: conditions and effects may be at times of other activities, and conditions
            before the plan's end.
        products: multiplies by constants.
        without_least: takes numbers without a least value.
        without_greatest: takes numbers without a greatest value.
        proves_unsolvable: its ``UNSOLVABLE_PROVEN`` is a proof.
        message_limit: largest problem in bytes of protobuf, if it is sent to a server.
        environment: environment variables to set for its process.
        satisficing: class of the same module to ask instead where no optimum is wanted, or this
            one breaks down.
    """

    optional: bool
    assignments: bool
    hierarchical_types: bool = True
    resources_with_variable_durations: bool = True
    intervals_of_numbers: bool = True
    empty_intervals: bool = True
    times_of_others: bool = True
    products: bool = True
    without_least: bool = True
    without_greatest: bool = True
    proves_unsolvable: bool = True
    message_limit: int | None = None
    environment: tuple[tuple[str, str], ...] = ()
    satisficing: str | None = None


# Its time ends at 10,000 unless it is told otherwise: whatever takes longer is "unsolvable". At
# ten times this its server crashes.
_HORIZON = ("ARIES_PLANNING_HORIZON", "100000000")
_ARIES = Quirks(
    optional=False,  # 0.5.0 ignores ``optional`` without a word
    assignments=True,
    resources_with_variable_durations=False,
    intervals_of_numbers=False,  # its server crashes
    empty_intervals=False,
    times_of_others=False,  # takes them for its own, or never: calls the wrong plan optimal
    products=False,  # "Unsupported operator up:times"
    without_least=False,  # "Unsupported type up:integer[-inf, 5]"
    without_greatest=False,
    proves_unsolvable=False,
    message_limit=4 * 2**20,
)
# Of its search strategies, "causal" finds first plans of SAMP relaxations far sooner than the
# others, with which it would have to share the processor; for proofs it needs a companion. Some
# small problems crash the prover's server ("No such key", "index out of bounds").
_ARIES_FIRST = replace(_ARIES, environment=(_HORIZON, ("ARIES_STRATEGIES", "causal")))
_ARIES_PROOF = replace(
    _ARIES, environment=(_HORIZON, ("ARIES_STRATEGIES", "causal,activity")), satisficing="Aries"
)
_CPSE = Quirks(
    optional=True,
    assignments=False,  # passes ``supports()``, fails in ``solve``
    hierarchical_types=False,  # gives a wrong UNSOLVABLE_PROVEN
    without_least=False,  # takes 0 for it: likewise
)
_TABLE = {
    ("up_aries", "Aries"): _ARIES_FIRST,
    ("up_aries", "AriesOpt"): _ARIES_PROOF,
    ("cpse", "CPSE"): _CPSE,
    ("cpse", "CPSETimepoints"): _CPSE,
}


def known_engines() -> list[tuple[str, str, str]]:
    """Return ``(name, module, class)`` of the installed engines that we know how to wrap."""
    return [k for k in _KNOWN if importlib.util.find_spec(k[1]) is not None]


def schedulers() -> tuple[str, ...]:
    """Return the names of the installed engines that ``samp-refine[...]`` is known to wrap."""
    return ("cpsat", *(name for name, _, _ in known_engines()))


def no_engine(name: str, engines: Iterable[str]) -> str:
    """Return what to tell who asks for an engine that is not there: those of its sort that are."""
    family, bracket, _ = name.partition("[")
    mine = sorted(e for e in engines if e.startswith(family + bracket)) if bracket else []
    return f"there is no engine '{name}'; there are: {', '.join(mine or sorted(engines))}"


def quirks_of(engine: Any) -> Quirks:
    """Return the table's entry for an engine class, else what its ``supported_kind`` says."""
    for cls in engine.__mro__:
        known = _TABLE.get((cls.__module__.split(".")[0], cls.__name__))
        if known is not None:
            return known
    kind = engine.supported_kind()
    optional = kind.has_optional_activities() and kind.has_scoped_constraints()
    return Quirks(
        optional=optional,
        assignments=kind.has_object_fluents(),
        hierarchical_types=kind.has_hierarchical_typing(),
        resources_with_variable_durations=kind.has_increase_effects()
        and kind.has_decrease_effects(),
        times_of_others=optional,  # without it, who is absent has times, too
    )


def is_compatible(engine: Any) -> bool | str:
    """Return whether an engine class can schedule at all: ``True``, or the reason why not."""
    from unified_planning.engines.mixins import OneshotPlannerMixin

    name = getattr(engine, "__name__", str(engine))
    if not (isinstance(engine, type) and issubclass(engine, OneshotPlannerMixin)):
        return f"{name} is not a oneshot planner"
    kind = engine.supported_kind()  # type: ignore[attr-defined]
    if not kind.has_scheduling():
        return f"{name} does not support scheduling problems"
    if not (kind.has_continuous_time() or kind.has_discrete_time()):
        return f"{name} does not support time"
    return True
