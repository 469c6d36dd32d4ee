"""How CP-SAT is run at each stage of a search: options, and limits in its deterministic time."""

from __future__ import annotations

from typing import Any

from ortools.sat.python import cp_model

# Building blocks
LIGHT = {"cp_model_probing_level": 0, "symmetry_level": 0}
QUICK: dict[str, Any] = {**LIGHT, "linearization_level": 0}
DIVE = {**QUICK, "search_branching": cp_model.FIXED_SEARCH, "num_workers": 1}
RELAXED = {**LIGHT, "linearization_level": 1}
# No interleave_search: with several workers it aborts the process ("heuristics.fixed_search"). No
# use_dynamic_precedence_in_disjunctive, which makes shops quicker: it does so, too ("adding
# conflicting constraint at positive level").
THOROUGH: dict[str, Any] = {}

SPRINT: dict[str, Any] = {
    **QUICK,
    "num_workers": 1,
    "cp_model_presolve": False,
    "use_objective_lb_search": True,
}
"""For small problems, where presolve costs more than the search."""
SPRINT_EFFORT = 0.005
TINY = 2_000
"""Constraints up to which a sprint is tried."""

TEAM: dict[str, Any] = {
    "subsolvers": ("no_lp", "default_lp"),
    "num_full_subsolvers": 2,
}
"""Two full searches that share what they learn: one without a linear relaxation, which proves most
shops, and one with it, which decides where loads do. CP-SAT's own choice for two workers is one
full search and local search beside it, which does not prove ft10 in 20 s."""
TEAM_EFFORT = 4.0
ALONE: tuple[tuple[dict[str, Any], float], ...] = (
    ({"num_workers": 1, "linearization_level": 0}, 0.1),
    ({"num_workers": 1, "linearization_level": 1}, 0.4),
    ({"num_workers": 1, "linearization_level": 0}, 2.0),
)
"""The same with one thread: (options, effort) one after the other, each starting from what the last
one found."""

SWIFT: dict[str, Any] = {**QUICK, "num_workers": 1, "max_presolve_iterations": 1}
"""For the whole problem with a schedule near the bound in hand: what presolve and a relaxation cost
is more than such a proof mostly takes."""
SWIFT_EFFORT = 0.3
DASH = {**SPRINT, "use_sat_inprocessing": False}
"""The same with a schedule near the bound in hand: half of so short a proof is inprocessing."""
DASH_EFFORT = 0.02

SMALL = 20_000
"""Constraints up to which a team, one thread alone, and swift proofs are tried: they must not cost
large models their time."""
COLLAPSED_EFFORT = 20.0
"""For the collapsed problem ..."""
CONTENT_EFFORT = 1.0
"""... and where no optimum is asked for: the whole problem,"""
CONTENT_COLLAPSED_EFFORT = 0.4
"""and the collapsed one."""
