"""What binds activities to jobs: who does them, what comes first, what fits on a robot at a time;
machines that are set up for kinds of jobs and work in batches, buffers of limited room.

All of it is said with what engines know already: orders of two with a gap between them, starts at
one instant, and levels.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from unified_planning.model import Fluent, FNode, Timing
from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import (
    FALSE,
    LE,
    TRUE,
    BoolType,
    Equals,
    IntType,
    Not,
    Or,
    Plus,
)

from up_samp.fleet.faults import Fault, FleetError, earlier_than, missing
from up_samp.fleet.loads import place_of
from up_samp.fleet.meanings import (
    Kind,
    Meaning,
    ends_before,
    exactly_one,
    one_at_a_time,
    only_with,
    together,
)
from up_samp.fleet.records import Order, Resource, Task
from up_samp.fleet.site import Site
from up_samp.fleet.visits import ENDS, JOBS, fit
from up_samp.fleet.work import Work
from up_samp.upio.expressions import at_start, present


def add_loads(site: Site, work: Work, robot: str) -> None:
    """State what fits on a robot at a time."""
    kind = site.records.kind_of(robot)
    mine = {v.what for v in work.visits[robot] if v.kind is Kind.DELIVERY}
    orders = [o for o in site.records.orders if o.id in mine]
    pairs = itertools.combinations(orders, 2)
    if len(orders) > 1 and not any(fit(site.records, pair, kind.capacity) for pair in pairs):
        _one_order(site, work, robot, orders)
        return  # one at a time comes off in any order
    for load in sorted({k for o in orders for k in o.load}):
        if sum(o.load.get(load, 0) for o in orders) > kind.capacity.get(load, 0):
            _level(site, work, robot, load, orders)
    if kind.unloading == "lifo":
        for one, other in itertools.permutations(orders, 2):
            _last_in_first_out(site, work, robot, one, other)


def _last_in_first_out(site: Site, work: Work, robot: str, below: Order, above: Order) -> None:
    """What is picked up while ``below`` is on the robot lies above it, and goes first. What is on
    board when the plan begins lies below all that is picked up.
    """
    under, over = work.sides(robot, below.id), work.sides(robot, above.id)
    picks: Sequence[Activity | None] = under[0] or [None]
    for pick, deliver, pick_2, deliver_2 in itertools.product(picks, under[1], *over):
        # below has gone when above comes, or above goes first
        ways = [LE(deliver.end, pick_2.start), LE(deliver_2.end, deliver.start)]
        if pick is not None:  # above lies below: the other permutation's case
            ways.append(LE(pick_2.end, pick.start))
        everything = filter(None, (pick, deliver, pick_2, deliver_2))
        site.problem.add_constraint(Or(ways), present(*everything))


def _one_order(site: Site, work: Work, robot: str, orders: Sequence[Order]) -> None:
    """One order at a time: the robot's hands are free or not. A delivery frees them a unit before
    its end, which is seen from its end on: the next pickup may begin then.
    """
    fluent = Fluent(f"{robot}_free", BoolType())
    free = FALSE() if site.records.on_board(robot) else TRUE()
    site.problem.add_fluent(fluent, default_initial_value=free)
    for order in orders:
        picks, delivers = work.sides(robot, order.id)
        for pick in picks:
            pick.add_condition(at_start(pick), fluent())
            pick.add_effect(pick.end, fluent(), FALSE())
        for deliver in delivers:
            deliver.add_effect(Timing(-1, deliver.end), fluent(), TRUE())


def _level(site: Site, work: Work, robot: str, load: str, orders: Sequence[Order]) -> None:
    """Room for loads of a kind: taken as a pickup begins, given back as a delivery ends."""
    capacity = site.records.kind_of(robot).capacity[load]
    fluent = Fluent(f"{robot}_room_{load}", IntType(0, capacity))
    taken = sum(order.load.get(load, 0) for order in site.records.on_board(robot))
    site.problem.add_fluent(fluent, default_initial_value=capacity - taken)
    for order in (o for o in orders if load in o.load):
        picks, delivers = work.sides(robot, order.id)
        for pick in picks:
            pick.add_decrease_effect(pick.start, fluent(), order.load[load])
        for deliver in delivers:
            deliver.add_increase_effect(deliver.end, fluent(), order.load[load])


# ------------------ What binds activities to jobs


class JobRules:
    """Writes the rules of jobs into a site's problem, whose activities are all there."""

    def __init__(self, site: Site, work: Work) -> None:
        self._site = site
        self._problem = site.problem
        self._records = site.records
        self._work = work
        self._leaving: dict[str, Activity] = {}

    def add(self) -> None:
        """State all rules of jobs."""
        self._done()
        self._linked()
        self._together()
        self._after()
        self._priorities()
        self._closings()
        self._left_out()

    def _closings(self) -> None:
        """A door closes again, unless no robot does anything any more by then: what is over is not
        prolonged by a door. It is opened once at a time.
        """
        robots = [a for some in self._work.busy.values() for a in some]
        of_door: dict[str, list[Activity]] = {}
        for door, opening, closing, units in self._work.closings:
            of_door.setdefault(door, []).extend((opening, closing))
            for a in robots:
                over = LE(a.end, Plus(opening.end, units))
                self._problem.add_constraint(Or(closing.present, over), present(opening, a))
        for door, activities in of_door.items():
            one_at_a_time(self._problem, door, activities)

    def _done(self) -> None:
        """Each job is done by exactly one robot, and orders are delivered by whom picked them."""
        for order in self._records.orders:
            parts = {"pick": Kind.PICKUP, "deliver": Kind.DELIVERY}
            if order.pickup.on is not None:
                del parts["pick"]
            for part, kind in parts.items():
                self._done_once(order, self._work.of(order.id, kind), part)
            for robot in self._records.robots if "pick" in parts else ():
                picks, delivers = self._work.sides(robot, order.id)
                together(self._problem, picks, delivers)
                for pick, deliver in itertools.product(picks, delivers):
                    ends_before(self._problem, pick, deliver)
        for task in self._records.tasks:
            if task.at:
                seats = self._work.seats(task)
                for number, activities in enumerate(seats):
                    self._done_once(task, activities, f"task{number or ''}")
                for some, others in itertools.pairwise(seats):
                    self._at_once(some, others)
            elif task.optional or task.modes:
                self._done_once(task, self._work.begins(task.id), "task")

    def _at_once(self, some: Sequence[Activity], others: Sequence[Activity]) -> None:
        """Who does its part of a crew's task begins as the others begin, and so ends as they do."""
        for a, b in itertools.product(some, others):
            self._problem.add_constraint(Equals(a.start, b.start), present(a, b))

    def _together(self) -> None:
        """Orders that belong together are picked up at once and delivered at once."""
        for order in self._records.orders:
            for other, kind in itertools.product(order.together, ENDS):
                some, others = self._work.of(order.id, kind), self._work.of(other, kind)
                self._at_once(some, others)
                together(self._problem, some, others)
        crews = (o.id for o in self._records.orders if o.id in self._records.crews)
        for name, robot in itertools.product(crews, self._records.robots):
            self._all_the_way(robot, name)

    def _all_the_way(self, robot: str, order: str) -> None:
        """Who has picked up an order does nothing for others before it is delivered."""
        picks, delivers = self._work.sides(robot, order)
        visits = ((v, self._work.activities[v]) for v in self._work.visits[robot] if v.kind in JOBS)
        mine = [a for v, a in visits if v.what != order]
        for a, pick, deliver in itertools.product(mine, picks, delivers):
            apart = Or(LE(a.end, pick.start), LE(deliver.end, a.start))
            self._problem.add_constraint(apart, present(a, pick, deliver))

    def _linked(self) -> None:
        """Parts are where their machines are, and loads are taken on where they were put."""
        for order in self._records.orders:
            for kind, stop in zip(ENDS, (order.pickup, order.delivery), strict=True):
                for mode, machine in self._work.machines.get(stop.task or "", {}).items():
                    for a in self._work.of(order.id, kind, mode):
                        only_with(self._problem, a, machine)
            if isinstance(order.attached, str):
                for place in {v.option for v in self._work.activities if v.what == order.id}:
                    self._taken_on(order.id, order.attached, place)

    def _taken_on(self, order: str, before: str, place: str) -> None:
        put = self._work.of(before, Kind.DELIVERY, place)
        for a in self._work.of(order, Kind.PICKUP, place) if place else ():
            self._problem.add_constraint(Or(Not(a.present), *(b.present for b in put)))

    def _done_once(self, job: Order | Task, activities: Sequence[Activity], part: str) -> None:
        """Exactly one of ``activities`` is there, or one that stands for leaving the part out.

        That one lasts as long as they do: the scheduler reads alternatives of equal length as one
        thing to be done, and finds first plans in which it is.
        """
        ways = [*activities]
        if job.optional and job.penalty is not None:
            length = int(activities[0].duration.lower.constant_value())
            name = self._site.fresh(f"skip_{part}_{job.id}", Meaning(Kind.SKIP, job.id))
            skip = self._problem.add_activity(name, length, optional=True)
            together(self._problem, [skip], [self._leave(job.id, job.penalty)])
            ways.append(skip)
        exactly_one(self._problem, ways)

    def _leave(self, job: str, penalty: float) -> Activity:
        """Return the activity that stands for leaving a job out; it lasts as long as that costs."""
        if job not in self._leaving:
            # with an objective of several terms it costs by itself: no time stands for it
            counts = bool(self._records.weighed)
            units = 1 if counts else self._site.up(penalty)
            name = self._site.fresh(f"leave_out_{job}", Meaning(Kind.LEAVE, job))
            a = self._problem.add_activity(name, duration=units, optional=True)
            self._leaving[job] = a
        return self._leaving[job]

    def _after(self) -> None:
        """Jobs begin once they are released, and what comes before them has ended; where that is
        left out, they are, too.
        """
        for job in self._records.jobs:
            begins = self._work.begins(job.id)
            for a in begins if job.release else ():
                a.add_release_date(self._site.up(job.release))
            for earlier in earlier_than(self._records, job):
                if earlier in self._leaving:
                    skipped = Not(self._leaving[earlier].present)
                    own = [self._leaving[job.id].present] if job.id in self._leaving else []
                    self._problem.add_constraint(Or([skipped, *own]))
                for a, b in itertools.product(self._work.ends(earlier), begins):
                    ends_before(self._problem, a, b)

    def _priorities(self) -> None:
        """Who has a higher priority begins no later."""
        jobs = self._records.jobs
        levels = sorted({j.priority for j in jobs}, reverse=True)
        for high, low in itertools.pairwise(levels):
            firsts = [a for j in jobs if j.priority == high for a in self._work.begins(j.id)]
            others = [a for j in jobs if j.priority == low for a in self._work.begins(j.id)]
            for a, b in itertools.product(firsts, others):
                self._problem.add_constraint(LE(a.start, b.start), present(a, b))

    def _left_out(self) -> None:
        """What is left out counts as seconds of makespan: it comes after all else, one by one."""
        if self._records.weighed:
            return
        last = set(self._leaving.values())
        others = [a for a in self._problem.activities if a not in last]
        for leaving, a in itertools.product(self._leaving.values(), others):
            ends_before(self._problem, a, leaving)
        one_at_a_time(self._problem, "nobody", list(self._leaving.values()))


