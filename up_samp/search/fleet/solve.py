"""Large problems: plans of thinned problems first, in which it is decided who does what.

A fleet of dozens has tens of thousands of optional activities, of which a plan has hundreds. A
scheduler's model of all of them takes longer to build than a plan takes to be found. So it is
first guessed who does which job (:mod:`up_samp.search.fleet.assignment`); the problem without
everything that this leaves out is scheduled, whole tours are decided robot by robot
(:mod:`up_samp.search.fleet.tours`), and what comes of it is a plan of the whole problem.
It is judged as that. Then some tours are planned anew among the others, with other jobs or
before others (:mod:`up_samp.search.fleet.improve`).
"""

from __future__ import annotations

import math
import random
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from operator import attrgetter

from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.model import (
    Body,
    CandidateSchedule,
    Configuration,
    Deadline,
    PathQuery,
    TimedMotion,
)
from up_samp.model.graphs import grouped
from up_samp.model.snapshot import Snapshot
from up_samp.motion.fleet.reservations import ReservationTable
from up_samp.search.budget import PARTS
from up_samp.search.conclusion import (
    SearchResult,
    conclude,
    conclude_stopped,
    conclude_undoable,
)
from up_samp.search.due import due_too_soon
from up_samp.search.events import Phase
from up_samp.search.facts import Choices, MotionCase
from up_samp.search.fleet.assignment import (
    NO_DRIVES,
    Assignment,
    assign,
    assignment_of_plan,
    decided_by,
    drives_chosen,
    in_stated_order,
    state_order,
)
from up_samp.search.fleet.duties import duties_of
from up_samp.search.fleet.evaluator import AssignmentEvaluator, Stop
from up_samp.search.fleet.evaluator_kernel import CostWeights
from up_samp.search.fleet.improve import FleetLNS, plan_tours, undecided_tours
from up_samp.search.fleet.jobs import Jobs, WorkMode, earlier_jobs, stands_of
from up_samp.search.fleet.sequential import FleetSolution
from up_samp.search.fleet.tours import TourPlanner
from up_samp.search.fleet.travel_times import Handover, OneDrive, TravelTimeModel, pauses_of
from up_samp.search.fleet_bound.bound import state_bounds
from up_samp.search.knowledge import BUILDING, STATING, Incumbent
from up_samp.search.loop import get_schedule, keep_if_better, solve, state_what_is_known
from up_samp.search.search import Search
from up_samp.tuning import Tuning
from up_samp.upio import Itinerary, read_itinerary
from up_samp.upio.restrict import thinned

_MOST = 8
"""Assignments that are tried, until there is a plan."""
_UNSCHEDULED = 2
"""Assignments without any schedule, or where doors are moved without a plan, after which no more
are made.
"""
_SLOWER = 0.2
"""By which traffic is expected to take longer from assignment to assignment."""
Arrival = tuple[Body, Configuration]
"""A body, and where it comes to."""
OpenThin = Callable[[SchedulingMotionProblem, Deadline], Search]
"""Opens a search on a thinned problem that asks the same motion service."""


@dataclass(frozen=True)
class LargeProblem:
    """A problem that is looked at in parts: see the module."""

    problem: SchedulingMotionProblem
    snapshot: Snapshot
    jobs: Jobs
    open_thin: OpenThin
    tuning: Tuning
    choices: Choices

    @cached_property
    def beside(self) -> frozenset[Stop]:
        """Where robots do what belongs to no job: charge, open doors."""
        own = self.jobs.of_members
        return frozenset(
            (robot, self.snapshot.configurations[place])
            for name, stands in stands_of(self.problem, self.snapshot).items()
            if name not in own
            for robot, place in stands
        )

    @cached_property
    def doors(self) -> bool:
        """Whether things are moved (doors are opened) by what belongs to no job."""
        return not {change.activity for change in self.snapshot.changes} <= {*self.jobs.of_members}

    def part(self, deadline: Deadline, name: str) -> Deadline:
        """Return the deadline of one of the parts of a search, the nearer to all of the time the
        larger the problem is: another assignment takes as long again, and the usual search is lost
        in tens of thousands of activities.
        """
        optional = sum(a.optional for a in self.problem.activities)
        return deadline.share(1.0 - (1.0 - PARTS[name][0]) * self.tuning.large / optional)


