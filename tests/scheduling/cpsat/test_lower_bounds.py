"""Shapes beside the benchmark families' in which a bound or a proof was once wrong."""

import itertools

import pytest
from unified_planning.model import (
    ClosedTimeInterval,
    GlobalEndTiming,
    GlobalStartTiming,
    TimePointInterval,
    Timing,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    LE,
    LT,
    BoolType,
    Equals,
    Fluent,
    Iff,
    IntType,
    MinimizeMakespan,
    Not,
    Or,
    UserType,
)

from tests.scheduling.cpsat.random_routes import begin, finish, inside, whole
from tests.scheduling.cpsat.truth import answer, bound_without_search
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession


class Trip:
    """Travellers between places; ``before``: LT, or LE where things may touch."""

    def __init__(self, places="AB", before=LT, starts="A"):
        self.problem = SchedulingProblem("trip")
        self.before = before
        self.spot = UserType("spot")
        self.spots = {n: self.problem.add_object(n, self.spot) for n in places}
        self.at = [
            self.problem.add_fluent(f"at{i}", self.spot, default_initial_value=self.spots[n])
            for i, n in enumerate(starts)
        ]
        self.busy = [[] for _ in starts]
        self.problem.add_quality_metric(MinimizeMakespan())

    def flag(self, name="flag"):
        return self.problem.add_fluent(name, BoolType(), default_initial_value=False)

    def here(self, places, who=0):
        options = [Equals(self.at[who](), self.spots[p]) for p in places]
        return options[0] if len(options) == 1 else Or(options)

    def moves(self, *legs, who=0):
        made = []
        for origin, to, length in legs:
            m = self.problem.add_activity(f"m{who}{origin}{to}", length, optional=True)
            m.add_condition(whole(m), self.here(origin, who))
            m.add_effect(m.end, self.at[who](), self.spots[to])
            made.append(m)
        self.busy[who] += made
        return made

    def stop(self, name, places, length, span=whole, who=0, *, optional=False):
        a = self.problem.add_activity(name, length, optional)
        a.add_condition(span(a), self.here(places, who))
        self.busy[who].append(a)
        return a

    def done(self):
        """Return the problem, with everybody doing one thing at a time."""
        for a, b in itertools.chain(*(itertools.combinations(x, 2) for x in self.busy)):
            apart = Or(self.before(a.end, b.start), self.before(b.end, a.start))
            self.problem.add_constraint(apart, [x.present for x in (a, b) if x.optional])
        return self.problem


def needs_its_place_late(span, optimum):
    trip = Trip(before=LE)
    trip.moves(("A", "B", 3), ("B", "A", 3))
    trip.stop("s", "B", 3, span)
    return trip.done(), optimum


def door_that_opens_by_itself():
    """The move keeps the door as it is, but for what the problem itself does: 5 + 1 + 1."""
    trip = Trip()
    door = trip.flag()
    for m in trip.moves(("A", "B", 5), ("B", "A", 5)):
        m.add_condition(inside(m), Or(door(), Not(door())))
    trip.problem.add_effect(GlobalStartTiming(3), door(), True)
    trip.stop("s", "B", 1)
    return trip.done(), 7


def effect_that_hangs_on_the_place():
    trip = Trip()
    flag = trip.flag()
    trip.moves(("A", "B", 2), ("B", "A", 2))
    s, u = trip.stop("s", "B", 1), trip.stop("u", "B", 1)
    s.add_effect(s.end, flag(), True, trip.here("B"))
    u.add_condition(begin(u), flag())
    return trip.done(), 6


def effect_on_what_a_parameter_names():
    """Moves light one place, so that the collapsed problem knows nothing of any."""
    trip = Trip()
    lit = Fluent("lit", BoolType(), x=trip.spot)
    trip.problem.add_fluent(lit, default_initial_value=False)
    there, _ = trip.moves(("A", "B", 2), ("B", "A", 2))
    there.add_effect(there.end, lit(trip.spots["A"]), True)
    s, u = trip.stop("s", "B", 1), trip.stop("u", "B", 1)
    s.add_effect(s.end, lit(s.add_parameter("which", trip.spot)), True)
    u.add_condition(begin(u), lit(trip.spots["B"]))
    return trip.done(), 6


def effect_of_the_problem_at_a_moves_end():
    trip = Trip()
    flag = trip.flag()
    there, _ = trip.moves(("A", "B", 2), ("B", "A", 2))
    trip.problem.add_effect(Timing(0, there.end), flag(), True)
    u = trip.stop("u", "B", 1)
    u.add_condition(begin(u), flag())
    return trip.done(), 4


