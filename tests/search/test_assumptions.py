"""What the recognisers of a search assume, broken: each bound holds against the plain schedule.

Every docstring in ``up_samp/search`` that says what is assumed has a row here. With a problem that
breaks the assumption goes its twin that keeps it: what is recognised in the twin would be wrong.
"""

import itertools
from functools import partial

import pytest
from unified_planning.model import (
    ClosedTimeInterval,
    GlobalStartTiming,
    OpenDurationInterval,
    TimePointInterval,
    Timing,
)
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import (
    LE,
    LT,
    And,
    BoolType,
    ConfigurationType,
    Equals,
    Fluent,
    Implies,
    Int,
    MinimizeMakespan,
    MovableType,
    Not,
    Or,
)

import up_samp.search as package
from tests.oracles.assuming import assuming
from tests.shuffled import shuffled
from tests.soundness.worlds import Change, Drive, World, build, write_rooms
from up_samp.benchmarks.places import drawn_map, outer_wall
from up_samp.geometry import lay_out
from up_samp.model import Deadline, ScheduleStatus
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.budget import Budget
from up_samp.search.facts import Facts
from up_samp.search.fleet.jobs import find_jobs
from up_samp.search.fleet_bound.bound import JobsBound
from up_samp.search.knowledge import History, Knowledge
from up_samp.search.params import Parameters
from up_samp.search.proof import demands
from up_samp.search.session import open_service
from up_samp.search.statements import lower_bounds
from up_samp.search.world import Motions, surely_there
from up_samp.upio import read_problem, write_refinement
from up_samp.upio.write_relaxation import relax

SIZE = (60.0, 14.0)
BOX = [(-0.5, -0.4), (0.5, -0.4), (0.5, 0.4), (-0.5, 0.4)]
PLACES = {
    "home0": (2.0, 3.0, 0.0), "home1": (2.0, 11.0, 0.0),
    "B": (12.0, 7.0, 0.0), "C": (22.0, 7.0, 0.0), "D": (32.0, 7.0, 0.0),
}  # fmt: skip


class Site:
    """A hall without walls, and robots in it that hold their one hand while they do anything."""

    def __init__(self, robots=2, *, hands=1):
        self.problem = SchedulingMotionProblem("site")
        file = drawn_map("assumptions", SIZE, outer_wall(*SIZE))
        spot = ConfigurationType(
            "spot", OccupancyMap(str(file), SE2(0.0, 0.0, 0.0)), ConfigurationKind.SE2
        )
        self.place = {
            name: ConfigurationObject(name, spot, SE2(*at)) for name, at in PLACES.items()
        }
        self.problem.add_objects(self.place.values())
        kind = MovableType("robot")
        self.robot = [
            MovableObject(
                f"r{r}",
                kind,
                footprint=BOX,
                motion_model=MotionModels.SE2,
                motion_parameters={"v_max": 1.0, "a_max": 1.0, "omega_max": 1.0},
            )
            for r in range(robots)
        ]
        at = Fluent("at", spot, robot=kind)
        self.problem.add_fluent(at)
        self.hand, self.at = [], []
        for r, robot in enumerate(self.robot):
            self.problem.add_object(robot)
            self.problem.set_initial_configuration(robot, self.place[f"home{r}"])
            self.problem.set_initial_value(at(robot), self.place[f"home{r}"])
            self.hand.append(self.problem.add_resource(f"hand{r}", hands))
            self.at.append(at(robot))
        self.problem.add_quality_metric(MinimizeMakespan())

    def drive(self, name, r, to, origin=None, *, tells=True, hand=True, **waypoints):
        """Add a drive from where the robot is, or from an ``origin``."""
        a = self.problem.add_motion_activity(name, optional=True)
        a.set_duration_bounds(1, 10_000)
        start = self.at[r] if origin is None else self.place[origin]
        a.add_motion_constraint(
            ActivityWaypoints(self.robot[r], start, [self.place[to]], **waypoints)
        )
        if origin is not None:
            a.add_condition(TimePointInterval(a.start), Equals(self.at[r], self.place[origin]))
        if tells:
            a.add_effect(a.end, self.at[r], self.place[to])
        if hand:
            a.uses(self.hand[r])
        return a

    def work(self, name, r, units, at=None, *, hand=True):
        """Add something that a robot does at a place."""
        a = self.problem.add_activity(name, units, optional=True)
        if at is not None:
            a.add_condition(TimePointInterval(a.start), Equals(self.at[r], self.place[at]))
        if hand:
            a.uses(self.hand[r])
        return a

    def state(self, constraint, *scope):
        self.problem.add_constraint(constraint, [x.present for x in scope])

    def draw(self, first, then, gap=0):
        """State that both are there if one is, the second after the first."""
        self.state(first.present, then)
        self.state(then.present, first)
        self.state(LT(first.end + gap, then.start), first, then)

    def one_of(self, *some):
        self.problem.add_constraint(Or([a.present for a in some]))

    def flag(self, name="flag"):
        return self.problem.add_variable(name, BoolType())


