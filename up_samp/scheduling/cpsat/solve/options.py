"""The profiles under which CP-SAT is run: its options at each stage of a solve.

How long each may take stands beside its use: :mod:`.attempts`, :mod:`.strategy`.
"""

from __future__ import annotations

from typing import Any

from ortools.sat.python import cp_model

Profile = dict[str, Any]

_LIGHT = {"cp_model_probing_level": 0, "symmetry_level": 0}
NO_LINEARIZATION: Profile = {**_LIGHT, "linearization_level": 0}
FIXED_SEARCH: Profile = {
    **NO_LINEARIZATION,
    "search_branching": cp_model.FIXED_SEARCH,
    "num_workers": 1,
}
DIVE: Profile = {**FIXED_SEARCH, "max_number_of_conflicts": 30}
"""A dive that leads somewhere has few conflicts; many take far longer than CP-SAT counts."""
LINEARIZATION: Profile = {**_LIGHT, "linearization_level": 1}
# No interleave_search: with several workers it aborts the process ("heuristics.fixed_search"). No
# use_dynamic_precedence_in_disjunctive, which makes shops quicker: it does so, too ("adding
# conflicting constraint at positive level").
CP_SATS_OWN: Profile = {}

IGNORED = ("ls*", "fj*")
"""Never run: CP-SAT's local search over violations and its feasibility jump write beyond their
memory (OR-Tools 9.15). Of 180 runs of a job shop's routing relaxation with two workers and ``ls``,
ten ended the process ("free(): invalid next size"); of 120 without it, none. With ``fj``, small
relaxations without a solution do: benchmarks/reliability/memory.py shows it, and whether a newer
OR-Tools is any better.
"""

NO_PRESOLVE: Profile = {
    **NO_LINEARIZATION,
    "num_workers": 1,
    "cp_model_presolve": False,
    "use_objective_lb_search": True,
}
"""For small problems, where presolve costs more than the search."""
NO_INPROCESSING: Profile = {**NO_PRESOLVE, "use_sat_inprocessing": False}
"""The same with a schedule near the bound in hand: half of so short a proof is inprocessing."""
ONE_PRESOLVE_PASS: Profile = {
    **NO_LINEARIZATION,
    "num_workers": 1,
    "max_presolve_iterations": 1,
}
"""For the whole problem with a schedule near the bound in hand: what presolve and a relaxation cost
is more than such a proof mostly takes."""
TWO_FULL_SEARCHES: Profile = {
    "subsolvers": ("no_lp", "default_lp"),
    "num_full_subsolvers": 2,
}
"""Two full searches that share what they learn: one without a linear relaxation, which proves most
shops, and one with it, which decides where loads do. CP-SAT's own choice for two workers is one
full search and local search beside it, which does not prove ft10 in 20 s."""
ONE_THREAD: tuple[Profile, ...] = (
    {"num_workers": 1, "linearization_level": 0},
    {"num_workers": 1, "linearization_level": 1},
)
"""The same with one thread: by turns, each starting from what the last one found."""
