"""What each recogniser assumes, broken: the answer is the one with nothing recognised.

Every docstring in ``scheduling/cpsat`` that says what is assumed has a row here.
"""

import itertools

import pytest
from unified_planning.model import (
    GlobalStartTiming,
    LeftOpenTimeInterval,
    TimePointInterval,
    Timing,
)
from unified_planning.shortcuts import (
    GE,
    LE,
    LT,
    And,
    BoolType,
    Equals,
    Fluent,
    Iff,
    Implies,
    IntType,
    Not,
    Or,
)

import up_samp.scheduling.cpsat as package
from tests.oracles.assuming import assuming
from tests.scheduling.cpsat.fleets import Fleet, optimum, write_fleet
from tests.scheduling.cpsat.random_routes import begin, inside, late, whole
from tests.scheduling.cpsat.test_lower_bounds import Trip, new_problem
from tests.scheduling.cpsat.truth import answer, bound_without_search
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes


def sooner(a):
    return TimePointInterval(Timing(-4, a.start))


AB = (("A", "B", 3), ("B", "A", 3))
WAYS = tuple((a, b, abs(ord(a) - ord(b)) + 1) for a, b in itertools.permutations("ABC", 2))


def optional(trip, name, place, length, *, who=0):
    """Return a stop that need not be made."""
    a = trip.problem.add_activity(name, length, optional=True)
    if place:
        a.add_condition(whole(a), trip.here(place, who))
        trip.busy[who].append(a)
    return a


def one_of(problem, *some, apart=True):
    problem.add_constraint(Or([a.present for a in some]))
    for a, b in itertools.combinations(some, 2) if apart else ():
        problem.add_constraint(Not(And(a.present, b.present)))


def pair(*, apart=True, lengths=(3, 3), condition=False, stops="BB"):
    """Two travellers at A; one of two stops is to be made, and something needs both, or one."""
    trip = Trip("AB", starts="AA")
    trip.moves(*AB)
    trip.moves(("A", "B", 7), ("B", "A", 7), who=1)
    one, other = (
        optional(trip, f"s{w}", place, lengths[w], who=w) for w, place in enumerate(stops)
    )
    if condition:
        wanted = trip.problem.add_variable("wanted", BoolType())
        trip.problem.add_constraint(Or(one.present, other.present), [wanted])
    else:
        one_of(trip.problem, one, other, apart=apart)
    return trip, one, other


# -- what is said of presences ---------------------------------------------------------------------
def together_on_a_condition():
    trip, one, other = pair(apart=False)
    flag = trip.problem.add_variable("flag", BoolType())
    trip.problem.add_constraint(Iff(one.present, other.present), [flag])
    return trip.done()


def both_may_be_made():
    trip, one, other = pair(apart=False)
    trip.problem.add_constraint(Implies(one.present, other.present))
    return trip.done()


def told_apart_by_who_may_be_absent():
    """Each of two asks for a value of its own of what is chosen for a third, which is not there."""
    trip, one, other = pair(apart=False, lengths=(3, 3), stops="BB")
    third = trip.problem.add_activity("third", 2, optional=True)
    chosen = third.add_parameter("chosen", IntType(0, 3))
    trip.problem.add_constraint(Or(one.present, other.present))
    for value, stop in enumerate((one, other)):
        trip.problem.add_constraint(Equals(chosen, value), [stop.present, third.present])
        trip.problem.add_constraint(Implies(stop.present, Or(one.present, other.present)))
    trip.problem.add_constraint(one.present)
    trip.problem.add_constraint(other.present)
    return trip.done()


def told_apart_by_a_parameter():
    """The same, where nothing is said of the third."""
    trip, one, other = pair(apart=False)
    third = trip.problem.add_activity("third", 2, optional=True)
    chosen = third.add_parameter("chosen", IntType(0, 3))
    trip.problem.add_constraint(Or(one.present, other.present))
    for value, stop in enumerate((one, other)):
        trip.problem.add_constraint(Equals(chosen, value), [stop.present])
    trip.problem.add_constraint(one.present)
    trip.problem.add_constraint(other.present)
    return trip.done()


