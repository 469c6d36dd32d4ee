"""State variables: ground fluents with who writes and who reads them, and when.

Semantics (PDDL 2.1 as up-aries has it; see ``up_samp/validation/semantics.md``): an effect at t is
seen from t + 1 on; a condition over integer instants lo..hi holds at each of them; an effect of
another activity on a fluent that the condition reads must not lie in lo..hi, whatever its value;
the activity's own effects and the problem's own are not kept apart, the old value counts at t.
"""

from __future__ import annotations

from typing import Any

from unified_planning.model import Effect, FNode, TimeInterval, Timing
from unified_planning.model.timing import TimepointKind

from up_samp.model import UnsupportedError, check_time
from up_samp.scheduling.cpsat.encode.forms import (
    FALSE,
    TRUE,
    Lin,
    Literal,
    compare,
    constant,
)
from up_samp.scheduling.cpsat.encode.ground_fluents import no_fluents
from up_samp.scheduling.cpsat.encode.nodes import (
    conjuncts,
)
from up_samp.scheduling.cpsat.encode.readings import Readings
from up_samp.scheduling.cpsat.encode.statevars import Read, StateVar, Write
from up_samp.scheduling.cpsat.encode.terms import ActivityVars, Terms, World


class States(Readings):
    """All state variables of a problem, who writes and who reads them."""

    def __init__(self, world: World, problem: Any, far: Lin) -> None:
        super().__init__(world, problem)
        self.far = far
        self.by_var: dict[int, ActivityVars] = {}
        self.activities: list[ActivityVars] = []
        self.happenings: list[tuple[Literal, Lin]] = []
        self.final: Lin | None = None

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
        if effect.forall:
            raise UnsupportedError(
                f"cpsat knows effects for all objects, not for all of '{effect}'"
            )
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
        value = reading.linear(effect.value)._replace(needs=())
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
                self._within(state, value, when)

    def _keep_apart(
        self, effect: Effect, owner: ActivityVars | None, active: Literal, time: Lin
    ) -> None:
        """Keep other activities' effects off the other fluents that an effect reads."""
        if owner is None:
            return
        terms = Terms(self.world, no_fluents, owner)
        own = {id(state): literal for literal, state in self.grounds(effect.fluent, terms)}
        for node in (effect.condition, effect.value):
            for literal, state in self._all_grounds(node, owner):
                when = self.store.all_of([active, literal, ~own.get(id(state), FALSE)])
                if when != FALSE:
                    state.reads.append(Read(owner.index, when, time, time, guard_only=True))

    def _within(self, state: StateVar, value: Lin, when: Literal) -> None:
        low, high = state.bounds
        self.store.enforce(constant(low).le(value), (when,))
        self.store.enforce(value.le(constant(high)), (when,))

    # -- conditions ----------------------------------------------------------------------------
    def add_condition(self, span: TimeInterval, node: FNode, owner: ActivityVars | None) -> None:
        """Register the reads of a condition."""
        check_time()
        terms = Terms(self.world, no_fluents, owner)
        lo, hi, nonempty = self._instants(span, terms)
        needs = [*lo.needs, *hi.needs] + ([] if owner is None else [owner.present])
        lo, hi = lo._replace(needs=()), hi._replace(needs=())
        low, high = nonempty
        gap = high.plus(low, -1)._replace(needs=())
        least, most = self.difference(gap, constant(0))
        if most < 0:
            return
        some = TRUE
        if least < 0:
            opposite = compare(gap.shift(1), "<=")
            some = self.store.equivalent(compare(constant(0).plus(gap, -1), "<="), opposite)
        active = self.store.all_of([*needs, some])
        # what is set in the last unit of a half-open interval is seen inside of it
        until = hi.shift(1) if span.is_right_open() else hi
        for part in conjuncts(node):
            self._require(part, owner, active, (lo, hi, until))

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
        for activity in self._mentioned(gap):
            if len(activity.end.terms) == 1 and activity.end.terms != activity.start.terms:
                (end, _), (start, _) = activity.end.terms[0], activity.start.terms[0]
                coefs = dict(gap.terms)
                coef = coefs.get(end, 0)
                if coef:
                    rest = Lin(((start, coef),)).plus(activity.size, coef)
                    gap = gap.plus(Lin(((end, -coef),))).plus(rest)
        return self.store.range(gap)

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
        number = None if owner is None else owner.index
        inside = self._own_writes_inside(node, owner, lo, until)
        if not inside:
            self._hold(node, owner, active, lo, hi)
            return
        # own and base effects inside the interval are allowed: look again after each of them
        if owner is not None:
            for _, state in self._all_grounds(node, owner):
                state.reads.append(Read(number, active, lo, hi, guard_only=True))
        self._hold(node, owner, active, lo, lo)
        for write in inside:
            after = write.time.shift(1)
            conditions = [
                self.store.equivalent(lo.le(write.time), write.time.shift(1).le(lo)),
                self.store.equivalent(after.le(until), until.le(write.time)),
            ]
            again = self.store.all_of([active, write.active, *conditions])
            self._hold(node, owner, again, after, after, loose=True)

    def _own_writes_inside(
        self, node: FNode, owner: ActivityVars | None, lo: Lin, hi: Lin
    ) -> list[Write]:
        if self.difference(hi, lo)[1] <= 0:
            return []
        found: dict[int, Write] = {}
        for _, state in self._all_grounds(node, owner):
            for write in state.exempt(None if owner is None else owner.index):
                after_lo = self.difference(write.time, lo)[1] >= 0
                if after_lo and self.difference(write.time, hi)[0] < 0:
                    found[id(write)] = write
        return list(found.values())