def errand(site, at="B", units=5, name="", gap=0, **more):
    """Add a job that any robot may do: to drive there, and to work."""
    made = []
    for r in range(len(site.robot)):
        go = site.drive(f"go{name}{r}", r, at, **more)
        do = site.work(f"do{name}{r}", r, units, at)
        site.draw(go, do, gap)
        made.append((go, do))
    site.one_of(*(do for _, do in made))
    return made


def known(problem):
    """Return what of a problem recognisers are told."""
    snapshot, grid = lay_out(read_problem(problem))
    relaxation = relax(problem, snapshot)
    service = open_service(snapshot, grid, Parameters())
    return relaxation, Facts(relaxation.snapshot, relaxation.choices), service


def bound(problem):
    """Return the absolute bound from the jobs of a problem, 0 where there are none."""
    _, facts, service = known(problem)
    jobs = find_jobs(problem, facts.snapshot)
    return (
        0 if jobs is None else JobsBound(problem, facts, service, jobs).absolute(Deadline.after(60))
    )


def soonest(problem):
    """Return the least makespan of all schedules whose drives last as long as their bounds say."""
    relaxation, facts, service = known(problem)
    deadline = Deadline.after(60.0)
    motions = Motions(facts, service, Budget(deadline, 10.0))
    for refinement in lower_bounds(motions, Knowledge(relaxation, History())):
        write_refinement(relaxation, refinement)
    report = CpsatSession(relaxation.problem, workers=1, plain=True).solve(deadline)
    assert report.status is ScheduleStatus.OPTIMAL
    return report.schedule.makespan


# -- gaps and what is held -------------------------------------------------------------------------
def a_pause(*scope_more, place="base"):
    """One errand, with 20 units between the drive and the work, under some scope."""
    site = Site()
    more = [site.flag(x) for x in scope_more]
    for go, do in errand(site):
        said = LE(go.end + 20, do.start)
        if place == "base":
            site.problem.add_constraint(said, [go.present, do.present, *more])
        else:
            site.problem.add_constraint(Implies(And(more), said), [go.present, do.present])
    return site.problem


def a_pause_from_start():
    """Units between the start of one and the start of the other are no gap."""
    site = Site()
    for go, do in errand(site):
        site.state(LE(go.start + 20, do.start), go, do)
    return site.problem


def checked(change=lambda site, made: None, *, hands=1, check=20, uses=True):
    """One errand, with a check beside that holds the hand, too."""
    site = Site(hands=hands)
    made = []
    for r, (go, do) in enumerate(errand(site, units=30)):
        look = site.work(f"check{r}", r, check, "B", hand=uses)
        site.state(look.present, do)
        site.state(do.present, look)
        made.append((go, do, look))
    change(site, made)
    return site.problem


def lent(site, made):
    """Who works lends the hand meanwhile."""
    for r in range(len(made)):
        loan = site.problem.add_activity(f"loan{r}", 24, optional=True)
        loan.add_increase_effect(loan.start, site.hand[r], 1)
        loan.add_decrease_effect(loan.end, site.hand[r], 1)


