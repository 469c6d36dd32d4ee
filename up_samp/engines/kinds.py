"""Which problems ``samp-refine`` takes, given the engine that it wraps."""

from __future__ import annotations

from typing import Any

from unified_planning.model import ProblemKind

COMPILED = (
    "SCHEDULING",
    "OPTIONAL_ACTIVITIES",
    "SCOPED_CONSTRAINTS",
    "EXISTENTIAL_CONDITIONS",
    "UNIVERSAL_CONDITIONS",
    "FORALL_EFFECTS",
    "NEGATIVE_CONDITIONS",
    "DISJUNCTIVE_CONDITIONS",
    "EQUALITIES",
    "OBJECT_FLUENTS",
    "FLAT_TYPING",
    "HIERARCHICAL_TYPING",
    "BOOL_ACTION_PARAMETERS",
    "BOUNDED_TYPES",
    "DISCRETE_NUMBERS",
    "DISCRETE_TIME",
    "CONTINUOUS_TIME",
    "TIMED_EFFECTS",
    "TIMED_GOALS",
    "DURATION_INEQUALITIES",
    "INT_TYPE_DURATIONS",
    "REAL_TYPE_DURATIONS",
    "INTERMEDIATE_CONDITIONS_AND_EFFECTS",
    "EXTERNAL_CONDITIONS_AND_EFFECTS",
    "MAKESPAN",
)
"""What the compilers bring to every engine that can schedule."""

PASSED_ON = (
    "SELF_OVERLAPPING",
    "STATIC_FLUENTS_IN_DURATIONS",
    "STATIC_FLUENTS_IN_BOOLEAN_ASSIGNMENTS",
    "STATIC_FLUENTS_IN_OBJECT_ASSIGNMENTS",
)
"""What a wrapped engine keeps of its own kind. Of what is not here some problems can be told to
it and some cannot, which a kind does not tell (numbers that are assigned, counted, or read over
intervals; effects on conditions; durations of parameters): engines that are asked by name try."""

_OTHER_METRICS = ("ACTIONS_COST", "FINAL_VALUE", "PLAN_LENGTH", "OVERSUBSCRIPTION")


def samp_kind(engine: Any) -> ProblemKind:
    """Return what an engine's kind (a UP engine class) becomes with compilers and motions."""
    kind = engine.supported_kind()  # which engines may share: it is not changed
    if getattr(engine, "has_sessions", False):  # nothing is compiled for it
        return ProblemKind({*kind.features, "SAMP"}, version=kind.version)
    own = {f for f in PASSED_ON if f in kind.features}
    return ProblemKind({*COMPILED, *own, "SAMP"}, version=kind.version)


def proves_optima(problem_kind: ProblemKind) -> bool:
    """Return whether optima of such problems are proven: with motions, of the makespan alone."""
    features = problem_kind.features
    return "SAMP" not in features or not any(m in features for m in _OTHER_METRICS)
