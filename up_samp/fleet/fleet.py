"""``Fleet``: state a problem in the words of those who have it; what comes of solving it."""

from __future__ import annotations

import copy
import dataclasses
import tempfile
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unified_planning.engines import PlanGenerationResult
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Plan
from unified_planning.shortcuts import OneshotPlanner

from up_samp import plotting
from up_samp.engines.factory import engine_named
from up_samp.engines.registration import register
from up_samp.fleet.batteries import tell_levels
from up_samp.fleet.build import tell_lateness, write_problem
from up_samp.fleet.checks import Finding, check_fleet
from up_samp.fleet.faults import (
    NO_ROBOT,
    Fault,
    FleetError,
    find_faults,
    job_faults,
    named_by,
    same_names,
)
from up_samp.fleet.files import read_problem_file, read_record, write_problem_file
from up_samp.fleet.meanings import Kind, Written, words_of
from up_samp.fleet.records import (
    AutomaticDoor,
    Door,
    FleetRecords,
    Lane,
    Lift,
    Order,
    Place,
    Resource,
    Robot,
    RobotType,
    Storey,
    Task,
    Weights,
    Zone,
)
from up_samp.fleet.spelled_out import ids_of, spelled_out
from up_samp.io import PlanDict, result_to_dict
from up_samp.io.precision import PRECISION
from up_samp.io.sampling import in_formation
from up_samp.model import SampError
from up_samp.model.objective import MinimizeCosts
from up_samp.upio.plan import figures_told, words_told
from up_samp.validation import terms_of

if TYPE_CHECKING:  # Matplotlib is slow to import
    from matplotlib.axes import Axes

Names = str | Sequence[str]


