"""Variables of activities and parameters, how their times hang together, which values are left to a
parameter, and how long a schedule may be.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from unified_planning.model import DurationInterval, FNode
from unified_planning.model.scheduling import Activity

from up_samp.model import UnsupportedError
from up_samp.scheduling.cpsat.encode.disjunctions import Alternatives
from up_samp.scheduling.cpsat.encode.forms import (
    FALSE,
    TRUE,
    Cmp,
    Form,
    Lin,
    Literal,
    ModelStore,
    compare,
    comparisons,
    constant,
    variables_in,
)
from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.terms import (
    INFINITE,
    MAGNITUDE,
    PLACEHOLDER,
    ActivityVars,
    Terms,
    World,
    check_duration,
    constant_bounds,
    int_bounds,
)
from up_samp.scheduling.cpsat.normal import Additions, Precondition, Presences, called


def domains(forms: Iterable[Form], variables: Variables) -> dict[int, frozenset[int]]:
    """Return, of the parameters that are objects and of which some form speaks alone, the values
    that are left.

    Forms that hold where the parameter's activity is there are enough: nobody asks for the values
    of what is absent.

    Assumes: a form speaks of one parameter alone, and holds wherever its activity is there.
    """
    activities, bounds = variables.world.activities, variables.store.bounds
    owners = {
        var: None if owner is None else activities[owner]
        for var, tpe, owner in variables.parameters.values()
        if tpe.is_user_type()
    }
    told: dict[int, list[Form]] = {}
    for form in forms:
        compared = variables_in(form)
        if len(compared) == 1 and compared <= owners.keys():
            (var,) = compared
            owner = owners[var]
            if _literals(form) <= {~(TRUE if owner is None else owner.present)}:
                told.setdefault(var, []).append(form)
    found = {}
    for var, some in told.items():
        low, high = bounds[var]
        found[var] = frozenset(
            v
            for v in range(low, high + 1)
            if all(implied_length(f, owners[var], {var: v}) < INFINITE for f in some)
        )
    return found


def _literals(form: Form) -> frozenset[Literal]:
    if form.__class__ is int:
        return frozenset((form,))
    if form.__class__ is Cmp:
        return frozenset(~need for need in form.needs)
    return frozenset[Literal]().union(*map(_literals, form[1:]))


Values = Mapping[int, int]
"""Variable (a parameter) -> value."""


def implied_length(form: Form, activity: ActivityVars | None, values: Values) -> int:
    """Return how long an activity that is there (``None``: the problem itself) lasts at least for a
    form to hold, if its parameters have ``values``; INFINITE if it cannot hold.
    """
    present = TRUE if activity is None else activity.present
    if form.__class__ is tuple:
        enough, better = (0, min) if form[0] == "|" else (INFINITE, max)
        least = INFINITE - enough
        for part in form[1:]:
            least = better(least, implied_length(part, activity, values))
            if least == enough:
                break
        return least
    if form.__class__ is int:
        return INFINITE if form in (FALSE, ~present) else 0
    if form.needs and any(need != present for need in form.needs):
        return 0
    if all(var in values for var, _ in form.terms):
        worth = form.const + sum(factor * values[var] for var, factor in form.terms)
        holds = {"<=": worth <= 0, "==": worth == 0, "!=": worth != 0}[form.op]
        return 0 if holds else INFINITE
    if activity is None:
        return 0
    terms = dict(form.terms)
    start, end = activity.start.terms[0][0], activity.end.terms[0][0]
    if len(terms) == 2 and terms.keys() == {start, end} and form.op in ("<=", "=="):
        if terms[start] == 1 and terms[end] == -1:
            return max(0, form.const)
        if form.op == "==" and terms[start] == -1 and terms[end] == 1:
            return max(0, -form.const)
    return 0


# ------------------ Variables of activities and parameters, and how their times hang together


class Variables:
    """Makes the variables of a model.

    ``presences`` tell which decisions are one; all members of one of the ``groups`` have one start,
    whichever of them is listed first. ``parameters`` holds (variable, type, activity) by name.
    """

    def __init__(
        self,
        world: World,
        states: States,
        horizon: Horizon,
        presences: Presences,
        groups: Iterable[Alternatives],
    ) -> None:
        self.world = world
        self.store: ModelStore = world.store
        self.states = states
        self.horizon = horizon
        self.parameters: dict[str, tuple[int, Any, str | None]] = {}
        self.told: dict[str, DurationInterval] = {}
        """Durations that are no numbers, by activity."""
        self._presences = presences
        self._group = {name: number for number, g in enumerate(groups) for name in g}
        self._starts: dict[int, int] = {}
        self._decisions: dict[str, Literal] = {}

    def of(self, activity: Activity | None) -> ActivityVars | None:
        """Return an activity's variables (None: of the problem itself)."""
        return None if activity is None else self.world.activities[activity.name]

    def add_activity(self, activity: Activity, limit: int = PLACEHOLDER) -> None:
        """Make the variables of an activity that ends by ``limit``."""
        check_duration(activity)
        store = self.store
        present = self._decision(activity.name) if activity.optional else TRUE
        needs = () if present == TRUE else (present,)
        start = Lin(((self._start(activity.name, limit), 1),), 0, needs)
        lower, upper = constant_bounds(activity.duration)
        if lower is not None and lower == upper:
            end, size = start.shift(lower), constant(lower)
        else:
            longest = limit if upper is None else max(upper, lower or 0)
            size = Lin(((store.integer(lower or 0, longest), 1),))
            end = Lin(((store.integer(0, limit), 1),), 0, needs)
        made = ActivityVars(
            activity.name, len(self.world.activities), present, start, end, lower or 0, upper, size
        )
        self.world.activities[activity.name] = made
        self.states.register(made)
        if limit == PLACEHOLDER:
            self.horizon.activity(made)

    def _start(self, name: str, limit: int) -> int:
        """Return the start variable of an activity: its own, or that of its group."""
        group = self._group.get(name)
        if group is None:
            return self.store.integer(0, limit)
        if group not in self._starts:
            self._starts[group] = self.store.integer(0, limit)
        return self._starts[group]

    def _decision(self, name: str) -> Literal:
        """Return the literal that decides about an optional activity or a bool variable."""
        leader = self._presences.get(name, name)
        if leader not in self._decisions:
            self._decisions[leader] = self.store.boolean()
        return self._decisions[leader]

    def add_parameters(self, parts: Additions) -> None:
        """Make the variables of all decision variables."""
        for parameter in parts.variables:
            self._parameter(parameter, None)
        for activity, parameter in parts.parameters:
            self._parameter(parameter, activity)

    def _parameter(self, parameter: Any, activity: Activity | None) -> None:
        tpe = parameter.type
        if parameter.name in self.parameters:
            raise UnsupportedError(f"two decision variables are called '{parameter.name}'")
        if tpe.is_bool_type() and activity is None:
            var = self._decision(called(parameter))
        elif tpe.is_bool_type() or tpe.is_user_type():
            values = self.world.values_of(tpe)
            if not values:
                raise UnsupportedError(f"there is no object for '{parameter.name}' of type '{tpe}'")
            var = self.store.member(values)
        else:
            low, high = int_bounds(tpe)
            var = self.store.integer(low, max(low, high))
        made = self.of(activity)
        needs = () if made is None or made.present == TRUE else (made.present,)
        if tpe.is_int_type() and low > high:
            self.store.enforce(FALSE, needs)  # there is no such number
        self.world.parameters[parameter.name] = Lin(((var, 1),), 0, needs)
        self.parameters[parameter.name] = (var, tpe, None if activity is None else activity.name)

    def link_times(self, activity: Activity) -> None:
        """Tie an activity's times and duration together."""
        store = self.store
        made = self.world.activities[activity.name]
        if made.most is not None and made.most < made.least:
            store.enforce(FALSE, (made.present,))  # it lasts no time that there is
        if made.size.terms:
            total = made.start.plus(made.size).plus(made.end, -1)
            store.enforce(compare(total._replace(needs=()), "=="), (made.present,))
            if None in constant_bounds(activity.duration):
                self.told[activity.name] = activity.duration
                self._duration_terms(activity, made)
        store.enforce(made.end.le(Lin(((self.world.makespan, 1),))))

    def _duration_terms(self, activity: Activity, made: ActivityVars) -> None:
        duration = activity.duration
        reader = self.states.reader(made, made.present, made.start, made.start)
        terms = Terms(self.world, reader, made)
        lower, upper = terms.linear(duration.lower), terms.linear(duration.upper)
        low = lower.shift(1 if duration.is_left_open() else 0)
        high = upper.shift(-1 if duration.is_right_open() else 0)
        self.store.enforce(low.le(made.size), (made.present,))
        self.store.enforce(made.size.le(high), (made.present,))

    def narrower(self, activity: Activity) -> bool:
        """Return whether an activity's duration may be no more than it might before."""
        lower, upper = constant_bounds(activity.duration)
        made = self.world.activities[activity.name]
        if lower is None or upper is None or made.most is None:
            return False
        return lower >= made.least and upper <= made.most

    def narrow(self, activity: Activity) -> None:
        """State an activity's narrower duration."""
        lower, upper = constant_bounds(activity.duration)
        made = self.world.activities[activity.name]
        when = (made.present,)
        self.store.enforce(made.start.shift(lower or 0).le(made.end), when)
        if upper is not None:
            self.store.enforce(made.end.le(made.start.shift(upper)), when)
        made.least, made.most = lower or 0, upper
        if made.size.terms and upper is not None:
            self.store.bounds[made.size.terms[0][0]] = (made.least, max(made.least, upper))

    def make_decisions(self) -> None:
        """Make the variables that solutions are read from, even where nothing constrains them."""
        self.store.var(self.world.makespan)
        for made in self.world.activities.values():
            for lin in (made.start, made.end, Lin(((abs(made.present), 1),))):
                for var, _ in lin.terms:
                    self.store.var(var)
        for var, _, _ in self.parameters.values():
            self.store.var(var)

    def time_variables(self) -> list[int]:
        """Return the makespan and the start and end variables."""
        times = [self.world.makespan]
        for made in self.world.activities.values():
            times += [v for lin in (made.start, made.end) for v, _ in lin.terms]
        return sorted(set(times))


