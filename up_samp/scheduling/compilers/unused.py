"""User types that nothing has, with their objects, away: engines need not support them then."""

from __future__ import annotations

from dataclasses import replace

from up_samp.scheduling.compilers.expressions import Type
from up_samp.scheduling.compilers.plain import Compiled, PlainProblem


def compile_unused(problem: PlainProblem) -> Compiled:
    """Drop types that no variable, fluent or fluent's parameter has, nor a relative of one."""
    needed: set[Type] = set(problem.parameter_types().values())
    for fluent in problem.fluents.values():
        needed |= {fluent.type, *(tpe for _, tpe in fluent.parameters)}

    def root(name: str) -> str:
        father = problem.types[name]
        return name if father is None else root(father)

    roots = {root(tpe[1]) for tpe in needed if tpe[0] == "user"}
    kept = {name: father for name, father in problem.types.items() if root(name) in roots}
    objects = {name: tpe for name, tpe in problem.objects.items() if tpe in kept}
    return Compiled(replace(problem, types=kept, objects=objects))
