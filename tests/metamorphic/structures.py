"""What is recognised in a site, told by its poses: whatever the style calls things."""

from __future__ import annotations

from dataclasses import dataclass

from tests.metamorphic.motions import MotionStyle, write
from tests.metamorphic.sites import MotionSite
from up_samp.model import Deadline
from up_samp.motion import MotionService
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_tasks, find_unit_places
from up_samp.scheduling.cpsat.routing.route import Route
from up_samp.search.loop import state_what_is_known
from up_samp.search.params import Parameters
from up_samp.search.search import Wrapped
from up_samp.search.session import lay_out, open_search, open_service
from up_samp.upio.read import read_problem


@dataclass(frozen=True)
class Structures:
    """Of the problem that is stated before the first schedule. ``routes`` have, each: where it
    begins, least durations by (from, to), where its stops are, what its places need (how long
    before a stop), how many states keep still. ``units`` are the places for one, by route;
    ``tasks`` are (length, ways, wanted, needed, opened).
    """

    routes: frozenset
    units: frozenset
    tasks: tuple


def service_of(site: MotionSite, folder) -> MotionService:
    """Return who plans motions in a site, in whatever style it is written."""
    problem = write(site, MotionStyle(), folder)
    return open_service(*lay_out(read_problem(problem, 1.0)), Parameters())


def structures(site: MotionSite, style: MotionStyle, folder, service=None) -> Structures:
    """Return what is recognised in a site as it is written in a style."""
    wrapped = Wrapped("cpsat", {"workers": 1}, lambda *_: [], lambda *_: [], native=True)
    search = open_search(
        write(site, style, folder),
        wrapped,
        Parameters(),
        Deadline.after(600.0),
        service=service,
    )
    state_what_is_known(search)
    search.scheduler.close()
    model = ScheduleModel(search.knowledge.relaxation.problem)
    routes = find_routes(model)
    poses = search.knowledge.relaxation.snapshot.configurations
    told = {code: poses.get(name, name) for name, code in model.world.objects.items()}
    origin = {route.key: told[route.initial] for route in routes}
    units = (
        frozenset((origin[key], told[p]) for key, places in unit.places.items() for p in places)
        for unit in find_unit_places(model, routes)
    )
    tasks = (
        (task.length, len(task.ways), task.wanted, task.needed, len(task.opened))
        for task in find_tasks(model, routes)
    )
    return Structures(
        frozenset(_route(route, told) for route in routes), frozenset(units), tuple(sorted(tasks))
    )


def _route(route: Route, told: dict) -> tuple:
    hops = {(told[a], told[b], min(m.least for m in ms)) for (a, b), ms in route.hops.items()}
    stops = [frozenset(told[p] for p in places) for _, places in route.stops]
    visits = [frozenset(told[p] for p in places) for _, places in route.visits]
    needs = {
        (told[place], tuple(sorted(e.lead for e in entries)))
        for place, entries in route.entries.items()
    }
    return (
        told[route.initial],
        frozenset(hops),
        tuple(sorted(stops, key=sorted)),
        tuple(sorted(visits, key=sorted)),
        frozenset(needs),
        len(route.still),
        route.final and frozenset(told[p] for p in route.final),
    )