def solve_large(
    large: LargeProblem, search: Search, optimal: bool
) -> Generator[Incumbent, None, SearchResult]:
    """Solve a large problem: plans by assigning jobs, better and better ones if that is asked for,
    then the search as for any other problem, from the best one on.
    """
    if not all(map(can_be_done(search), large.jobs.options)):
        return (yield from solve(search, optimal=optimal))  # it tells why there is no plan
    search.learn(due_too_soon(search.problem.source, search.motions))
    undoable = conclude_undoable(search)
    if undoable is not None:
        return undoable
    first = large.part(search.budget.deadline, "tours of a large problem")
    search.tell.stage(Phase.PREPARE, "who does which job", len(large.jobs.options))
    found: Found | None = None
    failed = 0
    for assignment in assignments_of(search, large, first):
        with search.history.stages.of(BUILDING):
            deadline = large.part(first, "one assignment")
            opened = candidate_of(large, assignment, deadline, search.start)
            if opened is not None:
                found = plan_of_assignment(search, large, assignment, opened, deadline)
        failed += opened is None or large.doors
        if found is not None or first.expired() or failed >= _UNSCHEDULED:
            break
        if search.stopped:
            return conclude_stopped(search)
    with search.history.stages.of(STATING):
        state_bounds(search, large.problem, large.jobs, relative=optimal)
    if found is not None:
        better = keep_if_better(search, found[0])
        if better is not None:
            yield better
            if not optimal:
                return conclude(search)
        yield from improve(search, large, found[1])
        search.start = None  # better plans are known
    if search.bounds.met or search.budget.deadline.expired():
        return conclude(search)
    if search.stopped:
        return conclude_stopped(search)
    return (yield from solve(search, optimal=optimal))


def can_be_done(search: Search) -> Callable[[Sequence[WorkMode]], bool]:
    """Return what tells whether somebody may do a job by what is proven of its stops: not where
    nobody can come to one of them, whatever moves where.
    """
    snapshot, coming = search.facts.snapshot, defaultdict[Arrival, list[list[MotionCase]]](list)
    for (body, poses), cases in search.facts.by_signature.items():
        coming[body, poses[-1]].append(cases)

    @cache
    def reached(arrival: Arrival) -> bool:
        ways = coming.get(arrival, ())
        return not ways or None in map(search.motions.never_possible, ways)

    def may_do(option: WorkMode) -> bool:
        start = snapshot.configurations[snapshot.initial[option.robot]]
        body = snapshot.objects[option.robot].body
        return all(stop == start or reached((body, stop)) for stop in option.stops)

    return lambda options: any(map(may_do, options))


def assignments_of(search: Search, large: LargeProblem, deadline: Deadline) -> Iterator[Assignment]:
    """Yield assignments of the jobs: that of a plan to begin from, if there is one, the best one
    found, then others, more and more careful about what is due.
    """
    guess, rules = guess_of(search, large), CostWeights()
    earlier = earlier_jobs(large.problem, large.jobs)
    if search.start is not None:
        evaluator = AssignmentEvaluator(guess, large.jobs, rules)
        soon = deadline.share(*PARTS["who does which job"])
        found = assignment_of_plan(search.start, evaluator, soon, large.tuning)
        yield in_stated_order(found, earlier, large.jobs.crews)
    for number in range(_MOST):
        # who was late was guessed to be too quick
        careful = rules._replace(traffic=rules.traffic * (1.0 + _SLOWER * number))
        rng = random.Random(search.seed + number)
        soon = deadline.share(*PARTS["who does which job"])
        evaluator = AssignmentEvaluator(guess, large.jobs, careful)
        found = assign(evaluator, soon, rng, large.tuning)
        yield in_stated_order(found, earlier, large.jobs.crews)