def duration_that_a_move_changes():
    trip = Trip()
    level = trip.problem.add_fluent("level", IntType(0, 5), default_initial_value=5)
    there, _ = trip.moves(("A", "B", 2), ("B", "A", 2))
    there.add_decrease_effect(there.end, level(), 4)
    trip.stop("s", "B", 1).set_duration_bounds(level(), level())
    return trip.done(), 4


def duration_that_a_moves_parameter_gives():
    trip = Trip()
    there, _ = trip.moves(("A", "B", 2), ("B", "A", 2))
    length = there.add_parameter("length", IntType(0, 3))
    trip.stop("s", "B", 1)
    trip.stop("t", "B", 1).set_duration_bounds(length, length)
    return trip.done(), 5


def door_needed_after_the_arrival():
    """The door moves in the midst of nothing, and is needed only 3 units after the move."""
    trip = Trip()
    leaf = UserType("leaf")
    shut, opened = (trip.problem.add_object(n, leaf) for n in ("shut", "opened"))
    door = trip.problem.add_fluent("door", leaf, default_initial_value=shut)
    there, back = trip.moves(("A", "B", 4), ("B", "A", 4))
    for m in (there, back):
        m.add_condition(inside(m), Equals(door(), door()))
    there.add_condition(TimePointInterval(Timing(3, there.end)), Equals(door(), opened))
    a = trip.problem.add_activity("opens", 4)
    a.add_condition(begin(a), Equals(door(), shut))
    a.add_effect(a.end, door(), opened)
    trip.stop("s", "B", 1)
    return trip.done(), 6


def quicker_last_move_on_a_way_round_about():
    """A door moves at 8: A to C takes 8 before that, C to B takes 5 after it; A to B takes 10."""
    trip = Trip("ABC")
    door = trip.flag()
    for m in trip.moves(("A", "B", 10), ("A", "C", 8), ("C", "B", 5)):
        m.add_condition(inside(m), Or(door(), Not(door())))
    trip.stop("s", "B", 1)
    a = trip.problem.add_activity("opens", 8)
    a.add_effect(a.end, door(), True)
    trip.problem.add_constraint(LE(a.start, 0))
    return trip.done(), 16


def place_for_one(starts, free):
    trip = Trip("ABC", starts=starts)
    unit = trip.problem.add_fluent("free", IntType(0, 1), default_initial_value=free)
    for who in range(2):
        there, back = trip.moves(("A", "B", 2), ("B", "A", 2), who=who)
        there.add_decrease_effect(there.end, unit(), 1)
        back.add_increase_effect(back.start, unit(), 1)
    return trip


def free_place_with_somebody_in_it():
    """Who starts in the place has not taken it, so the other may come at once."""
    trip = place_for_one("BA", 1)
    trip.stop("s", "B", 5)
    trip.stop("t", "B", 5, who=1)
    return trip.done(), 8


def put_into_a_place_for_one(by):
    """Who is lifted there takes no unit, so the other may come as well."""
    trip = place_for_one("AA", 1)
    trip.stop("s", "B", 5)
    trip.stop("t", "B", 5, who=1)
    if by == "crane":
        crane = trip.problem.add_activity("crane", 1, optional=True)
        crane.add_effect(crane.end, trip.at[0](), trip.spots["B"])
    else:
        trip.problem.add_effect(GlobalStartTiming(1), trip.at[0](), trip.spots["B"])
    return trip.done(), 8


def comes_later_from_one_of_two_places():
    """What may happen at A or B happens at A, so that B is still free for the other."""
    trip = place_for_one("AA", 1)
    s, t = trip.stop("s", "AB", 2), trip.stop("t", "B", 1)
    for constraint in (LT(s.end, t.start), GE(t.start, 14), LE(s.end, 3)):
        trip.problem.add_constraint(constraint)
    trip.stop("u", "B", 8, who=1)
    return trip.done(), 15


def two_travellers_meet():
    """One comes early on a long way, the other late on a short one; a door keeps still."""
    trip = Trip("ABC", starts="AA")
    door = trip.flag()
    for who, length in enumerate((10, 3)):
        for m in trip.moves(("A", "B", length), ("B", "A", length), who=who):
            m.add_condition(inside(m), Or(door(), Not(door())))
    opens = trip.problem.add_activity("opens", 1, optional=True)
    opens.add_effect(opens.end, door(), True)
    trip.stop("first", "A", 20, who=1)
    meet = trip.stop("meet", "B", 1)
    meet.add_condition(whole(meet), trip.here("B", 1))
    trip.busy[1].append(meet)
    return trip.done(), 26


