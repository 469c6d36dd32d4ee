"""Presence, times, parameters and constraints: rules 1 to 5; and UP's own plans."""

import pytest
from unified_planning.model import (
    GlobalEndTiming,
)
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.plans import Schedule
from unified_planning.shortcuts import (
    GE,
    LE,
    LT,
    And,
    BoolType,
    Equals,
    Exists,
    Forall,
    Iff,
    Implies,
    IntType,
    Minus,
    Not,
    Or,
    Plus,
    Times,
    UserType,
    Variable,
)
from unified_planning.test.examples.scheduling import get_example_problems

from tests.validation.schedule_kit import judge, kinds
from up_samp.model import UnsupportedError
from up_samp.validation import validate_schedule


@pytest.mark.parametrize("name", get_example_problems())
def test_up_examples(name):
    case = get_example_problems()[name]
    for p in case.valid_plans:
        verdict = validate_schedule(case.problem, p)
        assert verdict.definition3
        # these two hold only when an effect is seen at once
        assert verdict.valid == (name not in ("sched:symbolic", "sched:optional"))
    for p in case.invalid_plans:
        verdict = validate_schedule(case.problem, p)
        assert not verdict.valid
        assert not verdict.definition3


def test_presence_and_times():
    pb = SchedulingProblem()
    a = pb.add_activity("a", duration=3)
    b = pb.add_activity("b", duration=2, optional=True)
    stranger = SchedulingProblem().add_activity("c", duration=2)
    assert judge(pb, {a: (0, 3)}).valid
    assert judge(pb, {a: (0, 3), b: (9, 11)}).valid
    assert kinds(judge(pb, {b: (0, 2)})) == {"presence"}
    assert kinds(judge(pb, {a: (0, 3), stranger: (0, 2)})) == {"presence"}
    assert kinds(judge(pb, {a: (0, 4)})) == {"duration"}
    assert kinds(judge(pb, {a: (-1, 2)})) == {"time"}
    assert "time" in kinds(judge(pb, {a: (3, 0)}))
    twice = Schedule([a, a], {a.start: 0, a.end: 3})
    assert kinds(validate_schedule(pb, twice)) == {"presence"}
    assert kinds(validate_schedule(pb, Schedule([a], {a.start: 0}))) == {"unassigned"}
    half = Schedule([a], {a.start: 0.5, a.end: 3.5})
    assert kinds(validate_schedule(pb, half)) == {"time"}
    verdict = judge(pb, {a: (0, 4)})
    assert "a lasts 4" in verdict.violations[0].what
    assert not verdict.definition3


def test_parameters_and_hierarchical_types():
    pb = SchedulingProblem()
    vehicle = UserType("vehicle")
    truck = UserType("truck", father=vehicle)
    t, v = pb.add_object("t", truck), pb.add_object("v", vehicle)
    a = pb.add_activity("a", duration=1)
    p, q = a.add_parameter("p", vehicle), a.add_parameter("q", truck)
    n, x = a.add_parameter("n", IntType(1, 3)), pb.add_variable("x", BoolType())
    good = {p: t, q: t, n: 2, x: True}
    assert judge(pb, {a: (0, 1)}, good).valid
    assert judge(pb, {a: (0, 1)}, {**good, p: v}).valid
    for wrong in ({q: v}, {n: 4}, {n: True}, {x: 1}, {p: 3}):
        assert kinds(judge(pb, {a: (0, 1)}, {**good, **wrong})) == {"parameter"}
    missing = {k: value for k, value in good.items() if k is not n}
    assert kinds(judge(pb, {a: (0, 1)}, missing)) == {"unassigned"}


def test_durations_with_parameters_fluents_and_open_ends():
    pb = SchedulingProblem()
    f = pb.add_fluent("f", IntType(0, 9), default_initial_value=4)
    a, b = pb.add_activity("a"), pb.add_activity("b", duration=1)
    n = a.add_parameter("n", IntType(0, 9))
    a.set_duration_bounds(n, f)
    assert judge(pb, {a: (0, 3), b: (0, 1)}, {n: 3}).valid
    assert kinds(judge(pb, {a: (0, 2), b: (0, 1)}, {n: 3})) == {"duration"}
    assert kinds(judge(pb, {a: (0, 5), b: (0, 1)}, {n: 3})) == {"duration"}
    b.add_effect(b.end, f, 6)
    assert judge(pb, {a: (2, 8), b: (0, 1)}, {n: 3}).valid
    assert kinds(judge(pb, {a: (1, 4), b: (0, 1)}, {n: 3})) == {"interference"}
    from unified_planning.model import timing

    em = pb.environment.expression_manager
    a._set_duration_constraint(timing.OpenDurationInterval(em.Int(2), em.Int(4)))
    assert judge(pb, {a: (2, 5), b: (0, 1)}, {n: 3}).valid
    for end in (4, 6):
        assert kinds(judge(pb, {a: (2, end), b: (0, 1)}, {n: 3})) == {"duration"}


