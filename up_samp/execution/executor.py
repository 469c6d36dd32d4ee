"""Follow a plan: told where the robots are, it says what each may do now."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule

from up_samp.execution.astray import (
    Overrun,
    beside,
    coming_to,
    kept_away,
    place_of,
    pose_in,
)
from up_samp.execution.build import Dependencies, dependencies_of, with_sides
from up_samp.execution.files import dependencies_from_plan, event_from_list, event_to_list
from up_samp.execution.graph import At, Event, Graph, Narrow
from up_samp.execution.lives import drives_of, errors_of
from up_samp.execution.remaining import Remaining, Surprise, remaining_problem
from up_samp.execution.reorder import Followed, Proposal, adopt, propose
from up_samp.execution.reports import (
    TAKEN,
    Command,
    Do,
    Go,
    Heard,
    Hold,
    Reply,
    clock_doubt,
    doubt,
    is_number,
    unreadable,
)
from up_samp.execution.state import FloorState, MotionUnderWay, Strayed, TaskPhase
from up_samp.execution.tolerances import TOLERANCES
from up_samp.execution.travel import Along, along, away, pose_at
from up_samp.io.plan_dict import PlanDict, plan_to_dict
from up_samp.model import ProblemError

FORMAT, VERSION = "up-samp-execution", 1
_KEPT: dict[str, type] = {
    "progress": float, "told": float, "since": float, "let": float, "at_end": bool
}  # fmt: skip
"""What is kept of a motion under way."""


class Executor(Followed):
    """The state of a plan on the floor: pure Python in, plain values out, no threads.

    ``plan`` is a plan dictionary with ``dependencies``, or any plan of ``problem``. Call ``update``
    as often as robots tell where they are, ``done`` when a task is over, and do what ``commands``
    says. Times are seconds since the plan's start; they never go back.

    ``localisation`` (m) is how far from the truth a told progress may be (``None``: what the
    dependencies were made for, else 0.05), and ``latency`` (s) by how much longer than another one
    a message may take to come: a robot may have driven so much longer between two of them. Objects
    of the plan may have errors of their own, and longer latencies. ``tolerance`` (m) is rounding:
    by how much less than a point may be told of a robot that stands there.
    ``ahead`` (s): robots are let drive only so much farther than they can stand, and what they are
    let drive is never taken back, unless somebody is astray; ``None``: they are let drive to where
    they have to wait, and that may come nearer as long as they can stand before it.
    """

    def __init__(
        self,
        plan: PlanDict | Schedule,
        problem: SchedulingProblem | None = None,
        *,
        seconds_per_unit: float | None = None,
        tolerance: float = TOLERANCES.progress,
        localisation: float | None = None,
        latency: float = 0.0,
        ahead: float | None = None,
        dependencies: Dependencies | None = None,
    ):
        _check("m", localisation=localisation, tolerance=tolerance)
        _check("s", latency=latency, ahead=ahead)
        if isinstance(plan, Schedule):
            if problem is None:
                raise ProblemError("a UP plan can be followed only together with its problem")
            plan = plan_to_dict(problem, plan, seconds_per_unit=seconds_per_unit)
        self.plan: PlanDict = plan
        self.problem = problem
        if dependencies is None and problem is None:
            dependencies = dependencies_from_plan(plan)
        elif dependencies is None:
            error = TOLERANCES.localisation if localisation is None else localisation
            dependencies = dependencies_of(problem, plan, localisation=error)
        self.dependencies = dependencies
        graph = self.dependencies.graph
        if localisation is None:
            localisation = self.dependencies.localisation or TOLERANCES.localisation
        self.localisation = localisation
        lives = self.dependencies.lives
        self._late = {name: max(latency, life.latency) for name, life in lives.items()}
        errors = errors_of(lives, localisation)
        self.state = FloorState(graph, self.dependencies.travels, tolerance, errors, self._late)
        self.latency, self.ahead = latency, ahead
        self.sides = {**self.dependencies.sides}
        self.drives = drives_of(self.dependencies.lives)
        """The robots' motions, by activity and robot."""
        self._drivers = {robot for _, robot in self.drives}
        self._held: dict[str, str] = {}
        """Robots that have to hold until they tell where they are, and why."""
        self.withdrawn: dict[str, str] = {}
        """Activities that are not to begin any more, and why; what comes after them waits."""
        self._astray: dict[str, Overrun] = {}
        every = sorted(graph.tasks, key=lambda n: graph.tasks[n].planned)
        whose = dict.fromkeys(who for name in every for who in graph.tasks[name].who)
        self.turns = {r: [n for n in every if r in graph.tasks[n].who] for r in whose}
        """Each robot's activities, in the order of the plan."""

    @property
    def narrow(self) -> tuple[Narrow, ...]:
        """Where less than the localisation error is covered: the plan has no room for more."""
        return *self.dependencies.narrow, *self.state.squeezed

    def propose_order(self) -> Proposal | None:
        """Return another order of who goes first that is forecast to end sooner, see
        :func:`up_samp.execution.reorder.propose`. Nothing changes.

        This takes long, and nobody has to wait for it: ``executor.snapshot().propose_order()`` may
        run in another thread or process, while this executor goes on.
        """
        return propose(self.snapshot())

    def adopt(self, proposal: Proposal | None) -> int:
        """Take over an order where it still can be kept and is still better; return how many
        decisions changed (0: it was not taken).
        """
        return 0 if proposal is None else adopt(self, proposal)

    def reorder(self) -> int:
        """Decide again who goes first, at once; return how many decisions changed."""
        return self.adopt(self.propose_order())

    # ------------------------------------------------------------------ kept and taken up again

    def save(self) -> dict[str, Any]:
        """Return all that has happened so far as JSON would hold it, see :meth:`restore`."""
        state = self.state
        begun = [w for w in state.ways.values() if state.phase[w.activity] is not TaskPhase.WAITING]
        return {
            "format": FORMAT,
            "version": VERSION,
            "problem": self.plan.get("problem"),
            "now": state.now,
            "tolerance": state.tolerance,
            "localisation": self.localisation,
            "running": state.those(TaskPhase.RUNNING),
            "done": state.those(TaskPhase.DONE),
            "fired": [[event_to_list(event), time] for event, time in state.fired.items()],
            "moved_on": [[event_to_list(event), by] for event, by in state.moved_on.items()],
            "motions": [
                {key: getattr(w, key) for key in ("activity", "object", *_KEPT)} for w in begun
            ],
            "heard": dict(state.heard),
            "held": dict(self._held),
            "strayed": {r: [*s.pose, s.off, s.time] for r, s in self.state.strayed.items()},
            "sides": [[*k, side] for k, side in self.sides.items() if not isinstance(k, int)],
            "turned": [k for k, side in self.sides.items() if isinstance(k, int) and not side],
            "pace": state.pace.saved(),
            "limits": dict(state.limits),
        }

    @classmethod
    def restore(
        cls,
        plan: PlanDict | Schedule,
        saved: Mapping[str, Any],
        problem: SchedulingProblem | None = None,
        **options: Any,
    ) -> Executor:
        """Return an executor that goes on where the one went on that ``saved`` is of. ``options``
        are those of the constructor. Raises :class:`ProblemError` where it is of another plan.
        """
        same = {k: saved[k] for k in ("localisation", "tolerance") if k in saved}
        executor = cls(plan, problem, **{**same, **options})
        try:
            executor._resume(saved)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ProblemError(f"what was saved cannot be read: {error!r}") from error
        return executor

    def snapshot(self) -> Executor:
        """Return a copy on which nothing of what is told to this one has an effect."""
        options = {"tolerance": self.state.tolerance, "localisation": self.localisation}
        copy = Executor(
            self.plan, self.problem, dependencies=self.dependencies,
            latency=self.latency, ahead=self.ahead, **options,
        )  # fmt: skip
        copy.__dict__["open_sides"] = self.open_sides
        copy._resume(self.save(), self.state.graph)
        return copy

    def _resume(self, known: Mapping[str, Any], graph: Graph | None = None) -> None:
        """Go on from a saved state; ``graph`` is that of its orders, if known."""
        if (known.get("format"), known.get("version")) != (FORMAT, VERSION):
            raise ProblemError(
                f"this is no saved execution of version {VERSION}: {known.get('format')!r}, "
                f"version {known.get('version')!r}"
            )
        if known["problem"] != self.plan.get("problem"):
            raise ProblemError(
                f"what was saved is of a plan of {known['problem']!r}, not of "
                f"{self.plan.get('problem')!r}"
            )
        state = self.state
        for name in (*known["running"], *known["done"]):
            if name not in state.phase:
                raise ProblemError(f"what was saved speaks of '{name}', which the plan has not")
        self.sides = {(one, other, int(c)): side for one, other, c, side in known["sides"]}
        self.sides |= dict.fromkeys(known["turned"], False)
        if graph is None and self.sides:
            graph = with_sides(self.dependencies, self.sides)
        state.now = float(known["now"])
        state.fired = {event_from_list(event): float(time) for event, time in known["fired"]}
        moved = known.get("moved_on", ())
        state.moved_on = {event_from_list(event): float(by) for event, by in moved}
        for entry in known["motions"]:
            way = state.ways.get((entry["activity"], entry["object"]))
            if way is None:
                raise ProblemError(
                    f"what was saved speaks of '{entry['activity']}' of '{entry['object']}', which "
                    "the plan has not"
                )
            for key, kind in _KEPT.items():
                setattr(way, key, kind({"let": 0.0, **entry}[key]))
        self._note_begun(known["running"], known["done"])
        state.heard = {robot: float(time) for robot, time in known["heard"].items()}
        self._held = dict(known["held"])
        strayed = known.get("strayed", {}).items()
        state.strayed = {r: Strayed((x, y, a), off, at) for r, (x, y, a, off, at) in strayed}
        state.pace.load(known["pace"])
        state.limits = dict(known.get("limits", {}))
        state.load(state.graph if graph is None else graph)
        self.bar()

    def _note_begun(self, running: Collection[str], done: Collection[str]) -> None:
        """Note which activities are under way, or over, where nothing has begun so far."""
        state = self.state
        state.phase |= dict.fromkeys(running, TaskPhase.RUNNING)
        state.phase |= dict.fromkeys(done, TaskPhase.DONE)
        state.of_object = {w.object: w for name in running for w in state.ways_of[name]}

    def join(
        self,
        now: float,
        *,
        done: Collection[str] = (),
        under_way: Mapping[str, Mapping[str, Sequence[float] | float]] = MappingProxyType({}),
        times: Mapping[str, tuple[float, float | None]] = MappingProxyType({}),
    ) -> None:
        """Take up a plan that is half done: activities ``done`` are over, those ``under_way`` have
        begun. Of these, every motion says for each of its robots where it is: a pose (x, y, theta)
        or its progress (m). ``times`` (s) say since when, and until when, where that is known.

        Raises :class:`ProblemError` where that cannot have come about by the plan.
        """
        state = self.state
        if state.those(TaskPhase.RUNNING, TaskPhase.DONE):
            raise ProblemError("a plan can be joined only before anything of it has begun")
        for name in (*done, *under_way, *times):
            if name not in state.phase:
                raise ProblemError(f"the plan has no activity '{name}'")
        both = sorted(set(done) & set(under_way))
        if both:
            raise ProblemError(f"'{both[0]}' is told to be over, and to be under way")
        if not is_number(now) or now < 0.0:
            raise ProblemError(f"the time cannot be {now!r}: at least 0 s")
        here = {
            (name, way.object): self._where(way, under_way[name])
            for name in under_way
            for way in state.ways_of[name]
        }
        self._note_begun(list(under_way), done)
        state.now = float(now)
        for name in (*done, *under_way):
            start, end = times.get(name, (now, None))
            state.fired[Event(At.START, name)] = float(start)
            for way in state.ways_of[name]:
                state.heard[way.object] = way.since = float(now)
                way.told = way.progress = here.get((name, way.object), way.length)
            if name in done:
                state.fired[Event(At.END, name)] = float(now if end is None else end)
        self._check_as_planned(done)
        for way in state.ways.values():
            if way.activity in under_way:
                way.progress = 0.0  # believed as far as its gates are open
        state.load(state.graph)
        state.follow_all()
        self.bar()

    def _where(self, way: MotionUnderWay, told: Mapping[str, Sequence[float] | float]) -> float:
        """Return the progress (m) of a robot under way."""
        at = told.get(way.object)
        if at is None:
            raise ProblemError(f"'{way.activity}' is under way: where is '{way.object}'?")
        if isinstance(at, Sequence):
            found = self.placed(way, at)
            if not isinstance(found, float):
                why = found if isinstance(found, str) else f"it is {found.off:.3f} m off its path"
                raise ProblemError(f"'{way.object}' cannot go on: {why}")
            return found
        slack = way.error + TOLERANCES.progress
        if not is_number(at) or not -slack <= at <= way.length + slack:
            raise ProblemError(
                f"'{way.object}' cannot be at {at!r} m of '{way.activity}', which is "
                f"{way.length:.3f} m long"
            )
        return float(at)

    def _check_as_planned(self, done: Collection[str]) -> None:
        """Raise :class:`ProblemError` where something has begun, or is over, before what it has to
        wait for. Of points on the paths of motions that are over all have been passed.
        """
        state, graph = self.state, self.state.graph
        for event in graph.events:
            if event.at in (At.REACH, At.LEAVE) and event.activity in done:
                state.fired[event] = state.fired[Event(At.END, event.activity)]
        for edge in graph.edges:
            first, then = edge.first, edge.then
            if then not in state.fired or first in state.fired or first.at is At.ORIGIN:
                continue
            if first.at is At.REACH and first.activity not in done:
                way = state.ways[first.activity, first.object]
                running = state.phase[first.activity] is TaskPhase.RUNNING
                if running and way.told + way.error >= first.progress:
                    continue
            raise ProblemError(f"{then} cannot be told: {first} comes before it ({edge.why})")

    def remaining_problem(self, surprise: Surprise = Surprise()) -> Remaining:
        """Return what is left as an ordinary UP problem, see
        :func:`up_samp.execution.remaining.remaining_problem`.
        """
        if self.problem is None:
            raise ProblemError("what is left can be told only where the problem is known")
        lives = self.dependencies.lives
        left = remaining_problem(self.problem, self.plan, self.state, lives, surprise)
        return replace(left, localisation=self.localisation)

    # ------------------------------------------------------------------ what is told

    def update(
        self,
        robot: str,
        *,
        progress: float | None = None,
        now: float,
        motion: str | None = None,
        pose: Sequence[float] | None = None,
    ) -> Reply:
        """Note that ``robot`` is ``progress`` m along its motion under way, at ``now`` s, or at
        ``pose`` (x, y, theta: see :meth:`progress_of`). What cannot be is not believed, and who
        tells that it is where it cannot be has to hold.

        ``motion`` says which one is meant: what is told late of a motion that is over is ignored.
        """
        if robot not in (self._drivers if pose is None else self.dependencies.lives):
            return Reply(Heard.IGNORED, f"the plan drives no '{robot}'")
        astray = self.state.strayed.get(robot)
        known = self.state.heard.get(robot, -math.inf)
        last = max(known, -math.inf if astray is None else astray.time)
        timed = self._time(now, last)
        if timed is not None:
            return timed
        if motion is not None and (motion, robot) not in self.state.ways:
            return Reply(Heard.IGNORED, f"the plan has no motion '{motion}' of '{robot}'")
        way = self.state.of_object.get(robot)
        over = motion is not None and self.state.phase[motion] is TaskPhase.DONE
        if over and (way is not None or pose is not None):
            return Reply(Heard.IGNORED, f"'{motion}' is over")
        if way is None or motion not in (None, way.activity):
            return self._elsewhere(robot, motion, progress, pose)
        at = self._along(way, progress, pose)
        if isinstance(at, Strayed):
            return self._stray(robot, at, f"it is {at.off:.3f} m off its path")
        if isinstance(at, str):
            self._held[robot] = at  # it may drive by what it tells
            return Reply(Heard.AGAIN, at)
        self.state.heard[robot] = now
        return self._take(way, at)

    def _along(self, way: MotionUnderWay, progress: Any, pose: Any) -> float | Strayed | str:
        """Return how far (m) along its motion a robot is by what it tells, or where it is off its
        path, or why it cannot be.
        """
        why = unreadable(progress, pose)
        if why:
            return why
        if pose is not None:
            found = self.placed(way, pose)
            if not isinstance(found, float):
                return found
            progress = found
        why = doubt(way, progress, self._since_told(way.object), way.error)
        beyond = max(-progress, progress - way.length)
        if why or beyond <= way.error + TOLERANCES.progress:
            return why or float(progress)
        drive = self.drives[way.activity, way.object]
        return Strayed(pose_at(drive.path, progress), beyond, self.now)

    def _elsewhere(self, robot: str, motion: str | None, progress: Any, pose: Any) -> Reply:
        """Answer a robot that has no motion under way, or tells of another one than that."""
        why = unreadable(progress, pose)
        if why:
            return Reply(Heard.AGAIN, why)
        state, life = self.state, self.dependencies.lives[robot]
        way, here = state.of_object.get(robot), place_of(state, life)
        drives = [d for d in life.drives if d.activity == motion]
        rests = [*([] if here is None else [here]), *coming_to(state, life)]
        if pose is None:
            told = [pose_at(drive.path, progress) for drive in drives or beside(life, here)]
        else:
            told = [p.frame.of(pose) for p in drives or rests or life.pieces[:1]]
        pairs = itertools.product(told, rests)
        far = [(away(at, pose_in(state, p), life.body), at) for at, p in pairs]
        least, at = min(far, default=(0.0, told[0]))
        astray, near = Strayed(at, least, state.now), least <= self._near(robot)
        if way is not None:
            why = f"it tells of '{motion}' while in '{way.activity}'"
            return self._stray(robot, None if near else astray, why)
        if near:
            self._found(robot)
            return Reply(Heard.IGNORED, f"no motion of '{robot}' is under way")
        if motion is not None and state.phase[motion] is TaskPhase.DONE:
            return Reply(Heard.IGNORED, f"'{motion}' is over")
        why = "it drives, but no motion of it is under way"
        return self._stray(
            robot, astray, why if pose is None else f"it is {least:.3f} m off its place"
        )

    def _stray(self, robot: str, where: Strayed | None, why: str) -> Reply:
        """Let a robot hold that is where nobody led it, and keep others away from there."""
        self._held[robot] = why
        if where is not None:
            self.state.strayed[robot] = where
            self.bar()
        return Reply(Heard.HELD, why)

    def _found(self, robot: str) -> None:
        """Note that a robot tells what can be."""
        self._held.pop(robot, None)
        if self.state.strayed.pop(robot, None) is not None:
            self.bar()

    def _take(self, way: MotionUnderWay, progress: float) -> Reply:
        self._found(way.object)
        self.state.pace.told(way, progress, self.state.now, self.state.until(way))
        self.state.move(way, progress)
        if self.state.astray(way) or self._astray:
            self.bar()
        if way.object in self._astray:
            return Reply(Heard.HELD, str(self._astray[way.object]))
        self._finish_motion(way.activity)
        return TAKEN

    def _time(self, now: Any, last: float) -> Reply | None:
        """Let time pass until ``now``, if that can be; else return an answer. ``last`` is when the
        same one told something before.
        """
        if not is_number(now):
            return Reply(Heard.AGAIN, f"the time cannot be {now!r}: a finite number (s)")
        why = clock_doubt(now, self.now)
        if why:
            return Reply(Heard.AGAIN, why)
        if now < last:
            return Reply(Heard.IGNORED, f"it told something later, at {last:.2f} s")
        self.state.tick(now)
        return None

    def progress_of(self, activity: str, robot: str, pose: Sequence[float]) -> Along:
        """Return how far along its path a robot is that stands at ``pose`` (x, y, theta; the plan's
        frame), and how far it is off it, see :func:`up_samp.execution.travel.along`. Of a motion
        under way what was told before tells apart stretches that pass the same point.
        """
        drive = self.drives.get((activity, robot))
        if drive is None:
            raise ProblemError(f"the plan has no motion '{activity}' of '{robot}'")
        here = drive.frame.of(pose)
        way = self.state.of_object.get(robot)
        if way is None or way.activity != activity:
            return along(drive.path, here)
        seconds = self._since_told(robot)
        slack = 4 * way.error + TOLERANCES.progress
        low, high = way.told - slack, way.told + way.travel.fastest * seconds + slack
        return along(drive.path, here, (low, high))

    def _since_told(self, robot: str) -> float:
        """Return for how long (s) at most a robot may have driven since what it told last."""
        return self.state.silent(robot) + self._late[robot]

    def _near(self, robot: str) -> float:
        """Return how far (m) a robot may tell to be off its path, or its place."""
        return 2 * self.state.errors[robot] + TOLERANCES.place

    def placed(self, way: MotionUnderWay, pose: Any) -> float | Strayed | str:
        """Return the progress (m) of a robot that tells a pose, or where it is off its path, or why
        it cannot be there.
        """
        why = unreadable(None, pose)
        if why:
            return why
        place = self.progress_of(way.activity, way.object, pose)
        if place.off <= self._near(way.object):
            return place.progress
        frame = self.drives[way.activity, way.object].frame
        return Strayed(frame.of(pose), place.off, self.now)

    def done(self, activity: str, now: float | None = None, robot: str | None = None) -> Reply:
        """Note that a task that drives nothing is over, or that a motion's robots (of several that
        drive together just ``robot``, if said) are at its end. What ``robot`` says that has no part
        in it does not count.

        A motion is over only if what its robots told last says so, too.
        """
        state = self.state
        if activity not in state.phase:
            return Reply(Heard.IGNORED, f"the plan has no activity '{activity}'")
        timed = None if now is None else self._time(now, -math.inf)
        if timed is not None:
            return timed
        if state.phase[activity] is TaskPhase.DONE:
            return Reply(Heard.IGNORED, f"'{activity}' is over already")
        if state.phase[activity] is TaskPhase.WAITING:
            return Reply(Heard.AGAIN, f"'{activity}' cannot be over: it has not begun")
        end, task = state.end_number[activity], state.graph.tasks[activity]
        if task.moves:
            return self._at_end(activity, robot)
        if robot is not None and task.who and robot not in task.who:
            return Reply(Heard.IGNORED, f"'{robot}' does nothing in '{activity}'")
        if not state.may_happen(end):
            return self._not_yet(activity)
        self._end(activity)
        return TAKEN

    def _at_end(self, activity: str, robot: str | None) -> Reply:
        """Note that some of a motion's robots say that they are at its end."""
        ways = self.state.ways_of[activity]
        told = [w for w in ways if robot in (None, w.object)]
        if not told:
            return Reply(Heard.IGNORED, f"'{robot}' drives nothing in '{activity}'")
        for way in told:
            way.at_end = True
        self._finish_motion(activity)
        if self.state.phase[activity] is TaskPhase.DONE:
            return TAKEN
        short = [w for w in ways if w.object in self._held or not self.state.arrived(w)]
        if not any(w in short for w in told):
            return TAKEN if short else self._not_yet(activity)
        for way in told:
            way.at_end = False
        return Reply(Heard.AGAIN, f"'{activity}' cannot be over: its motion is not at its end")

    def _not_yet(self, activity: str) -> Reply:
        waits = ", ".join(self._missing(self.state.end_number[activity]))
        return Reply(Heard.AGAIN, f"'{activity}' may not end yet: it waits for {waits}")

    def _finish_motion(self, activity: str) -> None:
        ways = self.state.ways_of[activity]
        if any(w.object in self._held or w.object in self._astray for w in ways):
            return
        if self.state.may_happen(self.state.end_number[activity]) and all(
            self.state.arrived(w) for w in ways
        ):
            self._end(activity)

    def _end(self, activity: str) -> None:
        self.state.phase[activity] = TaskPhase.DONE
        for way in self.state.ways_of[activity]:
            self.state.finish(way)
            self.state.of_object.pop(way.object, None)
        self.state.fire(self.state.end_number[activity], self.state.now)

    # ------------------------------------------------------------------ who is astray

    @property
    def overruns(self) -> tuple[Overrun, ...]:
        """The robots that are where their commands cannot have led them."""
        return tuple(self._astray.values())

    def bar(self) -> None:
        """Find out who is astray, and keep everybody else away from there."""
        self._astray, self.state.bars = {}, {}
        for robot in dict.fromkeys([*self.state.of_object, *self.state.strayed]):
            overrun, bars = kept_away(self.state, self.dependencies, robot)
            if overrun is not None:
                self._astray[robot] = overrun
            for key, most in bars.items():
                self.state.bars[key] = min(most, self.state.bars.get(key, most))

    # ------------------------------------------------------------------ what to do

    def commands(self, now: float | None = None) -> dict[str, Command]:
        """Return what everybody is to do now, by robot (tasks that nobody drives for: by activity).

        What may begin has begun by being told.
        """
        if now is not None:
            if not is_number(now):
                raise ProblemError(f"the time cannot be {now!r}: a finite number (s)")
            self.state.tick(now)
        if self._astray:
            self.bar()
        for name in self.state.those(TaskPhase.RUNNING):
            if self.state.graph.tasks[name].moves:
                self._finish_motion(name)
        self._begin()
        found: dict[str, Command] = {r: self._drive(w) for r, w in self.state.of_object.items()}
        for name in self.state.those(TaskPhase.RUNNING):
            task = self.state.graph.tasks[name]
            if not task.moves:
                command = Do(name, self.state.may_happen(self.state.end_number[name]))
                for who in [w for w in task.who if w not in found] or [name]:
                    found[who] = command
        for robot in self.turns:
            if robot not in found:
                found[robot] = Hold(self._standing(robot))
        return found

    def _standing(self, robot: str) -> tuple[str, ...]:
        """Return why a robot without a motion or a task does nothing, in words."""
        why = self._held.get(robot) or self.withdrawn.get(self._to_do(robot))
        return (why,) if why else self._missing(self._next_of(robot))

    def _begin(self) -> None:
        state = self.state
        waiting = state.those(TaskPhase.WAITING)
        for name in [n for n in waiting if state.may_happen(state.start_number[n])]:
            ways = state.ways_of[name]
            barred = name in self.withdrawn
            if barred or any(w.object in state.of_object or w.object in self._held for w in ways):
                continue
            state.phase[name] = TaskPhase.RUNNING
            state.fire(state.start_number[name], state.now)
            for way in ways:
                state.of_object[way.object] = way
                way.since = state.heard[way.object] = state.now
                state.move(way, 0.0)

    def _drive(self, way: MotionUnderWay) -> Command:
        state = self.state
        known = (self._held.get(way.object), self._astray.get(way.object))
        if any(known):
            return Hold(tuple(str(why) for why in known if why))
        until = state.until(way)
        if way.progress < until - state.tolerance:
            return Go(way.activity, self._let(way, until))
        if until == state.limits.get(way.activity):
            return Hold((f"the way of '{way.activity}' is blocked",))
        if until == state.bars.get((way.activity, way.object)):
            return Hold(tuple(str(o) for o in self.overruns if way.object in (*o.held, *o.met)))
        return Hold(self._missing(self._next_of(way.object)))

    def _let(self, way: MotionUnderWay, until: float) -> float:
        """Return how far a robot is let drive that may go until there."""
        if self.ahead is None:
            return until
        far = way.progress + way.reach(self.ahead)
        if way.let < far - way.travel.fastest * self.ahead:
            way.let = max(way.let, min(until, far))
        return min(way.let, until)

    def _to_do(self, robot: str) -> str:
        """Return what is next of what a robot has not begun ("": nothing)."""
        mine, phase = self.turns.get(robot, ()), self.state.phase
        return next((n for n in mine if phase[n] is TaskPhase.WAITING), "")

    def _next_of(self, robot: str) -> int | None:
        """Return the event that is next for a robot: its closed gate, an end or a start."""
        state = self.state
        way = state.of_object.get(robot)
        if way is None:
            return state.start_number.get(self._to_do(robot))
        closed = state.closed(way)
        return state.end_number[way.activity] if closed is None else closed

    def _awaited(self, number: int | None) -> Iterator[tuple[Event, str]]:
        """Yield the events that an event still waits for, and why."""
        state = self.state
        for first, edge in () if number is None else state.into[number]:
            since = state.when[first]
            if since is None or since + edge.lag > state.now + 1e-9:
                yield edge.first, edge.why

    def _missing(self, number: int | None) -> tuple[str, ...]:
        """Return what an event waits for, in words."""
        shut = () if number is None else self.state.shut(number)
        astray = [o for o in self.overruns if {o.robot, *o.held}.intersection(shut)]
        return *(f"{event} ({why})" for event, why in self._awaited(number)), *map(str, astray)

    def waits_for(self, robot: str) -> tuple[str, ...]:
        """Return the objects or activities that a robot waits for now."""
        awaited = self._awaited(self._next_of(robot))
        return tuple(dict.fromkeys(e.object or e.activity or "time" for e, _ in awaited))

    @property
    def finished(self) -> bool:
        """Whether every activity is done."""
        return not self.state.those(TaskPhase.WAITING, TaskPhase.RUNNING)

    @property
    def awaits_time(self) -> bool:
        """Whether something waits for the clock: a window that opens, the end of a delay."""
        return bool(self.state.timers)

    def phase(self, activity: str) -> TaskPhase:
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
            over = ahead.over(bound)
            if over > 1e-6:
                found[bound.why] = max(over, found.get(bound.why, 0.0))
        return found


def _check(unit: str, **values: float | None) -> None:
    for name, value in values.items():
        if value is not None and (not is_number(value) or value < 0.0):
            raise ProblemError(f"'{name}' cannot be {value!r}: at least 0 {unit}")