def near_or_far(places):
    """One thing, done at one place or at another one, whichever is listed first."""
    trip = Trip("ABC", before=LE)
    trip.moves(("A", "B", 3), ("B", "A", 3), ("A", "C", 9), ("C", "A", 9))
    ways = [trip.stop(f"at{place}", place, 1, optional=True) for place in places]
    trip.problem.add_constraint(Or(a.present for a in ways))
    trip.problem.add_constraint(Or(Not(a.present) for a in ways))
    return trip.done(), 5


def met_before(who):
    """Two meet, and both have done what one of them sets by that."""
    trip = Trip("AB", before=LE, starts="AA")
    fork = trip.flag("fork")
    for each in range(2):
        trip.moves(("A", "B", 3), ("B", "A", 3), who=each)
    meet = trip.stop("meet", "B", 1)
    meet.add_condition(whole(meet), trip.here("B", 1))
    trip.busy[1].append(meet)
    meet.add_effect(meet.end, fork(), True)
    then = trip.stop("then", "A", 1, who=who)
    then.add_condition(begin(then), fork())
    return trip.done(), 10


def opened_first_by_somebody_else(told):
    """Who opens a door later, for what it does next, need not be the first to open it: that it has
    to be there, or what else it sets, is no matter of who goes through first.
    """
    trip = Trip("ABCD", before=LE, starts="AC")
    door, fork = trip.flag("door"), trip.flag("fork")
    through, _ = trip.moves(("A", "B", 2), ("B", "A", 2))
    through.add_condition(begin(through), door())
    trip.moves(("C", "A", 8), ("A", "D", 2), who=1)
    opens = [trip.stop(f"opens{who}", "A", 1, who=who, optional=True) for who in range(2)]
    for a in opens:
        a.add_effect(a.end, door(), True)
    opens[1].add_effect(opens[1].end, fork(), True)
    trip.stop("s", "B", 10)
    ways = [trip.stop(f"way{k}", "D", 1, who=1, optional=True) for k in range(2)]
    trip.problem.add_constraint(Or(a.present for a in ways))
    trip.problem.add_constraint(Or(Not(a.present) for a in ways))
    for a in ways:
        if told == "state":
            a.add_condition(begin(a), fork())
        else:
            trip.problem.add_constraint(opens[1].present, [a.present])
            trip.problem.add_constraint(LT(opens[1].end, a.start), [a.present])
    return trip.done(), 15


def the_way_home_and_the_global_end():
    trip = Trip()
    trip.moves(("A", "B", 5), ("B", "A", 5))
    trip.stop("s", "B", 1)
    trip.problem.add_condition(TimePointInterval(GlobalEndTiming()), trip.here("A"))
    trip.problem.add_constraint(LE(GlobalEndTiming(), 100))
    return trip.done(), 13


def well_before_the_global_end():
    """The way home makes the end late enough for what has to hold before it."""
    trip = Trip()
    flag = trip.flag()
    trip.moves(("A", "B", 5), ("B", "A", 5))
    s = trip.stop("s", "B", 1)
    s.add_effect(s.end, flag(), True)
    trip.problem.add_condition(TimePointInterval(GlobalEndTiming()), trip.here("A"))
    trip.problem.add_condition(TimePointInterval(GlobalEndTiming() - 3), flag())
    return trip.done(), 13


@pytest.mark.parametrize(
    "case",
    [
        lambda: needs_its_place_late(finish, 6),
        lambda: needs_its_place_late(inside, 6),
        door_that_opens_by_itself,
        effect_that_hangs_on_the_place,
        effect_on_what_a_parameter_names,
        effect_of_the_problem_at_a_moves_end,
        duration_that_a_move_changes,
        duration_that_a_moves_parameter_gives,
        door_needed_after_the_arrival,
        quicker_last_move_on_a_way_round_about,
        free_place_with_somebody_in_it,
        lambda: put_into_a_place_for_one("crane"),
        lambda: put_into_a_place_for_one("the problem itself"),
        comes_later_from_one_of_two_places,
        two_travellers_meet,
        lambda: near_or_far("BC"),
        lambda: near_or_far("CB"),
        lambda: met_before(0),
        lambda: met_before(1),
        lambda: opened_first_by_somebody_else("presence"),
        lambda: opened_first_by_somebody_else("state"),
        the_way_home_and_the_global_end,
        well_before_the_global_end,
    ],
)
def test_no_bound_of_what_happens_at_places_is_above_the_optimum(case):
    problem, optimum = case()
    assert answer(problem) == (ScheduleStatus.OPTIMAL, optimum)
    assert (bound_without_search(problem) or 0) <= optimum
    assert answer(problem, plain=True) == (ScheduleStatus.OPTIMAL, optimum)


