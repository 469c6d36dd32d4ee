"""The compilers one by one, on plain problems."""

from __future__ import annotations

from dataclasses import replace

import pytest
from unified_planning.model import Fluent as UpFluent
from unified_planning.model import GlobalStartTiming, RightOpenTimeInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem as UpProblem
from unified_planning.shortcuts import (
    And,
    BoolType,
    GlobalEndTiming,
    IntType,
    MinimizeMakespan,
    Not,
    OneshotPlanner,
    Or,
    TimePointInterval,
)

from tests.scheduling import problems
from up_samp.model import CandidateSchedule, Deadline, UnsupportedError
from up_samp.scheduling.adapters import _engine_class
from up_samp.scheduling.compilers.constraints import compile_differences, compile_resources
from up_samp.scheduling.compilers.fluents import (
    compile_flat_types,
    compile_ground,
    compile_precedences,
)
from up_samp.scheduling.compilers.intervals import (
    compile_dense,
    compile_stillness,
    compile_support,
    refuse_numbers,
)
from up_samp.scheduling.compilers.optional import compile_optional
from up_samp.scheduling.compilers.plain import (
    TRUE,
    Activity,
    Condition,
    Effect,
    Fluent,
    PlainProblem,
    end,
    integer,
    show,
    start,
    subexpressions,
)
from up_samp.scheduling.compilers.translate import ProblemWriter, read_plain
from up_samp.scheduling.engine_scheduler import EngineScheduler, restored
from up_samp.validation import validate_schedule


def activity(name, low=2, high=None, optional=False):
    return Activity(name, optional, integer(low), integer(low if high is None else high))


def of(*activities, **parts):
    return PlainProblem(tuple(activities), **parts)


def texts(compiled):
    return [show(c) for c in compiled.problem.constraints]


@pytest.mark.parametrize(
    ("constraint", "expected"),
    [
        (("lt", end("a"), start("b")), ["le(a.end + 1, b.start)"]),
        (("not", ("le", end("a"), start("b"))), ["le(b.start + 1, a.end)"]),
        (("le", ("minus", end("b"), start("a")), integer(9)), ["le(b.end, a.start + 9)"]),
        (("eq", end("a"), start("b")), ["le(a.end, b.start)", "le(b.start, a.end)"]),
        (
            ("not", ("eq", end("a"), start("b"))),
            ["or(le(a.end + 1, b.start), le(b.start + 1, a.end))"],
        ),
        (("le", integer(3), ("plus", start("a"), integer(5))), []),
        (("le", ("time", "horizon", None, 0), integer(8)), ["le(a.end, 8)", "le(b.end, 8)"]),
    ],
)
def test_differences_without_negation_and_minus(constraint, expected):
    compiled = compile_differences(of(activity("a"), activity("b"), constraints=(constraint,)))
    assert texts(compiled) == expected


def test_comparisons_with_an_absent_activity_ask_nothing():
    problem = of(
        activity("a", optional=True), activity("b"), constraints=(("lt", end("a"), start("b")),)
    )
    assert texts(compile_differences(problem)) == ["or(not(present(a)), le(a.end + 1, b.start))"]


def test_static_fluents_become_their_values():
    door = Fluent(("bool",), (("d", ("user", "Door")),), ("bool", False))
    problem = of(
        activity("walk", optional=True),
        conditions=(Condition(start("walk"), end("walk"), ("flu", "open", ("obj", "d1")), "walk"),),
        fluents={"open": door},
        types={"Door": None},
        objects={"d1": "Door"},
    )
    compiled = compile_ground(problem)
    assert compiled.problem.fluents == {}
    assert texts(compiled) == ["not(present(walk))"]


def test_stillness_is_said_by_differences():
    problem = of(
        activity("drive"),
        activity("shut"),
        conditions=(
            Condition(start("drive"), end("drive"), ("eq", ("flu", "d"), ("flu", "d")), "drive"),
        ),
        effects=(Effect(end("shut"), "assign", ("flu", "d"), ("bool", False), owner="shut"),),
        fluents={"d": Fluent(("bool",), (), ("bool", True))},
    )
    compiled = compile_stillness(problem)
    assert compiled.problem.conditions == ()
    assert texts(compiled) == ["or(le(shut.end + 1, drive.start), le(drive.end + 1, shut.end))"]