def other_lengths():
    return pair(lengths=(3, 1))[0].done()


def none_need_be_made():
    return pair(condition=True)[0].done()


def said_of_one_alternative():
    trip, one, other = pair()
    last = trip.stop("last", "A", 1)
    trip.problem.add_constraint(LE(other.end, last.start), [other.present])
    trip.problem.add_constraint(LE(last.end, one.start), [one.present])
    return trip.done()


def prepared_for_one_alternative():
    """A machine prepares for one of two who may make a stop, and another machine for a stop."""
    trip, one, _ = pair()
    last = trip.stop("last", "B", 1)
    first, then = (trip.problem.add_activity(name, 20) for name in ("first", "then"))
    trip.problem.add_constraint(GE(one.start, first.end), [one.present])
    trip.problem.add_constraint(LE(one.end, first.start), [one.present])
    trip.problem.add_constraint(GE(last.start, then.start))
    trip.problem.add_constraint(LE(last.end, then.end))
    trip.problem.add_constraint(Or(LE(first.end, then.start), LE(then.end, first.start)))
    return trip.done()


def value_left_to_some():
    """A parameter is limited only if something else is there."""
    trip = Trip("ABC")
    trip.moves(*WAYS)
    m = trip.problem.add_activity("go", 4, optional=True)
    to = m.add_parameter("to", trip.spot)
    m.add_condition(whole(m), trip.here("A"))
    m.add_effect(m.end, trip.at[0](), to)
    trip.busy[0].append(m)
    other = optional(trip, "other", "", 2)
    trip.problem.add_constraint(Equals(to, trip.spots["B"]), [m.present, other.present])
    trip.stop("s", "C", 2)
    return trip.done()


# -- states ----------------------------------------------------------------------------------------
def helpers_that_overlap():
    """Helpers and rivals may be under way at once: the last one is not the one that counts."""
    problem = new_problem()
    helper, rival = (problem.add_activity(n, 5, optional=True) for n in ("helper", "rival"))
    a = problem.add_activity("a", 2, optional=True)
    undone = Implies(rival.present, Or(LE(rival.end, helper.start), GE(rival.start, a.end)))
    problem.add_constraint(Or(And(helper.present, LE(helper.end, a.start), undone)), [a.present])
    problem.add_constraint(a.present)
    problem.add_constraint(rival.present)
    problem.add_constraint(LE(rival.end, 9))
    return problem


def a_door_that_is_shut_again():
    """Who goes through needs somebody to have opened; the door is shut meanwhile, and that is no
    matter, for the clause asks for the opening alone.
    """
    trip = Trip("ABC")
    made = trip.moves(*WAYS)
    door = trip.flag("door")
    opens = optional(trip, "opens", "A", 1)
    opens.add_effect(opens.end, door(), True)
    for m in made:
        if m.name.endswith("B"):
            done = And(opens.present, LE(opens.end, m.start))
            trip.problem.add_constraint(Or(Not(m.present), done))
    trip.problem.add_effect(GlobalStartTiming(4), door(), False)
    trip.stop("s", "B", 1)
    trip.stop("t", "C", 1)
    return trip.done()


def forks(*, taken=0, put=-1, read=begin, freed_by=""):
    """A robot takes two things at B and puts them down there; the fork that it takes them with is
    full at ``taken`` from the end of what takes them, and free at ``put`` from that of what puts
    them down. ``freed_by``: something else frees it, too.
    """
    trip = Trip("AB", before=LE)
    trip.moves(*AB)
    free = trip.problem.add_fluent("free", BoolType(), default_initial_value=True)
    takes = [trip.stop(f"take{k}", "B", 2) for k in range(2)]
    puts = [trip.stop(f"put{k}", "B", 5) for k in range(2)]
    for one, other in zip(takes, puts, strict=True):
        trip.problem.add_constraint(LE(one.end, other.start))
        one.add_condition(read(one), free())
        one.add_effect(Timing(taken, one.end), free(), False)
        other.add_effect(Timing(put, other.end), free(), True)
    for other in puts if freed_by or taken or read is sooner else ():
        trip.problem.add_constraint(And(LE(one.end, other.start) for one in takes))
    if freed_by == "timed":
        trip.problem.add_effect(GlobalStartTiming(8), free(), True)
    elif freed_by:
        frees = optional(trip, freed_by, "B" if freed_by == "stop" else "", 1)
        frees.add_effect(frees.end, free(), True)
    return trip.done()


