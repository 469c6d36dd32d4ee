"""The ordered list of compilers that an engine needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from up_samp.model import CandidateSchedule, check_time
from up_samp.scheduling.compilers.constraints import (
    compile_differences,
    compile_negations,
    compile_products,
    compile_rules,
)
from up_samp.scheduling.compilers.exclusion import compile_resources
from up_samp.scheduling.compilers.fluents import compile_ground, compile_instances, compile_numbers
from up_samp.scheduling.compilers.intervals import (
    compile_apart,
    compile_dense,
    compile_ends,
    compile_intervals,
    compile_stillness,
    compile_support,
    refuse_times_of_others,
)
from up_samp.scheduling.compilers.optional import (
    compile_anchor,
    compile_optional,
    compile_variables,
)
from up_samp.scheduling.compilers.plain import Compiled, PlainProblem
from up_samp.scheduling.compilers.precedences import compile_precedences
from up_samp.scheduling.compilers.types import compile_flat_types, compile_names, compile_unused
from up_samp.scheduling.quirks import Quirks

Compiler = Callable[[PlainProblem], Compiled]


def compilers_for(quirks: Quirks, *, apart: bool = False) -> list[Compiler]:
    """Return the passes, in order, that make a problem fit an engine.

    ``apart`` says once more, by differences, that effects keep out of others' conditions.
    """
    passes: list[Compiler] = [compile_rules, compile_ground]
    if not quirks.times_of_others:
        passes.append(refuse_times_of_others)
    if quirks.assignments:  # the precedences below say it themselves
        passes.append(compile_ends)
    passes += [compile_dense, compile_stillness, compile_support]
    if apart:
        passes.append(compile_apart)
    if not quirks.hierarchical_types:
        passes.append(compile_flat_types)
    if not quirks.assignments:
        passes += [compile_instances, compile_precedences]
    if not quirks.intervals_of_numbers:
        passes.append(compile_numbers)
    if not quirks.resources_with_variable_durations:
        passes.append(compile_resources)
    if not quirks.empty_intervals:
        passes.append(compile_intervals)
    passes += [compile_negations, compile_differences]
    if not quirks.products:
        passes.append(compile_products)
    if not quirks.optional:
        passes.append(compile_optional)
    if not quirks.reports_variables:
        passes.append(compile_variables)
    passes += [compile_anchor, compile_unused, compile_names]
    return passes


def chain(problem: PlainProblem, passes: Sequence[Compiler]) -> Compiled:
    """Run the passes one after the other; their maps back run the other way round."""
    backs: list[Callable[[CandidateSchedule], CandidateSchedule]] = []
    floor, exact = 0, True
    for compiler in passes:
        check_time()
        compiled = compiler(problem)
        problem, floor = compiled.problem, max(floor, compiled.floor)
        exact = exact and compiled.exact
        backs.append(compiled.map_back)

    def map_back(schedule: CandidateSchedule) -> CandidateSchedule:
        for back in reversed(backs):
            schedule = back(schedule)
        return schedule

    return Compiled(problem, map_back, floor, exact)
