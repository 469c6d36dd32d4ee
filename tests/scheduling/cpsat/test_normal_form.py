"""The steps of the normal form, each alone."""

import itertools
import random
from fractions import Fraction

import pytest
from unified_planning.model import (
    ClosedTimeInterval,
    LeftOpenTimeInterval,
    TimePointInterval,
    Timing,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    LE,
    LT,
    And,
    BoolType,
    Equals,
    Iff,
    Implies,
    IntType,
    MinimizeMakespan,
    Not,
    Or,
    UserType,
)

from up_samp.model import Deadline, UnsupportedError
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.scheduling.cpsat.encode.disjunctions import find_groups
from up_samp.scheduling.cpsat.encode.forms import Cmp
from up_samp.scheduling.cpsat.encode.recognition import find_unary
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.normal import Watcher, called, normal_form


@pytest.fixture
def problem():
    return SchedulingProblem("p")


def three(problem, duration=2):
    return [problem.add_activity(n, duration, optional=True) for n in "abc"]


def built(problem):
    model = ScheduleModel(problem)
    return model


# -- clauses ---------------------------------------------------------------------------------------
def stated(problem, node, scope=()):
    """What a problem with one constraint states: forms without needs."""
    problem.add_constraint(node, list(scope))
    return [bare(form) for form in built(problem).stated]


def bare(form):
    if isinstance(form, Cmp):
        return form._replace(needs=())
    return (form[0], *map(bare, form[1:])) if isinstance(form, tuple) else form


def test_conjunctions_are_clauses_behind_what_has_to_be_there(problem):
    a, b, c = three(problem)
    first, second = LE(a.end, b.start), LE(b.end, c.start)
    node = Implies(And(a.present, b.present), And(first, Implies(c.present, second)))
    one, other = stated(problem, node)
    assert one[0] == other[0] == "|"
    assert (len(one), len(other)) == (4, 5)  # and who has to be there


def test_exclusions_are_said_pair_by_pair(problem):
    a, b, c = three(problem)
    others = Not(Or(b.present, c.present))
    said = [
        (others, [a.present]),
        (Implies(a.present, others), []),
        (Not(And(a.present, Or(b.present, c.present))), []),
    ]
    for node, scope in said:
        mine = SchedulingProblem("p")
        a, b, c = three(mine)
        forms = stated(mine, node, scope)
        assert [len(form) for form in forms] == [3, 3]


def test_overlap_that_is_denied_is_a_disjunction(problem):
    a, b, _ = three(problem)
    denied = Not(And(a.present, b.present, LT(a.start, b.end), LT(b.start, a.end)))
    assert stated(problem, denied) == []
    assert built(problem).disjunctions.gaps == {(0, 1): 0}


# -- presences -------------------------------------------------------------------------------------
TOGETHER = {
    "iff": lambda a, b: [Iff(a, b)],
    "both ways": lambda a, b: [Implies(a, b), Implies(b, a)],
    "clauses": lambda a, b: [Or(Not(a), b), Not(And(b, Not(a)))],
    "at once": lambda a, b: [And(Implies(Not(b), Not(a)), Or(a, Not(b)))],
    "denied": lambda a, b: [Not(Iff(a, Not(b)))],
}
"""How authors say that two are there together."""


@pytest.mark.parametrize("seed", range(12))
def test_who_is_there_together_is_read_alike_however_each_pair_is_said(seed):
    """Two robots, each with a variable and two parts; every pair is said in a way of its own, in
    any order.
    """
    rng = random.Random(seed)
    problem = SchedulingProblem("p")
    builds = {r: problem.add_variable(f"builds{r}", BoolType()) for r in "12"}
    said = [Or(builds["1"], builds["2"]), Not(And(builds["1"], builds["2"]))]
    for r, k in rng.sample(list(itertools.product("12", "xy")), 4):
        length = {"x": 3, "y": 4}[k]
        load = problem.add_activity(f"load{r}{k}", length, optional=True)
        ways = TOGETHER[rng.choice(sorted(TOGETHER))]
        said += ways(*rng.sample([builds[r], load.present], 2))
    for constraint in rng.sample(said, len(said)):
        problem.add_constraint(constraint)
    form = normal_form(Watcher(problem).look())
    together = {}
    for name, leader in form.presences.items():
        together.setdefault(leader, set()).add(name)
    assert sorted(map(sorted, together.values())) == [
        [called(builds["1"]), "load1x", "load1y"],
        [called(builds["2"]), "load2x", "load2y"],
    ]
    assert {frozenset(g) for g in find_groups(form)} == {
        frozenset(("load1x", "load2x")),
        frozenset(("load1y", "load2y")),
    }


