"""The objective as a linear expression: each part of :mod:`up_samp.upio.objective`."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.model import UnsupportedError
from up_samp.scheduling.cpsat.encode.forms import (
    TRUE,
    Cmp,
    Form,
    Lin,
    Literal,
    compare,
    conjunction,
    constant,
    indicator_sum,
)
from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.terms import (
    ActivityVars,
    Terms,
    fluents_in,
)
from up_samp.upio.expressions import walk
from up_samp.upio.objective import Objective, ObjectivePart


class Encoding:
    """Makes linear expressions of the parts of an objective."""

    def __init__(self, states: States) -> None:
        self.states = states
        self.store = states.store
        after_all = states.reader(None, TRUE, states.far, states.far)
        self.final = Terms(states.world, after_all, compare=surely)

    def cost(self, objective: Objective) -> tuple[Lin, int]:
        """Return (expression, d): the cost of a schedule is expression / d."""
        told = [self._part(part) for part in objective.parts]
        weights = [objective.sign * Fraction(part.weight) for part in objective.parts]
        shares = [w / d for w, (_, d) in zip(weights, told, strict=True)]
        scale = math.lcm(1, *(s.denominator for s in shares))
        total = constant(0)
        sums: dict[str, dict[str, Lin]] = {}
        for part, share, (lin, _) in zip(objective.parts, shares, told, strict=True):
            if part.share is None:
                total = total.plus(lin, int(share * scale))
            else:
                term, name = part.share
                mine = sums.setdefault(term, {})
                mine[name] = mine.get(name, constant(0)).plus(lin, int(share * scale))
        for of in sums.values():
            total = total.plus(self._largest(list(of.values())))
        return total, scale

    def _largest(self, sums: list[Lin]) -> Lin:
        """Return what is never less than any of the sums, nor than 0."""
        most = max(0, *(self.store.range(lin)[1] for lin in sums))
        largest = Lin(((self.store.integer(0, most), 1),))
        for lin in sums:
            self.store.enforce(compare(lin.plus(largest, -1), "<="), ())
        return largest

    def _part(self, part: ObjectivePart) -> tuple[Lin, int]:
        if part.activity is not None:
            return self._paid(part, self.states.world.activities[part.activity])
        if part.interval is not None:
            return indicator_sum([(self._throughout(part), 1)]), 1
        if part.node.type.is_bool_type():
            return indicator_sum([(self._holds(self.final, part.node), 1)]), 1
        lin, scale = self.final.scaled(part.node)
        return self._counted(self._always_there(lin, part.node), TRUE, part), scale

    def _always_there(self, lin: Lin, node: FNode) -> Lin:
        if any(need != TRUE for need in lin.needs):
            raise UnsupportedError(
                f"the metric's '{node}' has no value where an activity that it reads is absent"
            )
        return lin._replace(needs=())

    def _paid(self, part: ObjectivePart, activity: ActivityVars) -> tuple[Lin, int]:
        """Return what an activity costs, if it is present."""
        changing = [f for f in fluents_in(part.node) if f.fluent().name in self.states.dynamic]
        if changing:
            raise UnsupportedError(
                f"the cost of activity '{activity.name}' reads '{changing[0]}', a change"
            )
        still = self.states.reader(activity, activity.present, constant(0), constant(0))
        lin, scale = Terms(self.states.world, still, activity).scaled(part.node)
        other = tuple(need for need in lin.needs if need != activity.present)
        lin = self._always_there(lin._replace(needs=other), part.node)
        sizes = self.states.in_sizes(lin)
        if len(sizes.terms) < len(lin.terms):  # what it takes, not when: closer to what it costs
            lin = sizes._replace(needs=())
        return self._counted(lin, activity.present, part), scale

    def _counted(self, lin: Lin, present: Literal, part: ObjectivePart) -> Lin:
        """Return what is paid: ``lin`` (as far as it is above 0, of a ``positive`` part, which is
        never less) where ``present`` holds, else nothing.
        """
        if not lin.terms:
            const = max(0, lin.const) if part.positive else lin.const
            return indicator_sum([(present, const)])
        if present == TRUE and not part.positive:
            return lin
        low, high = self.store.range(lin)
        paid = Lin(((self.store.integer(0 if part.positive else min(0, low), max(0, high)), 1),))
        # paid - lin >= 0, or == 0
        told = compare(lin.plus(paid, -1), "<=" if part.positive else "==")
        self.store.enforce(told, () if present == TRUE else (present,))
        if present != TRUE:
            self.store.enforce(compare(paid, "=="), (~present,))
            if low > 0:
                # a share of its presence costs a share of the least: linear relaxations do not know
                self.store.enforce(indicator_sum([(present, low)]).le(paid))
        return paid

    # -- goals -----------------------------------------------------------------------------------
    def _holds(self, terms: Terms, node: FNode) -> Literal:
        """Return a literal that is true exactly if ``node``, compared ``surely``, is true."""
        form = terms.form(node)
        return self.store.equivalent(form, negated(form))

    def _throughout(self, part: ObjectivePart) -> Literal:
        """Return a literal that is true exactly if a goal holds throughout its interval: at the
        first instant, and after each effect inside on what it reads.
        """
        states, store = self.states, self.store
        needs, some, lo, until = states.instants_of(part.interval)
        instants = [(some, lo)]
        read = (state for _, state in states.all_grounds(part.node, None))
        writes = {id(w): w for state in read for w in state.writes}
        instants += [states.right_after(w, some, lo, until) for w in writes.values()]
        held = []
        for active, instant in instants:
            seen = states.reader(None, active, instant, instant, loose=True)
            now = self._holds(Terms(states.world, seen, compare=surely), part.node)
            held.append(store.any_of([~active, now]))
        return store.all_of([*needs, *held])


def surely(difference: Lin, op: str) -> Form:
    """Return ``difference op 0`` as a form that is true only if all is there that it needs: what an
    absent activity leaves open is no goal reached, also where the times would cancel out.
    """
    return conjunction([compare(difference._replace(needs=()), op), *difference.needs])


def negated(form: Form) -> Form:
    """Return the negation of a form whose comparisons need nothing."""
    if form.__class__ is int:
        return ~form
    if form.__class__ is Cmp:
        if form.op != "<=":
            return form._replace(op="!=" if form.op == "==" else "==")
        # not (e <= 0): 1 - e <= 0
        return Cmp(tuple((v, -c) for v, c in form.terms), 1 - form.const, "<=")
    return ("|" if form[0] == "&" else "&", *map(negated, form[1:]))


def ends_in_time(problem: Any, objective: Objective) -> bool:
    """Return whether it is known that later times than are needed for some schedule bring nothing:
    sums in which times count as costs, goals that compare them. (What an effect writes down of a
    time may count in any way.)
    """
    if any(_times_in(effect.value) for _, effect, _ in problem.all_effects()):
        return False
    return all(_ends(part.node, objective.sign * part.weight) for part in objective.parts)


def lasts(node: FNode) -> bool:
    """Return whether an expression is how long one activity lasts."""
    if node.node_type is not Op.MINUS or any(a.node_type is not Op.TIMING_EXP for a in node.args):
        return False
    end, start = (a.timing() for a in node.args)
    names = end.timepoint.container, start.timepoint.container
    sides = end.is_from_end(), start.is_from_start()
    return all(sides) and names[0] == names[1] is not None and end.delay == start.delay == 0


def _times_in(node: FNode) -> bool:
    return any(n.node_type is Op.TIMING_EXP for n in walk(node))


def _ends(node: FNode, weight: int | Fraction) -> bool:
    if not _times_in(node):
        return True
    if node.type.is_bool_type():
        return not any(n.node_type in (Op.TIMES, Op.DIV) for n in walk(node))
    if node.node_type is Op.TIMING_EXP:
        return weight >= 0
    if node.node_type is Op.PLUS:
        return all(_ends(arg, weight) for arg in node.args)
    if lasts(node):
        return weight >= 0
    if node.node_type is Op.MINUS:
        return _ends(node.arg(0), weight) and _ends(node.arg(1), -weight)
    if node.node_type is Op.TIMES:
        timed = [arg for arg in node.args if _times_in(arg)]
        others = [Fraction(a.constant_value()) for a in node.args if a.is_constant()]
        if len(timed) == 1 and len(others) == len(node.args) - 1:
            return _ends(timed[0], weight * math.prod(others))
    return False