def given_by_the_clock(site, made):
    for hand in site.hand:
        site.problem.add_increase_effect(GlobalStartTiming(18), hand, 1)
        site.problem.add_decrease_effect(GlobalStartTiming(42), hand, 1)


def held_for_a_moment(site, made):
    """The hand is given back before the work is over."""
    for r, (_, do, _) in enumerate(made):
        do._effects.clear()
        do.add_decrease_effect(do.start, site.hand[r], 1)
        do.add_increase_effect(Timing(2, do.start), site.hand[r], 1)


def held_on_a_condition(site, made):
    for r, (_, do, _) in enumerate(made):
        flag = site.problem.add_fluent(f"two{r}", BoolType(), default_initial_value=False)
        do._effects.clear()
        do.add_decrease_effect(do.start, site.hand[r], 1, flag())
        do.add_increase_effect(do.end, site.hand[r], 1, flag())


def held_while_another_lasts(site, made):
    """What takes and gives is told of the ends of a short activity."""
    for r, (_, do, _) in enumerate(made):
        short = site.work(f"short{r}", r, 1, hand=False)
        site.state(short.present, do)
        do._effects.clear()
        do.add_decrease_effect(Timing(0, short.start), site.hand[r], 1)
        do.add_increase_effect(Timing(0, short.end), site.hand[r], 1)


def momentary(units=0):
    """Two looks at home that take a moment, a while apart: the robot may have driven off."""
    site = Site()
    looks = []
    for r, (go, do) in enumerate(errand(site)):
        one, two = (site.work(f"{name}{r}", r, units, f"home{r}") for name in ("one", "two"))
        site.draw(one, two, 20)
        for a, b in itertools.permutations((one, go, do), 2):
            site.state(a.present, b)
        looks.append(one)
    site.one_of(*looks)
    return site.problem


# -- pauses that somebody else fills ---------------------------------------------------------------
def filled(at="B", *, hand=True):
    """A pause of 20 units at B, or else work at D, with other work of 15, ``at`` B or not."""
    site = Site(robots=1)
    some = []
    for place, units in (("B", 3), ("D", 40)):
        go = site.drive(f"go{place}", 0, place, "home0")
        do = site.work(f"do{place}", 0, units, place)
        site.draw(go, do, 20)
        some.append(do)
    site.one_of(*some)
    site.one_of(*(site.work(f"other{n}", 0, 15, at, hand=hand) for n in range(2)))
    if at == "C":
        site.drive("aside", 0, "C", "B")
    return site.problem


# -- where robots are ------------------------------------------------------------------------------
def stands(told="start", change=lambda site: None):
    """Jobs of which it is only told where they are done: at B by r0, or at C by r1."""
    site = Site()
    other = site.problem.add_activity("other", 1, optional=True)
    some = []
    for r, place in enumerate("BC"):
        site.drive(f"to{r}", r, place)
        do = site.work(f"do{r}", r, 4)
        span = {
            "start": TimePointInterval(do.start),
            "empty": ClosedTimeInterval(Timing(0, do.start), Timing(-9, do.end)),
            "another's": TimePointInterval(other.start),
            "plan's start": ClosedTimeInterval(GlobalStartTiming(), GlobalStartTiming(-1)),
        }[told]
        do.add_condition(span, Equals(site.at[r], site.place[place]))
        some.append(do)
    site.one_of(*some)
    change(site)
    return site.problem


def told_by_the_clock(site):
    for r, place in enumerate("BC"):
        site.problem.add_effect(GlobalStartTiming(1), site.at[r], site.place[place])