def test_variables_may_have_the_names_of_activities(problem):
    """They decide nothing about these; two variables of one name are refused by name."""
    some = [problem.add_activity(name, k, optional=True) for k, name in enumerate("abc", 1)]
    variables = [problem.add_variable(name, BoolType()) for name in "bca"]
    problem.add_constraint(Iff(variables[0], some[0].present))
    problem.add_constraint(Not(variables[1]))
    problem.add_constraint(And(some[0].present, some[2].present))
    problem.add_quality_metric(MinimizeMakespan())
    for plain in (False, True):
        report = CpsatSession(problem, workers=1, plain=plain).solve(Deadline.after(60))
        assert report.schedule is not None
        assert report.schedule.makespan == 3
    some[0].add_parameter("size", IntType(0, 1))
    problem.add_variable("a.size", IntType(0, 5))
    with pytest.raises(UnsupportedError, match=r"are called 'a\.size'"):
        CpsatSession(problem).solve(Deadline.after(60))


def test_real_and_whole_numbers_ask_a_variable_for_one_value(problem):
    some = [problem.add_activity(name, 2, optional=True) for name in "ab"]
    kind = problem.add_variable("kind", IntType(0, 3))
    one = problem.environment.expression_manager.Real(Fraction(1))
    for activity, value in zip(some, (1, one), strict=True):
        problem.add_constraint(Equals(kind, value), scope=[activity.present])
    problem.add_constraint(Or(a.present for a in some))
    assert find_groups(normal_form(Watcher(problem).look())) == []


def test_variables_that_decide_presences_make_alternatives(problem):
    """One robot builds all parts of a kit: a bool variable for each robot (Iff with each part)."""
    parts = {r: [problem.add_activity(f"load{r}{k}", 3, optional=True) for k in "xy"] for r in "12"}
    builds = {r: problem.add_variable(f"builds{r}", BoolType()) for r in "12"}
    for r, loads in parts.items():
        for load in loads:
            problem.add_constraint(Iff(builds[r], load.present))
    problem.add_constraint(Or(builds["1"], builds["2"]))
    problem.add_constraint(Not(And(builds["1"], builds["2"])))
    form = normal_form(Watcher(problem).look())
    assert form.presences[called(builds["1"])] == form.presences["load1y"]
    assert form.presences["load1y"] != form.presences["load2y"]
    assert find_groups(form) == [
        ("load1x", "load2x"),
        ("load1y", "load2y"),
    ]
    model = built(problem)
    made = model.world.activities
    assert made["load1x"].present == made["load1y"].present == model.parameters["builds1"][0]


@pytest.mark.parametrize("told", ["which is which", "who does all"])
def test_alternatives_are_of_one_kind_in_whatever_order_they_are_written(problem, told):
    """One of two robots does two things that take the same time, at two places."""
    spot = UserType("spot")
    spots = {k: problem.add_object(k, spot) for k in "xy"}
    at = [problem.add_fluent(f"at{r}", spot, default_initial_value=spots["x"])() for r in range(2)]
    who = [problem.add_variable(f"who{r}", BoolType()) for r in range(2)]
    made = {}
    for name in ("1x", "0y", "0x", "1y"):
        a = made[name] = problem.add_activity(f"do{name}", 3, optional=True)
        here = Equals(at[int(name[0])], spots[name[1]])
        a.add_condition(TimePointInterval(Timing(0, a.start)), here)
        problem.add_constraint(Iff(who[int(name[0])], a.present))
    if told == "which is which":
        for k in "xy":
            problem.add_constraint(Or(made[f"0{k}"].present, made[f"1{k}"].present))
    else:
        problem.add_constraint(Or(*who))
    problem.add_constraint(Not(And(*who)))
    form = normal_form(Watcher(problem).look())
    found = {frozenset(g) for g in find_groups(form)}
    assert found == {frozenset({"do0x", "do1x"}), frozenset({"do0y", "do1y"})}


