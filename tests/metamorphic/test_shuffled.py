"""A shuffled problem lists everything otherwise and says the same."""

import dataclasses
import itertools

import pytest
from unified_planning.model import Fluent
from unified_planning.model.motion import ActivityWaypoints, MovableObject, SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.shortcuts import LE, Equals, IntType, OneshotPlanner, Or, Plus

from tests.fleet.witness import fleet_of
from tests.fuzz.problems import SECONDS, build
from tests.fuzz.wide import wide_case
from tests.metamorphic.motions import MotionStyle, write
from tests.metamorphic.sites import doors, haulage, store
from tests.oracles.brute_force_schedule import solve as brute_force
from tests.scheduling.cpsat.random_problems import HORIZON, random_problem
from tests.scheduling.cpsat.random_routes import random_routes
from tests.shuffled import COMMUTATIVE, SORTS, shuffled, shuffled_fleet
from up_samp.fleet.files import read_record
from up_samp.fleet.records import FleetRecords
from up_samp.validation import validate_plan


class Told:
    """Says a problem in words that hang on no order, under the names of the original."""

    def __init__(self, problem, names=None):
        self.problem, self.names = problem, names

    def name(self, sort, name):
        return name if self.names is None else self.names[sort, name]

    def node(self, node):
        kind, payload = node.node_type, node._content.payload
        args = [self.node(a) for a in node.args]
        if kind is Op.FLUENT_EXP:
            fluent = node.fluent()
            of = f"parameter of {fluent.name}"
            if self.names is None:
                own = [p.name for p in fluent.signature]
            else:
                own = [self.names[of, p.name] for p in fluent.signature]
            args = sorted(zip(own, args, strict=True))
            payload = self.name("fluent", fluent.name)
        elif kind in COMMUTATIVE:
            args.sort()
        if kind is Op.OBJECT_EXP:
            payload = self.name("object", payload.name)
        elif kind is Op.PARAM_EXP:
            payload = self.name("parameter", payload.name)
        elif kind is Op.TIMING_EXP:
            payload = self.timing(payload)
        elif kind is Op.PRESENT_EXP:
            payload = self.name("activity", payload.container)
        return f"{kind.name} {payload} {args}"

    def timing(self, timing):
        owner = timing.timepoint.container
        owner = owner and self.name("activity", owner)
        return f"{timing.timepoint.kind.name} {owner} {timing.delay}"

    def obstacles(self, some):
        if isinstance(some, dict):
            return sorted((self.name("object", o.name), self.whatever(v)) for o, v in some.items())
        return some and sorted(self.name("object", o.name) for o in some)

    def whatever(self, at):
        return self.name("fluent", at.name) if isinstance(at, Fluent) else self.node(at)

    def chronicle(self, one):
        constraints = [(self.node(c), sorted(map(self.node, s))) for c, s in one.scoped_constraints]
        conditions = [
            (self.timing(i.lower), self.timing(i.upper), i.is_left_open(), i.is_right_open(), text)
            for i, some in one.conditions.items()
            for text in map(self.node, some)
        ]
        effects = [
            (self.timing(t), e.kind.name, *map(self.node, (e.fluent, e.value, e.condition)))
            for t, some in one.effects.items()
            for e in some
        ]
        motions = [
            (
                self.node(c.movable),
                self.node(c.starting),
                [self.node(w) for w in c.waypoints],
                self.obstacles(c.static_obstacles),
                self.obstacles(c.dynamic_obstacles_at_start),
            )
            for c in getattr(one, "motion_constraints", ())
        ]
        moved = [
            (self.node(m), self.node(c)) for m, c in getattr(one, "motion_effects", {}).items()
        ]
        parameters = [self.name("parameter", p.name) for p in one.parameters]
        return [sorted(some, key=str) for some in (
            constraints, conditions, effects, motions, moved, parameters)]  # fmt: skip

    def all(self):
        p = self.problem
        return {
            "objects": sorted(
                (
                    self.name("object", o.name),
                    self.name("type", o.type.name),
                    str(getattr(o, "configuration", "")),
                    sorted(getattr(o, "footprint", None) or ()),
                )
                for o in p.all_objects
            ),
            "first": sorted((self.node(f), self.node(v)) for f, v in p.initial_values.items()),
            "base": self.chronicle(p._base),
            "activities": sorted(
                (
                    self.name("activity", a.name),
                    a.optional,
                    self.node(a.duration.lower),
                    self.node(a.duration.upper),
                    self.chronicle(a),
                )
                for a in p.activities
            ),
            "places": sorted(
                tuple(map(self.node, pair)) for pair in getattr(p, "initial_configuration", ())
            ),
        }