# ------------------ Machines that are set up and work in batches, buffers of limited room


def add_setups(site: Site, work: Work) -> None:
    """State what resources ask for between those that use them.

    :raises FleetError: where one is of no kind, or those of a batch last unequally long.
    """
    for name, resource in site.records.resources.items():
        if resource != Resource(resource.capacity):
            _check_users(site, name, work.users.get(name, ()))
            _set_up(site, resource, work.users.get(name, ()))


def _kind(site: Site, a: Activity) -> str:
    """Return the kind of the job that an activity belongs to."""
    return site.records.job_of[site.meanings[a.name].what].kind


def _check_users(site: Site, name: str, users: Sequence[Activity]) -> None:
    resource = site.records.resources[name]
    lengths: dict[str, int] = {}
    for a in users:
        kind, job = _kind(site, a), site.meanings[a.name].what
        if resource.setup and kind not in resource.kinds:
            text = f"'{job}' uses it: {missing('kind', kind, resource.kinds)}"
            raise FleetError([Fault(("resources", name), text)])
        lasts = int(a.duration.lower.constant_value())
        if resource.batches and lengths.setdefault(kind, lasts) != lasts:
            text = f"'{job}' lasts longer or shorter than others of its kind, and a batch begins "
            raise FleetError([Fault(("resources", name), text + "and ends together")])