# ------------------ How long a schedule may have to be
# A bound that loses neither feasibility nor optimality.


class Horizon:
    """Collects weights into timepoints: in the least solution of differences between times, none is
    later than all weights on a longest path.

    ``spread``: a least solution is not enough, as what lies between two times counts. Then longer
    gaps between instants than any single weight are closed to that: all differences get smaller.
    """

    def __init__(self, store: ModelStore) -> None:
        self.store = store
        self.certain = True
        self.spread = False
        self._instants = 2
        self._widest = 1
        self.origin = 1
        self.total = 1
        self._into: dict[int, int] = {}
        self._length: dict[int, int] = {}

    def activity(self, activity: ActivityVars) -> None:
        """Count an activity: its shortest duration, and an effect or condition beside it."""
        self._note(activity.least, 2)
        start = activity.start.terms[0][0]
        if start in self._length:
            return  # an alternative of one that is counted
        fixed = activity.end.terms == activity.start.terms
        self._length[start] = activity.least if fixed else 0
        self._into.setdefault(start, 0)
        if not fixed:
            self._into.setdefault(activity.end.terms[0][0], max(0, activity.least))
        self.total += activity.least if fixed else 0

    def timepoint(self, var: int) -> None:
        """Count a timepoint that is one of the activities' (the makespan)."""
        self._into.setdefault(var, 0)

    def lasting(self, least: FNode, world: World) -> None:
        """Count an activity that lasts ``least``, by what its parameters and fluents may be."""

        def read(node: FNode) -> Lin:
            return Lin(((self.store.integer(*int_bounds(node.fluent().type)), 1),))

        longest = self.store.range(Terms(world, read).linear(least))[1] + 1
        if longest >= MAGNITUDE:
            self.certain = False
        else:
            self.total += max(0, longest)
            self._note(longest)

    def beside(self, delay: int) -> None:
        """Count an effect or a condition with a delay (gaps of 1 + delay may be needed)."""
        self.total += 2 + abs(delay)
        self._note(2 + abs(delay), 2)

    def preconditions(self, preconditions: Iterable[Precondition]) -> None:
        """Count what is said with precedences: gaps before each activity that is named."""
        for precondition in preconditions:
            rivals = [*precondition.helpers.values(), precondition.initially or frozenset()]
            named = frozenset(precondition.helpers).union(*rivals)
            self.total += 2 + precondition.gap * (1 + len(named))
            self._note(2 + precondition.gap)

    def forms(self, forms: Iterable[Form]) -> None:
        """Count constraints."""
        into, length = self._into, self._length
        for form in forms:
            for cmp in comparisons(form):
                times = [(v, c) for v, c in cmp.terms if v in into]
                if not times:
                    continue
                if len(times) > 2 or any(abs(c) != 1 for _, c in times):
                    self.certain = False
                weight = self._weight(cmp, times)
                self._note(max(weight, abs(cmp.const)))
                if len(times) == 1:
                    self.origin = max(self.origin, weight)
                    continue
                for var, coef in times:
                    if coef < 0 or cmp.op != "<=":
                        other = next((v for v, _ in times if v != var), var)
                        short = weight - length.get(other, 0)
                        into[var] = max(into[var], short if short >= 0 else weight)

    def gap(self, gap: int) -> None:
        """Count a gap that is kept between activities."""
        self._note(gap)

    def _note(self, weight: int, instants: int = 0) -> None:
        self._widest = max(self._widest, weight)
        self._instants += instants

    def _weight(self, cmp: Cmp, times: list[tuple[int, int]]) -> int:
        names = {v for v, _ in times}
        weight = abs(cmp.const) if cmp.op != "<=" else cmp.const
        for var, coef in cmp.terms:
            if var not in names:
                low, high = self.store.bounds[var]
                weight += max(coef * low, coef * high, 0)
        return max(0, weight + (cmp.op == "!=")) if cmp.op == "<=" else abs(weight) + 1

    def bound(self) -> int:
        """Return a time by which a schedule can be over, if there is one at all."""
        longest = self.total + self.origin + sum(self._into.values())
        if self.spread:
            longest = max(longest, self._instants * self._widest)
        return longest if self.certain else 3 * longest + 100