@pytest.fixture(scope="module")
def problems(tmp_path_factory):
    return list(some_problems(tmp_path_factory.mktemp("maps")))


def some_problems(folder):
    yield from (random_problem(seed) for seed in range(12))
    yield from (random_routes(seed) for seed in range(4))
    yield from (build(wide_case(seed), folder) for seed in range(8))
    yield write(store(0, 1, 1), MotionStyle(at="parameter", moves="go"), folder)
    yield write(haulage(0, items=1), MotionStyle(team="presences"), folder)
    yield in_formation(write(doors(1), MotionStyle(fluents="parameter"), folder))


def in_formation(problem):
    """Add an activity that moves two robots, and a fluent of two parameters."""
    bodies = [o for o in problem.all_objects if isinstance(o, MovableObject)]
    spots = [o for o in problem.all_objects if o.type.is_configuration_type()]
    both = problem.add_motion_activity("both", 20, optional=True)
    for body, (here, there) in zip(bodies, itertools.pairwise(spots), strict=False):
        both.add_motion_constraint(ActivityWaypoints(body, here, [there], [], []))
        both.add_motion_effect(body, there)
    far = Fluent("far", IntType(0, 9), a=spots[0].type, b=spots[0].type)
    problem.add_fluent(far, default_initial_value=1)
    for a, b in itertools.pairwise(spots):
        problem.set_initial_value(far(a, b), 2)
    both.add_constraint(Or(LE(far(*spots[:2]), 3), Equals(Plus(1, far(*spots[1:3])), 3)))
    return problem


def test_it_says_the_same(problems):
    for seed, problem in enumerate(problems):
        other = shuffled(problem, seed)
        assert Told(other.problem, other.names).all() == Told(problem).all(), problem.name
        same = shuffled(problem, seed, rename=False)
        assert Told(same.problem, same.names).all() == Told(problem).all(), problem.name


def lists_of(problem):
    """Yield (sort of list, a list of it) for all that a problem lists, as texts."""
    yield "objects", [o.name for o in problem.all_objects]
    yield "fluents", [f.name for f in problem.fluents]
    yield "activities", [a.name for a in problem.activities]
    yield "variables", [v.name for v in problem.base_variables]
    yield "values", [str(f) for f in problem.explicit_initial_values]
    yield "types", [t.name for t in problem.user_types]
    for f in problem.fluents:
        yield f"signature {f.name}", [p.name for p in f.signature]
    if isinstance(problem, SchedulingMotionProblem):
        yield "configurations", [str(o) for o, _ in problem.initial_configuration]
        for o in problem.all_objects:
            yield f"corners {o.name}", [str(c) for c in getattr(o, "footprint", None) or ()]
    for one in (problem._base, *problem.activities):
        yield f"parameters {one.name}", [p.name for p in one.parameters]
        yield f"constraints {one.name}", [str(c) for c, _ in one.scoped_constraints]
        for number, (_, scope) in enumerate(sorted(one.scoped_constraints, key=str)):
            yield f"scopes {one.name} {number}", [str(s) for s in scope]
        yield f"conditions {one.name}", [str(span) for span in one.conditions]
        for span, some in one.conditions.items():
            yield f"together {one.name} {span}", [str(c) for c in some]
        yield f"effects {one.name}", [str(t) for t in one.effects]
        for timing, some in one.effects.items():
            yield f"instants {one.name} {timing}", [str(e) for e in some]
        for k, c in enumerate(getattr(one, "motion_constraints", ())):
            yield f"motions {one.name}", [str(m.movable) for m in one.motion_constraints]
            for some in (c.static_obstacles, c.dynamic_obstacles_at_start):
                yield f"obstacles {one.name} {k}", [o.name for o in some or ()]
        yield f"moved {one.name}", [str(m) for m in getattr(one, "motion_effects", ())]