def test_constraints_and_absence():
    def verdict(constraint, scope=(), b_present=True, c=(4, 6)):
        pb = SchedulingProblem()
        a = pb.add_activity("a", duration=2)
        b = pb.add_activity("b", duration=2, optional=True)
        pb.add_constraint(constraint(a, b), [s(a, b) for s in scope])
        return judge(pb, {a: (0, 2), b: c} if b_present else {a: (0, 2)})

    later = lambda a, b: LE(a.end, b.start)  # noqa: E731
    assert verdict(later).valid
    assert kinds(verdict(later, c=(1, 3))) == {"constraint"}
    # about an absent activity a relation says nothing, also negated
    assert verdict(later, b_present=False).valid
    assert verdict(lambda a, b: Not(later(a, b)), b_present=False).valid
    # Kleene's logic
    false, true = lambda a: LT(a.end, a.start), lambda a: LE(a.start, a.end)
    assert verdict(lambda a, b: Or(later(a, b), false(a)), b_present=False).valid
    assert not verdict(lambda a, b: And(later(a, b), false(a)), b_present=False).valid
    assert verdict(lambda a, b: Implies(later(a, b), false(a)), b_present=False).valid
    assert not verdict(lambda a, b: Iff(b.present, true(a)), b_present=False).valid
    assert not verdict(lambda a, b: b.present, b_present=False).valid
    # scopes
    assert verdict(lambda a, b: false(a), [lambda a, b: b.present], b_present=False).valid
    assert not verdict(lambda a, b: false(a), [lambda a, b: b.present]).valid
    assert not verdict(lambda a, b: false(a), [lambda a, b: Not(b.present)], b_present=False).valid
    assert verdict(lambda a, b: false(a), [later], b_present=False).valid


def test_arithmetic_constraints():
    pb = SchedulingProblem()
    a, b = pb.add_activity("a", duration=2), pb.add_activity("b", duration=3)
    n = pb.add_variable("n", IntType(0, 9))
    pb.add_constraint(LE(Plus(a.end, Times(n, 2)), Minus(b.end, 1)))
    pb.add_constraint(Not(Equals(a.start, b.start)))
    pb.add_constraint(LE(GlobalEndTiming(), 10))
    assert judge(pb, {a: (0, 2), b: (4, 7)}, {n: 2}).valid
    assert kinds(judge(pb, {a: (0, 2), b: (4, 7)}, {n: 3})) == {"constraint"}
    assert kinds(judge(pb, {a: (4, 6), b: (4, 7)}, {n: 0})) == {"constraint"}
    assert kinds(judge(pb, {a: (0, 2), b: (8, 11)}, {n: 0})) == {"constraint"}


def test_quantifiers_and_static_fluents_in_constraints():
    pb = SchedulingProblem()
    site = UserType("site")
    sites = [pb.add_object(f"s{i}", site) for i in range(3)]
    cost = pb.add_fluent("cost", IntType(0, 9), s=site, default_initial_value=2)
    pb.set_initial_value(cost(sites[2]), 7)
    a = pb.add_activity("a", duration=1)
    p = a.add_parameter("p", site)
    v = Variable("v", site)
    pb.add_constraint(Exists(GE(cost(v), 7), v))
    pb.add_constraint(Not(Forall(GE(cost(v), 7), v)))
    a.add_constraint(LE(cost(p), a.start))
    assert judge(pb, {a: (2, 3)}, {p: sites[0]}).valid
    assert kinds(judge(pb, {a: (2, 3)}, {p: sites[2]})) == {"constraint"}
    a.add_effect(a.end, cost(p), 3)
    with pytest.raises(UnsupportedError, match="cost"):
        judge(pb, {a: (2, 3)}, {p: sites[0]})