@dataclass(frozen=True, eq=False)
class FleetResult:
    """A solver's answer to a problem. ``outcome`` is UP's own result."""

    written: Written
    outcome: PlanGenerationResult
    seconds_per_unit: float = 1.0
    fleet: Fleet | None = None
    """What was asked, where it is known: it tells more of the answer."""

    @property
    def problem(self) -> SchedulingMotionProblem:
        """The UP problem that was solved."""
        return self.written.problem

    @property
    def status(self) -> str:
        """The name of UP's status, such as ``SOLVED_OPTIMALLY``."""
        return str(self.outcome.status.name)

    @property
    def plan(self) -> Plan | None:
        """UP's plan, or None."""
        return self.outcome.plan

    @property
    def makespan(self) -> float:
        """When all is over, s.

        :raises SampError: where there is no plan.
        """
        return float(self.data["makespan"]) * self.seconds_per_unit

    @cached_property
    def costs(self) -> dict[str, float]:
        """What the plan costs by term, weighted, where the objective weighs several.

        :raises SampError: where there is no plan, or another objective.
        """
        if self.plan is None or not any(
            isinstance(m, MinimizeCosts) for m in self.problem.quality_metrics
        ):
            raise SampError("only a plan of an objective of several terms costs something by term")
        return {term: float(cost) for term, cost in terms_of(self.problem, self.plan).items()}

    @property
    def left_out(self) -> list[str]:
        """The ids of optional orders and tasks that are not done; each adds to the makespan."""
        done = self.written.happening(self.data["activities"])
        return [meaning.what for meaning, _ in done if meaning.kind is Kind.LEAVE]

    @cached_property
    def data(self) -> PlanDict:
        """The plan as a dictionary (docs/plan-format.md)."""
        if self.plan is None:
            raise SampError(f"there is no plan ({self.status}); explain() tells why")
        return result_to_dict(self.problem, self.outcome, seconds_per_unit=self.seconds_per_unit)

    def gantt(self, file: str | PathLike[str] | None = None) -> Axes:
        """Draw who does what when; with ``file``, save the picture there."""
        return saved(plotting.plot_gantt(self.data), file)

    def map(self, file: str | PathLike[str] | None = None) -> Axes:
        """Draw the paths on the map; with ``file``, save the picture there."""
        return saved(plotting.plot_map(self.data, places=plotting.places_of(self.problem)), file)

    def save(self, folder: str | PathLike[str]) -> list[Path]:
        """Write ``plan.json``, ``gantt.png``, ``map.png`` and ``animation.html``."""
        places = plotting.places_of(self.problem)
        return plotting.write_outputs(self.data, Path(folder), places=places)

    def show(self, folder: str | PathLike[str] | None = None, *, browser: bool = True) -> Path:
        """Write the animated page (to ``folder``, or a temporary one) and open it in a browser;
        return the page's file.
        """
        target = Path(folder or tempfile.mkdtemp(prefix="up-samp-"))
        target.mkdir(parents=True, exist_ok=True)
        file = target / "animation.html"
        places = plotting.places_of(self.problem)
        page = Path(plotting.write_html(self.data, file, places=places))
        if browser:
            webbrowser.open(page.resolve().as_uri())
        return page

    def explain(self) -> str:
        """Tell in words what came out, and why there is no plan if there is none."""
        messages = words_told(self.outcome)
        if self.plan is None:
            found = [] if self.fleet is None else self.fleet.check()
            return "\n".join([f"no plan: {self.status}", *messages, *map(str, found)])
        metrics = figures_told(self.outcome)
        unit = self.seconds_per_unit
        bound = float(metrics.get("lower_bound", 0)) * unit
        lines = [f"{self.status}: all is over after {self.makespan:g} s"]
        costly = [m for m in self.problem.quality_metrics if isinstance(m, MinimizeCosts)]
        if costly:
            told = ", ".join(f"{term} {cost:g}" for term, cost in self.costs.items())
            total = "" if costly[0].in_order else f" {sum(self.costs.values()):g}:"
            lines.append(f"it costs{total} {told}")
        if costly and not costly[0].in_order:  # else the messages tell the bounds
            least = metrics.get("value_bound", "-")
            lines += [] if least == "-" else [f"no plan costs less than {float(Fraction(least)):g}"]
        elif bound:
            kind = metrics.get("bound_kind", "")
            lines.append(f"no plan can take less than {bound:g} s ({kind})")
        wishes = any("reverse_cost" in thing for thing in self.data["objects"])
        if wishes and self.status != "SOLVED_OPTIMALLY":
            lines.append(
                "its robots prefer to drive ahead: with reverse_cost: 1 more can be proven"
            )
        if self.left_out:
            lines.append(f"left out, which counts in that: {', '.join(self.left_out)}")
        drives: dict[str, float] = {}
        for motion in (*self.data["motions"], *in_formation(self.data)):
            samples = motion["samples"]
            took = samples[-1][0] - samples[0][0]
            drives[motion["object"]] = drives.get(motion["object"], 0.0) + took
        lines += [f"{name} is on the way for {took:.0f} s" for name, took in drives.items()]
        lines += [] if self.fleet is None else self.fleet.tell(self.data)
        return "\n".join([*lines, *messages])


def solve_problem(
    written: Written,
    timeout: float | None,
    params: Mapping[str, Any],
    fleet: Fleet | None = None,
) -> FleetResult:
    """Solve a problem; ``params["engine"]`` names the scheduler (``cpsat`` if it is absent)."""
    register()
    rest = {k: v for k, v in params.items() if k != "engine"}
    name = f"samp-refine[{params.get('engine', 'cpsat')}]"
    problem = written.problem
    engine_named(name)
    problem.environment.credits_stream = None
    with OneshotPlanner(name=name, params=rest) as planner:
        outcome = planner.solve(problem, timeout=timeout)
    return FleetResult(written, outcome, float(rest.get("seconds_per_unit", 1.0)), fleet)


def saved(ax: Axes, file: str | PathLike[str] | None) -> Axes:
    """Save a picture, if ``file`` names one; return its axes."""
    if file is not None:
        from up_samp.plotting.style import save_figure

        save_figure(ax, Path(file))
    return ax