def _set_up(site: Site, resource: Resource, users: Sequence[Activity]) -> None:
    """No set-up is longer than by way of a third kind: who keeps the gaps between neighbours keeps
    those between all.
    """
    for a in users:
        first = resource.setup_between(resource.kind, _kind(site, a))
        if first:
            a.add_release_date(site.up(first))
    for a, b in itertools.combinations(users, 2):
        one, other = site.meanings[a.name], site.meanings[b.name]
        if (one.what, one.kind) == (other.what, other.kind):
            continue  # one of them happens
        kind, then = _kind(site, a), _kind(site, b)
        gap = _units(site, resource.setup_between(kind, then))
        back = _units(site, resource.setup_between(then, kind))
        ways = [LE(Plus(a.end, gap), b.start), LE(Plus(b.end, back), a.start)]
        if resource.batches and kind == then:
            ways.append(Equals(a.start, b.start))
        site.problem.add_constraint(Or(ways), present(a, b))


def _units(site: Site, seconds: float) -> int:
    """Return seconds as whole units, rounded up; none of nothing."""
    return site.up(seconds) if seconds else 0


def add_buffers(site: Site, work: Work) -> None:
    """State how many loads fit into places: a delivery takes room as it begins, a pickup gives some
    back as it ends; so do tasks of machines with what is brought to them and fetched.

    :raises FleetError: where it is not known beforehand what goes there.
    """
    records, rooms = site.records, dict[str, FNode]()
    for name, place in records.places.items():
        if place.room is not None:
            level = Fluent(f"{name}_room", IntType(0, place.room))
            site.problem.add_fluent(level, default_initial_value=place.room - place.holds)
            rooms[name] = level()
    for visit, a in work.activities.items():
        for room in _levels(rooms, visit.what, visit.places):
            match visit.kind:
                case Kind.DELIVERY:
                    a.add_decrease_effect(a.start, room, 1)
                case Kind.PICKUP:
                    a.add_increase_effect(a.end, room, 1)
    for task, modes in work.machines.items():
        brought = records.bringers.get(task, ())
        fetched = [order for order in records.orders if order.pickup.task == task]
        for mode, told in records.task_of[task].modes.items():
            for room in _levels(rooms, task, told.input)[: len(brought)]:
                modes[mode].add_increase_effect(modes[mode].start, room, _count(brought))
            for room in _levels(rooms, task, told.output or told.input)[: len(fetched)]:
                modes[mode].add_decrease_effect(modes[mode].end, room, _count(fetched))


def _levels(rooms: Mapping[str, FNode], what: str, places: Sequence[str]) -> list[FNode]:
    """Return the level of the place at which something is, if that has one."""
    found = [rooms[place] for place in map(place_of, places) if place in rooms]
    if len(places) > len(found) > 0:
        text = f"'{what}' is at one of {', '.join(places)}: a place with room for so many is "
        raise FleetError([Fault(("places",), text + "named alone")])
    return found[:1]


def _count(orders: Sequence[Order]) -> int:
    """Return how many loads are brought to a machine, or fetched."""
    if any(order.optional for order in orders):
        text = f"'{orders[0].id}' goes to a machine at a place with room for so many: no order "
        raise FleetError([Fault(("places",), text + "of that machine cannot be optional")])
    return len(orders)
