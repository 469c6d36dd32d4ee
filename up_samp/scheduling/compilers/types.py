"""User types below others, and without objects, away; short names for everything."""

from __future__ import annotations

from dataclasses import replace

from up_samp.model import CandidateSchedule
from up_samp.scheduling.compilers.plain import (
    Activity,
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


# ------------------ User types that nothing has


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


def compile_names(problem: PlainProblem) -> Compiled:
    """Rename everything; only parameters of fluents keep their names."""
    renamer = _Renamer(problem)
    renamed = renamer.problem()
    activities = {new: old for old, new in renamer.activities.items()}
    parameters = {new: old for old, new in renamer.parameters.items()}
    objects = {new: old for old, new in renamer.objects.items()}
    users = {n for n, t in renamed.parameter_types().items() if t[0] == "user"}

    def map_back(schedule: CandidateSchedule) -> CandidateSchedule:
        return CandidateSchedule(
            {activities[a]: times for a, times in schedule.times.items()},
            {
                parameters[p]: objects[str(v)] if p in users else v
                for p, v in schedule.parameters.items()
                if p in parameters
            },
        )

    return Compiled(renamed, map_back)


class _Renamer:
    def __init__(self, problem: PlainProblem):
        self.old = problem
        self.activities = {a.name: f"a{i}" for i, a in enumerate(problem.activities)}
        self.types = {name: f"T{i}" for i, name in enumerate(problem.types)}
        self.objects = {name: f"o{i}" for i, name in enumerate(problem.objects)}
        self.fluents = {name: f"f{i}" for i, name in enumerate(problem.fluents)}
        self.parameters = {name: f"v{i}" for i, name in enumerate(problem.variables)}
        for activity in problem.activities:
            short = self.activities[activity.name]
            for i, (name, _) in enumerate(activity.parameters):
                self.parameters[name] = f"{short}.p{i}"
        self._memo: dict[Expr, Expr] = {}

    def problem(self) -> PlainProblem:
        old, said = self.old, self.old.mapped(self)
        return replace(
            said,
            name="p",
            activities=tuple(
                replace(a, name=self.activities[a.name], parameters=self._signature(a))
                for a in said.activities
            ),
            conditions=tuple(
                replace(c, owner=self.activities.get(c.owner or ""), dense=False)
                for c in said.conditions
            ),
            effects=tuple(
                replace(e, owner=self.activities.get(e.owner or "")) for e in said.effects
            ),
            variables={self.parameters[n]: self._type(t) for n, t in old.variables.items()},
            types={
                self.types[n]: None if father is None else self.types[father]
                for n, father in old.types.items()
            },
            objects={self.objects[n]: self.types[t] for n, t in old.objects.items()},
            fluents={self.fluents[n]: self._fluent(f) for n, f in old.fluents.items()},
            initial={self(f): self(v) for f, v in old.initial.items()},
        )

    def _type(self, tpe: Type) -> Type:
        return ("user", self.types[tpe[1]]) if tpe[0] == "user" else tpe

    def _signature(self, a: Activity) -> tuple[tuple[str, Type], ...]:
        return tuple((self.parameters[n], self._type(t)) for n, t in a.parameters)

    def _fluent(self, f: Fluent) -> Fluent:
        parameters = tuple((n, self._type(t)) for n, t in f.parameters)
        default = None if f.default is None else self(f.default)
        return Fluent(self._type(f.type), parameters, default)

    def __call__(self, expression: Expr) -> Expr:
        done = self._memo.get(expression)
        if done is None:
            done = self._memo[expression] = self._rename(expression)
        return done

    def _rename(self, e: Expr) -> Expr:
        operator = e[0]
        if operator in ("bool", "int"):
            return e
        if operator == "time":
            return e if e[2] is None else (operator, e[1], self.activities[e[2]], e[3])
        if operator == "flu":
            return (operator, self.fluents[e[1]], *(self(a) for a in e[2:]))
        table = {"obj": self.objects, "par": self.parameters, "pres": self.activities}.get(operator)
        if table is not None:
            return (operator, table[e[1]])
        return (operator, *(self(a) for a in e[1:]))