class Fleet:
    """A map, robots, and what they have to do. Lengths in m, angles in rad, times in s.

    Every ``add_...`` checks what it is given at once and raises :class:`FleetError` that names the
    thing and what to do; nothing is added then. ``problem`` is at any time the ordinary UP
    problem.

    :param map: a ROS ``map_server`` YAML file.
    :param objective: ``"makespan"``, ``"none"``, weights of several terms, as in ``{"tardiness":
        10, "driving": 0.1}`` (see :class:`Weights`), or a list of such or of terms, the most
        important first: ``["tardiness", "makespan"]``.
    :param seconds_per_unit: the schedule's unit: durations are rounded up to it.
    :param margin: clearance in m that motions keep from walls and from each other.
    """

    folder: Path
    """The folder that the map's file is relative to."""
    _told: FleetRecords
    _written: Written | None

    def __init__(
        self,
        map: str | PathLike[str],
        *,
        name: str = "fleet",
        objective: str | Mapping[str, float] | Weights | Sequence[Any] = "makespan",
        seconds_per_unit: float = 1.0,
        margin: float = PRECISION.margin,
    ) -> None:
        data = {
            "map": fspath(map),
            "name": name,
            "objective": objective,
            "seconds_per_unit": seconds_per_unit,
            "margin": margin,
        }
        self.folder = Path()
        self._hold(read_record(FleetRecords, data))

    @classmethod
    def from_file(cls, file: str | PathLike[str]) -> Fleet:
        """Read a problem file (YAML or JSON)."""
        path = Path(file)
        fleet = cls.__new__(cls)
        fleet.folder = path.parent
        fleet._hold(read_problem_file(path))
        return fleet

    def save(self, file: str | PathLike[str]) -> Path:
        """Write a problem file (YAML or JSON, by its ending) and return its path."""
        path = Path(file)
        home = path.resolve().parent

        def seen_from_home(map_file: str) -> str:
            where = (self.folder / map_file).resolve()
            return str(where.relative_to(home) if where.is_relative_to(home) else where)

        records = self.records
        floors = {
            name: dataclasses.replace(floor, map=seen_from_home(floor.map))
            for name, floor in records.floors.items()
        }
        records = dataclasses.replace(records, map=seen_from_home(records.map), floors=floors)
        return write_problem_file(path, records)

    @property
    def records(self) -> FleetRecords:
        """All that was said, as frozen records."""
        if any(len(some) > len(getattr(self._told, kind)) for kind, some in self._jobs.items()):
            listed: dict[str, Any] = {kind: tuple(some) for kind, some in self._jobs.items()}
            self._told = dataclasses.replace(self._told, **listed)
        return self._told

    def _hold(self, records: FleetRecords) -> None:
        """Take all records over; jobs that are added later are listed beside them first."""
        self._told, self._written = records, None
        self._jobs: dict[str, list[Any]] = {"orders": [], "tasks": []}
        self._by_id: dict[str, Order | Task] = {}
        self._takers: dict[str, list[Order]] = {}
        for kind, some in self._jobs.items():
            for job in getattr(records, kind):
                self._list(some, job)

    def _list(self, some: list[Any], job: Order | Task) -> None:
        some.append(job)
        self._by_id |= dict.fromkeys(ids_of(job), job)
        self._written = None
        if isinstance(job, Order) and isinstance(job.attached, str):
            self._takers.setdefault(job.attached, []).append(job)

    # -- what there is -------------------------------------------------------------------------
    def add_robot_type(self, name: str, footprint: Any, **options: Any) -> None:
        """Add a type of robots: see :class:`RobotType` for the options.

        ``footprint``: ``(length, width)``, or the corners of a polygon, heading along +x.
        """
        self._named("robot_types", RobotType, name, {"footprint": footprint, **options})

    def add_robot(self, name: str, type: str, start: str | Sequence[float], **options: Any) -> None:
        """Add a robot that is at ``start`` (a place, or a pose) at first. Options: see
        :class:`Robot`.
        """
        self._named("robots", Robot, name, {"type": type, "start": start, **options})

    def add_place(
        self,
        name: str,
        x: float,
        y: float,
        theta: float = 0.0,
        **options: Any,
    ) -> None:
        """Add a pose. Options: ``docking`` (how it is come to, see :class:`Docking` for its keys),
        ``park`` (how often each robot may rest here to be out of the way), ``charger`` (robots
        charge here, see :class:`Charger` for its keys), ``room`` and ``holds`` (of how many orders
        loads fit, and are here at first), ``floor``.
        """
        self._named("places", Place, name, {"pose": (x, y, theta), **options})

    def add_floor(self, name: str, map: str | PathLike[str], height: float) -> None:
        """Add a further floor, ``height`` m above the map's own (``ground``). Places, doors and
        zones say on which ``floor`` they are; robots change floors by lifts.
        """
        self._named("floors", Storey, name, {"map": fspath(map), "height": height})

    def add_lift(self, name: str, stops: Mapping[str, Any], **options: Any) -> None:
        """Add a lift: ``stops`` are the poses at which a robot stands in it, by floor. Options:
        ``seconds`` of a ride, ``skills``.
        """
        self._named("lifts", Lift, name, {"stops": stops, **options})

    def add_door(self, name: str, leaf: Any, closed: Any, open: Any, **options: Any) -> None:
        """Add a closed door, opened by a robot at one of the places ``opened_from``. Options: see
        :class:`Door`.
        """
        self._named("doors", Door, name, {"leaf": leaf, "closed": closed, "open": open, **options})

    def add_automatic_door(self, name: str, polygon: Any, **options: Any) -> None:
        """Add a doorway, whose door opens as robots come. Options: see :class:`AutomaticDoor`."""
        self._named("automatic_doors", AutomaticDoor, name, {"polygon": polygon, **options})

    def add_zone(self, name: str, polygon: Any, **options: Any) -> None:
        """Add a part of the floor that robots of some types must ``keep_out`` of, that takes
        ``max_robots`` at a time, or in which robots drive ``v_max`` m/s at most, only ``one_way``,
        without ``pivoting`` or ``stopping``, or which they ``avoid``. Options: see :class:`Zone`.
        """
        self._named("zones", Zone, name, {"polygon": polygon, **options})

    def add_lane(self, name: str, points: Any, **options: Any) -> None:
        """Add a way that robots prefer in both directions: a line through ``points`` (m), ``width``
        m wide. Options: see :class:`Lane`.
        """
        self._named("lanes", Lane, name, {"points": points, **options})

    def add_resource(self, name: str, capacity: int = 1, **options: Any) -> None:
        """Add something of which stops and tasks use one unit each. Options: see
        :class:`Resource`.
        """
        self._named("resources", Resource, name, {"capacity": capacity, **options})

    # -- what there is to do -------------------------------------------------------------------
    def add_order(self, id: str, pickup: Any, delivery: Any, **options: Any) -> None:
        """Add a transport from ``pickup`` to ``delivery``: a place, several, or a dictionary with
        ``at``, ``service``, ``window`` and ``resources``. Options: see :class:`Order`.
        """
        self._listed("orders", Order, {"id": id, "pickup": pickup, "delivery": delivery, **options})

    def add_task(
        self, id: str, at: Names = (), *, duration: float | None = None, **options: Any
    ) -> None:
        """Add something to do at a place (or one of several), or by no robot where none is named.
        Options: see :class:`Task`.
        """
        self._listed("tasks", Task, {"id": id, "at": at, "duration": duration, **options})

    # -- what comes of it ------------------------------------------------------------------------
    @property
    def problem(self) -> SchedulingMotionProblem:
        """The ordinary UP problem: for all engines, validators and tools.

        It is written anew after each change; what you change in it, this fleet does not see.
        """
        return self._as_written().problem

    def _as_written(self) -> Written:
        if self._written is None:
            faults = find_faults(self.records)
            if not self.records.robots:
                faults.append(NO_ROBOT)
            if faults:
                raise FleetError(faults)
            self._written = write_problem(self.records, self.folder)
        return self._written

    def solve(self, timeout: float | None = 60.0, **params: Any) -> FleetResult:
        """Solve it. ``params`` are those of the engine (``optimal=True``, ``seed=1``, ...);
        ``engine="aries"`` takes another scheduler. Other ``seconds_per_unit`` or another ``margin``
        than the problem's hold for this time only.
        """
        settings = self.records.settings
        other = {k: params[k] for k in settings if k in params}
        if other:
            rest = {k: v for k, v in params.items() if k not in settings}
            return self.with_settings(**other).solve(timeout, **rest)
        asked = self.with_settings()  # what is added later is no part of the answer
        asked._written = written = self._as_written()
        return solve_problem(written, timeout, {**settings, **params}, asked)

    def tell(self, plan: PlanDict) -> list[str]:
        """Return in words what else there is to say of a plan: how low batteries get, and what ends
        after it is due.
        """
        told = self.records, self._as_written(), plan
        return [*tell_levels(*told), *tell_lateness(*told)]

    def words(self) -> dict[str, Any]:
        """Return what the site calls what is done, and where: a plan's ``words`` for exports."""
        return words_of(spelled_out(self.records), self._as_written())

    def with_settings(self, **settings: float) -> Fleet:
        """Return the same problem with other ``seconds_per_unit`` or another ``margin``."""
        unknown = settings.keys() - self.records.settings
        if unknown:
            raise FleetError([Fault((min(unknown),), "is no setting of a problem")])
        read = read_record(FleetRecords, {"map": self.records.map, **settings})
        fleet = copy.copy(self)
        other = {name: getattr(read, name) for name in settings}
        fleet._hold(dataclasses.replace(self.records, **other))
        return fleet

    @property
    def settings(self) -> dict[str, float]:
        """The length of a schedule unit (s) and the margin (m): an engine's parameters."""
        return self.records.settings

    def check(self) -> list[Finding]:
        """Look at it before any solving: what overlaps, what can be reached at all."""
        return check_fleet(self.records, self.folder)

    def draw(self, file: str | PathLike[str] | None = None) -> Axes:
        """Draw the map with all places, doors, zones and robots; what the check tells of is red."""
        from up_samp.fleet.picture import draw_fleet  # Matplotlib is slow to import

        return saved(draw_fleet(self.records, self.folder, self.check()), file)

    def _named(self, kind: str, record: type, name: str, data: dict[str, Any]) -> None:
        known = getattr(self.records, kind)
        if name in known:
            raise FleetError([Fault((kind, name), "is there already")])

        self._take(kind, {**known, name: read_record(record, data, (kind, name))}, (kind, name))

    def _listed(self, kind: str, record: type, data: dict[str, Any]) -> None:
        """Add a job: looked at with those that it names alone, however many there are."""
        path = (kind, len(self._jobs[kind]))
        job = read_record(record, data, path)
        if self._by_id.keys() & set(ids_of(job)) or any(
            True for _ in job_faults(self._about(job), job)
        ):
            self._take(kind, (*getattr(self.records, kind), job), path)
        else:
            self._list(self._jobs[kind], job)

    def _about(self, job: Order | Task) -> FleetRecords:
        """Return the records with a job, and no other jobs but those that it names."""
        some = [self._by_id[name] for name in named_by(job) if name in self._by_id]
        rivals = [self._takers.get(name, []) for name in named_by(job)]
        some += [job, *(other for others in rivals for other in others)]
        orders = tuple(j for j in some if isinstance(j, Order))
        tasks = tuple(j for j in some if isinstance(j, Task))
        return dataclasses.replace(self._told, orders=orders, tasks=tasks)

    def _take(self, kind: str, value: Any, path: tuple[str | int, ...]) -> None:
        """Keep what was added, unless something in it is wrong."""
        changed = dataclasses.replace(self.records, **{kind: value})
        clashes = [f for f in same_names(changed) if f not in [*same_names(self.records)]]
        faults = [f for f in find_faults(changed) if f.path[: len(path)] == path]
        faults += [f for f in clashes if f not in faults]
        if faults:
            raise FleetError(faults)
        self._hold(changed)
