"""Names that nothing in a problem has yet."""

from __future__ import annotations

from up_samp.scheduling.compilers.plain import PlainProblem


def fresh(base: str, taken: set[str]) -> str:
    """Return a name like ``base`` that is not taken, and take it."""
    name, count = base, 0
    while name in taken:
        count += 1
        name = f"{base}_{count}"
    taken.add(name)
    return name


def names_in_use(problem: PlainProblem) -> set[str]:
    """Return every name of the problem."""
    names = {a.name for a in problem.activities}
    names.update(problem.variables, problem.types, problem.objects, problem.fluents)
    names.update(problem.parameter_types())
    return names