def set_for_itself():
    """Who needs a fork frees it first: what was known before it began is no matter."""
    trip = Trip("AB", before=LE)
    trip.moves(*AB)
    free = trip.problem.add_fluent("free", BoolType(), default_initial_value=False)
    for k in range(2):
        s = trip.stop(f"s{k}", "B", 3)
        s.add_effect(s.start, free(), True)
        s.add_condition(TimePointInterval(Timing(-1, s.end)), free())
    return trip.done()


def two_at_a_time():
    problem = new_problem()
    hands = problem.add_fluent("hands", IntType(0, 2), default_initial_value=2)
    for k in range(3):
        problem.add_activity(f"a{k}", 2 + k).uses(hands())
    return problem


def taken_without_asking():
    problem = new_problem()
    busy = problem.add_fluent("busy", BoolType(), default_initial_value=False)
    for k in range(3):
        a = problem.add_activity(f"a{k}", 3 + k)
        if k:
            a.add_condition(begin(a), Not(busy()))
        a.add_effect(a.start, busy(), True)
        a.add_effect(a.end, busy(), False)
    return problem


def held_for_a_while():
    problem = new_problem()
    busy = problem.add_fluent("holder", IntType(0, 3), default_initial_value=0)
    for k in range(3):
        a = problem.add_activity(f"a{k}", 6)
        a.add_effect(a.start, busy(), k + 1)
        span = LeftOpenTimeInterval(Timing(0, a.start), Timing(2 if k else 6, a.start))
        a.add_condition(span, Equals(busy(), k + 1))
    return problem


def other_gaps_one_way():
    problem = new_problem()
    a, b = (problem.add_activity(n, 2) for n in "ab")
    problem.add_constraint(Or(LE(a.end + 5, b.start), LE(b.end, a.start)))
    late_a = problem.add_variable("late", BoolType())
    problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start), late_a))
    return problem


def writes_that_need_nothing():
    trip = Trip("ABC")
    for m in trip.moves(*WAYS):
        m._conditions.clear()
    trip.stop("s", "C", 1)
    trip.stop("t", "B", 1)
    return trip.done()


# -- routes ----------------------------------------------------------------------------------------
def a_move_beside_all_else():
    trip = Trip("ABC")
    trip.moves(*WAYS)
    lift = trip.problem.add_activity("lift", 1, optional=True)
    lift.add_effect(lift.end, trip.at[0](), trip.spots["C"])
    trip.stop("s", "C", 4)
    return trip.done()


def an_effect_on_a_condition():
    trip = Trip("ABC")
    flag = trip.flag()
    made = trip.moves(("A", "B", 2), ("B", "A", 2))
    m = made[0]
    m.add_effect(m.end, trip.at[0](), trip.spots["C"], flag())
    sets = trip.problem.add_activity("sets", 3, optional=True)
    sets.add_effect(sets.end, flag(), True)
    trip.stop("s", "C", 1)
    return trip.done()


def a_length_for_company():
    """A move lasts long only if something else is there, too."""
    trip = Trip("AB")
    m = trip.problem.add_activity("go", 1, optional=True)
    m.set_duration_bounds(1, 9)
    to = m.add_parameter("to", trip.spot)
    m.add_condition(whole(m), trip.here("A"))
    m.add_effect(m.end, trip.at[0](), to)
    trip.busy[0].append(m)
    other = optional(trip, "other", "", 2)
    long = And(m.present, LE(m.start + 6, m.end))
    trip.problem.add_constraint(
        Or(Not(m.present), Not(Equals(to, trip.spots["B"])), Not(other.present), long)
    )
    trip.stop("s", "B", 2)
    return trip.done()


