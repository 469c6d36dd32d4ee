"""Who is where, said with fluents or with precedences: the two encodings of every family."""

from __future__ import annotations

from dataclasses import dataclass, field

from unified_planning.model import (
    ClosedTimeInterval,
    Fluent,
    FNode,
    GlobalEndTiming,
    TimePointInterval,
    Timing,
    Type,
)
from unified_planning.model.motion import (
    ConfigurationObject,
    MovableObject,
    SchedulingMotionProblem,
)
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import LT, And, Equals, Not, Or


def before(a: Activity, b: Activity) -> FNode:
    """Return the constraint that ``a`` ends strictly before ``b`` starts."""
    return LT(a.end, b.start)


def apart(a: Activity, b: Activity) -> FNode:
    """Return the constraint that ``a`` and ``b`` do not share even an instant."""
    return Or(before(a, b), before(b, a))


def at_start(a: Activity) -> TimePointInterval:
    """Return the instant at which ``a`` starts, as the time of a condition."""
    return TimePointInterval(Timing(0, a.start))


def throughout(a: Activity) -> ClosedTimeInterval:
    """Return ``[start, end]`` of ``a``, as the time of a condition."""
    return ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end))


def scope_of(*activities: Activity) -> list[FNode]:
    """Return the scope "all these activities are present"."""
    return [a.present for a in activities if a.optional]


Ends = tuple[ConfigurationObject, ConfigurationObject]
"""Where a move begins and ends."""


class FluentRoutes:
    """``robot_at(robot)`` holds the place; moves change it at their end. ``finish`` comes last."""

    def __init__(self, problem: SchedulingMotionProblem, pose_type: Type, robot_type: Type) -> None:
        self.problem = problem
        self.robot_at = Fluent("robot_at", pose_type, robot=robot_type)
        problem.add_fluent(self.robot_at)

    def start(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """``robot`` starts at ``place``."""
        self.problem.set_initial_value(self.robot_at(robot), place)

    def move(self, robot: MovableObject, a: Activity, ends: Ends, implied: bool = False) -> None:
        """``a`` takes ``robot`` from one place to another. ``implied``: other precedences say
        already that the robot is there then.
        """
        at, (origin, to) = self.robot_at(robot), ends
        a.add_condition(at_start(a), Equals(at, origin))
        a.add_effect(a.end, at, to)

    def stand(
        self, robot: MovableObject, a: Activity, place: ConfigurationObject, implied: bool = False
    ) -> None:
        """``robot`` stands at ``place`` throughout ``a`` (``implied``: see ``move``)."""
        a.add_condition(throughout(a), Equals(self.robot_at(robot), place))

    def end(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """``robot`` is at ``place`` when everything is over."""
        self.problem.add_condition(
            TimePointInterval(GlobalEndTiming()), Equals(self.robot_at(robot), place)
        )

    def finish(self) -> None:
        """State what could not be stated before all activities were known."""


@dataclass
class _Itinerary:
    """What is known of one robot: arrivals and departures by place, and who needs a place."""

    start: str = ""
    end: str | None = None
    arrivals: dict[str, list[Activity]] = field(default_factory=dict)
    departures: dict[str, list[Activity]] = field(default_factory=dict)
    needs: list[tuple[Activity, str]] = field(default_factory=list)


class PrecedenceRoutes:
    """Places said with precedences alone (the paper's helper and deleter activities).

    Activity a of a robot needs place L at its start. Given that the robot's activities never
    overlap, either of these says so, and the shorter one is written:

    - *helpers and deleters*: the last helper (a move to L) before a is followed by no deleter (a
      move away from L) before a ends; at the robot's start, no deleter before a;
    - *nowhere else*: every move to another place that ends before a starts is followed by a move
      away from there that also ends before a starts.

    Why naming only the moves from L as deleters is enough: order the robot's moves in time. By
    induction the moves before a form a walk. If it has left L after the helper, one of them is a
    move from L; if it is elsewhere, its last arrival there has no later departure.
    """

    def __init__(self, problem: SchedulingMotionProblem, pose_type: Type, robot_type: Type) -> None:
        self.problem = problem
        self.itineraries: dict[str, _Itinerary] = {}

    def _of(self, robot: MovableObject) -> _Itinerary:
        return self.itineraries.setdefault(robot.name, _Itinerary())

    def start(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """``robot`` starts at ``place``."""
        self._of(robot).start = place.name

    def move(self, robot: MovableObject, a: Activity, ends: Ends, implied: bool = False) -> None:
        """``a`` takes ``robot`` from one place to another."""
        itinerary, (origin, to) = self._of(robot), (place.name for place in ends)
        itinerary.departures.setdefault(origin, []).append(a)
        itinerary.arrivals.setdefault(to, []).append(a)
        if not implied:
            itinerary.needs.append((a, origin))

    def stand(
        self, robot: MovableObject, a: Activity, place: ConfigurationObject, implied: bool = False
    ) -> None:
        """``robot`` stands at ``place`` throughout ``a`` (``implied``: see ``move``)."""
        if not implied:
            self._of(robot).needs.append((a, place.name))

    def end(self, robot: MovableObject, place: ConfigurationObject) -> None:
        """``robot`` is at ``place`` when everything is over."""
        self._of(robot).end = place.name

    def finish(self) -> None:
        """State what could not be stated before all activities were known."""
        for itinerary in self.itineraries.values():
            for a, place in itinerary.needs:
                if self._helpers_are_shorter(itinerary, place):
                    formula = self._helped(itinerary, a, place)
                    self.problem.add_constraint(formula, scope=scope_of(a))
                else:
                    self._nowhere_else(itinerary, place, a)
            if itinerary.end is not None:
                self._nowhere_else(itinerary, itinerary.end, None)

    @staticmethod
    def _helpers_are_shorter(itinerary: _Itinerary, place: str) -> bool:
        def pairs(at: str) -> int:
            return len(itinerary.arrivals.get(at, ())) * len(itinerary.departures.get(at, ()))

        return pairs(place) <= sum(pairs(other) for other in itinerary.arrivals if other != place)

    @staticmethod
    def _helped(itinerary: _Itinerary, a: Activity, place: str) -> FNode:
        deleters = [x for x in itinerary.departures.get(place, ()) if x is not a]
        ways = []
        if place == itinerary.start:
            ways.append(And([Or(Not(x.present), before(a, x)) for x in deleters]))
        for h in itinerary.arrivals.get(place, ()):
            undisturbed = [Or(Not(x.present), before(x, h), before(a, x)) for x in deleters]
            ways.append(And([h.present, before(h, a), *undisturbed]))
        return Or(ways)

    def _nowhere_else(self, itinerary: _Itinerary, place: str, a: Activity | None) -> None:
        """State that the robot is at ``place`` at the start of ``a`` (``None``: in the end)."""

        def left_again(other: str, since: Activity | None) -> list[FNode]:
            ways = []
            for x in itinerary.departures.get(other, ()):
                after = [before(since, x)] if since is not None else []
                in_time = [before(x, a)] if a is not None else []
                ways.append(And([x.present, *after, *in_time]))
            return ways

        scope = scope_of(a) if a is not None else []
        if place != itinerary.start:
            self.problem.add_constraint(Or(left_again(itinerary.start, None)), scope=scope)
        for other, arrivals in itinerary.arrivals.items():
            for h in arrivals:
                if other != place and h is not a:
                    later = [before(a, h)] if a is not None else []
                    self.problem.add_constraint(
                        Or([*later, *left_again(other, h)]), scope=[*scope, *scope_of(h)]
                    )