# -- precedences -----------------------------------------------------------------------------------
def helped(problem, a, helpers, rivals, initially):
    """State that ``a`` needs what ``helpers`` leave, in the published form."""
    options = []
    for h in helpers:
        undone = [
            Implies(r.present, Or(LE(r.end, h.start), LE(a.end, r.start)))
            for r in rivals
            if r not in (h, a)
        ]
        options.append(And(h.present, LE(h.end, a.start), *undone))
    if initially:
        options.append(And([Implies(r.present, LE(a.end, r.start)) for r in rivals if r is not a]))
    problem.add_constraint(Or(options), [a.present])


def test_preconditions_by_helpers_and_rivals_are_read(problem):
    a, b, c = three(problem)
    helped(problem, a, [b], [b, c], True)
    problem.add_constraint(Or(And(c.present, LE(a.end, c.start))), [a.present])
    problem.add_constraint(LE(a.end, b.start), [a.present])
    form = normal_form(Watcher(problem).look())
    (found,) = form.preconditions
    assert (found.activity, found.helpers) == ("a", {"b": frozenset({"c"})})
    assert found.initially == frozenset({"b", "c"})
    assert len(form.parts.constraints) == 2  # what comes afterwards is stated, too


def walk(problem, *, apart=True, forgotten=False):
    """Move to and fro between two places (m0, m1, m2), and work at the second one."""
    moves = [problem.add_activity(f"m{i}", 3, optional=True) for i in range(3)]
    work = problem.add_activity("work", 2, optional=True)
    out, back, again = moves
    helped(problem, out, [back], moves, True)
    helped(problem, back, [out, again], moves, False)
    helped(problem, again, [back], moves, True)
    helped(problem, work, [out, again], [out, again] if forgotten else moves, False)
    if apart:
        for a, b in itertools.combinations([*moves, work], 2):
            scope = [a.present, b.present]
            problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)), scope)
    problem.add_constraint(work.present)
    problem.add_quality_metric(MinimizeMakespan())


def histories(problem):
    return [s for k, s in built(problem).states.vars.items() if k[0] == "#history"]


def test_helpers_and_rivals_that_never_overlap_are_a_state_variable(problem):
    walk(problem)
    (state,) = histories(problem)
    assert state.values == [0, 1]
    assert state.initial == 0
    assert [w.value.const for w in state.writes] == [1, 0, 1]
    assert [r.allowed for r in state.reads] == [{0}, {1}, {0}, {1}]
    assert CpsatSession(problem).solve(Deadline.after(20)).schedule.makespan == 5


def test_helpers_and_rivals_that_may_overlap_are_not_a_state_variable(problem):
    walk(problem, apart=False)
    assert histories(problem) == []
    assert CpsatSession(problem).solve(Deadline.after(20)).schedule.makespan == 5


def test_a_rival_that_is_not_named_is_not_kept_away(problem):
    """Work then needs somebody to have come, not to be still there: not the state of moves."""
    walk(problem, forgotten=True)
    where, came = histories(problem)
    assert (len(where.reads), len(where.writes)) == (3, 3)
    assert (len(came.reads), len(came.writes)) == (1, 2)
    assert CpsatSession(problem).solve(Deadline.after(20)).schedule.makespan == 5


def test_rivals_that_cannot_come_next_need_not_be_named(problem):
    """Of who needs to be at a place, only those that leave it are named: a state all the same."""
    moves = [problem.add_activity(f"m{i}", 2, optional=True) for i in range(5)]
    work = problem.add_activity("work", 2, optional=True)
    out, on, back, other, direct = moves  # 0 to 1, 1 to 2, 2 to 0, 1 to 0, 0 to 2
    direct.set_fixed_duration(5)
    helped(problem, out, [back, other], [out, direct], True)
    helped(problem, direct, [back, other], [out, direct], True)
    helped(problem, on, [out], [on, other], False)
    helped(problem, other, [out], [on, other], False)
    helped(problem, back, [on, direct], [back], False)
    helped(problem, work, [on, direct], [back], False)
    for a, b in itertools.combinations([*moves, work], 2):
        scope = [a.present, b.present]
        problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)), scope)
    problem.add_constraint(work.present)
    problem.add_quality_metric(MinimizeMakespan())
    (state,) = histories(problem)
    assert len(state.values) == 3
    assert (len(state.writes), len(state.reads)) == (5, 6)
    assert CpsatSession(problem).solve(Deadline.after(20)).schedule.makespan == 6