@pytest.mark.parametrize(
    ("owner", "time", "value", "cut"),
    [
        ("a", start("a"), "x", True),  # the same value again, halfway
        ("a", end("a", -1), "x", True),
        ("a", start("a"), "y", False),  # would break the condition: never in a schedule
        ("a", end("a"), "x", False),  # seen after the condition
        ("a", start("a", -1), "x", False),
        ("b", start("b"), "x", False),  # others keep out
        (None, ("time", "zero", None, 3), "x", True),
    ],
)
def test_a_condition_that_is_renewed_halfway_is_asked_for_at_its_start(owner, time, value, cut):
    at = ("flu", "at")
    condition = Condition(start("a"), end("a"), ("eq", at, ("obj", "x")), "a")
    problem = of(
        activity("a"),
        activity("b"),
        types={"place": None},
        objects={"x": "place", "y": "place"},
        fluents={"at": Fluent(("user", "place"), (), ("obj", "x"))},
        conditions=(condition,),
        effects=(
            Effect(time, "assign", at, ("obj", value), owner=owner),
            Effect(end("b"), "assign", at, ("obj", "y"), owner="b"),
        ),
    )
    compiled = compile_support(problem)
    assert compiled.exact
    assert compiled.problem.conditions == (
        replace(condition, high=start("a")) if cut else condition,
    )
    apart = ["or(le(b.end + 1, a.start), le(a.end + 1, b.end))"]  # others keep out of all of it
    assert texts(compiled) == (apart if cut else [])


def test_resources_forbid_minimal_sets_only():
    effects = []
    for name, amount in (("a", 2), ("b", 1), ("c", 1), ("d", 1)):
        effects += [
            Effect(start(name), "decrease", ("flu", "r"), integer(amount), owner=name),
            Effect(end(name), "increase", ("flu", "r"), integer(amount), owner=name),
        ]
    problem = of(
        *(activity(n) for n in "abcd"),
        effects=tuple(effects),
        fluents={"r": Fluent(("int", 0, 2), (), integer(2))},
    )
    compiled = compile_resources(problem)
    assert compiled.problem.effects == ()
    mentioned = [
        {e[2] for e in subexpressions(c) if e[0] == "time"} for c in compiled.problem.constraints
    ]
    assert sorted(map(sorted, mentioned)) == [["a", "b"], ["a", "c"], ["a", "d"], ["b", "c", "d"]]


def test_a_resource_with_too_many_sets_stays_only_where_durations_are_certain():
    def crowd(high):
        names = [f"a{i}" for i in range(36)]
        level = ("flu", "level")
        effects = []
        for n in names:
            effects.append(Effect(start(n), "decrease", level, integer(1), owner=n))
            effects.append(Effect(end(n), "increase", level, integer(1), owner=n))
        return of(
            *(activity(n, 2, high) for n in names),
            fluents={"level": Fluent(("int", 0, 3), (), integer(3))},
            effects=tuple(effects),
        )

    assert compile_resources(crowd(2)).problem == crowd(2)
    with pytest.raises(UnsupportedError, match="level: too many sets"):
        compile_resources(crowd(4))


def test_optional_activities_go_and_come_back():
    plain = read_plain(problems.fetch_and_return())
    compiled = compile_optional(compile_differences(plain).problem)
    assert not compiled.problem.optional_names
    assert ProblemWriter(compiled.problem).up.kind.has_optional_activities() is False
    parameters = {n: False for n, t in compiled.problem.parameter_types.items()}
    parameters["pick.present"] = True
    times = {a.name: (0, 2) for a in compiled.problem.activities}
    back = restored(plain, compiled, CandidateSchedule(times, parameters))
    assert back == CandidateSchedule({"pick": (0, 2)}, {})