def guess_of(search: Search, large: LargeProblem) -> TravelTimeModel:
    """Return what work takes, as far as it can be told before motions are decided."""
    service = search.motions.service

    def lasts(body: Body, start: Configuration, goal: Configuration) -> float:
        return service.lower_bound(body, (start, goal))

    def drives(
        body: Body, start: Configuration, goal: Configuration, deadline: Deadline
    ) -> float | None:
        with search.budget.motion_time():
            report = service.plan(PathQuery(body, (start, goal), ()), deadline)
        return None if report.trajectory is None else report.trajectory.duration

    pauses = pauses_of(large.problem, large.jobs)
    duties = duties_of(large.problem, large.snapshot, large.jobs)
    return TravelTimeModel(
        large.snapshot, lasts, drives, pauses, duties, handover_of(search, large)
    )


def handover_of(search: Search, large: LargeProblem) -> Handover:
    """Return what tells how long handovers at shared places take, by ways that are known."""
    floor, objects = ReservationTable(search.motions.service, ()), large.snapshot.objects
    tasks = grouped(large.snapshot.tasks, attrgetter("object"))
    heeded = {name: {task.avoid for task in some} for name, some in tasks.items()}

    def motion_of(robot: str, a: Configuration, b: Configuration) -> TimedMotion:
        some = heeded.get(robot, {None})
        avoid = next(iter(some)) if len(some) == 1 else None
        return TimedMotion("", robot, objects[robot].body, (a, b), 0.0, math.inf, avoid=avoid)

    def hands_over(one: OneDrive, other: OneDrive, deadline: Deadline) -> float | None:
        motions = motion_of(*one), motion_of(*other)
        with search.budget.motion_time():
            for motion in motions:
                if not floor.ways(motion).paths:
                    floor.alone(motion.body, motion.poses, deadline)
            seconds = floor.handover(*motions)
        return seconds if seconds < math.inf else None

    return hands_over


Found = tuple[Incumbent, FleetLNS]
"""A valid plan made of tours, and how to make it better."""


def plan_of_assignment(
    search: Search,
    large: LargeProblem,
    assignment: Assignment,
    opened: tuple[Search, Itinerary],
    deadline: Deadline,
) -> Found | None:
    """Return a valid plan of the whole problem in which everybody does what is assigned.

    :param opened: the search on the problem thinned to the assignment, and its candidate.
    """
    inner, itinerary = opened
    homes = homes_of(large.problem, assignment)
    # what was a plan may be none any more
    for known in (search.driven, {}) if search.driven else ({},):
        found = plan_tours(inner, itinerary, deadline, homes=homes, known=known)
        plan = None if found is None else plan_of_tours(search, found[1])
        if found is not None and plan is not None:
            rng, again = random.Random(search.seed), partial(open_tours, large)
            return plan, FleetLNS(assignment, *found, again, rng)
    return None


def plan_of_tours(search: Search, decided: FleetSolution) -> Incumbent | None:
    """Return a valid plan of the whole problem from tours: lean, or else with all that is
    assigned.
    """
    plan = search.plan_of(decided.lean(), decided.trajectories())
    if not search.judged(plan.plan):
        return plan
    whole = replace(decided, needless=frozenset())
    if not decided.needless <= decided.runs.keys():
        return None  # nobody knows how to drive it all
    plan = search.plan_of(whole.schedule, whole.trajectories())
    return None if search.judged(plan.plan) else plan


