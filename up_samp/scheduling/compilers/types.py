"""User types below others, and user types that nothing has, away."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from up_samp.scheduling.compilers.plain import (
    Compiled,
    Expr,
    Fluent,
    PlainProblem,
    Type,
    disjunction,
)


def compile_flat_types(problem: PlainProblem) -> Compiled:
    """Return the problem with flat types only."""
    if all(father is None for father in problem.types.values()):
        return Compiled(problem)
    root = partial(_root, problem)

    def flat(tpe: Type) -> Type:
        return ("user", root(tpe[1])) if tpe[0] == "user" else tpe

    def flat_all(parameters: tuple[tuple[str, Type], ...]) -> tuple[tuple[str, Type], ...]:
        return tuple((name, flat(tpe)) for name, tpe in parameters)

    restricted: list[Expr] = []
    for name, tpe in problem.parameter_types.items():
        if tpe[0] == "user" and problem.types[tpe[1]] is not None:
            choices = problem.objects_of(tpe[1])
            restricted.append(disjunction(("eq", ("par", name), ("obj", o)) for o in choices))
    flattened = replace(
        problem,
        activities=tuple(replace(a, parameters=flat_all(a.parameters)) for a in problem.activities),
        constraints=(*problem.constraints, *restricted),
        variables={n: flat(t) for n, t in problem.variables.items()},
        types={n: None for n, father in problem.types.items() if father is None},
        objects={o: root(t) for o, t in problem.objects.items()},
        fluents={
            n: Fluent(flat(f.type), flat_all(f.parameters), f.default)
            for n, f in problem.fluents.items()
        },
    )
    return Compiled(flattened)


def _root(problem: PlainProblem, name: str) -> str:
    """Return the type above all others that a type is below of."""
    father = problem.types[name]
    return name if father is None else _root(problem, father)


# ------------------ User types that nothing has


def compile_unused(problem: PlainProblem) -> Compiled:
    """Drop types that no variable, fluent or fluent's parameter has, nor a relative of one."""
    needed: set[Type] = set(problem.parameter_types.values())
    for fluent in problem.fluents.values():
        needed |= {fluent.type, *(tpe for _, tpe in fluent.parameters)}
    roots = {_root(problem, tpe[1]) for tpe in needed if tpe[0] == "user"}
    kept = {name: father for name, father in problem.types.items() if _root(problem, name) in roots}
    objects = {name: tpe for name, tpe in problem.objects.items() if tpe in kept}
    return Compiled(replace(problem, types=kept, objects=objects))
