"""The UP problems that random cases mean, in several styles.

How a job is said is the style: one optional drive for each pair of places, or one drive with an
object parameter; who is where by fluents or by precedences; obstacles as nothing, lists or
dictionaries.
"""

from __future__ import annotations

import itertools
import math

from unified_planning.model import Timing
from unified_planning.model.metrics import MinimizeMakespan
from unified_planning.model.motion import ActivityWaypoints, SchedulingMotionProblem
from unified_planning.model.timing import TimePointInterval
from unified_planning.shortcuts import GE, LE, And, Equals, Implies, Not, Or, Plus

from tests.fuzz.cases import Case, Load, Robot, limited, random_case
from tests.fuzz.scene import Scene
from tests.shuffled import shuffled

SECONDS = 2.0
"""Seconds per unit."""


class Writer(Scene):
    """Writes a case as a UP problem."""

    def write(self) -> SchedulingMotionProblem:
        doing = {r.name: self._jobs(r) for r in self.case.robots}
        if self.style.one_at_a_time == "all":
            self._one_at_a_time("all", [a for own in doing.values() for a in own])
        else:
            for robot in self.case.robots:
                self._one_at_a_time(robot.name, doing[robot.name])
        if self.case.limit is not None:
            for activity in self.problem.activities:
                self._limit(activity)
        self.problem.add_quality_metric(MinimizeMakespan())
        return self.problem

    def _limit(self, activity) -> None:
        if self.style.limit == "deadline":
            activity.add_deadline(self.case.limit)
            return
        scope = [activity.present] if activity.optional else []
        self.problem.add_constraint(LE(activity.end, self.case.limit), scope)

    def _jobs(self, robot: Robot) -> list:
        """Write a robot's drives and services; return its activities."""
        activities, arrivals = [], [(robot.start, None)]
        for number, goals in enumerate(robot.goals):
            told = self.style.choice != "optional" and len(arrivals) == 1
            by_parameter = told and all(x.side == "on" for x in self._carried(robot, number))
            drive = self._one_drive if by_parameter else self._drives
            arrivals, drives, done = drive(robot, number, arrivals, goals)
            activities += drives
            if robot.service:
                activities.append(self._service(robot, number, done))
        if robot.name in self.case.idle:
            activities += self._idle(robot, arrivals)
        return activities

    def _idle(self, robot: Robot, arrivals) -> list:
        """Write an optional drive from where the robot ends to where it began, which none needs."""
        drives = []
        for place, before in arrivals[:1]:
            if place != robot.start:
                name = f"{robot.name}_idle_{place}"
                drive = self._drive(robot, name, place, self.places[robot.start], optional=True)
                self._after(drive, before, optional=True)
                drives.append(drive)
        return drives

    def _drive(self, robot: Robot, name: str, start, goal, *, optional: bool):
        drive = self.problem.add_motion_activity(name, 1, optional)
        drive.set_duration_bounds(self._shortest(start, goal), 60)
        if callable(goal):
            goal = goal(drive)
        drive.add_motion_constraint(
            ActivityWaypoints(
                self.movable[robot.name], self.places[start], [goal], **self._obstacles(robot)
            )
        )
        drive.add_motion_effect(self.movable[robot.name], goal)
        if robot.name in self.at:
            at = self.at[robot.name]
            if self.style.state == "fluents":
                drive.add_condition(
                    TimePointInterval(Timing(0, drive.start)), Equals(at, self.places[start])
                )
            self._sets(drive, at, goal)
        return drive

    def _carried(self, robot: Robot, number: int) -> list[Load]:
        return [x for x in self.case.loads if (robot.name, number) in x.carried]

    def _bring(self, drive, robot: Robot, number: int, goal: str) -> None:
        """Say what a drive brings along to a place."""
        for load in self._carried(robot, number):
            turned = load.turned and load.carried[-1] == (robot.name, number)
            to = self._beside(load, goal, turned=turned)
            drive.add_motion_effect(self.loads[load.name], to)

    def _shortest(self, start: str, goal) -> int:
        """Return units below which no drive is allowed: what a straight line takes, or one."""
        if self.style.durations == "wide" or callable(goal):
            return 1
        x, y, _ = self.case.floor.places[start]
        u, v, _ = self.case.floor.places[goal.name]
        far = math.hypot(u - x, v - y)
        seconds = far + 2.0 if far > 2.0 else 2.0 * math.sqrt(2.0 * far)
        return max(1, math.floor(seconds / SECONDS))

    def _drives(self, robot, number, arrivals, goals):
        """Write an optional drive for each pair of places, one of which is there."""
        drives = []
        reached: dict[str, list] = {}
        for (start, before), goal in itertools.product(arrivals, goals):
            single = len(arrivals) * len(goals) == 1
            name = f"{robot.name}_{number}_{start}_{goal}"
            drive = self._drive(robot, name, start, self.places[goal], optional=not single)
            self._bring(drive, robot, number, goal)
            self._after(drive, before, optional=not single)
            drives.append(drive)
            reached.setdefault(goal, []).append(drive)
        if len(drives) > 1:
            self.problem.add_constraint(Or(*(d.present for d in drives)))
            for a, b in itertools.combinations(drives, 2):
                self.problem.add_constraint(Not(And(a.present, b.present)))
        return [(g, (d, len(drives) > 1)) for g, d in reached.items()], drives, drives

    def _after(self, drive, before, *, optional: bool) -> None:
        """Say that one of the drives that lead here comes before, a unit or more."""
        if before is None:
            return
        leading, choice = before
        apart = [LE(Plus(d.end, 1), drive.start) for d in leading]
        if choice and self.style.order == "implies":
            scope = [drive.present] if optional else []
            for d, c in zip(leading, apart, strict=True):
                self.problem.add_constraint(Implies(d.present, c), scope)
            self.problem.add_constraint(Or(*(d.present for d in leading)), scope)
            return
        if choice:
            apart = [And(d.present, c) for d, c in zip(leading, apart, strict=True)]
        self.problem.add_constraint(Or(*apart), [drive.present] if optional else [])

    def _one_drive(self, robot, number, arrivals, goals):
        """Write one drive whose goal is a parameter."""
        ((start, before),) = arrivals

        chosen = []
        by_variable = self.style.choice == "variable"

        def goal_of(drive):
            if by_variable:
                to = self.problem.add_variable(f"goal_{robot.name}_{number}", self.kind)
                self.problem.add_constraint(Or(*(Equals(to, self.places[g]) for g in goals)))
            else:
                to = drive.add_parameter("to", self.kind)
                drive.add_constraint(Or(*(Equals(to, self.places[g]) for g in goals)))
            chosen.append(to)
            return to

        name = f"{robot.name}_{number}"
        drive = self._drive(robot, name, start, goal_of, optional=False)
        for load in self._carried(robot, number):
            drive.add_motion_effect(self.loads[load.name], chosen[0])
        self._after(drive, before, optional=False)
        if number + 1 < len(robot.goals) and len(goals) > 1:
            # the next drive has to know where from
            where = self.problem if by_variable else drive
            where.add_constraint(Equals(chosen[0], self.places[goals[0]]))
            goals = goals[:1]
        return [(g, ([drive], False)) for g in goals], [drive], [drive]

    def _service(self, robot: Robot, number: int, drives):
        service = self.problem.add_activity(f"serve_{robot.name}_{number}", robot.service)
        ready = [LE(Plus(d.end, 1), service.start) for d in drives]
        if len(drives) > 1:
            ready = [And(d.present, c) for d, c in zip(drives, ready, strict=True)]
        self.problem.add_constraint(Or(*ready))
        return service

    def _one_at_a_time(self, name: str, activities: list) -> None:
        if len(activities) < 2:
            return
        if self.style.one_at_a_time in ("uses", "all"):
            resource = self.problem.add_resource(f"{name}_busy", 1)
            for activity in activities:
                activity.uses(resource)
            return
        for a, b in itertools.combinations(activities, 2):
            scope = [x.present for x in (a, b) if x.optional]
            self.problem.add_constraint(Or(LE(a.end, b.start), GE(a.start, b.end)), scope)


def build(case: Case, folder):
    """Return the UP problem of a case, in a listing of its own; its map goes into ``folder``."""
    problem = Writer(case, case.floor.write(folder)).write()
    return shuffled(problem, (case.seed, case.limit)).problem


__all__ = ["SECONDS", "Case", "build", "limited", "random_case"]