# -- what a job is ---------------------------------------------------------------------------------
def wanted(scope=(), *, drawn="pairs", shared=False):
    """One errand, that is to be done under some scope or always; what draws along is said of
    pairs, of three together, or of one of two drives.
    """
    site = Site()
    made = []
    for r in range(2):
        go, do = site.drive(f"go{r}", r, "C"), site.work(f"do{r}", r, 5, "C")
        there = site.drive(f"way{r}", r, "B")
        if drawn == "pairs":
            site.draw(go, do)
        elif drawn == "three":
            site.problem.add_constraint(Or(Not(do.present), Not(there.present), go.present))
        elif drawn == "either":
            site.problem.add_constraint(Or(go.present, there.present), [do.present])
        if drawn != "pairs":  # who is at C may have come otherwise
            do._conditions.clear()
        made.append(do)
    site.problem.add_constraint(Or([a.present for a in made]), [site.flag(x) for x in scope])
    return site.problem


def shared_by_two(*, one=True):
    """Two jobs of which both need the same drive, or each one of its own."""
    site = Site()
    drives = {r: site.drive(f"go{r}", r, "D", f"home{r}") for r in range(2)}
    for name in "xyz":
        works = []
        for r in range(2):
            go = drives[r] if one else site.drive(f"go{name}{r}", r, "D", f"home{r}")
            do = site.work(f"do{name}{r}", r, 1, "D")
            site.state(go.present, do)
            site.state(LT(go.end, do.start), go, do)
            works.append(do)
        site.one_of(*works)
    return site.problem


def told_at_first(site):
    for r, place in enumerate("BC"):
        site.problem.set_initial_value(site.at[r], site.place[place])


def told_midway(site):
    """A drive tells that it is there a unit after its start."""
    for a in site.problem.motion_activities:
        ((timing, effects),) = [(t, e) for t, e in a._effects.items() if e[0].is_assignment()]
        del a._effects[timing]
        a._effects.setdefault(Timing(1, a.start), []).extend(effects)


def told_by_others(site):
    for r, place in enumerate("BC"):
        call = site.problem.add_activity(f"call{r}", 1, optional=True)
        call.add_effect(call.end, site.at[r], site.place[place])


def moved_by_others(site):
    for r, place in enumerate("BC"):
        lift = site.problem.add_motion_activity(f"lift{r}", optional=True)
        lift.set_fixed_duration(1)
        lift.add_motion_effect(site.robot[r], site.place[place])
        lift.add_effect(lift.end, site.at[r], site.place[place])


# -- who stays where -------------------------------------------------------------------------------
NOBODY = {"static_obstacles": [], "dynamic_obstacles_at_start": []}


def two_at_one_place(change=lambda site: None, **waypoints):
    """Two long jobs at B, and room for one robot; there is a way back home."""
    site = Site()
    for name in "xy":
        errand(site, "B", 30, name, **waypoints)
    change(site)
    return site.problem


def away(site):
    for r in range(2):
        site.drive(f"away{r}", r, "D")


def carried_off(site):
    for r in range(2):
        lift = site.problem.add_motion_activity(f"lift{r}", optional=True)
        lift.set_fixed_duration(1)
        lift.add_motion_effect(site.robot[r], site.place["D"])
        lift.add_effect(lift.end, site.at[r], site.place["D"])


def through_a_door(*changes, lifted=False, heeds=None):
    """Drives through a gap with a door, and back."""
    drives = (
        Drive("in", "r0", "a", "c", True, heeds=heeds),
        Drive("out", "r0", "c", "a", True, heeds=heeds),
        Drive("about", "r0", "a", "b", True),
    )
    world = World(7, False, (("r0", "a"), ("r1", "b2")), drives, changes, "shut")
    folder = drawn_map("assumptions", SIZE, outer_wall(*SIZE)).parent
    problem = build(world, write_rooms(folder))
    if lifted:
        lift = problem.add_motion_activity("lift", optional=True)
        lift.set_fixed_duration(1)
        (robot,) = (o for o in problem.all_objects if o.name == "r0")
        lift.add_motion_effect(robot, problem.object("d"))
    return problem


