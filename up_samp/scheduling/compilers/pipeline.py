"""The ordered list of compilers that an engine needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from up_samp.model import CandidateSchedule, check_time
from up_samp.scheduling.compilers.constraints import (
    compile_differences,
    compile_negations,
    compile_products,
    compile_resources,
    compile_rules,
)
from up_samp.scheduling.compilers.fluents import (
    compile_flat_types,
    compile_ground,
    compile_instances,
    compile_unused,
)
from up_samp.scheduling.compilers.intervals import (
    compile_dense,
    compile_intervals,
    compile_stillness,
    compile_support,
    refuse_numbers,
    refuse_times,
)
from up_samp.scheduling.compilers.optional import (
    compile_anchor,
    compile_optional,
)
from up_samp.scheduling.compilers.plain import Compiled, PlainProblem, some_value
from up_samp.scheduling.compilers.precedences import compile_precedences
from up_samp.scheduling.quirks import Quirks

Compiler = Callable[[PlainProblem], Compiled]


def compilers_for(quirks: Quirks) -> list[Compiler]:
    """Return the passes, in order, that make a problem fit an engine."""
    passes: list[Compiler] = [compile_rules, compile_ground]
    if not quirks.times_of_others:
        passes.append(refuse_times)
    passes += [compile_dense, compile_stillness, compile_support]
    if not quirks.hierarchical_types:
        passes.append(compile_flat_types)
    if not quirks.assignments:
        passes += [compile_instances, compile_precedences]
    if not quirks.intervals_of_numbers:
        passes.append(refuse_numbers)
    if not quirks.resources_with_variable_durations:
        passes.append(compile_resources)
    if not quirks.empty_intervals:
        passes.append(compile_intervals)
    passes += [compile_negations, compile_differences]
    if not quirks.products:
        passes.append(compile_products)
    if not quirks.optional:
        passes.append(compile_optional)
    passes += [compile_anchor, compile_unused]
    return passes


def chain(problem: PlainProblem, passes: Sequence[Compiler]) -> Compiled:
    """Run the passes one after the other."""
    presence: dict[str, str] = {}
    floor, exact = 0, True
    for compiler in passes:
        check_time()
        compiled = compiler(problem)
        problem, floor = compiled.problem, max(floor, compiled.floor)
        exact = exact and compiled.exact
        presence |= compiled.presence
    return Compiled(problem, presence, floor, exact)


def restored(
    original: PlainProblem, compiled: Compiled, schedule: CandidateSchedule
) -> CandidateSchedule:
    """Return a schedule of a compiled problem as one of the original, with some value for each
    variable that has none: engines leave out those that nothing constrains.

    Raises:
        LookupError: an activity that has to be there, or what says whether it is, is missing.
    """
    absent = {a for a, p in compiled.presence.items() if not schedule.parameters[p]}
    absent |= original.optional_names - schedule.times.keys()
    here = [a for a in original.activities if a.name not in absent]
    variables = [*original.variables.items(), *(p for a in here for p in a.parameters)]
    given = schedule.parameters
    return CandidateSchedule(
        {a.name: schedule.times[a.name] for a in here},
        {n: given[n] if n in given else some_value(original, t)[1] for n, t in variables},
    )