def homes_of(problem: SchedulingMotionProblem, assignment: Assignment) -> frozenset[str]:
    """Return the drives out of the way of others, which nobody needs otherwise: no job does, they
    need not happen, nor has whoever makes them to be anywhere in the end.
    """
    jobs, snapshot = assignment.jobs, assignment.guess.snapshot
    needed = {a.name for a in problem.activities if not a.optional}.union(*jobs.needs.values())
    drives = map(snapshot.by_object.get, assignment.guess.duties.ends)
    needed |= {task.activity for some in filter(None, drives) for task in some}
    extras = frozenset(n for options in jobs.options for o in options for n in o.extras)
    rests, tours = assignment.drives_home(), assignment.tours.items()
    last = (rests[robot].get(len(tour) - 1, ()) for robot, tour in tours)
    return extras.union(*last) - needed


def candidate_of(
    large: LargeProblem,
    assignment: Assignment,
    deadline: Deadline,
    start: CandidateSchedule | None = None,
) -> tuple[Search, Itinerary] | None:
    """Return a search on the problem thinned to an assignment, and its candidate: with the drives
    of its tours alone where nobody does anything beside; with what it takes for who has to charge;
    or with all that may be done beside where nothing comes of that, or where there are doors:
    nobody knows yet who opens them, and has to charge for that.

    :param start: what the scheduler begins from, so that of drives that are alike its are made.
    """
    charging = assignment.evaluator.charging(assignment.tours)
    some = dict.fromkeys((large.beside,) if large.doors else (charging, large.beside))
    ways = ((beside, lean) for beside in some for lean in (not beside, False))
    found = (_candidate(large, assignment, deadline, *way, start) for way in dict.fromkeys(ways))
    return next(filter(None, found), None)


def _candidate(
    large: LargeProblem,
    assignment: Assignment,
    deadline: Deadline,
    beside: frozenset[Stop],
    lean: bool,
    start: CandidateSchedule | None,
) -> tuple[Search, Itinerary] | None:
    activities = large.problem.activities
    chosen = drives_chosen(assignment, activities) if lean else NO_DRIVES
    problem = thinned(large.problem, decided_by(assignment, activities, beside, chosen))
    state_order(problem, assignment, chosen)
    inner = large.open_thin(problem, deadline)
    inner.start = start
    try:
        state_what_is_known(inner)
        report = get_schedule(inner, optimal=False)
    finally:
        inner.scheduler.close()
    if report.schedule is None:
        return None
    # where less may happen less is left to choice, of which the whole problem asks, too
    told, surely = report.schedule.parameters, dict[str, str]()
    for key, choice in inner.facts.choices.items():
        name = large.choices[key].variable
        if choice.variable is None and name is not None:
            surely[name] = choice.values[0]
    schedule = CandidateSchedule(report.schedule.times, {**surely, **told})
    return inner, read_itinerary(inner.knowledge.relaxation, schedule)


def open_tours(
    large: LargeProblem, assignment: Assignment, deadline: Deadline
) -> TourPlanner | None:
    """Return the tours of an assignment, none of them decided."""
    opened = candidate_of(large, assignment, deadline)
    tours = (
        None if opened is None else undecided_tours(*opened, homes_of(large.problem, assignment))
    )
    if tours is not None:
        tours.learn_ways_past(deadline)
    return tours


def improve(search: Search, large: LargeProblem, better: FleetLNS) -> Iterator[Incumbent]:
    """Yield better plans made of tours, until the time is over that there is for it."""
    budget = search.budget
    # each better plan gives all that comes after it the time to bring another one
    deadline = large.part(budget.whole, "tours of a large problem")

    def over() -> bool:
        return deadline.expired() or budget.deadline.expired() or search.stopped

    changes = better.improved(over, deadline)
    while not (search.bounds.met or search.stopped):
        before = better.assignment, better.tours, better.best
        with search.history.stages.of(BUILDING):
            decided = next(changes, None)
        if better.without_traffic < math.inf:
            search.history.without_traffic = search.facts.units(better.without_traffic)
        if decided is None:
            return
        plan = plan_of_tours(search, decided)
        if plan is None:  # no plan is better than these tours, and none comes of them
            better.assignment, better.tours, better.best = before
        kept = keep_if_better(search, plan)
        if kept is not None:
            yield kept
