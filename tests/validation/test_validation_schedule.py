"""The rules of ``up_samp.validation.semantics``, one by one."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import brute_force_schedule
from unified_planning.model import (
    ClosedTimeInterval,
    GlobalEndTiming,
    GlobalStartTiming,
    LeftOpenTimeInterval,
    OpenTimeInterval,
    RightOpenTimeInterval,
    Timing,
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
    OneshotPlanner,
    Or,
    Plus,
    Times,
    UserType,
    Variable,
)
from unified_planning.test.examples.scheduling import get_example_problems

from up_samp.model import ProblemError, UnsupportedError
from up_samp.validation import validate_schedule

INTERVALS = {
    "[]": ClosedTimeInterval,
    "()": OpenTimeInterval,
    "(]": LeftOpenTimeInterval,
    "[)": RightOpenTimeInterval,
}


def plan(problem, times, values=None):
    """``times``: activity -> (start, end) of the present ones."""
    assignment = dict(values or {})
    for a, (start, end) in times.items():
        assignment[a.start], assignment[a.end] = start, end
    return Schedule(list(times), assignment)


def judge(problem, times, values=None):
    return validate_schedule(problem, plan(problem, times, values))


def kinds(verdict):
    return {v.kind for v in verdict.violations}


# ------------------------------------------------------------------ UP's own plans


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


# ------------------------------------------------------------------ presence, times, parameters


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


# ------------------------------------------------------------------ constraints


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


# ------------------------------------------------------------------ effects and conditions


def one_reads_one_writes(write, interval, wants, initial=False, sets=True):
    """r = [5, 10] wants f == ``wants`` over its interval; w sets f at ``write``."""
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=initial)
    w, r = pb.add_activity("w", duration=1), pb.add_activity("r", duration=5)
    w.add_effect(w.end, f, sets)
    r.add_condition(
        INTERVALS[interval](Timing(0, r.start), Timing(0, r.end)), f if wants else Not(f)
    )
    return judge(pb, {w: (write - 1, write), r: (5, 10)})


@pytest.mark.parametrize(
    ("interval", "write", "wants", "valid"),
    [
        # as aries 0.5.0 answers, each tried
        ("[]", 4, True, True),
        ("[]", 5, True, False),
        ("[]", 10, False, False),
        ("[]", 11, False, True),
        ("()", 5, True, True),
        ("()", 6, True, False),
        ("()", 9, False, False),
        ("()", 10, False, True),
        ("(]", 5, True, True),
        ("(]", 10, False, False),
        ("(]", 11, False, True),
        ("[)", 5, True, False),
        ("[)", 9, False, False),
        ("[)", 10, False, True),
    ],
)
def test_other_activities_effects(interval, write, wants, valid):
    assert one_reads_one_writes(write, interval, wants).valid == valid


@pytest.mark.parametrize(("interval", "apart"), [("[]", 4), ("()", 5), ("(]", 5), ("[)", 4)])
def test_kept_apart_whatever_the_value(interval, apart):
    allowed = {t for t in range(3, 13) if one_reads_one_writes(t, interval, True, True).valid}
    ends = {"[]": 11, "()": 10, "(]": 11, "[)": 10}[interval]
    assert allowed == {t for t in range(3, 13) if t <= apart or t >= ends}


@pytest.mark.parametrize(
    ("interval", "write", "wants", "valid"),
    [
        ("[]", 4, True, True),
        ("[]", 5, False, False),
        ("[]", 5, True, False),
        ("[]", 10, False, True),
        ("[]", 9, False, False),
        ("()", 9, False, False),
        ("()", 10, False, True),
        ("()", 5, True, True),
        ("[)", 9, False, False),
        ("[)", 10, False, True),
        ("(]", 10, False, True),
    ],
)
def test_own_effects_are_seen_one_later(interval, write, wants, valid):
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=False)
    a = pb.add_activity("a", duration=5)
    a.add_effect(Timing(write - 5, a.start), f, True)
    a.add_condition(
        INTERVALS[interval](Timing(0, a.start), Timing(0, a.end)), f if wants else Not(f)
    )
    assert judge(pb, {a: (5, 10)}).valid == valid


def test_problem_effects_and_conditions_are_not_kept_apart():
    for t, wants, valid in [(5, False, True), (5, True, False), (6, True, True), (6, False, False)]:
        pb = SchedulingProblem()
        f = pb.add_fluent("f", default_initial_value=False)
        a, b = pb.add_activity("a", duration=1), pb.add_activity("b", duration=5)
        pb.add_effect(5, f, True)
        a.add_condition(a.start, f if wants else Not(f))
        assert judge(pb, {a: (t, t + 1), b: (0, 5)}).valid == valid
        pb = SchedulingProblem()
        f = pb.add_fluent("f", default_initial_value=False)
        b = pb.add_activity("b", duration=5)
        b.add_effect(b.end, f, True)
        pb.add_condition(GlobalStartTiming(t), f if wants else Not(f))
        assert judge(pb, {b: (0, 5)}).valid == valid


def test_definition3_sees_effects_at_once():
    for write, wants, both in [(5, True, (False, True)), (5, False, (False, False))]:
        verdict = one_reads_one_writes(write, "[]", wants)
        assert (verdict.valid, verdict.definition3) == both
    # the activity's own effect at its end is seen at its end
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=False)
    a = pb.add_activity("a", duration=5)
    a.add_effect(a.end, f, True)
    a.add_condition(ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end)), Not(f))
    verdict = judge(pb, {a: (0, 5)})
    assert verdict.valid
    assert not verdict.definition3


def test_global_end():
    for sets, wants in ((True, True), (False, False), (True, False)):
        pb = SchedulingProblem()
        f = pb.add_fluent("f", default_initial_value=not sets)
        a = pb.add_activity("a", duration=5)
        a.add_effect(Timing(3, a.end), f, sets)
        pb.add_condition(GlobalEndTiming(), f if wants else Not(f))
        verdict = judge(pb, {a: (0, 5)})
        assert verdict.valid == verdict.definition3 == (sets == wants)
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=True)
    a = pb.add_activity("a", duration=5)
    a.add_effect(a.end, f, False)
    pb.add_condition(ClosedTimeInterval(GlobalStartTiming(), GlobalEndTiming()), f)
    assert kinds(judge(pb, {a: (0, 5)})) == {"condition"}
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=True)
    a = pb.add_activity("a", duration=5)
    pb.add_effect(GlobalEndTiming(), f, False)
    pb.add_condition(GlobalEndTiming(), Not(f))
    a.add_condition(a.end, f)
    assert judge(pb, {a: (0, 5)}).valid


def test_conflicting_effects():
    def verdict(first, second, at=(5, 5)):
        pb = SchedulingProblem()
        f = pb.add_fluent("f", IntType(0, 5), default_initial_value=2)
        a, b = pb.add_activity("a", duration=1), pb.add_activity("b", duration=1)
        for activity, (how, value) in ((a, first), (b, second)):
            getattr(activity, f"add_{how}effect")(activity.start, f, value)
        return judge(pb, {a: (at[0], at[0] + 1), b: (at[1], at[1] + 1)})

    assert kinds(verdict(("", 1), ("", 2))) == {"effect-conflict"}
    assert kinds(verdict(("", 1), ("", 1))) == {"effect-conflict"}
    assert kinds(verdict(("", 1), ("increase_", 1))) == {"effect-conflict"}
    assert verdict(("", 1), ("", 2), at=(5, 6)).valid
    assert verdict(("increase_", 1), ("increase_", 2)).valid
    assert verdict(("increase_", 4), ("decrease_", 3)).valid
    assert kinds(verdict(("increase_", 2), ("increase_", 2))) == {"bounds"}
    assert kinds(verdict(("increase_", 4), ("decrease_", 3), at=(5, 6))) == {"bounds"}
    assert not verdict(("", 1), ("", 1)).definition3


@pytest.mark.parametrize(
    ("start", "duration", "valid"), [(5, 5, True), (4, 5, False), (4, 0, True)]
)
def test_uses(start, duration, valid):
    pb = SchedulingProblem()
    r = pb.add_resource("r", 1)
    a, b = pb.add_activity("a", duration=5), pb.add_activity("b", duration=duration)
    a.uses(r)
    b.uses(r)
    verdict = judge(pb, {a: (0, 5), b: (start, start + duration)})
    assert verdict.valid == verdict.definition3 == valid
    assert kinds(verdict) <= {"bounds"}


def test_conditional_forall_and_reading_effects():
    pb = SchedulingProblem()
    site = UserType("site")
    sites = [pb.add_object(f"s{i}", site) for i in range(2)]
    lit = pb.add_fluent("lit", BoolType(), s=site, default_initial_value=False)
    power = pb.add_fluent("power", default_initial_value=False)
    a, b = pb.add_activity("a", duration=2), pb.add_activity("b", duration=2)
    p = a.add_parameter("p", BoolType())
    v = Variable("v", site)
    a._add_effect_instance(a.end, _effect(pb, lit(v), True, And(p, power), (v,)))
    b.add_effect(b.end, power, True)
    pb.add_condition(GlobalEndTiming(), And(lit(sites[0]), lit(sites[1])))
    assert judge(pb, {b: (0, 2), a: (1, 3)}, {p: True}).valid
    assert kinds(judge(pb, {b: (0, 2), a: (1, 3)}, {p: False})) == {"condition"}
    # the condition of the effect is read at 2, when b changes it
    assert "interference" in kinds(judge(pb, {b: (0, 2), a: (0, 2)}, {p: True}))


def _effect(pb, fluent, value, condition, forall):
    from unified_planning.model import Effect

    em = pb.environment.expression_manager
    return Effect(*em.auto_promote(fluent, value, condition), forall=forall)


def test_parametric_fluents_are_told_apart():
    for same, valid in ((True, False), (False, True)):
        pb = SchedulingProblem()
        site = UserType("site")
        s, t = pb.add_object("s", site), pb.add_object("t", site)
        f = pb.add_fluent("f", BoolType(), s=site, default_initial_value=True)
        a, b = pb.add_activity("a", duration=5), pb.add_activity("b", duration=5)
        p, q = a.add_parameter("p", site), b.add_parameter("q", site)
        a.add_effect(a.end, f(p), True)
        b.add_condition(b.start, f(q))
        verdict = judge(pb, {a: (0, 5), b: (5, 10)}, {p: s, q: s if same else t})
        assert verdict.valid == valid


def test_absent_activities_do_nothing():
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=False)
    a = pb.add_activity("a", duration=5)
    b = pb.add_activity("b", duration=5, optional=True)
    b.add_effect(b.start, f, True)
    b.add_condition(b.start, f)
    b.add_constraint(LE(100, b.start))
    a.add_condition(Timing(0, b.start), f)  # hangs on b: asks nothing
    assert judge(pb, {a: (0, 5)}, {b.start: 3, b.end: 8}).valid
    assert {"condition", "constraint"} <= kinds(judge(pb, {a: (0, 5), b: (3, 8)}))


def test_effect_before_the_start_and_missing_initial_value():
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=False)
    a = pb.add_activity("a", duration=5)
    a.add_effect(a.start - 3, f, True)
    assert kinds(judge(pb, {a: (2, 7)})) == {"effect-time"}
    assert judge(pb, {a: (3, 8)}).valid
    pb = SchedulingProblem()
    g = pb.add_fluent("g", IntType())
    a = pb.add_activity("a", duration=5)
    a.add_condition(a.start, GE(g, 1))
    with pytest.raises(ProblemError, match="g has no initial value"):
        judge(pb, {a: (2, 7)})


def test_unsupported_things_are_named():
    pb = SchedulingProblem()
    a = pb.add_activity("a", duration=5)
    f = pb.add_fluent("f", default_initial_value=False)
    from fractions import Fraction

    a.add_effect(Timing(Fraction(1, 2), a.start), f, True)
    with pytest.raises(UnsupportedError, match="1/2"):
        judge(pb, {a: (0, 5)})


# ------------------------------------------------------------------ against a naive oracle

small = st.integers(0, 6)


@st.composite
def puzzles(draw):
    """Three activities of 0..3 units that set and read a bool, and use a resource."""
    rows = []
    for _ in range(3):
        rows.append(
            {
                "start": draw(small),
                "length": draw(st.integers(0, 3)),
                "sets": draw(st.none() | st.tuples(st.integers(0, 3), st.booleans())),
                "wants": draw(
                    st.none() | st.tuples(st.sampled_from(list(INTERVALS)), st.booleans())
                ),
                "uses": draw(st.integers(0, 2)),
            }
        )
    return draw(st.booleans()), rows


def build(initial, rows):
    pb = SchedulingProblem()
    f = pb.add_fluent("f", default_initial_value=initial)
    r = pb.add_resource("r", 2)
    times = {}
    for i, row in enumerate(rows):
        a = pb.add_activity(f"a{i}", duration=row["length"])
        if row["sets"]:
            a.add_effect(a.start + row["sets"][0], f, row["sets"][1])
        if row["wants"]:
            span = INTERVALS[row["wants"][0]](Timing(0, a.start), Timing(0, a.end))
            a.add_condition(span, f if row["wants"][1] else Not(f))
        if row["uses"]:
            a.uses(r, row["uses"])
        times[a] = (row["start"], row["start"] + row["length"])
    return pb, times


def oracle(initial, rows, at_once):
    """Tick by tick, as plainly as can be."""
    value, ok = initial, True
    for t in range(15):
        sets = [
            (i, row["sets"][1])
            for i, row in enumerate(rows)
            if row["sets"] and row["start"] + row["sets"][0] == t
        ]
        ok &= len(sets) < 2
        load = sum(row["uses"] for row in rows if row["start"] <= t < row["start"] + row["length"])
        ok &= load <= 2
        if at_once and sets:
            value = sets[-1][1]
        for i, row in enumerate(rows):
            if not row["wants"]:
                continue
            span, wants = row["wants"]
            low = row["start"] + (span[0] == "(")
            high = row["start"] + row["length"] - (span[1] == ")")
            if low <= t <= high:
                ok &= value == wants
                ok &= at_once or all(j == i for j, _ in sets)
        if sets:
            value = sets[-1][1]
    return ok


@settings(max_examples=150, deadline=None, derandomize=True)
@given(puzzles())
def test_agrees_with_a_naive_oracle(puzzle):
    verdict = judge(*build(*puzzle))
    assert verdict.valid == oracle(*puzzle, at_once=False)
    assert verdict.definition3 == oracle(*puzzle, at_once=True)


@pytest.mark.parametrize("set_at", [2, 3, 4, 5])
@pytest.mark.parametrize("owner", ["problem", "own", "other"])
def test_half_open_intervals_are_dense_inside(owner, set_at):
    """A condition over [0, 5): an effect at 4 is seen in (4, 5), one at 5 is not."""
    problem = SchedulingProblem("dense")
    flag = problem.add_fluent("flag", BoolType(), default_initial_value=True)
    a = problem.add_activity("a", duration=5)
    a.add_condition(RightOpenTimeInterval(Timing(0, a.start), Timing(0, a.end)), flag)
    b = problem.add_activity("b", duration=set_at)
    if owner == "problem":
        problem.add_effect(set_at, flag, False)
    elif owner == "own":
        a.add_effect(Timing(set_at, a.start), flag, False)
    else:
        b.add_effect(b.end, flag, False)
    times = {"a": (0, 5), "b": (0, set_at)}
    assignment = {
        t: v for x in (a, b) for t, v in zip((x.start, x.end), times[x.name], strict=True)
    }
    valid = validate_schedule(problem, Schedule([a, b], assignment)).valid
    assert valid == (set_at == 5)
    problem.add_constraint(LE(a.start, 0))
    problem.add_constraint(LE(b.start, 0))
    with OneshotPlanner(name="cpsat") as planner:
        found = planner.solve(problem, timeout=20).plan is not None
    assert found == (set_at == 5)
    assert (brute_force_schedule.solve(problem, 6) is not None) == found
