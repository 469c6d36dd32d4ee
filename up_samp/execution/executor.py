"""Follow a plan: told where the robots are, it says what each may do now."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule

from up_samp.execution.build import Dependencies, dependencies_of
from up_samp.execution.commands import Command, Do, Go, Hold
from up_samp.execution.files import dependencies_from_plan
from up_samp.execution.forecast import Forecast, forecast, routes_of
from up_samp.execution.graph import At, Event
from up_samp.execution.pace import Pace
from up_samp.execution.remaining import remaining_problem
from up_samp.execution.sides import planned_sides
from up_samp.execution.state import Phase, State, Way
from up_samp.execution.surprise import Remaining, Surprise
from up_samp.execution.tolerances import TOLERANCES
from up_samp.io.plan_dict import PlanDict, plan_to_dict
from up_samp.model import ProblemError
from up_samp.model.execution_tuning import ExecutionTuning


class Executor:
    """The state of a plan on the floor: pure Python in, plain values out, no threads.

    ``plan`` is a plan dictionary with ``dependencies``, or any plan of ``problem``. Call ``update``
    as often as robots tell where they are, ``done`` when a task is over, and do what ``commands``
    says. Times are seconds since the plan's start; they never go back. ``tuning`` are numbers that
    say how hard orders are looked at again (docs/tuning.md).
    """

    def __init__(
        self,
        plan: PlanDict | Schedule,
        problem: SchedulingProblem | None = None,
        *,
        margin: float | None = None,
        seconds_per_unit: float | None = None,
        tolerance: float = TOLERANCES.progress,
        dependencies: Dependencies | None = None,
        tuning: ExecutionTuning | None = None,
    ):
        if isinstance(plan, Schedule):
            if problem is None:
                raise ProblemError("a UP plan can be followed only together with its problem")
            plan = plan_to_dict(problem, plan, seconds_per_unit=seconds_per_unit)
        self.plan: PlanDict = plan
        self.problem = problem
        if dependencies is not None:
            self.dependencies = dependencies
        elif problem is not None:
            self.dependencies = dependencies_of(problem, plan, margin=margin)
        else:
            self.dependencies = dependencies_from_plan(plan)
        graph = self.dependencies.graph
        self.state = State(graph, self.dependencies.travels, tolerance)
        self.routes = routes_of(graph, self.state.ways)
        self.tuning = tuning or ExecutionTuning()
        self.pace = Pace(self.tuning.pace)
        self.sides: dict[tuple[str, str, int], bool] = {}
        """Components that are passed on another side than planned (see ``reorder``)."""
        self.turned: frozenset[int] = frozenset()
        """Choices that are the other way round than planned, by their number."""
        self._running: dict[str, None] = {}
        self._ready = dict.fromkeys(sorted(graph.tasks, key=lambda n: graph.tasks[n].planned))
        self._of_robot: dict[str, list[str]] = {}
        for name in self._ready:
            for who in graph.tasks[name].who:
                self._of_robot.setdefault(who, []).append(name)

    @cached_property
    def open_sides(self) -> dict[tuple[str, str, int], bool]:
        """The components that could be passed on either side, with the plan's side."""
        return planned_sides(self.dependencies)

    def reorder(self) -> int:
        """Decide again who goes first, see :func:`up_samp.execution.reorder.reorder`."""
        from up_samp.execution.reorder import reorder

        return reorder(self)

    def remaining_problem(self, surprise: Surprise | None = None) -> Remaining:
        """Return what is left as an ordinary UP problem, see
        :func:`up_samp.execution.remaining.remaining_problem`.
        """
        if self.problem is None:
            raise ProblemError("what is left can be told only where the problem is known")
        drives = {d.key: d for life in self.dependencies.lives.values() for d in life.drives}
        return remaining_problem(self.problem, self.plan, self.state, drives, surprise)

    # ------------------------------------------------------------------ what is told

    @property
    def now(self) -> float:
        """The latest time told (s)."""
        return self.state.now

    def update(self, robot: str, *, progress: float, now: float, motion: str | None = None) -> None:
        """Note that ``robot`` is ``progress`` m along its motion under way, at ``now`` s.

        ``motion`` says which one is meant: what is told late of a motion that is over is ignored.
        """
        self.state.tick(now)
        if motion is not None and self.state.phase.get(motion) is Phase.DONE:
            return
        way = self._way_of(robot)
        if way is not None and motion is not None and way.activity != motion:
            raise ProblemError(f"'{robot}' tells of '{motion}' while in '{way.activity}'")
        if way is None:
            if progress > self.state.tolerance:
                raise ProblemError(f"'{robot}' drives, but no motion of it is under way")
            return
        self.pace.told(way, progress, self.state.now, self.state.until(way))
        self.state.move(way, progress)
        if way.progress >= way.length - self.state.tolerance:
            self._finish_motion(way.activity)

    def done(self, activity: str, now: float | None = None) -> None:
        """Note that a task that drives nothing is over."""
        if now is not None:
            self.state.tick(now)
        if activity not in self.state.phase:
            raise ProblemError(f"the plan has no activity '{activity}'")
        if self.state.phase[activity] is not Phase.RUNNING:
            raise ProblemError(
                f"'{activity}' cannot be over: it is {self.state.phase[activity].value}"
            )
        if self.state.graph.tasks[activity].moves:
            self._finish_motion(activity)
            if self.state.phase[activity] is not Phase.DONE:
                raise ProblemError(f"'{activity}' cannot be over: its motion is not at its end")
            return
        if not self.state.open(self.state.end_number[activity]):
            waits = ", ".join(self._missing(self.state.end_number[activity]))
            raise ProblemError(f"'{activity}' may not end yet: it waits for {waits}")
        self._end(activity)

    def _way_of(self, robot: str) -> Way | None:
        return self.state.of_object.get(robot)

    def _finish_motion(self, activity: str) -> None:
        ways = self.state.ways_of[activity]
        if self.state.open(self.state.end_number[activity]) and all(
            self.state.arrived(w) for w in ways
        ):
            self._end(activity)

    def _end(self, activity: str) -> None:
        self.state.phase[activity] = Phase.DONE
        self.state.fire(self.state.end_number[activity], self.state.now)
        del self._running[activity]
        for way in self.state.ways_of[activity]:
            self.state.of_object.pop(way.object, None)

    # ------------------------------------------------------------------ what to do

    def commands(self, now: float | None = None) -> dict[str, Command]:
        """Return what everybody is to do now, by robot (tasks that nobody drives for: by activity).

        What may begin has begun by being told.
        """
        if now is not None:
            self.state.tick(now)
        for name in [n for n in self._running if self.state.graph.tasks[n].moves]:
            self._finish_motion(name)
        self._begin()
        found: dict[str, Command] = {}
        for name in self._running:
            for way in self.state.ways_of[name]:
                found[way.object] = self._drive(way)
        for name in self._running:
            task = self.state.graph.tasks[name]
            if not task.moves:
                command = Do(name, self.state.open(self.state.end_number[name]))
                for who in [w for w in task.who if w not in found] or [name]:
                    found[who] = command
        for robot, names in self._of_robot.items():
            if robot not in found:
                found[robot] = Hold(self._waits(names))
        return found

    def _begin(self) -> None:
        state = self.state
        for name in [n for n in self._ready if state.missing[state.start_number[n]] == 0]:
            if any(w.object in state.of_object for w in state.ways_of[name]):
                continue
            del self._ready[name]
            self._running[name] = None
            state.phase[name] = Phase.RUNNING
            state.fire(state.start_number[name], state.now)
            for way in state.ways_of[name]:
                state.of_object[way.object] = way
                state.move(way, 0.0)

    def _drive(self, way: Way) -> Command:
        state = self.state
        until = state.until(way)
        if way.progress < until - state.tolerance:
            return Go(way.activity, until)
        if until < way.length:
            number = next(n for p, n in way.gates[way.gate :] if state.missing[n] > 0)
            return Hold(self._missing(number))
        return Hold(self._missing(state.end_number[way.activity]))

    def _waits(self, names: Sequence[str]) -> tuple[str, ...]:
        name = next((n for n in names if n in self._ready), None)
        return () if name is None else self._missing(self.state.start_number[name])

    def _missing(self, number: int) -> tuple[str, ...]:
        """Return what an event waits for, in words."""
        graph = self.state.graph
        return tuple(
            f"{graph.events[e.first]} ({e.why})"
            for e in self.state.into[number]
            if not self._holds(e.first, e.lag)
        )

    def _holds(self, first: int, lag: float) -> bool:
        since = self.state.fired.get(self.state.graph.events[first])
        return since is not None and since + lag <= self.state.now + 1e-9

    def waits_for(self, robot: str) -> tuple[str, ...]:
        """Return the objects or activities that a robot waits for now."""
        state, way = self.state, self._way_of(robot)
        if way is None:
            name = next((n for n in self._of_robot.get(robot, ()) if n in self._ready), None)
            number = None if name is None else state.start_number[name]
        else:
            closed = [n for _, n in way.gates[way.gate :] if state.missing[n] > 0]
            number = closed[0] if closed else state.end_number[way.activity]
        found: dict[str, None] = {}
        for edge in () if number is None else state.into[number]:
            if not self._holds(edge.first, edge.lag):
                event = state.graph.events[edge.first]
                found[event.object or event.activity or "time"] = None
        return tuple(found)

    @property
    def finished(self) -> bool:
        """Whether every activity is done."""
        return not self._ready and not self._running

    @property
    def left(self) -> tuple[int, int]:
        """How many activities have not begun, and how many are under way."""
        return len(self._ready), len(self._running)

    def phase(self, activity: str) -> Phase:
        """Return how far an activity is."""
        return self.state.phase[activity]

    def times(self) -> dict[str, tuple[float, float | None]]:
        """Return when activities that have begun started and ended (s; ``None``: not yet)."""
        found = {}
        for name in self.state.graph.tasks:
            start = self.state.fired.get(Event(At.START, name))
            if start is not None:
                found[name] = (start, self.state.fired.get(Event(At.END, name)))
        return found

    # ------------------------------------------------------------------ what will be

    def retime(self) -> Forecast:
        """Return when everything happens as soon as possible from now on: the longest path over
        the graph, with the bodies' speed profiles and the paces seen so far.
        """
        return forecast(self.state, self.routes, self.pace)

    def predicted_makespan(self) -> float:
        """Return when the last activity will end (s)."""
        return self.retime().makespan

    def slack(self) -> dict[str, float]:
        """Return for each activity by how much (s) it may end later without delaying the predicted
        makespan or breaking a deadline; negative where a deadline will be missed.
        """
        ahead = self.retime()
        return {name: ahead.slack(name) for name in self.state.graph.tasks}

    def late(self) -> dict[str, float]:
        """Return by how much (s) activities end, or will end, later than planned."""
        ahead = self.retime()
        found = {}
        for name, task in self.state.graph.tasks.items():
            delay = ahead.span(name)[1] - task.planned[1]
            if delay > 1e-6:
                found[name] = delay
        return found

    def missed(self) -> dict[str, float]:
        """Return by how much (s) deadlines, windows and longest durations will be missed."""
        ahead = self.retime()
        found: dict[str, float] = {}
        for bound in self.state.graph.bounds:
            over = ahead.times[bound.then] - ahead.times[bound.first] - bound.most
            if over > 1e-6:
                found[bound.why] = max(over, found.get(bound.why, 0.0))
        return found


def by_name(commands: Mapping[str, Command]) -> dict[str, dict[str, Any]]:
    """Return commands as JSON would hold them."""
    found: dict[str, dict[str, Any]] = {}
    for name, command in commands.items():
        if isinstance(command, Go):
            found[name] = {"go": command.motion, "until": command.until}
        elif isinstance(command, Do):
            found[name] = {"do": command.activity, "may_end": command.may_end}
        else:
            found[name] = {"hold": list(command.waiting_for)}
    return found
