"""Clauses that say who comes first: read as what moves need, be it under values of parameters."""

import itertools

import pytest
from unified_planning.model import TimePointInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LE,
    And,
    BoolType,
    Equals,
    MinimizeMakespan,
    Not,
    Or,
    Plus,
    UserType,
)

from up_samp.model import Deadline
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_tasks


class Hall:
    """One robot at p0, a task at p2, and two buttons at p1, either of which opens the door to p2.
    It drives with its goal as a parameter (or, if not ``guided``, with a move for each goal).
    """

    def __init__(self, *, guided=True, door=False, copies=0):
        self.p = SchedulingProblem("hall")
        self.kind = UserType("spot")
        self.spots = [self.p.add_object(f"p{i}", self.kind) for i in range(3)]
        self.at = self.p.add_fluent("at", self.kind, default_initial_value=self.spots[0])()
        self.buttons = [self.add(f"button{i}", 1, 1) for i in range(2)]
        self.task = self.add("task", 3, 2, optional=False)
        self.moves = [self.drive(i, j if not guided else None)
                      for i in range(3) for j in range(3) if i != j]  # fmt: skip
        self.moves += [self.drive(0, 2) for _ in range(copies)]
        if door:
            opened = self.p.add_fluent("open", BoolType(), default_initial_value=False)()
            for button in self.buttons:
                button.add_effect(Timing(-1, button.end), opened, True)
        every = [*self.buttons, self.task, *self.moves]
        for a, b in itertools.combinations(every, 2):
            both = [x.present for x in (a, b) if x.optional]
            self.p.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)), both)
        self.p.add_quality_metric(MinimizeMakespan())

    def add(self, name, length, place, *, optional=True):
        a = self.p.add_activity(name, length, optional=optional)
        a.add_condition(TimePointInterval(Timing(0, a.start)), Equals(self.at, self.spots[place]))
        return a

    def drive(self, i, j):
        m = self.p.add_activity(f"move{len(self.p.activities)}", 4, optional=True)
        m.add_condition(TimePointInterval(Timing(0, m.start)), Equals(self.at, self.spots[i]))
        goal = m.add_parameter("to", self.kind) if j is None else self.spots[j]
        m.add_effect(Timing(-1, m.end), self.at, goal)
        return m

    def other_goal(self, move, place):
        """Return that a move does not lead to a place, as a list of alternatives."""
        if move.parameters:
            return [Not(Equals(move.to, self.spots[place]))]
        goal = next(e.value for es in move.effects.values() for e in es)
        return [] if goal.object() == self.spots[place] else None

    def opened(self, gap=0, by=And):
        """State that a button was pressed ``gap`` before the end of a move to p2."""
        for m in self.moves:
            other = self.other_goal(m, 2)
            if other is not None:
                pressed = [by(b.present, LE(Plus(b.end, gap), m.end)) for b in self.buttons]
                self.p.add_constraint(Or([*other, *pressed]), [m.present])
        return self

    def route(self):
        self.model = ScheduleModel(self.p)
        (route,) = find_routes(self.model)
        return route


@pytest.mark.parametrize("door", [False, True])
@pytest.mark.parametrize("guided", [False, True])
@pytest.mark.parametrize("gap", [0, 2])
def test_a_clause_that_names_the_openers_is_read_as_a_door(guided, door, gap):
    hall = Hall(guided=guided, door=door).opened(gap)
    route = hall.route()
    (entry,) = route.entries[2]
    assert entry.state == (("open",) if door else ("#milestone", 0))
    assert entry.lead == gap + 1
    tasks = find_tasks(hall.model, [route])
    assert [(len(t.ways), t.wanted, t.needed) for t in tasks] == [
        (2, False, True),
        (1, True, False),
    ]
    report = CpsatSession(hall.p, workers=1).solve(Deadline.after(30))
    assert report.schedule.makespan == 4 + 1 + 4 + 3


def test_copies_of_a_move_are_used_in_the_order_in_which_they_are_written():
    """Also the tenth: whoever states that the first ones are used first keeps quick schedules."""
    route = Hall(guided=False, copies=12).route()
    ways = next(moves for to, moves in route.leaving[route.initial] if to == 2)
    numbers = [int(m.name.removeprefix("move")) for m in ways]
    assert len(numbers) == 13
    assert numbers == sorted(numbers)


def test_who_may_be_absent_opens_nothing():
    """That a button comes first if it is pressed at all does not ask for pressing it."""
    hall = Hall().opened(by=lambda present, before: before)
    assert hall.route().entries == {}
    assert hall.model.implied == {}
    report = CpsatSession(hall.p, workers=1).solve(Deadline.after(30))
    assert report.schedule.makespan == 4 + 3


def test_a_clause_with_another_way_out_asks_for_nothing():
    hall = Hall()
    key = hall.p.add_activity("key", 1, optional=True)
    for m in hall.moves:
        pressed = [And(b.present, LE(b.end, m.end)) for b in hall.buttons]
        hall.p.add_constraint(Or([*hall.other_goal(m, 2), key.present, *pressed]), [m.present])
    assert hall.route().entries == {}


def test_a_door_that_is_shut_again_is_not_what_a_clause_speaks_of():
    """Who was let through by an opening before does not see whether it was shut since."""
    hall = Hall(door=True)
    shut = hall.add("shut", 1, 1)
    shut.add_effect(Timing(-1, shut.end), hall.p.fluent("open")(), False)
    (entry,) = hall.opened().route().entries[2]
    assert entry.state == ("#milestone", 0)


def test_a_milestone_is_not_kept_as_it_is():
    """The second button may be pressed in the midst of a move that the first one is enough for."""
    hall = Hall(guided=False)
    for button in hall.buttons:  # anybody may press it, at any time
        button._conditions.clear()
    hall.p._base._constraints[:] = [
        (c, s) for c, s in hall.p._base._constraints if "button" not in str(c)
    ]
    for m in hall.moves:
        m.set_fixed_duration(2)
        pressed = [And(b.present, LE(b.end, m.start)) for b in hall.buttons]
        hall.p.add_constraint(Or(pressed), [m.present])
    route = hall.route()
    assert route.entries.keys() == {1, 2, 0} - {route.initial} | {0}
    assert route.still == {}