def guarded(but=(), *, before=None, provides=False, holds=False):
    """All moves into B but some need a door to be open, which is opened at C."""
    trip = Trip("ABC", before=before or LT)
    door = trip.problem.add_fluent("door", BoolType(), default_initial_value=holds)
    for m in trip.moves(*WAYS):
        if m.name.endswith("B") and m.name not in but:
            m.add_condition(late(m), door())
            if provides:
                m.add_effect(m.start, door(), True)
    opens = optional(trip, "opens", "C", 4)
    opens.add_effect(opens.end, door(), True)
    trip.stop("s", "B", 2)
    return trip, door, opens


def one_way_in_needs_nothing():
    return guarded(("m0AB",))[0].done()


def a_way_in_that_opens_itself():
    return guarded(provides=True)[0].done()


def a_move_that_keeps_nothing_still(but="m0AB"):
    trip = Trip("AB")
    flag = trip.flag()
    for m in trip.moves(("A", "B", 8), ("B", "A", 8)):
        if m.name != but:
            m.add_condition(inside(m), Or(flag(), Not(flag())))
    sets = trip.problem.add_activity("sets", 2)
    sets.add_effect(sets.end, flag(), True)
    trip.stop("s", "B", 1)
    return trip.done()


def a_visit_or_something_else():
    trip = Trip("ABC", before=LE)
    made = {m.name: m for m in trip.moves(*WAYS)}
    other = optional(trip, "other", "", 1)
    come = [m.present for name, m in made.items() if name.endswith("C")]
    trip.problem.add_constraint(Or(*come, other.present))
    trip.stop("s", "B", 1)
    return trip.done()


def a_move_that_may_stay(at_a=1, *, stated=False):
    """It goes to C, or to where it begins, which lasts ``at_a``: a visit to C if it cannot."""
    trip = Trip("ABC", before=LE)
    trip.moves(("B", "A", 4), ("C", "A", 6))
    far = trip.problem.add_fluent(Fluent("far", IntType(0, 99), spot=trip.spot))
    for place, length in zip("ABC", (at_a, 3, 4), strict=True):
        trip.problem.set_initial_value(far(trip.spots[place]), length)
    go = trip.problem.add_activity("go", 1)
    to = go.add_parameter("to", trip.spot)
    go.set_duration_bounds(far(to), 5)
    go.add_constraint(Not(Equals(to, trip.spots["B"])))
    if stated:
        go.add_constraint(Not(Equals(trip.spots["A"], to)))
    go.add_condition(whole(go), trip.here("A"))
    go.add_effect(go.end, trip.at[0](), to)
    trip.busy[0].append(go)
    back = trip.stop("back", "A", 1)
    trip.problem.add_constraint(LE(go.end, back.start))
    return trip.done()


def room(*, gives="AB", starts="AA", free=1):
    """B holds one traveller at a time, as far as those who leave it give it back."""
    trip = Trip("AB", before=LE, starts=starts)
    unit = trip.problem.add_fluent("unit", IntType(0, 1), default_initial_value=free)
    for who in (0, 1):
        for m in trip.moves(*AB, who=who):
            if m.name.endswith("AB"):
                m.add_decrease_effect(m.end, unit(), 1)
            elif gives[who] == "AB"[who]:
                m.add_increase_effect(m.start, unit(), 1)
        trip.stop(f"s{who}", "B", 2, who=who)
    return trip


def one_departure_gives_nothing_back():
    return room(gives="A-").done()


def doors_of_two_kinds():
    """What opens the door also does something that somebody needs."""
    trip, _, opens = guarded(("m0AB", "m0CB"))
    lamp = trip.flag("lamp")
    opens.add_effect(opens.end, lamp(), True)
    again = optional(trip, "again", "A", 1)
    again.add_effect(again.end, lamp(), True)
    needs = trip.stop("needs", "A", 1)
    needs.add_condition(begin(needs), lamp())
    return trip.done()