# -- without routes ------------------------------------------------------------------------------
def new_problem():
    problem = SchedulingProblem("few")
    problem.add_quality_metric(MinimizeMakespan())
    return problem


def optimum_of(problem):
    status, makespan = answer(problem)
    assert status is ScheduleStatus.OPTIMAL
    return makespan


def test_the_horizon_counts_the_global_end():
    problem = new_problem()
    problem.add_activity("a", 1)
    problem.add_constraint(GE(GlobalEndTiming(), 1000))
    assert optimum_of(problem) == 1000


@pytest.mark.parametrize("by", ["parameter", "fluent"])
def test_the_horizon_counts_durations_that_are_no_constants(by):
    problem = new_problem()
    a = problem.add_activity("a", 1)
    if by == "parameter":
        length = a.add_parameter("length", IntType(0, 1000))
        problem.add_constraint(GE(length, 900))
    else:
        length = problem.add_fluent("length", IntType(0, 1000), default_initial_value=900)()
    a.set_duration_bounds(length, length)
    assert optimum_of(problem) == 900


def test_a_condition_before_the_global_end_is_not_one_at_the_end():
    for wanted, optimum in ((False, 3), (True, 9)):
        problem = new_problem()
        flag = problem.add_fluent("flag", BoolType(), default_initial_value=False)
        a = problem.add_activity("a", 3)
        a.add_effect(a.end, flag(), True)
        problem.add_activity("b", 9, optional=True)
        span = TimePointInterval(GlobalEndTiming() - 2)
        problem.add_condition(span, flag() if wanted else Not(flag()))
        assert optimum_of(problem) == optimum


def test_a_condition_over_no_instant_switches_nothing():
    """Both set the level from 0 to 1, but neither needs it to be 0 at any instant."""
    problem = new_problem()
    level = problem.add_fluent("level", IntType(0, 3), default_initial_value=0)
    a, b = (problem.add_activity(n, 0, optional=True) for n in "ab")
    for x in (a, b):
        span = ClosedTimeInterval(Timing(0, x.start), Timing(-1, x.end))
        x.add_condition(span, Equals(level(), 0))
        x.add_effect(x.end, level(), 1)
    problem.add_constraint(Iff(a.present, b.present))
    problem.add_constraint(Or(a.present, b.present))
    assert optimum_of(problem) == 1


def test_a_constraint_on_the_global_end_may_come_later():
    problem = new_problem()
    problem.add_activity("a", 3).add_deadline(5)
    session = CpsatSession(problem, workers=1)
    assert session.solve(Deadline.after(20)).schedule.makespan == 3
    problem.add_constraint(GE(GlobalEndTiming(), 5))
    assert session.solve(Deadline.after(20)).schedule.makespan == 5
    problem.add_constraint(GE(GlobalEndTiming(), 6))
    assert session.solve(Deadline.after(20)).status is ScheduleStatus.INFEASIBLE


def test_a_new_activity_may_lower_a_bound_by_the_global_end():
    problem = new_problem()
    a = problem.add_activity("a", 3)
    problem.add_activity("c", 10, optional=True)
    problem.add_constraint(LE(a.end + 2, GlobalEndTiming()))
    session = CpsatSession(problem, workers=1)
    report = session.solve(Deadline.after(20))
    assert (report.schedule.makespan, report.bound) == (10, 10)
    problem.add_activity("b", 5)
    report = session.solve(Deadline.after(20))
    assert (report.status, report.schedule.makespan) == (ScheduleStatus.OPTIMAL, 5)


def test_a_tour_without_any_length():
    """Annealing is asked to better a tour that takes no time at all."""
    trip = Trip()
    trip.moves(("A", "B", 2), ("B", "A", 2))
    trip.stop("s", "A", 0)
    assert optimum_of(trip.done()) == 0
