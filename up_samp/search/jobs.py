"""Jobs of which one robot or another does each, as constraints on presence say, and a quick guess
of who should do which.

A *job* is an unconditional disjunction of presences. Each of its options draws along what has to be
present with it; together they are a robot's share of work, from where it first has to be to where
it ends. Jobs are dealt out by insertion where they end soonest, with straight lines for ways, and
then moved and swapped as long as that helps (Potvin and Rousseau 1993). It proves nothing: it says
which activities are worth a look.
"""

from __future__ import annotations

import math
import random
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from unified_planning.model import FNode
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity

from up_samp.model import Configuration
from up_samp.model.snapshot import MotionTask, Snapshot, TermKind
from up_samp.scheduling.cpsat.encode.durations import least


@dataclass(frozen=True)
class Option:
    """One way to do a job: ``leader`` is present, and ``members`` with it. ``robot`` is busy for
    ``work`` s from being at ``entry`` until it is at ``exit``.
    """

    leader: str
    members: frozenset[str]
    robot: str
    work: float
    entry: Configuration
    exit: Configuration
    due: float = math.inf
    """When it has to be done at the latest (s)."""
    extras: frozenset[str] = frozenset()
    """What may be present only if it is done: a way home, say."""


@dataclass(frozen=True)
class Jobs:
    """All jobs of a problem, and who is drawn along by whom."""

    options: tuple[tuple[Option, ...], ...]
    needs: Mapping[str, frozenset[str]]
    """Activity -> those that have to be present with it."""

    def drawn(self, name: str) -> set[str]:
        """Return what has to be present with an activity, itself included."""
        found, todo = {name}, [name]
        while todo:
            for other in self.needs.get(todo.pop(), ()):
                if other not in found:
                    found.add(other)
                    todo.append(other)
        return found

    def without(self, gone: set[str]) -> set[str]:
        """Return everything that cannot be present without some activities, with these."""
        found = set(gone)
        needed: dict[str, list[str]] = defaultdict(list)
        for name, others in self.needs.items():
            for other in others:
                needed[other].append(name)
        todo = list(gone)
        while todo:
            for name in needed[todo.pop()]:
                if name not in found:
                    found.add(name)
                    todo.append(name)
        return found


def find_jobs(problem: SchedulingMotionProblem, snapshot: Snapshot) -> Jobs | None:
    """Return the jobs of a problem, or None where some option is no work of one robot in the plane.

    :param snapshot: of the same problem.
    """
    needs: dict[str, set[str]] = defaultdict(set)
    dues = _dues(problem)
    clauses: list[tuple[str, ...]] = []
    for names, conditions in _clauses(problem):
        if not conditions and len(names) > 1:
            clauses.append(names)
        elif len(conditions) == 1 and len(names) == 1:
            needs[conditions[0]].add(names[0])
    table = {name: frozenset(others) for name, others in needs.items()}
    tasks: dict[str, list[MotionTask]] = defaultdict(list)
    for task in snapshot.tasks:
        tasks[task.activity].append(task)
    lengths = {a.name: float(least(a.duration)) for a in problem.activities}
    found = []
    for names in clauses:
        options = [_option(name, table, tasks, lengths, snapshot) for name in names]
        if any(o is None for o in options):
            return None
        found.append(tuple(o for o in options if o is not None))
    return _with_extras(Jobs(tuple(found), table), dues) if found else None


def _with_extras(jobs: Jobs, dues: Mapping[str, float]) -> Jobs:
    """Return jobs whose options know when they are due and what else may come of them."""
    draws: dict[str, list[str]] = defaultdict(list)
    for name, others in jobs.needs.items():
        for other in others:
            draws[other].append(name)
    found = []
    for options in jobs.options:
        whole = []
        for option in options:
            extras = {n for m in option.members for n in draws[m]} - option.members
            due = min((dues.get(m, math.inf) for m in option.members), default=math.inf)
            whole.append(replace(option, due=due, extras=frozenset(extras)))
        found.append(tuple(whole))
    return Jobs(tuple(found), jobs.needs)


