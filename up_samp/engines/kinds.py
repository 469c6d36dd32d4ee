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
    "INCREASE_EFFECTS",
    "DECREASE_EFFECTS",
    "INT_FLUENTS",
    "BOUNDED_TYPES",
    "DISCRETE_NUMBERS",
    "NUMERIC_FLUENTS",
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
"""What the compilers bring to every engine that can schedule; a wrapped engine that still lacks
something is refused by name when the problem is compiled for it."""


def engine_kind(engine: Any) -> ProblemKind:
    """Return a copy of an engine's kind (engines may return a shared object)."""
    return engine.supported_kind().clone()


def samp_kind(kind: ProblemKind) -> ProblemKind:
    """Return the kind of a wrapped engine with what compilers and motions add."""
    features = {f for f in kind.features if f not in _OTHER_CLASSES}
    features |= set(COMPILED) | {"SAMP"}
    return ProblemKind(features, version=kind.version)


_OTHER_CLASSES = {"ACTION_BASED", "HIERARCHICAL", "CONTINGENT", "ACTION_BASED_MULTI_AGENT", "TAMP"}