def a_door_with_two_uses():
    trip, door, opens = guarded()
    again = optional(trip, "again", "C", 4)
    again.add_effect(again.end, door(), True)
    for name, one in (("x", opens), ("y", again)):
        wants = trip.problem.add_activity(f"wants_{name}", 1)
        trip.problem.add_constraint(And(one.present, LE(one.end, wants.start)))
    return trip.done()


def a_door_that_somebody_shuts():
    trip, door, _ = guarded()
    shuts = trip.problem.add_activity("shuts", 1)
    shuts.add_effect(shuts.end, door(), False)
    trip.stop("t", "A", 1)
    trip.stop("u", "B", 1)
    return trip.done()


def a_door_that_closes(*, at_once=True, opened_at=None):
    """It closes after it was opened: right then, or at any time; or it opens by itself, too."""
    trip, door, opens = guarded(before=LE)
    closes = trip.problem.add_activity("closes", 9, optional=True)
    trip.problem.add_constraint(Iff(closes.present, opens.present))
    both = [opens.present, closes.present]
    follows = Equals(opens.end, closes.start) if at_once else LE(opens.end, closes.start)
    trip.problem.add_constraint(follows, both)
    closes.add_effect(closes.end, door(), False)
    if opened_at is not None:
        trip.problem.add_effect(GlobalStartTiming(opened_at), door(), True)
    return trip.done()


def a_battery_that_is_filled_by_others():
    trip = Trip("ABC")
    level = trip.problem.add_fluent("level", IntType(0, 4), default_initial_value=2)
    for m in trip.moves(*WAYS):
        m.add_decrease_effect(m.end, level(), 1)
    fills = trip.problem.add_activity("fills", 3, optional=True)
    fills.add_increase_effect(fills.end, level(), 2)
    for place in "BC":
        trip.stop(place.lower(), place, 1)
    home = trip.stop("home", "A", 1)
    for a in trip.problem.activities:
        if a.name in "bc":
            trip.problem.add_constraint(LE(a.end, home.start))
    return trip.done()


def in_any_order_but_one():
    """An order on a condition is no order."""
    trip = Trip("ABC")
    trip.moves(*WAYS)
    flag = trip.problem.add_variable("flag", BoolType())
    far, near = trip.stop("far", "C", 2), trip.stop("near", "B", 2)
    trip.problem.add_constraint(LE(far.end, near.start), [flag])
    return trip.done()


def something_beside_the_routes():
    return pair(stops=("B", ""))[0].done()


def one_alternative_needs_no_place():
    trip = Trip("AB", starts="AA")
    trip.moves(("A", "B", 7), ("B", "A", 7))
    trip.moves(*AB, who=1)
    one, free = optional(trip, "one", "B", 2), optional(trip, "free", "", 2)
    one_of(trip.problem, free, one)
    trip.stop("t", "B", 1, who=1)
    return trip.done()


def fleet(*args, seed=0, **more):
    return lambda: write_fleet(Fleet(*args, **more), seed)


def narrow_then_loose():
    """Bounds are forgotten when what is appended lets more happen."""
    trip, door, _ = guarded()
    return trip.done(), door


