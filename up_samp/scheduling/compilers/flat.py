"""Types below other types away: each variable gets the root type, constraints say the rest."""

from __future__ import annotations

from dataclasses import replace

from up_samp.scheduling.compilers.expressions import Expr, Type, disjunction
from up_samp.scheduling.compilers.plain import Compiled, Fluent, PlainProblem


def compile_flat_types(problem: PlainProblem) -> Compiled:
    """Return the problem with flat types only."""
    if all(father is None for father in problem.types.values()):
        return Compiled(problem)

    def root(name: str) -> str:
        father = problem.types[name]
        return name if father is None else root(father)

    def flat(tpe: Type) -> Type:
        return ("user", root(tpe[1])) if tpe[0] == "user" else tpe

    def flat_all(parameters: tuple[tuple[str, Type], ...]) -> tuple[tuple[str, Type], ...]:
        return tuple((name, flat(tpe)) for name, tpe in parameters)

    restricted: list[Expr] = []
    for name, tpe in problem.parameter_types().items():
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
