"""Random schedules in which much happens at one instant, and random executions of their graphs.

Times lie on a coarse grid; what a schedule is asked (zones, resources, levels, lamps, clauses) is
drawn at random and kept where the validator finds that the schedule keeps it. All lists are
shuffled before the problem is written.
"""

import random

from unified_planning.model import ClosedTimeInterval, Fluent, TimePointInterval, Timing
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.timing import (
    LeftOpenTimeInterval,
    OpenTimeInterval,
    RightOpenTimeInterval,
)
from unified_planning.plans import Schedule
from unified_planning.shortcuts import (
    LE,
    LT,
    And,
    BoolType,
    Equals,
    GlobalStartTiming,
    IntType,
    Not,
    Or,
    Plus,
)  # fmt: skip

from up_samp.execution.graph import At, Event
from up_samp.io import plan_to_dict
from up_samp.validation import validate_schedule


class Instants:
    """A random problem with its plan; ``plan`` is ``None`` where nothing could be asked."""

    def __init__(self, seed):
        rng = self.rng = random.Random(seed)
        self.spans = {}
        for k in range(rng.randint(3, 7)):
            start = rng.randint(0, 4) * 2
            self.spans[f"t{k}"] = (start, start + rng.choice((2, 2, 4)))
        self.wishes = []
        for _ in range(rng.randint(3, 8)):
            kind = rng.choice(
                (self._resource, self._zone, self._level, self._lamp, self._clause, self._shift)
            )
            wish = kind(len(self.wishes))
            if validate_schedule(*self.written([*self.wishes, wish])).valid:
                self.wishes.append(wish)
        rng.shuffle(self.wishes)
        self.problem, self.schedule = self.written(self.wishes, shuffled=True)
        self.plan = plan_to_dict(self.problem, self.schedule)

    def written(self, wishes, *, shuffled=False):
        problem = SchedulingProblem("instants")
        names = list(self.spans)
        if shuffled:
            self.rng.shuffle(names)
        activities = {}
        for name in names:
            start, end = self.spans[name]
            activities[name] = problem.add_activity(name, end - start)
        said = [say for wish in wishes for say in wish(problem, activities)]
        if shuffled:
            self.rng.shuffle(said)
        for say in said:
            say()
        times = {}
        for name, a in activities.items():
            times[a.start], times[a.end] = self.spans[name]
        return problem, Schedule(list(activities.values()), times)

    def _some(self, most=4):
        return self.rng.sample(list(self.spans), self.rng.randint(1, min(most, len(self.spans))))

    def _fluent(self, problem, number, kind, first):
        fluent = Fluent(f"f{number}", kind)
        problem.add_fluent(fluent, default_initial_value=first)
        return fluent()

    def _resource(self, number):
        users = {name: self.rng.choice((1, 1, 2)) for name in self._some()}
        capacity = self.rng.randint(max(users.values()), 3)

        def wish(problem, activities):
            tool = problem.add_resource(f"f{number}", capacity)
            return [lambda n=n, k=k: activities[n].uses(tool, k) for n, k in users.items()]

        return wish

    def _zone(self, number):
        """Some come in when they start, others let somebody out when they end (or the other way
        round); room that is left is counted, or who is inside."""
        inside, most = self.rng.randint(0, 1), self.rng.randint(1, 2)
        counts_room = self.rng.random() < 0.6
        comes = {n: self.rng.random() < 0.5 for n in self._some(6)}
        late = {n: self.rng.random() < 0.3 for n in comes}

        def wish(problem, activities):
            first = most - inside if counts_room else inside
            room = self._fluent(problem, number, IntType(0, most), first)

            def change(name):
                a = activities[name]
                at = a.start if comes[name] != late[name] else a.end
                if comes[name] == counts_room:
                    a.add_decrease_effect(at, room, 1)
                else:
                    a.add_increase_effect(at, room, 1)

            return [lambda n=n: change(n) for n in comes]

        return wish

    def _level(self, number):
        changes = [
            (n, self.rng.choice((-2, -1, 1, 2)), self.rng.random() < 0.5, self.rng.randint(0, 1))
            for n in self._some(6)
        ]
        low, high = self.rng.choice(((0, 3), (0, 4), (None, 3), (0, None)))
        first = self.rng.randint(0, 3)
        read = self.rng.choice([*self.spans, None, None])
        wanted = self.rng.randint(0, 3)

        def wish(problem, activities):
            level = self._fluent(problem, number, IntType(low, high), first)

            def change(name, amount, early, delay):
                a = activities[name]
                at = Timing(delay, a.start if early else a.end)
                add = a.add_increase_effect if amount > 0 else a.add_decrease_effect
                add(at, level, abs(amount))

            found = [lambda c=c: change(*c) for c in changes]
            if read is not None:
                a = activities[read]
                span = ClosedTimeInterval(Timing(0, a.start), Timing(0, a.end))
                found.append(lambda: a.add_condition(span, LE(wanted, level)))
            return found

        return wish

    def _lamp(self, number):
        """Set by some, read by others over intervals of all kinds."""
        sets = [
            (n, self.rng.random() < 0.5, self.rng.randint(0, 1), self.rng.random() < 0.7)
            for n in self._some(2)
        ]
        reads = [(n, self.rng.randint(0, 5), self.rng.random() < 0.7) for n in self._some(3)]
        first = self.rng.random() < 0.3

        def wish(problem, activities):
            lamp = self._fluent(problem, number, BoolType(), first)

            def read(name, how, lit):
                a = activities[name]
                start, end = Timing(0, a.start), Timing(0, a.end)
                span = (
                    TimePointInterval(start), TimePointInterval(end),
                    ClosedTimeInterval(start, end), LeftOpenTimeInterval(start, end),
                    RightOpenTimeInterval(start, end), OpenTimeInterval(start, end),
                )[how]  # fmt: skip
                a.add_condition(span, lamp if lit else Not(lamp))

            def put(name, early, delay, lit):
                a = activities[name]
                a.add_effect(Timing(delay, a.start if early else a.end), lamp, lit)

            found = [lambda s=s: put(*s) for s in sets]
            return [*found, *(lambda r=r: read(*r) for r in reads)]

        return wish

    def _clause(self, number):
        one, two = (self.rng.choice(list(self.spans)) for _ in range(2))
        which, lag = self.rng.randint(0, 5), self.rng.randint(0, 2)
        turned = self.rng.random() < 0.5

        def wish(problem, activities):
            a, b = activities[one], activities[two]
            parts = [
                [LE(a.end, b.start)], [LE(Plus(a.end, lag), b.start)],
                [LE(a.end, b.start), LE(b.end, a.start)], [Equals(a.end, b.start)],
                [Equals(b.start, a.start)], [LT(a.end, b.start), LT(b.end, a.start)],
            ][which]  # fmt: skip
            parts = parts[::-1] if turned else parts
            said = Or(parts) if which in (2, 5) else And(parts)
            return [lambda: problem.add_constraint(said)]

        return wish

    def _shift(self, number):
        """The problem itself gives and takes at times of its own."""
        changes = [(2 * self.rng.randint(0, 5), self.rng.choice((-1, 1))) for _ in range(2)]
        users = self._some(2)

        def wish(problem, activities):
            crew = self._fluent(problem, number, IntType(0, 3), 1)

            def change(at, amount):
                add = problem.add_increase_effect if amount > 0 else problem.add_decrease_effect
                add(GlobalStartTiming(at), crew, 1)

            def use(name):
                a = activities[name]
                a.add_decrease_effect(a.start, crew, 1)
                a.add_increase_effect(a.end, crew, 1)

            return [
                *(lambda c=c: change(*c) for c in changes),
                *(lambda u=u: use(u) for u in users),
            ]

        return wish


def executed(found, plan, rng):
    """A record of an execution that the graph allows: every event as soon as it may happen, and
    many of them late.
    """
    graph, times = found.graph, {}
    unit = float(plan["seconds_per_unit"])
    share = rng.choice((0.0, 0.3, 0.7))
    for k in graph.order:
        event = graph.events[k]
        at = [0.0, *(times[first] for first, then in graph.implied if then == k)]
        at += [times[graph.number[e.first]] + e.lag for e in graph.edges if e.then == event]
        if event.at is At.END:
            begun = graph.number[Event(At.START, event.activity)]
            at.append(times[begun] + graph.tasks[event.activity].expected)
        late = event.at is not At.ORIGIN and rng.random() < share
        times[k] = max(at) + (rng.choice((0.001, 0.5, 1.0, 2.0, 7.25)) if late else 0.0)
    activities = []
    for entry in plan["activities"]:
        start, end = (times[graph.number[Event(at, entry["name"])]] for at in (At.START, At.END))
        span = {"start": round(start / unit, 9), "end": round(end / unit, 9)}
        activities.append({**entry, **span})
    return {**plan, "activities": activities}