LINE = ((3, 30), (9, 21), (2, 4), ((0, 1), (0, 1)))
BROKEN = {
    "find_presences": [together_on_a_condition],
    "find_groups": [
        both_may_be_made,
        other_lengths,
        none_need_be_made,
        told_apart_by_who_may_be_absent,
        told_apart_by_a_parameter,
    ],
    "merge_forms": [said_of_one_alternative],
    "domains": [value_left_to_some],
    "find_histories": [helpers_that_overlap],
    "find_milestones": [a_door_that_is_shut_again],
    "find_own_states": [
        lambda: forks(taken=2),
        lambda: forks(read=sooner),
        lambda: forks(freed_by="timed"),
        set_for_itself,
        a_battery_that_is_filled_by_others,
    ],
    "own_states_after": [lambda: forks(freed_by="stop"), lambda: forks(freed_by="somebody")],
    "_borrowed": [two_at_a_time],
    "_marked": [taken_without_asking],
    "_held": [held_for_a_while],
    "_pair": [other_gaps_one_way],
    "_circuit": [writes_that_need_nothing],
    "find_routes": [a_move_beside_all_else],
    "changes_of": [an_effect_on_a_condition, a_move_beside_all_else],
    "least": [a_length_for_company],
    "find_entries": [one_way_in_needs_nothing, a_way_in_that_opens_itself],
    "_may_stay": [a_move_that_may_stay],
    "find_still": [a_move_that_keeps_nothing_still],
    "find_visits": [a_visit_or_something_else],
    "find_unit_places": [one_departure_gives_nothing_back, lambda: room(free=0).done()],
    "with_openings": [doors_of_two_kinds, a_door_with_two_uses, a_door_that_somebody_shuts],
    "find_set_back": [
        lambda: a_door_that_closes(),
        lambda: a_door_that_closes(at_once=False),
        lambda: a_door_that_closes(opened_at=2),
        a_door_that_somebody_shuts,
    ],
    "find_work": [something_beside_the_routes, in_any_order_but_one],
    "_find_beside": [prepared_for_one_alternative],
    "find_tasks": [one_alternative_needs_no_place, fleet(*LINE), fleet(*LINE, seed=3)],
    "bound_by_work": [
        fleet(*LINE, alone="uses"),
        lambda: pair()[0].done(),
        one_alternative_needs_no_place,
        none_need_be_made,
        fleet(*LINE, extra=2),
        fleet((3, 30), (9, 21), (2, 4), ((0, 1), (1,))),
    ],
    "bound_by_assignment": [fleet((3,), (9, 9 + 3), (2, 4), ((0,), (0,)), home=True)],
    "only_tightened": [],
}
"""Recogniser -> problems in which what it assumes does not hold. The last one is about what is
kept from one solve to the next: ``test_what_is_kept_...``."""


def test_all_that_is_assumed_is_broken_here():
    assert assuming(package) == BROKEN.keys()


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, id=f"{n}{k}") for n, some in BROKEN.items() for k, c in enumerate(some)],
)
def test_broken_assumptions_change_no_answer(case):
    truth = answer(case(), plain=True)
    assert truth is not None
    assert answer(case()) == truth
    quick = bound_without_search(case())
    assert truth[1] is None or quick is None or quick <= truth[1]


@pytest.mark.parametrize("leaves", [{"at_a": 6}, {"at_a": 99}, {"stated": True}])
def test_a_move_that_cannot_stay_is_a_move_still(leaves):
    problem = a_move_that_may_stay(**leaves)
    (route,) = find_routes(ScheduleModel(problem))
    assert "go" not in route.odd
    assert {m.to for m in route.moves if m.name == "go"} == {2}
    assert [places for _, places in route.visits] == [{2}]
    assert answer(problem) == answer(problem, plain=True) == (ScheduleStatus.OPTIMAL, 13)


def test_a_move_that_may_stay_is_none():
    (route,) = find_routes(ScheduleModel(a_move_that_may_stay()))
    assert route.odd == {"go": "may stay where it is"}
    assert route.visits == []
    assert answer(a_move_that_may_stay(), plain=True) == (ScheduleStatus.OPTIMAL, 3)


def test_what_is_kept_is_forgotten_when_more_may_happen():
    problem, door = narrow_then_loose()
    session = CpsatSession(problem, workers=1)
    before = session.solve(Deadline.after(60))
    problem.add_effect(GlobalStartTiming(1), door(), True)
    after = session.solve(Deadline.after(60))
    assert after.status is ScheduleStatus.OPTIMAL
    assert after.bound == after.schedule.makespan < before.bound == before.schedule.makespan
    assert answer(problem, plain=True) == (ScheduleStatus.OPTIMAL, after.bound)


def test_the_fleets_here_have_the_optima_that_all_orders_tell():
    some = Fleet(*LINE, extra=2)
    assert answer(write_fleet(some, 5)) == (ScheduleStatus.OPTIMAL, optimum(some))