OPENED = Change("open", "away")
BROKEN = {
    "stated_gaps": (
        a_pause,
        (partial(a_pause, "flag"), partial(a_pause, "flag", place="own"), a_pause_from_start),
    ),
    "held_by": (
        checked,
        (
            *(
                partial(checked, change)
                for change in (
                    lent,
                    given_by_the_clock,
                    held_for_a_moment,
                    held_on_a_condition,
                    held_while_another_lasts,
                )
            ),
            partial(checked, hands=2),
            partial(checked, uses=False),
            momentary,
        ),
    ),
    "idle_between": (
        partial(filled, "C"),
        (filled, partial(filled, hand=False), partial(filled, at=None)),
    ),
    "activity_locations": (
        stands,
        tuple(partial(stands, told) for told in ("another's", "empty", "plan's start")),
    ),
    "guaranteed_locations": (
        stands,
        tuple(
            partial(stands, change=change)
            for change in (
                told_by_the_clock,
                told_at_first,
                told_midway,
                told_by_others,
                moved_by_others,
            )
        ),
    ),
    "find_jobs": (
        wanted,
        (
            partial(wanted, ("flag",)),
            partial(wanted, drawn="three"),
            partial(wanted, drawn="either"),
        ),
    ),
    "units_apart": (stands, (partial(stands, change=moved_by_others),)),
    "_counted": (partial(shared_by_two, one=False), (shared_by_two,)),
    "items_of": (stands, (partial(stands, "empty"), partial(stands, change=told_by_others))),
    "final_occupancy": (
        two_at_one_place,
        (
            partial(two_at_one_place, **NOBODY),
            partial(two_at_one_place, away),
            partial(two_at_one_place, carried_off),
        ),
    ),
    "surely_there": (
        partial(through_a_door, OPENED),
        (
            partial(through_a_door, OPENED, Change("more", "aside")),
            partial(through_a_door, OPENED, Change("close", "shut", True)),
            partial(through_a_door, OPENED, lifted=True),
            partial(through_a_door, OPENED, heeds=("r1",)),
        ),
    ),
    "demands": (),
}
"""Recogniser -> (a problem that keeps what it assumes, those that do not). The last two state no
bound: they have tests of their own."""
BOUNDS = {name: row for name, row in BROKEN.items() if name not in ("surely_there", "demands")}


def test_all_that_is_assumed_is_broken_here():
    assert assuming(package) == BROKEN.keys()


@pytest.mark.parametrize(
    ("kept", "case"),
    [
        pytest.param(kept, case, id=f"{name}{k}")
        for name, (kept, cases) in BOUNDS.items()
        for k, case in enumerate(cases)
    ],
)
def test_no_bound_hangs_on_a_broken_assumption(kept, case):
    best = soonest(case())
    assert bound(kept()) > best  # so what is recognised there would be wrong here
    for seed in range(3):
        assert bound(shuffled(case(), seed).problem) <= best


def test_nothing_is_surely_there_on_a_broken_assumption():
    def there(problem):
        _, facts, service = known(problem)
        return {
            (task.activity, thing, place)
            for task, found in surely_there(facts, service).items()
            for thing, place in found.items()
        }

    kept, cases = BROKEN["surely_there"]
    assert there(kept()) == {("out", "door", "away")}
    for case in cases:
        assert there(shuffled(case(), 1, rename=False).problem) == set()


@pytest.mark.parametrize("seed", range(2))
def test_no_demand_that_is_lifted_takes_schedules_away(seed):
    """A duration that is longer than any other, and some that are open."""
    site = Site()
    errand(site)
    site.problem.add_activity("years", 1).set_duration_bounds(2_000_000, 2_500_000)
    site.problem.add_activity("open", 1)._set_duration_constraint(
        OpenDurationInterval(Int(2), Int(4))
    )
    problem = shuffled(site.problem, seed).problem
    snapshot = read_problem(problem)
    asked = list(demands(relax(problem, snapshot)))
    for demand in asked:
        relaxation = relax(problem, snapshot)
        demand.lift(relaxation)
        report = CpsatSession(relaxation.problem, workers=1).solve(
            Deadline.after(20), optimal=False
        )
        assert report.schedule is not None, demand.text
    assert len(asked) > 10
