"""Effects: when they happen, conflicts, bounds, resources: rules 6 to 8 and 13."""

import pytest
from unified_planning.model import (
    GlobalEndTiming,
    Timing,
)
from unified_planning.model.motion import ActivityWaypoints
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.shortcuts import (
    GE,
    LE,
    And,
    BoolType,
    IntType,
    UserType,
    Variable,
)

from tests.upio.hall import Hall
from tests.validation.schedule_kit import judge, kinds
from up_samp.model import ProblemError, UnsupportedError


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


@pytest.mark.parametrize(("start", "kind"), [(3, "motion"), (2, "motion effect"), (4, None)])
def test_fluents_that_name_configurations_are_read_as_conditions_are(start, kind, tmp_path):
    """By a motion at its start, by a motion effect at its end: nobody changes them just then."""
    hall = Hall(tmp_path)
    pb, (robot,) = hall.problem, hall.robots
    here = pb.add_fluent("here", hall.place, default_initial_value=hall.poses["left0"])
    there = pb.add_fluent("there", hall.place, default_initial_value=hall.poses["left0"])
    tell = pb.add_activity("tell", duration=3)
    for fluent in (there, here):
        tell.add_effect(tell.end, fluent, hall.poses["left0"])
    stay = pb.add_motion_activity("stay", 1)
    stay.add_motion_constraint(ActivityWaypoints(robot, here, [hall.poses["left0"]]))
    stay.add_motion_effect(robot, there)
    verdict = judge(pb, {stay: (start, start + 1), tell: (0, 3)})
    assert [v.kind for v in verdict.violations] == ["interference"] * (kind is not None)
    assert kind is None or f"which the {kind} of stay" in verdict.violations[0].what


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
