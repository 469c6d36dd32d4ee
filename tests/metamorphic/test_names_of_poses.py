"""A pose may have several names: by whichever of them motions say it, the answers agree."""

import itertools
import math
import random

import pytest
from unified_planning.model.motion import ActivityWaypoints, ConfigurationObject

from tests.fuzz.problems import SECONDS, build, random_case
from tests.metamorphic.answers import answer_to, in_one_meaning
from tests.metamorphic.motions import ALIKE, OTHERS, write
from tests.metamorphic.sites import FAMILIES
from tests.shuffled import shuffled
from tests.upio.hall import Hall
from tests.usual import usually
from up_samp.upio import read_problem
from up_samp.upio.read import _alike
from up_samp.validation import validate_plan


class OtherNames:
    """Says in a problem's motions each pose by its name, or by another one that it gets here.

    Where a motion ends its effect has to say by the same name; fluents go on telling the old ones.
    """

    def __init__(self, problem, rng):
        self.problem, self.rng = problem, rng
        self.others = {}
        manager = problem.environment.expression_manager
        initial = [(o, self.said(p, manager)) for o, p in problem.initial_configuration]
        problem._initial_configuration[:] = initial
        for activity in problem.motion_activities:
            ends = {}
            told = [self.constraint(c, manager, ends) for c in activity.motion_constraints]
            activity._motion_constraints = told
            activity._motion_constraints_set = set(told)
            effects = {
                o: ends.get(o) or self.said(p, manager) for o, p in activity.motion_effects.items()
            }
            activity._motion_effects.clear()
            activity._motion_effects.update(effects)

    def constraint(self, told, manager, ends):
        nodes = [self.said(p, manager) for p in (told.starting, *told.waypoints)]
        ends[told.movable] = nodes[-1]
        return ActivityWaypoints(
            told.movable,
            nodes[0],
            nodes[1:],
            static_obstacles=told.static_obstacles,
            dynamic_obstacles_at_start=told.dynamic_obstacles_at_start,
        )

    def said(self, node, manager):
        if not node.is_object_exp() or self.rng.random() < 0.5:
            return node
        place = node.object()
        if place.name not in self.others:
            env = self.problem.environment
            name = f"also_{place.name}"
            other = ConfigurationObject(name, place.type, place.configuration, env)
            self.problem.add_object(other)
            self.others[place.name] = other
        return manager.ObjectExp(self.others[place.name])


def wrong(made, seeds, timeout, **params):
    """What cannot be true of a problem that ``made()`` makes anew, said by some other names."""
    answers = []
    for seed in (None, *seeds):
        problem = made()
        if seed is not None:
            renamed = OtherNames(problem, random.Random(seed))
            assert renamed.others
            assert set(read_problem(problem).alike) >= set(renamed.others)
        unit = params.get("seconds_per_unit", 1.0)

        def judge(plan, problem=problem, unit=unit):
            return validate_plan(problem, plan, seconds_per_unit=unit)

        answers.append(answer_to(problem, f"names {seed}", judge, timeout=timeout, **params))
    return in_one_meaning(answers), answers


CASES = usually(104, of=(101, 104, *range(200, 240)))


@pytest.mark.parametrize("case", CASES)
def test_random_problems_say_the_same_by_other_names(case, tmp_path):
    found, answers = wrong(
        lambda: build(random_case(case), tmp_path), (1, 2), 10.0, seconds_per_unit=SECONDS
    )
    assert not found, found
    assert len(answers) == 3


STYLES = [*ALIKE, *OTHERS]
SITES = list(itertools.product(FAMILIES, range(len(STYLES))))


@pytest.mark.parametrize(("family", "number"), usually(("doors", 8), of=SITES))
def test_sites_say_the_same_by_other_names(family, number, tmp_path):
    """Also where parameters and fluents name poses."""
    found, _ = wrong(lambda: write(FAMILIES[family](1), STYLES[number], tmp_path), (3,), 20.0)
    assert not found, (STYLES[number], found)


def test_poses_are_one_whatever_whole_turns_and_signs_tell_them_apart():
    half = 0.5**0.5
    poses = {
        "a": (1.0, 2.0, math.pi),
        "b": (1.0, 2.0 + 1e-12, -math.pi),
        "c": (1.0, 2.0, 0.0),
        "d": (1.0, 2.0, 0.0, 0.0, 0.0, half, -half),
        "e": (1.0, 2.0, 0.0, 0.0, 0.0, -half, half),
        "f": (1.0, 2.0, 0.0, 0.0, 0.0, half, half),
        "g": (1.0, 2.0, 2 * math.pi),
    }
    flat = dict.fromkeys(poses, 0)
    alike = {frozenset(names) for names in _alike(poses, flat).values()}
    assert alike == {frozenset("ab"), frozenset("cg"), frozenset("de")}
    assert frozenset("cg") not in map(frozenset, _alike(poses, flat | {"g": 1}).values())


def test_poses_are_one_however_they_are_rounded():
    """Also beside the lines of whatever grid numbers are rounded to."""
    rng = random.Random(0)
    for _ in range(200):
        grid = 10.0 ** -rng.randint(3, 9)
        x, y = ((rng.randrange(10**5) + rng.choice((0.0, 0.5))) * grid for _ in range(2))
        turn = rng.choice((0.0, math.pi / 3, rng.uniform(-3.0, 3.0)))
        poses = [(x, y, turn), (5.0, 5.0, turn), (x, y + 1e-3, turn)]
        poses += [tuple(v + rng.choice((-1e-9, 1e-9)) for v in poses[0]) for _ in range(4)]
        rng.shuffle(poses)
        named = {str(k): pose for k, pose in enumerate(poses)}
        same = tuple(n for n, pose in named.items() if math.dist(pose, (x, y, turn)) < 1e-8)
        assert _alike(named, {}) == dict.fromkeys(same, same), named


@pytest.mark.parametrize("order", range(2))
def test_who_drives_on_from_where_it_is_may_say_so_with_an_error_of_rounding(order, tmp_path):
    hall = Hall(tmp_path, robots=1)
    hall.pose("here", 6.3456785, 3.0, 0.0)
    hall.pose("there", 6.3456785 + 1e-9, 3.0, 0.0)
    hall.move("come", 0, "left0", "here")
    hall.move("go", 0, "there", "right0")
    problem = shuffled(hall.problem, order, rename=False).problem
    found = answer_to(problem, "rounded", lambda plan: validate_plan(problem, plan), timeout=20.0)
    assert found.makespan is not None, found
