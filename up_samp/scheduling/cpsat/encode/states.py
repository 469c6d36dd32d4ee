"""State variables: ground fluents with who writes and who reads them, and when."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from unified_planning.model import Effect, FNode, TimeInterval, Timing
from unified_planning.model.timing import TimepointKind

from up_samp.model import ProblemError, UnsupportedError, check_time
from up_samp.model.graphs import grouped
from up_samp.scheduling.cpsat.encode.forms import (
    FALSE,
    TRUE,
    Cmp,
    Form,
    Lin,
    Literal,
    ModelStore,
    compare,
    constant,
    parts_of,
)
from up_samp.scheduling.cpsat.encode.terms import (
    ActivityVars,
    Terms,
    World,
    fluents_in,
    has_decisions,
    number_bounds,
    unless_decided,
)
from up_samp.upio.expressions import conjuncts, fluent_told, with_timings

Key = tuple[Any, ...]


@dataclass
class Write:
    """An effect on a ground fluent: assignment of ``value``, or increase by it if ``add``."""

    owner: int | None
    active: Literal
    time: Lin
    value: Lin
    add: bool = False


@dataclass
class Read:
    """A value that must be one of ``allowed`` (if given), equals ``value`` (if given), and
    must not be disturbed over the instants lo..hi.
    """

    owner: int | None
    active: Literal
    lo: Lin
    hi: Lin
    allowed: frozenset[int] | None = None
    value: Lin | None = None
    guard_only: bool = False
    loose: bool = False
    """Whether effects of others at ``hi`` are allowed (the old value counts)."""


class SureChange(NamedTuple):
    """What a write does whenever its owner is there: sets a state to ``value``, or adds it.
    ``since`` and ``late`` bound when, counted from its owner's start and from its end.
    """

    owner: ActivityVars
    value: int
    adds: bool
    since: tuple[int, int]
    late: tuple[int, int]


@dataclass
class StateVar:
    """A ground fluent. ``values`` are the codes it may take (``None``: too many to list,
    thousands).
    """

    key: Key
    bounds: tuple[int, int]
    values: list[int] | None
    initial: int | None
    writes: list[Write] = field(default_factory=list)
    reads: list[Read] = field(default_factory=list)
    _by_owner: dict[int | None, list[Write]] = field(default_factory=dict)
    _indexed: int = 0

    @property
    def listed(self) -> frozenset[int]:
        """The values that it may take, where they can be listed."""
        return frozenset(self.values or ())

    def exempt(self, owner: int | None) -> list[Write]:
        """Return the writes that conditions of ``owner`` are not kept apart from."""
        if owner is None:
            return self.writes
        return [*self.by_owner().get(None, ()), *self.by_owner().get(owner, ())]

    def by_owner(self) -> dict[int | None, list[Write]]:
        """Return the writes by whose they are."""
        if self._indexed != len(self.writes):
            self._by_owner = grouped(self.writes, lambda write: write.owner)
            self._indexed = len(self.writes)
        return self._by_owner

    def held(self) -> Iterable[int]:
        """Return the values that it has at first or that something gives it (all, if that hangs on
        decisions).
        """
        if self.initial is None or any(w.add or w.value.terms for w in self.writes):
            return self.listed
        return {self.initial, *(w.value.const for w in self.writes)}

    def lasts(self, allowed: frozenset[int]) -> bool:
        """Return whether it surely stays one of these values once it has one."""
        return all(not (w.add or w.value.terms) and w.value.const in allowed for w in self.writes)

    @property
    def numeric(self) -> bool:
        """Whether it is increased or decreased anywhere."""
        return any(w.add for w in self.writes)


def no_fluents(node: FNode) -> Lin:
    """Refuse a fluent by name, where there is no time at which it could be read."""
    raise UnsupportedError(f"the fluent '{node}' is read at no time; cpsat needs one")


# ------------------ State variables
# Ground fluents with who writes and who reads them, and when. Semantics (PDDL 2.1 as up-aries has
# it; see ``docs/semantics.md``): an effect at t is seen from t + 1 on; a condition
# over integer instants lo..hi holds at each of them; an effect of another activity on a fluent that
# the condition reads must not lie in lo..hi, whatever its value; the activity's own effects and the
# problem's own are not kept apart, the old value counts at t.


class States:
    """All state variables of a problem, by fluent and arguments, who writes and who reads them."""

    def __init__(self, world: World, problem: Any, far: Lin) -> None:
        self.world = world
        self.store: ModelStore = world.store
        self.problem = problem
        self.vars: dict[Key, StateVar] = {}
        self.explicit = problem.explicit_initial_values
        self.defaults = problem.fluents_defaults
        self.declared = frozenset(problem.fluents)
        self.dynamic: set[str] = set()
        """Names of the fluents that change."""
        self._allowed: dict[FNode, frozenset[int]] = {}
        self.far = far
        self.by_var: dict[int, ActivityVars] = {}
        self.activities: list[ActivityVars] = []
        self.happenings: list[tuple[Literal, Lin]] = []
        self.final: Lin | None = None

    # -- the ground fluents ----------------------------------------------------------------------

    def var(self, fluent: Any, args: tuple[int, ...]) -> StateVar:
        """Return the state variable of ``fluent`` at ``args`` (codes of objects, numbers)."""
        key = (fluent.name, *args)
        found = self.vars.get(key)
        if found is None:
            found = self.vars[key] = self._make(key, fluent, args)
        return found

    def _make(self, key: Key, fluent: Any, args: tuple[int, ...]) -> StateVar:
        if fluent not in self.declared and fluent not in self.problem.fluents:
            raise ProblemError(f"the fluent '{fluent.name}' is used, but it is not in the problem")
        tpe = fluent.type
        if tpe.is_bool_type() or tpe.is_user_type():
            values: list[int] | None = self.world.values_of(tpe)
            bounds = (min(values), max(values)) if values else (0, 0)
        else:
            bounds = number_bounds(tpe, self.world.scales.get(fluent.name, 1))
            few = bounds[1] - bounds[0] < 2000
            values = list(range(bounds[0], bounds[1] + 1)) if few else None
        return StateVar(key, bounds, values, self._initial(fluent, args))

    def _initial(self, fluent: Any, args: tuple[int, ...]) -> int | None:
        names = {code: name for name, code in self.world.objects.items()}
        manager = self.problem.environment.expression_manager
        nodes = []
        for parameter, code in zip(fluent.signature, args, strict=True):
            if parameter.type.is_user_type():
                nodes.append(manager.ObjectExp(self.problem.object(names[code])))
            elif parameter.type.is_bool_type():
                nodes.append(manager.Bool(bool(code)))
            else:
                nodes.append(manager.Int(code))
        value = self.explicit.get(manager.FluentExp(fluent, tuple(nodes)))
        if value is None:
            value = self.defaults.get(fluent)
        if value is None:
            return None
        scale = self.world.scales.get(fluent.name, 1)
        return Terms(self.world, no_fluents).at_scale(value, scale).const

    def grounds(self, node: FNode, terms: Terms) -> Iterator[tuple[Literal, StateVar]]:
        """Yield (literal, variable) for each ground fluent that ``node`` may stand for."""
        fluent = node.fluent()
        choices: list[list[tuple[Literal, int]]] = []
        for arg, parameter in zip(node.args, fluent.signature, strict=True):
            lin = terms.linear(arg)
            if not lin.terms:
                choices.append([(TRUE, lin.const)])
                continue
            var = self.store.variable(lin)
            choices.append(
                [(self.store.is_value(var, v), v) for v in self.world.values_of(parameter.type)]
            )
        for combination in itertools.product(*choices):
            literal = self.store.all_of(x for x, _ in combination)
            if literal != FALSE:
                yield literal, self.var(fluent, tuple(v for _, v in combination))

    # -- how conditions and values read them -----------------------------------------------------
    def all_grounds(
        self, node: FNode, owner: ActivityVars | None
    ) -> Iterator[tuple[Literal, StateVar]]:
        """Yield (literal, variable) for each state variable that an expression may read."""
        for fluent in fluents_in(node):
            args_have_fluents = any(fluents_in(a) for a in fluent.args)
            if args_have_fluents:
                raise UnsupportedError(f"the nested fluent '{fluent}' is not supported by cpsat")
            yield from self.grounds(fluent, Terms(self.world, no_fluents, owner))

    def _hold(
        self,
        node: FNode,
        owner: ActivityVars | None,
        active: Literal,
        lo: Lin,
        hi: Lin,
        loose: bool = False,
    ) -> None:
        if active == FALSE:
            return
        pattern = Read(None if owner is None else owner.index, active, lo, hi, loose=loose)
        fluents = list(fluents_in(node))
        if len(fluents) == 1 and all(a.is_constant() for a in fluents[0].args):
            ((_, state),) = self.grounds(fluents[0], Terms(self.world, no_fluents, owner))
            told = self._read_alone(node, state, pattern)
            if told is not None:
                self._read(state, told)
                return
        decided, rest = unless_decided(node)
        if decided is not None and not loose:
            # whatever is decided, nobody may change meanwhile what is read
            self._guard(rest, owner, pattern)
            said = Terms(self.world, no_fluents, owner)
            other = self._literals(said.form(decided, False), said.form(decided))
            self._hold(rest, owner, self.store.all_of([active, *other]), lo, hi)
            return
        terms = Terms(self.world, self.reader(owner, active, lo, hi, loose), owner)
        self.store.enforce(terms.form(node), (active,))

    def _guard(self, node: FNode, owner: ActivityVars | None, pattern: Read) -> None:
        """Keep others' effects off what an expression reads: of what a parameter chooses, only off
        that which is chosen.
        """
        for literal, state in self.all_grounds(node, owner):
            when = self.store.all_of([pattern.active, literal])
            if when != FALSE:
                self._read(state, replace(pattern, active=when, guard_only=True))

    def _read_alone(self, node: FNode, state: StateVar, pattern: Read) -> Read | None:
        """Return what is asked of a state by what speaks of it alone, or compares it with an
        object parameter (``None``: it is something else).
        """
        if state.values is None:
            return None
        if not has_decisions(node):
            return replace(pattern, allowed=self._values(node, state))
        told = fluent_told(node)
        if told is None or not (told[1].is_parameter_exp() and told[1].type.is_user_type()):
            return None
        value = self.world.parameters.get(told[1].parameter().name)
        if value is None or state.key[0] not in self.dynamic:
            return None
        # all effects are known by now
        allowed = frozenset(state.held()) & self._left(value)
        return replace(pattern, allowed=allowed, value=value)

    def _left(self, value: Lin) -> frozenset[int]:
        """Return what a parameter may be."""
        low, high = self.store.range(value)
        known = self.world.domains.get(value.terms[0][0]) if value.terms else None
        return frozenset(range(low, high + 1)) if known is None else known

    def _literals(self, form: Form, opposite: Form) -> list[Literal]:
        """Return literals that together are true exactly if a form of parameters holds."""
        found = []
        for part in parts_of("&", form):
            one = part.terms[0] if part.__class__ is Cmp and len(part.terms) == 1 else (0, 0)
            if abs(one[1]) != 1 or part.op != "==":
                return [self.store.equivalent(form, opposite)]
            found.append(self.store.is_value(one[0], -part.const * one[1]))
        return found

    def _values(self, node: FNode, state: StateVar) -> frozenset[int]:
        """Return the values of ``state`` with which ``node`` holds."""
        found = self._allowed.get(node)
        if found is None:
            values = state.values or []
            told = fluent_told(node)
            if told is not None and told[1].is_object_exp():
                fixed = self.world.objects[told[1].object().name]
                found = frozenset((fixed,)).intersection(values)
            else:
                found = frozenset(v for v in values if self._evaluate(node, v) == TRUE)
            self._allowed[node] = found
        return found

    def _evaluate(self, node: FNode, value: int) -> Any:
        return Terms(self.world, lambda _: constant(value)).form(node)

    def _read(self, state: StateVar, read: Read) -> None:
        if state.key[0] in self.dynamic:
            anything = read.allowed is not None and len(read.allowed) == len(state.values or ())
            if anything and state.initial is not None and read.value is None:
                read = replace(read, allowed=None, guard_only=True)
            state.reads.append(read)
        elif state.initial is None or (
            read.allowed is not None and state.initial not in read.allowed
        ):
            self.store.enforce(FALSE, (read.active,))

    def reader(
        self, owner: ActivityVars | None, active: Literal, lo: Lin, hi: Lin, loose: bool = False
    ) -> Any:
        """Return a function fluent expression -> value over lo..hi (cached, reads registered)."""
        cache: dict[FNode, Lin] = {}
        number = None if owner is None else owner.index

        def read(node: FNode) -> Lin:
            if node not in cache:
                grounds = list(self.grounds(node, Terms(self.world, read, owner)))
                pattern = Read(number, active, lo, hi, loose=loose)
                cache[node] = self._value(node, grounds, pattern)
            return cache[node]

        return read

    def _value(self, node: FNode, grounds: list[tuple[Literal, StateVar]], pattern: Read) -> Lin:
        if len(grounds) == 1:
            literal, only = grounds[0]
            static = only.key[0] not in self.dynamic and only.initial is not None
            if static and literal == TRUE:
                return constant(only.initial or 0)
        bounds = [s.bounds for _, s in grounds]
        if node.type.is_user_type():
            result = self.store.member(self.world.values_of(node.type))
        else:
            result = self.store.integer(min(b[0] for b in bounds), max(b[1] for b in bounds))
        value = Lin(((result, 1),))
        for literal, state in grounds:
            when = self.store.all_of([pattern.active, literal])
            if when == FALSE:
                continue
            if state.key[0] in self.dynamic:
                state.reads.append(replace(pattern, active=when, value=value))
            elif state.initial is None:
                self.store.enforce(FALSE, (when,))
            else:
                self.store.enforce(compare(value.shift(-state.initial), "=="), (when,))
        return value

    # -- activities and their effects ------------------------------------------------------------
    def register(self, activity: ActivityVars) -> None:
        """Let times of ``activity`` be known."""
        self.activities.append(activity)
        for lin in (activity.start, activity.end):
            self.by_var.update((v, activity) for v, _ in lin.terms)

    def activity(self, index: int) -> ActivityVars:
        """Return the activity with this index."""
        return self.activities[index]

    def movers(self) -> frozenset[int]:
        """Return who sets a state variable of more than two values to something."""
        return frozenset(
            write.owner
            for state in self.vars.values()
            if state.values is None or len(state.values) > 2
            for write in state.writes
            if write.owner is not None and not write.add
        )

    def add_effect(self, timing: Timing, effect: Effect, owner: ActivityVars | None) -> None:
        """Register the writes of an effect."""
        if not (effect.is_assignment() or effect.is_increase() or effect.is_decrease()):
            raise UnsupportedError(f"the continuous effect '{effect}' is not supported by cpsat")
        if timing.timepoint.kind is TimepointKind.GLOBAL_END:
            raise UnsupportedError(f"the effect '{effect}' at the global end is not supported")
        present = TRUE if owner is None else owner.present
        terms = Terms(self.world, no_fluents, owner)
        time = terms.time(timing)
        active = self.store.all_of([present, *time.needs])
        time = time._replace(needs=())
        self.store.enforce(constant(0).le(time), (active,))
        self.happenings.append((active, time))
        reading = Terms(self.world, self.reader(owner, active, time, time, loose=True), owner)
        self._keep_apart(effect, owner, active, time)
        condition = reading.form(effect.condition)
        if condition != TRUE:
            opposite = reading.form(effect.condition, False)
            active = self.store.all_of([active, *self._literals(condition, opposite)])
        scale = self.world.scales.get(effect.fluent.fluent().name, 1)
        value = reading.at_scale(effect.value, scale)._replace(needs=())
        if effect.is_decrease():
            value = constant(0).plus(value, -1)
        number = None if owner is None else owner.index
        for literal, state in self.grounds(effect.fluent, reading):
            when = self.store.all_of([active, literal])
            if when == FALSE:
                continue
            adds = not effect.is_assignment()
            state.writes.append(Write(number, when, time, value, adds))
            if not adds:
                self.within_bounds(state, value, when)

    def _keep_apart(
        self, effect: Effect, owner: ActivityVars | None, active: Literal, time: Lin
    ) -> None:
        """Keep other activities' effects off the other fluents that an effect reads."""
        if owner is None:
            return
        terms = Terms(self.world, no_fluents, owner)
        own = {id(state): literal for literal, state in self.grounds(effect.fluent, terms)}
        for node in (effect.condition, effect.value):
            for literal, state in self.all_grounds(node, owner):
                when = self.store.all_of([active, literal, ~own.get(id(state), FALSE)])
                if when != FALSE:
                    state.reads.append(Read(owner.index, when, time, time, guard_only=True))

    def within_bounds(self, state: StateVar, value: Lin, when: Literal) -> None:
        """State that a value is one that a variable may have."""
        low, high = state.bounds
        self.store.enforce(constant(low).le(value), (when,))
        self.store.enforce(value.le(constant(high)), (when,))

    # -- conditions ----------------------------------------------------------------------------
    def add_condition(self, span: TimeInterval, node: FNode, owner: ActivityVars | None) -> None:
        """Register the reads of a condition."""
        check_time()
        needs, some, lo, hi, until = self._span(span, owner)
        active = self.store.all_of([*needs, some])
        if active != FALSE:
            for part in conjuncts(node):
                self._require(part, owner, active, (lo, hi, until))

    def _span(
        self, span: TimeInterval, owner: ActivityVars | None
    ) -> tuple[list[Literal], Literal, Lin, Lin, Lin]:
        """Return what an interval needs, whether it holds an instant, its first and last one, and
        until when values count: what is set in the last unit of a half-open interval is seen inside
        of it.
        """
        terms = Terms(self.world, no_fluents, owner)
        lo, hi, nonempty = self._instants(span, terms)
        needs = [*lo.needs, *hi.needs] + ([] if owner is None else [owner.present])
        lo, hi = lo._replace(needs=()), hi._replace(needs=())
        low, high = nonempty
        gap = high.plus(low, -1)._replace(needs=())
        least, most = self.difference(gap, constant(0))
        some = TRUE if most >= 0 else FALSE
        if least < 0 <= most:
            opposite = compare(gap.shift(1), "<=")
            some = self.store.equivalent(compare(constant(0).plus(gap, -1), "<="), opposite)
        return needs, some, lo, hi, hi.shift(1) if span.is_right_open() else hi

    def instants_of(self, span: TimeInterval) -> tuple[list[Literal], Literal, Lin, Lin]:
        """Return the same of an interval of the problem's own, but for its last instant."""
        needs, some, lo, _, until = self._span(with_timings(span), None)
        return needs, some, lo, until

    def _instants(self, span: TimeInterval, terms: Terms) -> tuple[Lin, Lin, tuple[Lin, Lin]]:
        """Return the first and last instant, and the two by which to tell whether there is any.

        The global end is the first instant at which all effects are seen. A condition that lasts
        until then may as well last for ever, which needs no variable.
        """
        ends, exact = [], []
        bounds = (
            (span.lower, 1 if span.is_left_open() else 0),
            (span.upper, -1 if span.is_right_open() else 0),
        )
        both = all(self._is_end(t) and t.delay + step >= 0 for t, step in bounds)
        for timing, step in bounds:
            if not self._is_end(timing):
                ends.append(terms.time(timing).shift(step))
                exact.append(ends[-1])
                continue
            delay = int(timing.delay) + step
            at = self.far if both else self._final_instant()
            exact.append(at.shift(delay))
            ends.append(self.far if delay == 0 else at.shift(delay))
        return ends[0], ends[1], (exact[0], exact[1])

    @staticmethod
    def _is_end(timing: Timing) -> bool:
        return bool(timing.timepoint.kind is TimepointKind.GLOBAL_END)

    def _final_instant(self) -> Lin:
        """Return 1 + the latest of all ends of present activities and times of effects."""
        if self.final is None:
            self.final = final = Lin(((self.store.integer(1, self.far.const), 1),))
            latest = [(TRUE, constant(1))]
            latest += [(active, time.shift(1)) for active, time in self.happenings]
            latest += [(a.present, a.end._replace(needs=()).shift(1)) for a in self.activities]
            for active, time in latest:
                self.store.enforce(time.le(final), (active,))
            self.store.attain(final, latest)
        return self.final

    def difference(self, a: Lin, b: Lin) -> tuple[int, int]:
        """Return bounds of ``a - b`` that hold whatever the schedule (activities' sizes known)."""
        if a.terms == b.terms:
            return a.const - b.const, a.const - b.const
        gap = a.plus(b, -1)
        if len(a.terms) == len(b.terms) == 1:
            one, other = self.by_var.get(a.terms[0][0]), self.by_var.get(b.terms[0][0])
            if one is not other:
                return self.store.range(gap)
        return self.store.range(self.in_sizes(gap))

    def sure_changes(self, state: StateVar) -> list[SureChange]:
        """Return all that may change a state; nothing, if some of it may happen or not where its
        owner is there, has no owner, or sets it to what is not known.
        """
        found = []
        for write in state.writes:
            if self.store.never(write.active):
                continue
            owner = None if write.owner is None else self.activity(write.owner)
            if owner is None or write.active != owner.present or write.value.terms:
                return []
            times = (self.difference(write.time, at) for at in (owner.start, owner.end))
            found.append(SureChange(owner, write.value.const, write.add, *times))
        return found

    def surely_during(self, owner: int, low: Lin, high: Lin) -> bool:
        """Return whether an interval is within an activity's, whatever the schedule."""
        activity = self.activity(owner)
        after = self.difference(low, activity.start)[0] >= 0
        return after and self.difference(activity.end, high)[0] >= 0

    def in_sizes(self, lin: Lin) -> Lin:
        """Return a sum of times with starts and sizes of activities instead of their ends."""
        for activity in self._mentioned(lin):
            if len(activity.end.terms) == 1 and activity.end.terms != activity.start.terms:
                (end, _), (start, _) = activity.end.terms[0], activity.start.terms[0]
                coef = dict(lin.terms).get(end, 0)
                if coef:
                    rest = Lin(((start, coef),)).plus(activity.size, coef)
                    lin = lin.plus(Lin(((end, -coef),))).plus(rest)
        return lin

    def _mentioned(self, lin: Lin) -> list[ActivityVars]:
        owners = {self.by_var[v].index: self.by_var[v] for v, _ in lin.terms if v in self.by_var}
        return list(owners.values())

    def _require(
        self,
        node: FNode,
        owner: ActivityVars | None,
        active: Literal,
        span: tuple[Lin, Lin, Lin],
    ) -> None:
        """Require ``node`` over the instants lo..hi, and at ``until`` if that is another one."""
        lo, hi, until = span
        inside = self._own_writes_inside(node, owner, lo, until)
        if not inside:
            self._hold(node, owner, active, lo, hi)
            return
        # own and base effects inside the interval are allowed: look again after each of them
        if owner is not None:
            self._guard(node, owner, Read(owner.index, active, lo, hi))
        self._hold(node, owner, active, lo, lo)
        for write in inside:
            again, after = self.right_after(write, active, lo, until)
            self._hold(node, owner, again, after, after, loose=True)

    def right_after(
        self, write: Write, active: Literal, lo: Lin, until: Lin
    ) -> tuple[Literal, Lin]:
        """Return whether a write happens from ``lo`` on and before ``until``, where ``active``, and
        the instant after it.
        """
        store, after = self.store, write.time.shift(1)
        inside = [
            store.equivalent(lo.le(write.time), after.le(lo)),
            store.equivalent(after.le(until), until.le(write.time)),
        ]
        return store.all_of([active, write.active, *inside]), after

    def _own_writes_inside(
        self, node: FNode, owner: ActivityVars | None, lo: Lin, hi: Lin
    ) -> list[Write]:
        if self.difference(hi, lo)[1] <= 0:
            return []
        found: dict[int, Write] = {}
        for _, state in self.all_grounds(node, owner):
            for write in state.exempt(None if owner is None else owner.index):
                after_lo = self.difference(write.time, lo)[1] >= 0
                if after_lo and self.difference(write.time, hi)[0] < 0:
                    found[id(write)] = write
        return list(found.values())
