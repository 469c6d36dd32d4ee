"""Rewrite UP expressions: exchange motion types, objects, fluents and parameters for plain ones.

Wrapped engines (and UP's protobuf) know no movable and configuration types, so the relaxation
uses a plain user type for each, with objects of the same names.
"""

from __future__ import annotations

from operator import is_
from typing import Any

from unified_planning.environment import Environment
from unified_planning.model import Effect, Fluent, FNode, Object, Parameter, Variable
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.types import Type


class Rewriter:
    """Maps everything of a SAMP problem to its plain counterpart (memoised).

    ``above``: a plain type that all configuration types are below (for objects that take
    configurations of several types).
    """

    def __init__(self, environment: Environment, above: Type | None = None):
        self.environment = environment
        self.above = above
        self._types: dict[Type, Type] = {}
        self._names: set[str] = set()
        self._objects: dict[Object, Object] = {}
        self._fluents: dict[Fluent, Fluent] = {}
        self._met: dict[Fluent, None] = {}
        self._parameters: dict[Parameter, Parameter] = {}
        self._expressions: dict[int, FNode] = {}
        """By the number of a node, which is its own in the environment."""

    def type(self, tpe: Type) -> Type:
        """Return the plain type for ``tpe`` (itself where it is plain already)."""
        if not tpe.is_user_type():
            return tpe
        if tpe not in self._types:
            father = getattr(tpe, "father", None)
            plain_father = None if father is None else self.type(father)
            if tpe.is_configuration_type():
                plain_father = self.above
            name = tpe.name
            while name in self._names:  # UP takes a configuration type and a user type of one name
                name += "_"
            self._names.add(name)
            self._types[tpe] = self.environment.type_manager.UserType(name, plain_father)
        return self._types[tpe]

    def object(self, obj: Object) -> Object:
        """Return the plain object of the same name."""
        if obj not in self._objects:
            self._objects[obj] = Object(obj.name, self.type(obj.type), self.environment)
        return self._objects[obj]

    @property
    def fluents(self) -> list[Fluent]:
        """All fluents that expressions name, as they are in the SAMP problem."""
        return list(self._met)

    def fluent(self, fluent: Fluent) -> Fluent:
        """Return the plain fluent of the same name and signature."""
        if fluent not in self._fluents:
            signature = [
                Parameter(p.name, self.type(p.type), self.environment) for p in fluent.signature
            ]
            self._fluents[fluent] = Fluent(
                fluent.name, self.type(fluent.type), signature, environment=self.environment
            )
        return self._fluents[fluent]

    def parameter(self, parameter: Parameter) -> Parameter:
        """Return the plain parameter of the same (scoped) name."""
        if parameter not in self._parameters:
            self._parameters[parameter] = Parameter(
                parameter.name, self.type(parameter.type), self.environment
            )
        return self._parameters[parameter]

    def variable(self, variable: Variable) -> Variable:
        """Return the plain variable (of a quantifier) of the same name."""
        return Variable(variable.name, self.type(variable.type), self.environment)

    def __call__(self, expression: FNode) -> FNode:
        """Return ``expression`` over plain things."""
        done = self._expressions.get(expression.node_id)
        if done is None:
            done = self._expressions[expression.node_id] = self._rewrite(expression)
        return done

    def _rewrite(self, expression: FNode) -> FNode:
        manager, kind = self.environment.expression_manager, expression.node_type
        if kind is Op.OBJECT_EXP:
            return manager.ObjectExp(self.object(expression.object()))
        if kind is Op.PARAM_EXP:
            return manager.ParameterExp(self.parameter(expression.parameter()))
        if kind is Op.VARIABLE_EXP:
            return manager.VariableExp(self.variable(expression.variable()))
        arguments = expression.args
        known = self._expressions
        # preconditions without fluents are millions of nodes: most arguments were seen before
        plain = tuple([known.get(a.node_id) or self(a) for a in arguments])
        if kind is Op.FLUENT_EXP:
            self._met[expression.fluent()] = None
            return manager.FluentExp(self.fluent(expression.fluent()), plain)
        payload: Any = expression._content.payload
        if kind in (Op.EXISTS, Op.FORALL):
            payload = tuple(map(self.variable, expression.variables()))
        elif all(map(is_, plain, arguments)):
            return expression
        return manager.create_node(node_type=kind, args=plain, payload=payload)

    def effect(self, effect: Effect) -> Effect:
        """Return a plain effect."""
        return Effect(
            self(effect.fluent),
            self(effect.value),
            self(effect.condition),
            kind=effect.kind,
            forall=tuple(map(self.variable, effect.forall)),
        )
