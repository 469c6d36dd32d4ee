"""The CP-SAT model of a scheduling problem, built once and then grown by what is appended."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

from unified_planning.model import FNode
from unified_planning.model.scheduling import Activity, SchedulingProblem

from up_samp.model import Deadline, UnsupportedError
from up_samp.scheduling.cpsat.encode.alternatives import Group, find_groups, merge_forms
from up_samp.scheduling.cpsat.encode.durations import constant_bounds, constants, least
from up_samp.scheduling.cpsat.encode.histories import find_histories
from up_samp.scheduling.cpsat.encode.horizon import Horizon
from up_samp.scheduling.cpsat.encode.metrics import objective_of
from up_samp.scheduling.cpsat.encode.numbers import NumericTimeline
from up_samp.scheduling.cpsat.encode.pairs import Disjunctions
from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.store import (
    TRUE,
    Form,
    Lin,
    Literal,
    Store,
    compare,
    constant,
    disjunction,
)
from up_samp.scheduling.cpsat.encode.terms import ActivityVars, Terms, World, int_bounds
from up_samp.scheduling.cpsat.encode.timeline import Timeline
from up_samp.scheduling.cpsat.encode.unary import find_unary
from up_samp.scheduling.cpsat.normal.form import normal_form
from up_samp.scheduling.cpsat.normal.precedences import FollowUp, Precondition
from up_samp.scheduling.cpsat.normal.presences import Presences
from up_samp.scheduling.cpsat.problem import Additions

_PLACEHOLDER = 10**7

T = TypeVar("T")


class OutOfTimeError(Exception):
    """The time was up while a model was being built."""


class ScheduleModel:
    """Variables and constraints for one problem.

    :param problem: its parts are passed in by :meth:`build` and :meth:`grow`.
    """

    def __init__(self, problem: SchedulingProblem) -> None:
        self.problem = problem
        self.store = Store()
        self.world = World(self.store)
        self.horizon = Horizon(self.store)
        self.parameters: dict[str, tuple[int, Any, str | None]] = {}
        self.timelines: dict[Any, Timeline | NumericTimeline] = {}
        self.follow_ups: list[FollowUp] = []
        self.unread: list[Precondition] = []
        """What is said with precedences and is no state variable."""
        self.read_counts: dict[Any, int] = {}
        self.replaced: set[Any] = set()
        """State variables that disjunctions say as well: they have no timeline."""
        self.objective: Lin | None = None
        self.disjunctions = Disjunctions()
        self.limit = 0
        self.limit_at_least = 0
        self.exact: dict[int, tuple[int, ...]] = {}
        """Presence of each alternative -> presences of its whole group, one of them true."""
        self.stated: list[Form] = []
        """What was stated at first, but for disjunctions of pairs."""
        self._leaders: dict[str, str] = {}
        self._presences = Presences({})
        self._decisions: dict[str, Literal] = {}
        self._deadline = Deadline.never()
        self._is_exact = False
        """Whether the makespan variable is the latest end, not only at least that."""

    # -- building ------------------------------------------------------------------------------
    def build(self, parts: Additions, deadline: Deadline | None = None) -> None:
        """Build the model from everything there is.

        :raises OutOfTimeError: when ``deadline`` comes before that; the model is of no use then.
        """
        self._deadline = deadline or Deadline.never()
        world, store = self.world, self.store
        for code, obj in enumerate(self.problem.all_objects):
            world.objects[obj.name] = code
            world.object_types.append(obj.type)
        world.makespan = store.integer(0, _PLACEHOLDER)
        self.horizon.timepoint(world.makespan)
        self.states = States(world, self.problem, constant(0))
        form = normal_form(parts)
        parts, self._presences = form.parts, form.presences
        groups = find_groups(parts, form.presences)
        self._leaders = {name: g.names[0] for g in groups for name in g.names}
        for activity in self._in_time(parts.activities):
            self._activity(activity)
        self.exact = self._alternatives(groups)
        self._parameters(parts)
        forms = self._forms(parts, first=True)
        self.follow_ups = form.follow_ups
        self.horizon.preconditions(form.preconditions)
        # durations may read fluents, so which of these change has to be known before
        self.states.dynamic = {e.fluent.fluent().name for _, e, _ in parts.effects}
        self._set_horizon(parts, forms)
        for activity in parts.activities:
            self._link_times(activity, vague=activity.name in parts.vague)
        for timing, effect, owner in self._in_time(parts.effects):
            self.states.add_effect(timing, effect, self._vars(owner))
        for span, condition, owner in self._in_time(parts.conditions):
            self.states.add_condition(span, condition, self._vars(owner))
        rest = self.disjunctions.take(forms, list(world.activities.values()))
        self._unary()
        rest += self._histories(form.preconditions)
        rest = self.stated = merge_forms(rest, self.exact)
        self.disjunctions.emit(store, self.states)
        self.disjunctions.emit_loads(store, Lin(((world.makespan, 1),)))
        self.objective = objective_of(self.problem, self.states, self._exact_makespan)
        self._timelines()
        for form in self._in_time(rest):
            store.enforce(form)
        if world.makespan_used and parts.whole:
            self._exact_makespan()
        self._make_decisions()
        self._deadline = Deadline.never()

    def _in_time(self, parts: Iterable[T]) -> Iterator[T]:
        """Yield parts of the problem until the time is up."""
        for part in parts:
            if self._deadline.expired():
                raise OutOfTimeError
            yield part

    def grow(self, parts: Additions) -> None:
        """Add what was appended (no effects, no new objects; see :meth:`can_grow`)."""
        for activity in parts.activities:
            self._activity(activity, self.limit)
            self._link_times(activity)
        self._parameters(parts)
        for activity in parts.durations:
            self._narrow(activity)
        if parts.durations:
            self.disjunctions.emit_loads(self.store, Lin(((self.world.makespan, 1),)))
        for form in self._forms(parts):
            self.store.enforce(form)
        for span, condition, owner in parts.conditions:
            self.states.add_condition(span, condition, self._vars(owner))
        self._timelines()
        if self.world.makespan_used:
            self._exact_makespan()  # perhaps what was appended is the first to mention it
        self._make_decisions()

    def _make_decisions(self) -> None:
        """Make the variables that solutions are read from, even where nothing constrains them."""
        self.store.var(self.world.makespan)
        for made in self.world.activities.values():
            for lin in (made.start, made.end, Lin(((abs(made.present), 1),))):
                for var, _ in lin.terms:
                    self.store.var(var)
        for var, _, _ in self.parameters.values():
            self.store.var(var)

    def only_tightened(self, parts: Additions) -> bool:
        """Return whether every schedule of the problem was one before (bounds stay valid).

        New effects may support conditions, new objects widen domains, longer durations may end
        what shorter ones may not, and new activities move the global end for what speaks of it.
        """
        if parts.rewritten or parts.effects or parts.new_objects:
            return False
        if parts.activities and (self.states.final is not None or self.world.makespan_used):
            return False
        return all(self._narrower(a) for a in parts.durations)

    def can_grow(self, parts: Additions) -> bool:
        """Return whether the additions fit into the model as it is."""
        if not self.only_tightened(parts):
            return False
        if any(None in constant_bounds(a.duration) for a in parts.activities):
            return False
        horizon = self.horizon
        before = horizon.bound()
        for activity in parts.activities:
            horizon.total += 2 * (4 + least(activity.duration))
        for span, _, _ in parts.conditions:
            horizon.beside(int(abs(span.lower.delay) + abs(span.upper.delay)))
        for activity in parts.durations:
            horizon.total += least(activity.duration)
        horizon.total += sum(constants(c) for c, _, _ in parts.constraints)
        return horizon.bound() <= max(self.limit, before)

    # -- parts ---------------------------------------------------------------------------------
    def _vars(self, activity: Activity | None) -> ActivityVars | None:
        return None if activity is None else self.world.activities[activity.name]

    def _activity(self, activity: Activity, limit: int = _PLACEHOLDER) -> None:
        store = self.store
        present = self._decision(activity.name) if activity.optional else TRUE
        needs = () if present == TRUE else (present,)
        leader = self.world.activities.get(self._leaders.get(activity.name, ""))
        times = ((store.integer(0, limit), 1),) if leader is None else leader.start.terms
        start = Lin(times, 0, needs)
        lower, upper = constant_bounds(activity.duration)
        if lower is not None and lower == upper:
            end, size = start.shift(lower), constant(lower)
        else:
            size = Lin(((store.integer(lower or 0, limit if upper is None else upper), 1),))
            end = Lin(((store.integer(0, limit), 1),), 0, needs)
        made = ActivityVars(
            activity.name, len(self.world.activities), present, start, end, lower or 0, upper, size
        )
        self.world.activities[activity.name] = made
        self.states.register(made)
        if limit == _PLACEHOLDER:
            self.horizon.activity(made)

    def _decision(self, name: str) -> Literal:
        """Return the literal that decides about an optional activity or a bool variable."""
        leader = self._presences.of(name)
        if leader not in self._decisions:
            self._decisions[leader] = self.store.boolean()
        return self._decisions[leader]

    def _alternatives(self, groups: list[Group]) -> dict[int, tuple[int, ...]]:
        """Tell who is never there together; return presence -> presences of its exact group."""
        exact: dict[int, tuple[int, ...]] = {}
        for group in groups:
            members = [self.world.activities[name] for name in group.names]
            indices = sorted(a.index for a in members)
            self.disjunctions.exclusive.update(itertools.combinations(indices, 2))
            self.store.at_most_one([a.present for a in members])
            if group.exact:
                self.disjunctions.groups.append(members)
                exact.update({a.present: tuple(m.present for m in members) for a in members})
        return exact

    def _link_times(self, activity: Activity, *, vague: bool = False) -> None:
        store = self.store
        made = self.world.activities[activity.name]
        if made.size.terms:
            total = made.start.plus(made.size).plus(made.end, -1)
            store.enforce(compare(total._replace(needs=()), "=="), (made.present,))
            if None in constant_bounds(activity.duration) and not vague:
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

    def _narrower(self, activity: Activity) -> bool:
        lower, upper = constant_bounds(activity.duration)
        made = self.world.activities[activity.name]
        if lower is None or upper is None or made.most is None:
            return False
        return lower >= made.least and upper <= made.most

    def _narrow(self, activity: Activity) -> None:
        lower, upper = constant_bounds(activity.duration)
        made = self.world.activities[activity.name]
        when = (made.present,)
        self.store.enforce(made.start.shift(lower or 0).le(made.end), when)
        if upper is not None:
            self.store.enforce(made.end.le(made.start.shift(upper)), when)
        made.least, made.most = lower or 0, upper
        if made.size.terms and upper is not None:
            self.store.bounds[made.size.terms[0][0]] = (made.least, upper)

    def _parameters(self, parts: Additions) -> None:
        for parameter in parts.variables:
            self._parameter(parameter, None)
        for activity, parameter in parts.parameters:
            self._parameter(parameter, activity)

    def _parameter(self, parameter: Any, activity: Activity | None) -> None:
        tpe = parameter.type
        if tpe.is_bool_type() and activity is None:
            var = self._decision(parameter.name)
        elif tpe.is_bool_type() or tpe.is_user_type():
            values = self.world.values_of(tpe)
            if not values:
                raise UnsupportedError(f"there is no object for '{parameter.name}' of type '{tpe}'")
            var = self.store.member(values)
        else:
            var = self.store.integer(*int_bounds(tpe))
        made = self._vars(activity)
        needs = () if made is None or made.present == TRUE else (made.present,)
        self.world.parameters[parameter.name] = Lin(((var, 1),), 0, needs)
        self.parameters[parameter.name] = (var, tpe, None if activity is None else activity.name)

    def _forms(self, parts: Additions, first: bool = False) -> list[Form]:
        forms: list[Form] = []
        for constraint, scope, owner in parts.constraints:
            if first and self.disjunctions.add_written(constraint, scope, self.world.activities):
                continue
            terms = Terms(self.world, self._static, self._vars(owner))
            form = terms.form(constraint)
            if scope:
                form = disjunction([*(terms.form(s, False) for s in scope), form])
            forms.append(form)
        return forms

    def _static(self, node: FNode) -> Lin:
        """Return the value of a fluent that never changes (constraints may use no other)."""
        if node.fluent().name in self._changing():
            raise UnsupportedError(
                f"the constraint reads '{node}', which changes; use a condition at a time instead"
            )
        return self.states.reader(None, TRUE, constant(0), constant(0))(node)  # type: ignore[no-any-return]

    def _changing(self) -> set[str]:
        effects = [e for _, e, _ in self.problem.all_effects()] if self.limit == 0 else []
        return self.states.dynamic | {e.fluent.fluent().name for e in effects}

    def _set_horizon(self, parts: Additions, forms: list[Form]) -> None:
        horizon = self.horizon
        horizon.forms(forms)
        for activity in parts.activities:
            if None in constant_bounds(activity.duration) and activity.name not in parts.vague:
                horizon.lasting(activity.duration.lower, self.world)
        horizon.total += len(self.world.activities) * max(
            self.disjunctions.gaps.values(), default=0
        )
        for timing, _, _ in parts.effects:
            horizon.beside(int(abs(timing.delay)))
        for span, _, _ in parts.conditions:
            horizon.beside(int(abs(span.lower.delay) + abs(span.upper.delay)))
        # room for what may be appended later, so that growing seldom means rebuilding
        self.limit = max(2 * horizon.bound() + 100, self.limit_at_least)
        delays = [int(abs(t.delay)) for t, _, _ in parts.effects]
        delays += [int(abs(s.upper.delay)) for s, _, _ in parts.conditions]
        self.states.far = constant(self.limit + max(delays, default=0) + 2)
        for var in self.time_variables():
            self.store.rebound(var, 0, self.limit)

    def _unary(self) -> None:
        """Take what is said by resources, levels and states that are for one as disjunctions."""
        for unary in find_unary(self.states):
            self.disjunctions.add_unary(unary)
            if unary.whole:
                self.replaced.add(unary.key)
                self.read_counts[unary.key] = len(self.states.vars[unary.key].reads)

    def _histories(self, preconditions: list[Precondition]) -> list[Form]:
        """Take what is said by precedences as conditions on state variables, where that is the
        same; return what has to be stated as it is written.
        """
        found = find_histories(
            preconditions,
            self.world.activities,
            self.disjunctions.gap,
            [s for k, s in self.states.vars.items() if k[0] in self.states.dynamic],
        )
        self.unread = found.left
        for state, reads in found.reads:
            state.reads += reads
        for state in (*found.states, *found.milestones):
            self.states.vars[state.key] = state
            self.states.dynamic.add(state.key[0])
        for state in found.milestones:
            self.replaced.add(state.key)
            self.read_counts[state.key] = len(state.reads)
        return self._forms(Additions(constraints=[p.constraint for p in found.left]))

    def _timelines(self) -> None:
        for key, state in self._in_time(self.states.vars.items()):
            if key[0] not in self.states.dynamic:
                continue
            timeline = self.timelines.get(key)
            if key in self.replaced:
                if len(state.reads) == self.read_counts[key]:
                    continue
                self.replaced.discard(key)  # what reads it now is not said by disjunctions
            if timeline is None:
                apart = self.disjunctions.apart
                timeline = (
                    NumericTimeline(self.states, state)
                    if state.numeric
                    else Timeline(self.states, state, apart)
                )
                self.timelines[key] = timeline
                timeline.build()
            else:
                for read in state.reads[self.read_counts[key] :]:
                    timeline.add_read(read)
            self.read_counts[key] = len(state.reads)

    def _exact_makespan(self) -> None:
        """Make the makespan variable equal to the latest end, where constraints mention it."""
        if self._is_exact:
            return
        self._is_exact = True
        ends = [(made.present, made.end) for made in self.world.activities.values()]
        self.store.attain(Lin(((self.world.makespan, 1),)), [(TRUE, constant(0)), *ends])

    def capped(self, makespan: int) -> Any:
        """Return a copy of the CP-SAT model in which everything ends by ``makespan``.

        Times of absent activities are capped too, which costs nothing. Small domains make
        precedence cycles fail at once.
        """
        copy = self.store.model.clone()
        variables = copy.proto.variables
        for var in self.time_variables():
            domain = variables[self.store.position(var)].domain
            if len(domain) == 2 and domain[0] <= makespan < domain[1]:
                domain[1] = makespan
        return copy

    def time_variables(self) -> list[int]:
        """Return the makespan and the start and end variables."""
        times = [self.world.makespan]
        for made in self.world.activities.values():
            times += [v for lin in (made.start, made.end) for v, _ in lin.terms]
        return sorted(set(times))
