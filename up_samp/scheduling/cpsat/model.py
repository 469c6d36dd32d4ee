"""The CP-SAT model of a scheduling problem, built once and then grown by what is appended."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from unified_planning.model import FNode
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.extensions import parts as parts_from_outside
from up_samp.model import Deadline, OutOfTimeError, UnsupportedError, check_time, in_force
from up_samp.scheduling.cpsat.encode.disjunctions import Disjunctions, find_groups, merge_forms
from up_samp.scheduling.cpsat.encode.forms import (
    FALSE,
    TRUE,
    Form,
    Lin,
    Literal,
    ModelStore,
    clauses_of,
    compare,
    constant,
    disjunction,
)
from up_samp.scheduling.cpsat.encode.objective import Encoding, ends_in_time, lasts
from up_samp.scheduling.cpsat.encode.recognition import find_histories, find_milestones, find_unary
from up_samp.scheduling.cpsat.encode.states import Key, Read, States, StateVar
from up_samp.scheduling.cpsat.encode.terms import (
    PLACEHOLDER,
    Terms,
    World,
    constant_bounds,
    constants,
    countable,
    least,
    scales_of,
)
from up_samp.scheduling.cpsat.encode.timeline import NumericTimeline, Timeline
from up_samp.scheduling.cpsat.encode.variables import Horizon, Variables, domains
from up_samp.scheduling.cpsat.normal import (
    Additions,
    NormalForm,
    Precondition,
    Watcher,
    normal_form,
)
from up_samp.upio.expressions import walk, with_timings
from up_samp.upio.objective import objective_of, only_makespan

T = TypeVar("T")


class ScheduleModel:
    """Variables and constraints for one problem, whole from the start.

    :param problem: watched by others, never changed.
    :param plain: recognise nothing: state what is written, as it is written.
    :raises OutOfTimeError: when ``deadline`` comes before the model is built.
    """

    def __init__(
        self,
        problem: SchedulingProblem,
        deadline: Deadline = Deadline.never(),
        *,
        plain: bool = False,
    ) -> None:
        self.problem = problem
        self.plain = plain
        self.limit = 0
        self.store = ModelStore()
        self.world = World(self.store)
        self.horizon = Horizon(self.store)
        self.timelines: dict[Any, Timeline | NumericTimeline] = {}
        self.unread: list[Precondition] = []
        """What is said with precedences and is no state variable."""
        self.read_counts: dict[Any, int] = {}
        self.replaced: set[Any] = set()
        """State variables that disjunctions say as well: they have no timeline."""
        self.implied: dict[Key, list[Read]] = {}
        """What clauses ask of state variables: it is stated by these clauses alone."""
        self.asked = None if only_makespan(problem) else objective_of(problem)
        """What is minimised or maximised (``None``: the makespan, or nothing)."""
        self.objective = Lin(())
        self.scale = 1
        """What is minimised is ``objective``; costs are that divided by ``scale``."""
        self.disjunctions = Disjunctions()
        self.stated: list[Form] = []
        """What was stated at first, but for disjunctions of pairs: of what is written, each family
        leaves what it does not say."""
        self.appended: list[Form] = []
        """What was stated later."""
        self._deadline = deadline
        self._is_exact = False
        """Whether the makespan variable is the latest end, not only at least that."""
        # without a deadline of its own, the one that is in force goes on to be
        with in_force(deadline) if deadline is not None else contextlib.nullcontext():
            self._build()
        self._deadline = Deadline.never()

    def _build(self) -> None:
        problem = self.problem
        parts = Watcher(problem).look()
        form = NormalForm(parts) if self.plain else normal_form(parts)
        for code, obj in enumerate(problem.all_objects):
            self.world.objects[obj.name] = code
            self.world.object_types.append(obj.type)
        self.world.makespan = self.store.integer(0, PLACEHOLDER)
        self.horizon.timepoint(self.world.makespan)
        self.world.scales = scales_of(problem)
        self.states = States(self.world, problem, constant(0))
        groups = [] if self.plain else find_groups(form)
        self.variables = Variables(self.world, self.states, self.horizon, form.presences, groups)
        for activity in self._in_time(form.parts.activities):
            self.variables.add_activity(activity)
        self.exact = self.disjunctions.take_alternatives(groups, self.world.activities, self.store)
        """Presence of each alternative -> presences of its whole group, one of them true."""
        for _, state in FAMILIES:
            state(self, form)

    def surely(self, presences: Iterable[Literal]) -> bool:
        """Return whether one of some activities is there in every schedule: this is where to ask.

        They are all that may be there of an exact group, or one of them always is; to be a member
        of such a group alone says nothing.
        """
        some = set(presences)
        return TRUE in some or any(
            all(p in some or self.store.never(p) for p in self.exact[mine])
            for mine in some & self.exact.keys()
        )

    @property
    def parameters(self) -> dict[str, tuple[int, Any, str | None]]:
        """(variable, type, activity) of decision variables."""
        return self.variables.parameters

    # -- families of constraints -----------------------------------------------------------------
    def _parameters(self, form: NormalForm) -> None:
        self.variables.add_parameters(form.parts)

    def _written(self, form: NormalForm) -> None:
        self.stated = self._forms(form.parts, first=True)
        for state in parts_from_outside("constraints").values():
            self.stated.extend(state(self))
        if not self.plain:
            self.world.domains = domains(self.stated, self.variables)
        self.horizon.preconditions(form.preconditions)

    def _dynamic(self, form: NormalForm) -> None:
        # durations may read fluents, so which of these change has to be known before
        self.states.dynamic = {e.fluent.fluent().name for _, e, _ in form.parts.effects}

    def _limits(self, form: NormalForm) -> None:
        self._set_horizon(form.parts, self.stated)

    def _durations(self, form: NormalForm) -> None:
        for activity in form.parts.activities:
            self.variables.link_times(activity)

    def _effects(self, form: NormalForm) -> None:
        for timing, effect, owner in self._in_time(form.parts.effects):
            self.states.add_effect(timing, effect, self.variables.of(owner))

    def _conditions(self, form: NormalForm) -> None:
        for span, condition, owner in self._in_time(form.parts.conditions):
            self.states.add_condition(span, condition, self.variables.of(owner))

    def _disjunctions(self, form: NormalForm) -> None:
        if not self.plain:
            activities = list(self.world.activities.values())
            self.stated = self.disjunctions.take(self.stated, activities)

    def _precedences(self, form: NormalForm) -> None:
        self.stated += self._histories(form.preconditions)

    def _milestones(self, form: NormalForm) -> None:
        if self.plain:
            return
        made, self.implied = find_milestones(self.stated, self.states)
        self._adopt(made)
        self.replaced.update(state.key for state in made)
        self.read_counts.update((state.key, 0) for state in made)

    def _merged(self, form: NormalForm) -> None:
        self.stated = merge_forms(self.stated, self.exact)

    def _loads(self, form: NormalForm) -> None:
        self.disjunctions.emit(self.store)
        self.disjunctions.emit_loads(self.store, Lin(((self.world.makespan, 1),)))

    def _metric(self, form: NormalForm) -> None:
        makespan = Lin(((self.world.makespan, 1),))
        self.objective = makespan
        if self.asked is not None:
            encoding = Encoding(self.states)
            self.objective, self.scale = encoding.cost(self.asked)
            for limited, most in self.asked.limits:
                total, scale = encoding.cost(limited)
                within = compare(total.plus(constant(-math.floor(most * scale))), "<=")
                self.store.enforce(within, ())
            told = (self.asked, *(limited for limited, _ in self.asked.limits))
            self.horizon.certain &= all(ends_in_time(self.problem, one) for one in told)

    def _rest(self, form: NormalForm) -> None:
        for stated in self._in_time(self.stated):
            self.store.enforce(stated)

    def _makespan(self, form: NormalForm) -> None:
        if self.world.makespan_used:
            self._exact_makespan()

    def _decisions(self, form: NormalForm) -> None:
        self.variables.make_decisions()

    def _in_time(self, parts: Iterable[T]) -> Iterator[T]:
        """Yield parts of the problem until the time is up."""
        for part in parts:
            if self._deadline.expired():
                raise OutOfTimeError("no time is left to build the model")
            yield part

    # -- growing ---------------------------------------------------------------------------------
    def only_tightened(self, parts: Additions) -> bool:
        """Return whether every schedule of the problem was one before (bounds stay valid).

        New effects may support conditions, new objects widen domains, longer durations may end
        what shorter ones may not, and new activities move the global end for what speaks of it.

        Assumes: what is appended takes schedules away: no effects, objects or longer reach of
        durations.
        """
        if parts.rewritten or parts.effects or parts.new_objects:
            return False
        if parts.activities and (self.states.final is not None or self.world.makespan_used):
            return False
        return all(self.variables.narrower(a) for a in parts.durations)

    def can_grow(self, parts: Additions) -> bool:
        """Return whether what was appended fits into the model as it is; else it is built anew."""
        if not self.only_tightened(parts):
            return False
        if any(None in constant_bounds(a.duration) for a in parts.activities):
            return False
        horizon = self.horizon
        if horizon.spread:
            return False
        before = horizon.bound()
        for activity in parts.activities:
            horizon.total += 2 * (4 + least(activity.duration))
        for span, _, _ in parts.conditions:
            horizon.beside(int(abs(span.lower.delay) + abs(span.upper.delay)))
        for activity in parts.durations:
            horizon.total += least(activity.duration)
        horizon.total += sum(constants(c) for c, _, _ in parts.constraints)
        return horizon.bound() <= max(self.limit, before)

    def grow(self, parts: Additions) -> None:
        """Add what was appended (:meth:`can_grow`)."""
        for activity in parts.activities:
            self.variables.add_activity(activity, self.limit)
            self.variables.link_times(activity)
        self.variables.add_parameters(parts)
        for activity in parts.durations:
            self.variables.narrow(activity)
        if parts.durations:
            self.disjunctions.emit_loads(self.store, Lin(((self.world.makespan, 1),)))
        forms = self._forms(parts)
        self.appended += forms
        for form in forms:
            self.store.enforce(form)
        for span, condition, owner in parts.conditions:
            self.states.add_condition(span, condition, self.variables.of(owner))
        self._timelines()
        if self.world.makespan_used:
            self._exact_makespan()  # perhaps what was appended is the first to mention it
        self.variables.make_decisions()

    def _forms(self, parts: Additions, first: bool = False) -> list[Form]:
        forms: list[Form] = []
        short = first and not self.plain
        absent = {~a.present for a in self.world.activities.values()} - {FALSE}
        for constraint, scope, owner in parts.constraints:
            check_time()
            if short and self.disjunctions.add_written(constraint, scope, self.world.activities):
                continue
            terms = Terms(self.world, self._static, self.variables.of(owner))
            form = terms.form(constraint)
            if scope:
                form = disjunction([*(terms.form(s, False) for s in scope), form])
            forms += clauses_of(form, absent) if short else (form,)
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
            if None in constant_bounds(activity.duration):
                horizon.lasting(activity.duration.lower, self.world)
        widest = max(self.disjunctions.gaps.values(), default=0)
        horizon.gap(widest)
        horizon.total += len(self.world.activities) * widest
        for timing, _, _ in parts.effects:
            horizon.beside(countable(int(abs(timing.delay))))
        asked = () if self.asked is None else self.asked.all_parts
        timed = [with_timings(p.interval) for p in asked if p.interval is not None]
        for span in [*(span for span, _, _ in parts.conditions), *timed]:
            horizon.beside(int(abs(span.lower.delay) + abs(span.upper.delay)))
        horizon.total += sum(constants(p.node) for p in asked)
        horizon.spread = any(lasts(n) for p in asked for n in walk(p.node))
        # room for what may be appended later, so that growing seldom means rebuilding
        self.limit = 2 * horizon.bound() + 100
        latest = 2**58  # a few such numbers are summed
        if self.limit > latest:
            raise UnsupportedError(
                f"cpsat counts times to {latest}, and a schedule of this problem may last "
                "longer: choose a larger unit"
            )
        delays = [int(abs(t.delay)) for t, _, _ in parts.effects]
        delays += [int(abs(s.upper.delay)) for s, _, _ in parts.conditions]
        delays += [int(abs(s.upper.delay)) for s in timed]
        self.states.far = constant(self.limit + max(delays, default=0) + 2)
        for var in self.variables.time_variables():
            self.store.rebound(var, self.limit)

    def _unary(self, form: NormalForm) -> None:
        """Take what is said by resources, levels and states that are for one as disjunctions."""
        for unary in [] if self.plain else find_unary(self.states):
            self.disjunctions.add_unary(unary)
            if unary.whole:
                self.replaced.add(unary.key)
                self.read_counts[unary.key] = len(self.states.vars[unary.key].reads)

    def _histories(self, preconditions: list[Precondition]) -> list[Form]:
        """Take what is said by precedences as conditions on state variables, where that is the
        same; return what has to be stated as it is written.
        """
        activities, gap = self.world.activities, self.disjunctions.gap
        made, left = find_histories(preconditions, activities, gap)
        self.unread = left
        self._adopt(made)
        return self._forms(Additions(constraints=[p.constraint for p in left]))

    def _adopt(self, states: Iterable[StateVar]) -> None:
        """Take what was found to be a state variable for one."""
        for state in states:
            self.states.vars[state.key] = state
            self.states.dynamic.add(state.key[0])

    def _timelines(self, form: NormalForm | None = None) -> None:
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
                    else Timeline(self.states, state, apart, circuits=not self.plain)
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
        """Return a copy of the CP-SAT model in which everything ends by ``makespan``; it holds
        until the next one is asked for.

        Times of absent activities are capped too, which costs nothing. Small domains make
        precedence cycles fail at once.
        """
        copy = self.store.copy()
        variables = copy.proto.variables
        for var in self.variables.time_variables():
            domain = variables[self.store.position(var)].domain
            if len(domain) == 2 and domain[0] <= makespan < domain[1]:
                domain[1] = makespan
        return copy


FAMILIES: tuple[tuple[str, Callable[[ScheduleModel, NormalForm], None]], ...] = (
    ("decision variables", ScheduleModel._parameters),
    ("constraints as they are written", ScheduleModel._written),
    ("which fluents change", ScheduleModel._dynamic),
    ("the horizon", ScheduleModel._limits),
    ("starts, durations and ends", ScheduleModel._durations),
    ("effects", ScheduleModel._effects),
    ("conditions", ScheduleModel._conditions),
    ("disjunctions of pairs", ScheduleModel._disjunctions),
    ("unary resources", ScheduleModel._unary),
    ("precedences that say states", ScheduleModel._precedences),
    ("what clauses need to have been done", ScheduleModel._milestones),
    ("alternatives said as one", ScheduleModel._merged),
    ("loads of resources", ScheduleModel._loads),
    ("the metric", ScheduleModel._metric),
    ("timelines of states", ScheduleModel._timelines),
    ("all other constraints", ScheduleModel._rest),
    ("the latest end", ScheduleModel._makespan),
    ("what solutions are read from", ScheduleModel._decisions),
)
"""What a model states, in this order."""