def test_who_may_come_from_anywhere_has_to_be_named(problem):
    """Work needs the move out, and no move back after it; what a lift does is not told."""
    out, back, lift, work = (problem.add_activity(f"m{i}", 2, optional=True) for i in range(4))
    helped(problem, back, [out], [back, lift], False)
    helped(problem, work, [out], [back], False)
    for a, b in itertools.combinations([out, back, lift, work], 2):
        scope = [a.present, b.present]
        problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)), scope)
    assert [len(s.writes) for s in histories(problem)] == [2, 2]


def test_what_is_done_once_and_for_all_is_a_milestone(problem):
    """It is told of what moves something; the clauses themselves are stated, and nothing else."""
    a, b, c = three(problem)
    spot = UserType("spot")
    spots = [problem.add_object(f"spot{i}", spot) for i in range(3)]
    at = problem.add_fluent("at", spot, default_initial_value=spots[0])
    c.add_effect(c.end, at(), spots[1])
    helped(problem, c, [a, b], [], False)
    model = built(problem)
    (state,) = [s for k, s in model.states.vars.items() if k[0] == "#milestone"]
    assert [w.owner for w in state.writes] == [0, 1]
    assert [r.owner for r in model.implied[state.key]] == [2]
    assert state.reads == []


# -- unary resources -------------------------------------------------------------------------------
def unary(problem):
    found = find_unary(built(problem).states)
    return [(u.gap, u.members, u.whole) for u in found]


def test_half_of_a_resource_is_shared_and_more_is_not(problem):
    room = problem.add_fluent("room", IntType(0, 4), default_initial_value=4)
    for activity, amount in zip(three(problem), (3, 3, 2), strict=True):
        activity.uses(room(), amount)
    assert unary(problem) == [(0, (0, 1), False)]


def test_a_resource_for_one_says_all_unless_it_is_read(problem):
    free = problem.add_fluent("free", IntType(0, 1), default_initial_value=1)
    activities = three(problem)
    for activity in activities:
        activity.uses(free())
    assert unary(problem) == [(0, (0, 1, 2), True)]
    activities[0].add_condition(
        TimePointInterval(Timing(0, activities[0].start)), Equals(free(), 1)
    )
    assert unary(problem) == [(0, (0, 1, 2), False)]


def busy(problem, activities):
    flag = problem.add_fluent("busy", BoolType(), default_initial_value=False)
    for a in activities:
        a.add_condition(TimePointInterval(Timing(0, a.start)), Not(flag()))
        a.add_effect(a.start, flag(), True)
        a.add_effect(a.end, flag(), False)
    return flag


def test_a_busy_flag_keeps_a_unit_between(problem):
    busy(problem, three(problem))
    assert unary(problem) == [(1, (0, 1, 2), True)]


def test_a_busy_flag_that_somebody_clears_says_nothing(problem):
    activities = three(problem)
    flag = busy(problem, activities[:2])
    activities[2].add_effect(activities[2].start, flag(), False)
    assert unary(problem) == []


def test_a_flag_that_is_not_needed_free_says_nothing(problem):
    flag = problem.add_fluent("busy", BoolType(), default_initial_value=False)
    for a in three(problem):
        a.add_effect(a.start, flag(), True)
        a.add_effect(a.end, flag(), False)
    assert unary(problem) == []


def test_a_state_that_is_held_after_it_is_set_is_for_one(problem):
    holder = UserType("holder")
    names = [problem.add_object(n, holder) for n in "xyz"]
    held = problem.add_fluent("held", holder, default_initial_value=names[0])
    for a, name in zip(three(problem), names, strict=True):
        a.add_effect(a.start, held(), name)
        a.add_condition(
            LeftOpenTimeInterval(Timing(0, a.start), Timing(0, a.end)), Equals(held(), name)
        )
    assert unary(problem) == [(1, (0, 1, 2), False)]


def test_a_state_that_is_kept_until_it_changes_is_for_one(problem):
    state = problem.add_fluent("state", IntType(0, 3), default_initial_value=0)
    for i, a in enumerate(three(problem)):
        a.add_condition(
            ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end)), Equals(state(), i)
        )
        a.add_effect(a.end, state(), i + 1)
    assert unary(problem) == [(1, (0, 1, 2), False)]


def test_a_state_that_is_needed_at_the_start_alone_is_not_for_one(problem):
    state = problem.add_fluent("state", IntType(0, 3), default_initial_value=0)
    for i, a in enumerate(three(problem)):
        a.add_condition(TimePointInterval(Timing(0, a.start)), Equals(state(), i))
        a.add_effect(a.end, state(), i + 1)
    assert unary(problem) == []