def test_precedences_leave_no_fluent():
    plain = read_plain(problems.fetch_and_return())
    compiled = compile_precedences(compile_ground(plain).problem).problem
    assert (dict(compiled.fluents), compiled.conditions, compiled.effects) == ({}, (), ())
    assert not any(e[0] == "flu" for c in compiled.constraints for e in subexpressions(c))


def test_precedences_relate_fluents_and_refuse_what_is_assigned_and_counted():
    two = {n: Fluent(("bool",), (), ("bool", False)) for n in ("f", "g")}
    either = ("or", ("flu", "f"), ("flu", "g"))
    problem = of(
        activity("a"),
        activity("b"),
        conditions=(Condition(start("a"), end("a"), either, "a"),),
        effects=tuple(
            Effect(end("b"), "assign", ("flu", n), ("bool", True), owner="b") for n in two
        ),
        fluents=two,
    )
    compiled = compile_precedences(problem).problem
    assert (dict(compiled.fluents), compiled.conditions, compiled.effects) == ({}, (), ())
    number = {"n": Fluent(("int", 0, 3), (), integer(0))}
    both = tuple(Effect(end("b"), k, ("flu", "n"), integer(1)) for k in ("assign", "increase"))
    counted = of(activity("b"), effects=both, fluents=number)
    with pytest.raises(UnsupportedError, match="fluent n, both assigned and counted"):
        compile_precedences(counted)


def test_types_below_types_become_constraints():
    compiled = compile_flat_types(read_plain(problems.garages()))
    assert set(compiled.problem.types) == {"Place"}
    assert texts(compiled) == ["eq(park.where, box)"]


def test_names_travel_back():
    written = ProblemWriter(read_plain(problems.garages()))
    ((short, parameter),) = ((a.name, a.parameters[0].name) for a in written.up.activities)
    box = next(o.name for o in written.up.all_objects if o.type.name != "T0")
    assert max(map(len, (short, parameter, box))) < len("park.where")
    back = written.read_back(CandidateSchedule({short: (1, 3)}, {parameter: box}))
    assert back == CandidateSchedule({"park": (1, 3)}, {"park.where": "box"})


def test_a_duration_that_effects_change_is_refused_by_name():
    effect = Effect(start("b"), "assign", ("flu", "level"), integer(3), owner="b")
    lasting = Activity("a", False, ("flu", "level"), ("flu", "level"))
    problem = of(
        lasting,
        activity("b"),
        effects=(effect,),
        fluents={"level": Fluent(("int", 0, 3), (), integer(1))},
    )
    with pytest.raises(UnsupportedError, match="duration of a reads the fluent level"):
        compile_ground(problem)


@pytest.mark.parametrize(
    ("owner", "time", "value", "said"),
    [
        ("a", end("a", -1), False, ["not(present(a))"]),  # seen right after it, inside
        ("a", end("a", -1), True, []),
        ("a", end("a"), False, []),  # seen after the condition
        ("b", end("b"), False, []),  # others keep out
        (
            None,
            ("time", "zero", None, 3),
            False,
            ["or(le(zero + 4, a.end - 1), le(a.end, zero + 3))"],
        ),
    ],
)
def test_what_is_set_in_the_last_unit_of_a_half_open_condition_is_seen(owner, time, value, said):
    ready = ("flu", "ready")
    problem = of(
        activity("a", optional=owner == "a"),
        activity("b"),
        fluents={"ready": Fluent(("bool",), (), TRUE)},
        conditions=(Condition(start("a"), end("a", -1), ready, "a", dense=True),),
        effects=(Effect(time, "assign", ready, ("bool", value), owner=owner),),
    )
    compiled = compile_dense(problem)
    assert texts(compiled) == said
    assert compiled.exact
    closed = replace(problem, conditions=(replace(problem.conditions[0], dense=False),))
    assert compiled.problem.conditions == closed.conditions
    assert texts(compile_dense(closed)) == []