def _dues(problem: SchedulingMotionProblem) -> dict[str, float]:
    """Return the latest ends of activities that are stated as such (units)."""
    found: dict[str, float] = {}
    for owner in (problem._base, *problem.activities):
        for constraint, _ in owner._constraints:
            if constraint.node_type is not Op.LE:
                continue
            end, limit = constraint.args
            if end.is_timing_exp() and limit.is_int_constant():
                name = end.timing().timepoint.container
                if name is not None:
                    value = float(limit.constant_value())
                    found[name] = min(value, found.get(name, math.inf))
    return found


def _clauses(
    problem: SchedulingMotionProblem,
) -> Iterator[tuple[tuple[str, ...], tuple[str, ...]]]:
    """Yield (names, conditions): one of the names is present if all conditions are."""
    for owner in (problem._base, *problem.activities):
        for constraint, scope in owner._constraints:
            names = _present(constraint.args if constraint.node_type is Op.OR else [constraint])
            conditions = _present([s for s in scope if not s.is_true()])
            if names is not None and conditions is not None:
                yield names, conditions


def _present(nodes: Sequence[FNode]) -> tuple[str, ...] | None:
    """Return whose presences some expressions are; None if one is something else."""
    if any(node.node_type is not Op.PRESENT_EXP for node in nodes):
        return None
    return tuple(node.presence().container for node in nodes)


def _option(
    leader: str,
    needs: Mapping[str, frozenset[str]],
    tasks: Mapping[str, list[MotionTask]],
    lengths: Mapping[str, float],
    snapshot: Snapshot,
) -> Option | None:
    members = Jobs((), needs).drawn(leader)
    driven = [task for name in sorted(members) for task in tasks.get(name, ())]
    robots = {task.object for task in driven}
    if len(robots) != 1 or any(task.terms[-1].kind is not TermKind.CONSTANT for task in driven):
        return None
    unit, pose = snapshot.seconds_per_unit, snapshot.configurations
    work = sum(lengths[name] * unit for name in members if name not in tasks)
    legs = [t for t in driven if t.terms[0].kind is TermKind.CONSTANT]
    for task in legs:
        work += ride(snapshot, task.object, pose[task.terms[0].name], pose[task.terms[-1].name])
    ends = {task.terms[-1].name for task in driven}
    begins = {task.terms[0].name for task in legs}
    first = sorted(ends & begins) or sorted(begins - ends) or sorted(ends)
    last = sorted(ends - begins) or sorted(ends)
    (robot,) = robots
    return Option(leader, frozenset(members), robot, work, pose[first[0]], pose[last[0]])


def ride(snapshot: Snapshot, robot: str, a: Configuration, b: Configuration) -> float:
    """Return a guess (s) of a drive between two poses in the plane: along the axes, with a turn."""
    limits = snapshot.objects[robot].body.kinematics
    length = abs(a[0] - b[0]) + abs(a[1] - b[1])
    return length / limits.v_max + limits.v_max / limits.a_max + 2.0


LATE = 10.0
"""Weight of a second too late against a second of work."""
TRAFFIC = 1.4
"""How much longer than guessed a tour is expected to take, where something is due."""


@dataclass
class Deal:
    """Who does which jobs in which order: (job, option) by robot."""

    snapshot: Snapshot
    jobs: Jobs
    tours: dict[str, list[tuple[int, int]]]
    bias: Mapping[tuple[int, int], float] = field(default_factory=dict)
    """What (job, option) is taken to cost more or less than guessed (share)."""

    def cost(self, robot: str, tour: Sequence[tuple[int, int]]) -> float:
        """Return a guess of when a robot has done a tour (s), and what is late counts more."""
        end, late = self._guess(robot, tour)
        return end + LATE * late

    def end(self, robot: str, tour: Sequence[tuple[int, int]]) -> float:
        """Return a guess of when a robot has done a tour (s)."""
        return self._guess(robot, tour)[0]

    def _guess(self, robot: str, tour: Sequence[tuple[int, int]]) -> tuple[float, float]:
        here = self.snapshot.configurations[self.snapshot.initial[robot]]
        total = late = 0.0
        for job, number in tour:
            option = self.jobs.options[job][number]
            total += ride(self.snapshot, robot, here, option.entry)
            total += option.work * (1.0 + self.bias.get((job, number), 0.0))
            here = option.exit
            # traffic takes time, too
            late += max(0.0, TRAFFIC * total - option.due * self.snapshot.seconds_per_unit)
        return total, late

    def leaders(self) -> set[str]:
        """Return the options that are taken."""
        return {self.jobs.options[j][k].leader for tour in self.tours.values() for j, k in tour}