def operands(problem):
    """Yield (kind, operands) of what is commutative and not deep, in constraints."""
    stack = [c for one in (problem._base, *problem.activities) for c, _ in one.scoped_constraints]
    while stack:
        node = stack.pop()
        stack += node.args
        if node.node_type in COMMUTATIVE and not any(b.args for a in node.args for b in a.args):
            yield node.node_type, tuple(map(str, node.args))


def test_it_lists_everything_in_another_order(problems):
    changed, kinds = set(), set()
    for seed, problem in enumerate([*problems, *problems[-1:] * 4]):
        other = shuffled(problem, seed, rename=False).problem
        after = dict(lists_of(other))
        changed |= {s.split()[0] for s, some in lists_of(problem) if after.get(s, some) != some}
        known = set(operands(problem))
        kinds |= {kind for kind, args in operands(other) if (kind, args) not in known}
    assert changed == {
        "objects", "fluents", "activities", "variables", "values", "types", "signature",
        "configurations", "corners", "parameters", "constraints", "scopes", "conditions",
        "together", "effects", "instants", "motions", "obstacles", "moved",
    }  # fmt: skip
    assert kinds == COMMUTATIVE - {Op.TIMES}


def test_nothing_keeps_its_name(problems):
    for seed, problem in enumerate(problems):
        other = shuffled(problem, seed)
        assert all(new != old for (_, new), old in other.names.items())
        names = [new for sort, new in other.names if sort != "parameter"]
        assert len(set(names)) == len(names)
        again = shuffled(problem, seed)
        assert str(again.problem) == str(other.problem)


def test_it_has_the_same_optimum_by_brute_force():
    for seed in range(100, 106):
        problem = random_problem(seed)
        best, other = (brute_force(p, HORIZON) for p in (problem, shuffled(problem, seed).problem))
        assert (best and best.value) == (other and other.value), seed


@pytest.mark.parametrize("seed", [12])
def test_plans_come_back(tmp_path, seed):
    problem = build(wide_case(seed), tmp_path)
    other = shuffled(problem, seed)
    with OneshotPlanner(name="samp-refine[cpsat]", params={"seconds_per_unit": SECONDS}) as planner:
        result = planner.solve(other.problem, timeout=20.0)
    plan = other.back(result.plan)
    assert validate_plan(problem, plan, seconds_per_unit=SECONDS).violations == ()
    late = plan.activities[0]
    plan.set(late.end, int(plan.get(late.end).constant_value()) + 100)
    assert validate_plan(problem, plan, seconds_per_unit=SECONDS).violations


def fleet_names(data, sort, found):
    """Collect all texts in a fleet's plain data by where they are."""
    if isinstance(data, dict):
        for key, value in data.items():
            fleet_names(value, key, found)
    elif isinstance(data, list | tuple):
        for value in data:
            fleet_names(value, sort, found)
    elif isinstance(data, str):
        found.setdefault(data, set()).add(sort)


def test_fleets_say_the_same(tmp_path):
    changed, sorts = set(), set()
    for seed in (3, 4, 8, 22):
        spec = fleet_of(seed, tmp_path).spec
        records = read_record(FleetRecords, {k: v for k, v in spec.items() if k != "walls"})
        other = shuffled_fleet(records, seed)
        sorts |= {sort for sort, _ in other.names}
        # what is shuffled anew under the first names has everything that was there
        again = shuffled_fleet(records, seed, rename=False).records
        assert sorted_data(dataclasses.asdict(again)) == sorted_data(dataclasses.asdict(records))
        for kind in ("robots", "places", "orders"):
            if list(getattr(again, kind)) != list(getattr(records, kind)):
                changed.add(kind)
        found = {}
        fleet_names(dataclasses.asdict(other.records), "", found)
        assert not {old for _, old in other.names.items()} & found.keys() - {"map"}
    assert changed == {"robots", "places", "orders"}
    assert {"robots", "places", "jobs", "robot_types", "kinds", "doors"} <= sorts <= set(SORTS)


def sorted_data(data):
    if isinstance(data, dict):
        return sorted((k, sorted_data(v)) for k, v in data.items())
    if isinstance(data, list | tuple):
        return sorted(map(sorted_data, data), key=str)
    return data