@pytest.mark.parametrize("engine", ["aries", "aries-opt"])
def test_a_half_open_condition_is_waited_for(engine):
    """The problem clears a flag at 4 and sets it again at 6: five units fit after that only."""
    problem = UpProblem("flag")
    ready = problem.add_fluent("ready", BoolType(), default_initial_value=True)
    a = problem.add_activity("a", 5)
    span = RightOpenTimeInterval(Timing(0, a.start), Timing(0, a.end))
    a.add_condition(span, ready())
    problem.add_effect(GlobalStartTiming(4), ready(), False)
    problem.add_effect(GlobalStartTiming(6), ready(), True)
    problem.add_quality_metric(MinimizeMakespan())

    def check(problem, schedule):
        return [str(v) for v in validate_schedule(problem, schedule).violations]

    which = _engine_class(engine, problem.environment)
    with EngineScheduler(which, problem, {}, check) as scheduler:
        report = scheduler.solve(Deadline.after(30))
    assert report.schedule.times == {"a": (7, 12)}


@pytest.mark.parametrize("where", ["of an activity", "at the end", "at a time"])
def test_negated_conjunctions_are_told_to_engines_that_do_not_know_them(where):
    """aries binds no ``not (a and b)`` in conditions: its server ended with an error."""
    problem = UpProblem("p")
    lit, shut = UpFluent("lit"), UpFluent("shut")
    for fluent in (lit, shut):
        problem.add_fluent(fluent, default_initial_value=False)
    light = problem.add_activity("light", 2)
    light.add_effect(light.end, lit, True)
    look = problem.add_activity("look", 1)
    look.add_effect(look.end, shut, True)
    either = Not(And(Or(lit, shut), Not(And(lit, shut))))
    if where == "of an activity":
        look.add_condition(look.start, either)
    else:
        time = GlobalEndTiming() if where == "at the end" else GlobalStartTiming(3)
        problem.add_condition(TimePointInterval(time), either)
    problem.add_quality_metric(MinimizeMakespan())
    with OneshotPlanner(name="samp-refine[aries]") as planner:
        result = planner.solve(problem, timeout=30)
    assert result.plan is not None, result.log_messages
    assert validate_schedule(problem, result.plan).valid


@pytest.mark.parametrize(
    ("low", "high", "kind", "why"),
    [
        (start("a"), end("a"), "assign", "over an interval on the number n"),
        (start("a"), start("a"), "assign", None),
        (start("a"), start("a"), "increase", "both assigned and counted"),
    ],
)
def test_what_breaks_an_engine_on_numbers_is_refused_by_name(low, high, kind, why):
    number = ("flu", "n")
    effects = (
        Effect(end("b"), "assign", number, integer(1), owner="b"),
        Effect(end("b"), kind, number, integer(2), owner="b"),
    )
    problem = of(
        activity("a"),
        activity("b"),
        conditions=(Condition(low, high, ("le", integer(1), number), "a"),),
        effects=effects,
        fluents={"n": Fluent(("int", 0, 3), (), integer(0))},
    )
    if why is None:
        assert refuse_numbers(problem).problem is problem
        return
    with pytest.raises(UnsupportedError, match=why):
        refuse_numbers(problem)


@pytest.mark.parametrize(
    ("low", "high", "amount", "exact", "first"),
    [
        (1, 2, 1, True, 2),
        (1, 2, 2, False, 2),  # whoever takes that could not be absent
        (-1, 2, -1, True, -1),
        (0, None, 3, True, 3),
        (None, 0, -3, True, -3),
        (0, 9, None, True, 9),
        (0, 4, None, False, 4),
        (0, 9, "far", False, 9),
    ],
)
def test_who_is_absent_takes_and_gives_where_there_is_room(low, high, amount, exact, first):
    problem = UpProblem("p")
    begin = high if low is None else low
    level = problem.add_fluent("level", IntType(low, high), default_initial_value=begin)
    far = problem.add_fluent("far", IntType(0, 5), default_initial_value=2)
    a = problem.add_activity("a", 0, optional=True)
    taken = {None: a.add_parameter("n", IntType(0, 5)), "far": far()}.get(amount, amount)
    a.add_decrease_effect(a.start, level(), taken)
    compiled = compile_optional(read_plain(problem))
    assert compiled.exact == exact
    (copy,) = (e for e in compiled.problem.initial if "off_level" in str(e))
    assert compiled.problem.initial[copy] == integer(first)