def deal(
    jobs: Jobs, snapshot: Snapshot, rounds: int = 4, *, seed: int = 0, noise: float = 0.0
) -> Deal:
    """Return a quick and balanced share of all jobs, by guesses with ``noise`` (a share)."""
    rng = random.Random(seed)
    bias = {
        (j, k): rng.uniform(-noise, noise)
        for j, options in enumerate(jobs.options)
        for k in range(len(options))
    }
    robots = sorted({o.robot for options in jobs.options for o in options})
    found = Deal(snapshot, jobs, {robot: [] for robot in robots}, bias)
    work = [min(o.work for o in options) for options in jobs.options]
    due = [min(o.due for o in options) for options in jobs.options]
    for job in sorted(range(len(jobs.options)), key=lambda j: (due[j], -work[j], j)):
        _insert(found, job)
    for _ in range(rounds):
        if not _shifted(found):
            break
    return found


def _insert(found: Deal, job: int) -> None:
    """Give a job to who has done everything soonest then."""
    best: tuple[float, float, str, list[tuple[int, int]]] | None = None
    for number, option in enumerate(found.jobs.options[job]):
        tour = found.tours[option.robot]
        before = found.cost(option.robot, tour)
        for at in range(len(tour) + 1):
            longer = [*tour[:at], (job, number), *tour[at:]]
            end = found.cost(option.robot, longer)
            key = (end, end - before, option.robot, longer)
            if best is None or key[:3] < best[:3]:
                best = key
    assert best is not None
    found.tours[best[2]] = best[3]


def _shifted(found: Deal) -> bool:
    """Take jobs from who ends last and give them anew; return whether that helped."""
    helped = False
    for robot in sorted(found.tours, key=lambda r: -found.cost(r, found.tours[r])):
        tour = found.tours[robot]
        worst = found.cost(robot, tour)
        for job, _ in list(tour):
            kept = dict(found.tours)
            found.tours[robot] = [step for step in found.tours[robot] if step[0] != job]
            _insert(found, job)
            changed = [r for r in kept if kept[r] != found.tours[r]]
            if math.fsum(found.cost(r, found.tours[r]) ** 4 for r in changed) < math.fsum(
                found.cost(r, kept[r]) ** 4 for r in changed
            ):
                helped |= found.cost(robot, found.tours[robot]) < worst
            else:
                found.tours = kept
    return helped


def decided(deal: Deal, names: Sequence[str]) -> frozenset[str]:
    """Return the activities that may be present if everybody does what was dealt out, and makes use
    of what may come of a job only in the end (to go home).
    """
    jobs = deal.jobs
    chosen = {(j, k) for tour in deal.tours.values() for j, k in tour}
    gone = {o.leader for j, options in enumerate(jobs.options) for k, o in enumerate(options)
            if (j, k) not in chosen}  # fmt: skip
    for tour in deal.tours.values():
        for j, k in tour[:-1]:
            gone |= jobs.options[j][k].extras
    return frozenset(names) - jobs.without(gone)


def state_order(problem: SchedulingMotionProblem, deal: Deal) -> None:
    """State in a thinned problem that everything is done as it was dealt out, in that order."""
    manager = problem.environment.expression_manager
    activities = {a.name: a for a in problem.activities}
    for tour in deal.tours.values():
        before: list[Activity] = []
        for j, k in tour:
            option = deal.jobs.options[j][k]
            mine = [
                activities[n] for n in sorted(option.members | option.extras) if n in activities
            ]
            for a in mine:
                problem.add_constraint(a.present)
                for earlier in before:
                    problem.add_constraint(
                        manager.LE(earlier.end, a.start), [earlier.present, a.present]
                    )
            before = mine
