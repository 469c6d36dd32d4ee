"""A candidate solved again: what it does is kept, and scheduled anew until its motions fit.

The activities of a candidate alone make a small problem (:func:`up_samp.upio.restrict.restrict`).
Each component adds constraints or puts another objective, has it scheduled by our own engine, and
where motions are driven tells it what they turned out to need, see ``until_driven``:

| component | constraints | objective | what motions that do not fit tell |
|---|---|---|---|
| ``repair_durations`` | | the problem's | the time that they need |
| ``serialize_motions`` | motions one after another | any schedule | what is learned of each |
| ``least_work`` | the same, activities open | few motions | the same |
| ``slack`` | no later end | time left for motions | |
| ``prune_motions`` | no later end, motions optional | few motions | the same, or: some are needed |
| ``begin_soon`` | no later end | early starts | the time that they need |
| ``begin_near`` | | near the old times | |
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping

from unified_planning.model.metrics import Oversubscription
from unified_planning.model.scheduling import Activity, SchedulingProblem
from unified_planning.plans import Plan, Schedule

from up_samp.model import CandidateSchedule, Deadline, ProblemError
from up_samp.scheduling.cpsat import CpsatSession
from up_samp.search.check import Check
from up_samp.search.events import Phase
from up_samp.search.knowledge import Incumbent
from up_samp.search.search import Search
from up_samp.search.world import groups_of, motion_key
from up_samp.upio import Itinerary, Relaxation, read_itinerary
from up_samp.upio.objective import only_makespan
from up_samp.upio.plan import to_candidate
from up_samp.upio.restrict import restrict

Next = Callable[[CandidateSchedule], "CandidateSchedule | None"]
"""Schedules a small problem again, near a schedule; None ends it."""
Tell = Callable[[Itinerary, Check], bool]
"""Tells a small problem what motions that did not fit need; False ends it."""
_REPAIR_STEPS, _REPAIR_EFFORT = 25, 0.4
"""Of scheduling anew and driving, where late motions get the time they need, and the effort for
each (CP-SAT's deterministic time, like all efforts): a few seconds at most."""
_STEPS, _FEW_STEPS = 12, 4
"""Of scheduling anew and driving, where motions are serialized or pruned, or only begin sooner."""
STEP_EFFORT = 0.3
"""For one of these steps: some seconds at most."""
_NEAR_EFFORT = 0.1
"""For a schedule near a plan's: about a second at most."""
_SLACK = (1, 3, 6)
"""Units more than scheduled that are worth having; each counts once for each motion."""
_SLACK_EFFORT = 0.06
"""For slack: well below a second."""


class Subproblem:
    """A problem of few activities that our own engine schedules again as it is told more:
    ``effort`` of counted work at a time, with one worker, so that it always does the same.
    """

    def __init__(self, search: Search, problem: SchedulingProblem, effort: float) -> None:
        self.search, self.problem = search, problem
        self.activities: Mapping[str, Activity] = {a.name: a for a in problem.activities}
        self.told = set[str]()
        self.session = CpsatSession(
            problem, seed=search.seed, workers=1, effort=effort, tuning=search.tuning
        )

    def schedule(
        self, near: CandidateSchedule, *, optimal: bool = True, deadline: Deadline | None = None
    ) -> CandidateSchedule | None:
        """Return the best (``optimal``), or some, schedule; None where none is found in time."""
        budget = self.search.budget
        report = self.session.solve(deadline or budget.deadline, optimal=optimal, hint=near)
        self.search.history.seconds_scheduler += report.seconds
        if report.schedule is None:
            return None
        values = {**near.parameters, **report.schedule.parameters}
        return CandidateSchedule(report.schedule.times, values)

    def heard(self, itinerary: Itinerary, check: Check) -> bool:
        """Let motions last as long as they turned out to need; False where that is not all that
        keeps them from fitting.
        """
        if check.failed or not check.needed:
            return False
        self.last_at_least(itinerary, check)
        return True

    def last_at_least(self, itinerary: Itinerary, check: Check) -> None:
        """Let motions last as long as they turned out to need.

        Who comes late begins its next motion late: that is not counted again. Those that do not fit
        again wait for others, who may begin later now: they also end as long after all that began
        on their way.
        """
        manager = self.problem.environment.expression_manager
        motions = {motion_key(m): m for m in itinerary.motions}
        starts = {m.activity: itinerary.schedule.times[m.activity][0] for m in motions.values()}
        unit = self.search.facts.snapshot.seconds_per_unit
        begun: dict[str, int] = {}
        for key, drive in check.trajectories.items():
            activity, since = motions[key].activity, math.floor(drive.times[0] / unit)
            begun[activity] = min(since, begun.get(activity, since))
        starts |= {name: max(starts[name], since) for name, since in begun.items()}
        for key, end in check.needed.items():
            mine = motions[key]
            waits, first = key in self.told, starts[mine.activity]
            self.told.add(key)
            others = {m.activity for m in motions.values() if waits and m.object != mine.object}
            for name in sorted({mine.activity} | {n for n in others if first < starts[n] < end}):
                since = manager.Plus(self.activities[name].start, end - starts[name])
                self.problem.add_constraint(manager.LE(since, self.activities[mine.activity].end))


def until_driven(
    search: Search,
    near: CandidateSchedule,
    again: Next,
    tell: Tell,
    *,
    steps: int,
    learn: bool = False,
) -> Incumbent | None:
    """Schedule ``again``, drive, and ``tell`` what did not fit, until all motions fit; None where
    that ends before. ``learn``: checks also look for what holds for later candidates.
    """
    for _ in range(steps):
        if search.budget.deadline.expired():
            return None
        scheduled = again(near)
        if scheduled is None:
            return None
        near = scheduled
        itinerary = read_itinerary(search.knowledge.relaxation, near)
        check = search.checker.check(itinerary, learn=learn)
        if check.passed:
            return search.plan_of(near, check.trajectories)
        if not tell(itinerary, check):
            return None
    return None


# ------------------------------------------------------------------ motions get the time they need


def repair_durations(
    search: Search, schedule: CandidateSchedule, check: Check, *, loose: bool = False
) -> Incumbent | None:
    """Return a plan of a candidate whose motions are late: the same activities, with the ends that
    the motions turned out to need. None where none is found, or some motion found no trajectory at
    all. ``loose``: motions get what time is left.
    """
    if check.failed:
        return None
    search.tell.stage(Phase.REPAIR)
    problem = restrict(search.knowledge.relaxation, schedule)
    small = Subproblem(search, problem, _REPAIR_EFFORT)

    def again(near: CandidateSchedule) -> CandidateSchedule | None:
        found = small.schedule(near)
        if found is None or not search.bounds.improves(found):
            return None
        return spread(search, problem, found) if loose else found

    small.last_at_least(read_itinerary(search.knowledge.relaxation, schedule), check)
    return until_driven(search, schedule, again, small.heard, steps=_REPAIR_STEPS)


# ------------------------------------------------------------------ motions one after another


def serialize_motions(
    search: Search, schedule: CandidateSchedule, check: Check
) -> Incumbent | None:
    """Return some plan with the activities of ``schedule``, as long as there is none and where its
    motions do not fit; None where none is found.

    Robots that drive at the same time may find no way past each other, or not in time. Who drives
    alone only has to get around what rests. So the candidate's activities are scheduled anew, first
    with the motions of the groups that failed in turn, then with all of them; what is learned about
    each motion among what rests (who has to be gone before) counts for later candidates, too. The
    plan may be long: what comes after makes it shorter.
    """
    if search.bounds.incumbent is not None:
        return None
    search.tell.stage(Phase.REPAIR)
    itinerary = read_itinerary(search.knowledge.relaxation, schedule)
    alone = of_failed_groups(itinerary, check)
    everybody = {m.activity for m in itinerary.motions}
    for some in (alone, everybody) if alone != everybody else (everybody,):
        found = _in_turn(search, schedule, some)
        if found is not None:
            return found
    return None


def _in_turn(
    search: Search, schedule: CandidateSchedule, some: Collection[str]
) -> Incumbent | None:
    """Return a plan in which the motions of ``some`` activities happen one at a time."""
    deadline = search.budget.part("motions one at a time")

    def again(near: CandidateSchedule) -> CandidateSchedule | None:
        if deadline.expired():
            return None
        # made anew: the relaxation holds what was learned by then
        problem = restrict(search.knowledge.relaxation, schedule)
        _take_turns(problem, some)
        small = Subproblem(search, problem, STEP_EFFORT)
        return small.schedule(near, optimal=False, deadline=deadline)

    def tell(itinerary: Itinerary, check: Check) -> bool:
        return bool(search.learn(check.refinements))

    return until_driven(search, schedule, again, tell, steps=_STEPS, learn=True)


def least_work(search: Search, schedule: CandidateSchedule, check: Check) -> Incumbent | None:
    """Make some plan of as little work as there may be, as long as there is none.

    Optional work makes the floor fuller: loads that stand about, robots that come and go. What can
    be left out is left out first, whatever that costs, and the rest is done one motion after the
    other; the plan is a plan of the whole problem, and what comes after it adds work where that is
    worth it. A choice of activities that did not come to a plan is not tried again; where no choice
    was found in the time for it, none is sought again: there are fewer, the more is learned. What
    another candidate comes of sooner, guesses that are still to be told, comes first.
    """
    tried, nothing = search.knowledge.tried_alone, frozenset[str]()
    soon = search.knowledge.may_guess(check.refinements)
    if search.bounds.incumbent is not None or soon or nothing in tried:
        return None
    tried.add(frozenset(schedule.times))
    least = _with_fewest_motions(search, schedule) or CandidateSchedule({})
    names = frozenset(least.times)
    known = names in tried | {nothing}
    tried.add(names)
    if known:
        return None
    return _in_turn(search, least, search.facts.snapshot.by_activity.keys() & names)


def _with_fewest_motions(search: Search, near: CandidateSchedule) -> CandidateSchedule | None:
    """Return a schedule of the whole problem with the fewest motions that is found soon."""
    relaxation = search.knowledge.relaxation
    problem = relaxation.problem.clone()
    moving = relaxation.snapshot.by_activity.keys()
    manager = problem.environment.expression_manager
    drives = [a for a in problem.activities if a.name in moving and a.optional]
    if not drives:
        return None
    problem.clear_quality_metrics()
    left_out = {manager.Not(a.present): 1 for a in drives}
    problem.add_quality_metric(Oversubscription(left_out, problem.environment))
    # a problem of all activities, not of a candidate's alone
    return Subproblem(search, problem, 3 * STEP_EFFORT).schedule(near)


def of_failed_groups(itinerary: Itinerary, check: Check) -> set[str]:
    """Return the motion activities of the groups in which a motion failed or came late."""
    names = {*check.failed, *check.needed}
    wrong = {m.activity for m in itinerary.motions if motion_key(m) in names}
    found = set()
    for group in groups_of(itinerary.motions):
        names = {m.activity for m in group}
        if names & wrong:
            found |= names
    return found


def _take_turns(problem: SchedulingProblem, some: Collection[str]) -> None:
    """Let the activities of ``some`` happen one at a time, with a rest in between: who arrives
    when another one leaves may still meet it.
    """
    manager = problem.environment.expression_manager
    turns = [a for a in problem.activities if a.name in some]
    for a, b in itertools.combinations(turns, 2):
        problem.add_constraint(manager.Or(manager.LT(a.end, b.start), manager.LT(b.end, a.start)))


# ------------------------------------------------------------------ time where it costs nothing


def slack(search: Search, schedule: CandidateSchedule) -> CandidateSchedule:
    """Return a candidate with the same activities and makespan, whose motions have what time that
    leaves: a scheduler has no reason to give a motion more than it needs alone, and with more those
    that are not critical can give way.
    """
    relaxation = search.knowledge.relaxation
    if not only_makespan(relaxation.problem):
        return schedule
    return spread(search, restrict(relaxation, schedule), schedule)


def spread(
    search: Search, problem: SchedulingProblem, schedule: CandidateSchedule
) -> CandidateSchedule:
    """Return a schedule of ``problem`` (see ``restrict``) that ends no later than ``schedule`` and
    whose motions have as much slack as can be; ``schedule`` itself, if there is none to be had in
    little time.
    """
    loose = problem.clone()
    manager = loose.environment.expression_manager
    moving = search.facts.snapshot.by_activity.keys()
    goals = {}
    for activity in loose.activities:
        if activity.name in moving:
            start, end = schedule.times[activity.name]
            for more in _SLACK:
                longer = manager.Plus(activity.start, end - start + more)
                goals[manager.LE(longer, activity.end)] = 1
    _prefer(loose, goals, schedule.makespan)
    return Subproblem(search, loose, _SLACK_EFFORT).schedule(schedule) or schedule


def _prefer(problem: SchedulingProblem, goals: dict[object, int], until: int) -> None:
    """Let as many ``goals`` (by their worth) hold as can, with all of it at an end by ``until``."""
    manager = problem.environment.expression_manager
    for activity in problem.activities:
        problem.add_constraint(manager.LE(activity.end, until))
    problem.clear_quality_metrics()
    problem.add_quality_metric(Oversubscription(goals, problem.environment))


# ------------------------------------------------------------------ needless motions and waits


def prune_motions(search: Search, plan: Incumbent) -> Incumbent | None:
    """Return a plan with fewer motions that ends no later, if one is found: the last pass of
    a search.

    A makespan says nothing of moves that end before it: an idle robot may drive out, back and out
    again, or round by a place at which it has nothing to do. Among the plans with some of the same
    motions, or one in place of several in a row, no later end, the same decisions and all else that
    is present, the one with the fewest motions is sought, then with the least driving.
    Its motions are checked and the plan is validated like any other.
    """
    search.tell.stage(Phase.TIDY)
    relaxation = search.knowledge.relaxation
    weights = _worth_of_leaving_out(relaxation, plan.schedule)
    if not weights or not only_makespan(relaxation.problem):
        return None
    problem = _with_motions_optional(relaxation, plan.schedule, weights, plan.schedule.makespan)
    small = Subproblem(search, problem, STEP_EFFORT)
    present = weights.keys() & plan.schedule.times.keys()

    def again(near: CandidateSchedule) -> CandidateSchedule | None:
        found = small.schedule(near)
        return found if found is not None and present - found.times.keys() else None

    def tell(itinerary: Itinerary, check: Check) -> bool:
        if small.heard(itinerary, check):
            return True
        gone = sorted(weights.keys() - itinerary.schedule.times.keys())
        manager = problem.environment.expression_manager
        problem.add_constraint(manager.Or(small.activities[n].present for n in gone))
        return True

    return until_driven(search, plan.schedule, again, tell, steps=_STEPS)


def begin_soon(search: Search, plan: Incumbent) -> Incumbent | None:
    """Return a plan with the same activities that ends no later and in which most begin
    sooner, if one is found: a makespan says nothing of waits that end before it. (Without any
    metric a plan is to be like the one that it began from.)
    """
    relaxation = search.knowledge.relaxation
    old = {
        name: span for name, span in plan.schedule.times.items() if name in relaxation.activities
    }
    if not relaxation.problem.quality_metrics or not only_makespan(relaxation.problem):
        return None
    search.tell.stage(Phase.TIDY)
    problem = restrict(relaxation, plan.schedule)
    manager = problem.environment.expression_manager
    goals = {
        manager.LE(a.start, old[a.name][0] - more): 1
        for a, more in itertools.product(problem.activities, _SLACK)
        if more <= old.get(a.name, (-1, -1))[0]
    }
    _prefer(problem, goals, plan.schedule.makespan)
    small = Subproblem(search, problem, STEP_EFFORT)

    def again(near: CandidateSchedule) -> CandidateSchedule | None:
        found = small.schedule(near)
        sooner = found is not None and sum(s - found.times[n][0] for n, (s, _) in old.items()) > 0
        return found if sooner else None

    return until_driven(search, plan.schedule, again, small.heard, steps=_FEW_STEPS)


def _worth_of_leaving_out(relaxation: Relaxation, schedule: CandidateSchedule) -> dict[str, int]:
    """Return what leaving out each present optional motion is worth: one motion more than all
    driving, one unit of driving more than all changes without motions; and each motion that leads
    where several of these lead.
    """
    present = schedule.times
    optional = {a.name for a in relaxation.problem.activities if a.optional} & set(present)
    drives = relaxation.snapshot.by_activity.keys() & optional
    changes = {c.activity for c in relaxation.snapshot.changes} & optional - drives
    unit = len(changes) + 1
    lengths = {n: (present[n][1] - present[n][0]) * unit for n in drives}
    most = sum(lengths.values()) + unit
    worth = {n: most + lengths[n] for n in drives} | dict.fromkeys(changes, 1)
    return dict.fromkeys(_shortcuts(relaxation, schedule, drives), most) | worth


def _shortcuts(
    relaxation: Relaxation, schedule: CandidateSchedule, drives: Collection[str]
) -> Iterator[str]:
    """Yield optional motions that lead from where some of the ``drives`` of a candidate begins to
    where one of the next two of the same object ends.
    """
    present = schedule.times
    optional = {a.name for a in relaxation.problem.activities if a.optional} - present.keys()
    for tasks in relaxation.snapshot.by_object.values():
        ends = {t.activity: (t.terms[0], t.terms[-1]) for t in tasks}
        mine = sorted(ends.keys() & set(drives), key=lambda name: present[name])
        wanted = {
            (ends[one][0], ends[then][1])
            for i, one in enumerate(mine)
            for then in mine[i + 1 : i + 3]
        }
        yield from (name for name, pair in ends.items() if name in optional and pair in wanted)


def _with_motions_optional(
    relaxation: Relaxation, schedule: CandidateSchedule, weights: Mapping[str, int], until: int
) -> SchedulingProblem:
    """Return the problem of a schedule's activities and of the weighted ones, which are optional;
    all of it ends by ``until``.
    """
    problem = restrict(relaxation, schedule, free=frozenset(weights))
    manager = problem.environment.expression_manager
    present = {a.name: a.present for a in problem.activities if a.name in weights}
    _prefer(problem, {manager.Not(p): weights[n] for n, p in present.items()}, until)
    return problem


# ------------------------------------------------------------------ a plan to begin from


def start_of(problem: SchedulingProblem, plan: Plan) -> CandidateSchedule:
    """Return a UP plan (an old one, or another's) as what to begin from: what it says of activities
    that the problem has.

    Activities that have to be present and are not in the plan are to begin at 0. Raises
    :class:`ProblemError` where the plan is no schedule.
    """
    if not isinstance(plan, Schedule):
        raise ProblemError(f"a search begins from schedules only, not from a {type(plan).__name__}")
    told = to_candidate(plan)
    known = {a.name for a in problem.activities}
    times = {name: span for name, span in told.times.items() if name in known}
    for activity in problem.activities:
        if not activity.optional and activity.name not in times:
            least = activity.duration.lower
            times[activity.name] = (0, int(least.constant_value()) if least.is_constant() else 1)
    names = {p.name for p in problem.base_variables}
    names |= {p.name for a in problem.activities if a.name in times for p in a.parameters}
    values = {name: value for name, value in told.parameters.items() if name in names}
    return CandidateSchedule(times, values)


def begin_near(search: Search, start: CandidateSchedule) -> CandidateSchedule | None:
    """Return a schedule of the relaxation with the activities of ``start``, near its times; None
    where there is none or it is not found in little time.

    Only what the plan drives is looked at before, so that a search begins in a fraction of a second
    where the plan still fits; else the plan is the scheduler's hint.
    """
    search.tell.stage(Phase.SCHEDULE)
    # nothing decides the places of motions but the plan itself
    problem = restrict(search.knowledge.relaxation, start)
    return Subproblem(search, problem, _NEAR_EFFORT).schedule(start, optimal=False)
