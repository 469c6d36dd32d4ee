"""A whole day in simulated time: the same loop, another clock, simulated robots; and its report."""

from __future__ import annotations

import dataclasses
import json
import random
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from up_samp.execution.floor import Delays, Handled
from up_samp.fleet.fleet import Fleet
from up_samp.fleet.records import Break, FleetRecords, Order, Task
from up_samp.fleet.spelled_out import with_places
from up_samp.io.plan_dict import PlanDict
from up_samp.model import ProblemError
from up_samp.operate.clock import SimulatedClock
from up_samp.operate.judge import DayVerdict, judge_day, record_of_day
from up_samp.operate.loop import Operation
from up_samp.operate.records import DayOrder, OrderState, Settings
from up_samp.operate.simulated import (
    Mishaps,
    SimulatedRobots,
    SteppedClock,
    driven_until,
)
from up_samp.operate.store import Store
from up_samp.operate.upkeep import BREAK, CHARGE
from up_samp.plotting.background import ground_of
from up_samp.plotting.map_picture import map_panels
from up_samp.plotting.style import figure_axes, save_figure

NOTICED = 5.0
"""Seconds after which somebody has seen that a robot has broken down."""
AFTER = 1800.0
"""Seconds that are left for what came in the day, and then whatever is not done is lost."""


@dataclass(frozen=True)
class DayPlan:
    """What happens in a day: orders per hour, drawn from those of the site file; each is due
    ``due`` s after it came. ``noise`` (m), ``delays`` (share), breakdowns of ``repair`` s each.
    """

    hours: float = 8.0
    orders_per_hour: float = 60.0
    due: float = 300.0
    noise: float = 0.0
    delays: float = 0.0
    breakdowns: int = 0
    repair: float = 600.0
    lost: float = 0.0
    twice: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class DayFigures:
    """What came of a day. Times in s; an order that was not done counts until the day's end, as
    if it had been done then, but for ``done`` and ``per_hour``. ``waiting`` is the share of driving
    time that robots stood though they had a motion to drive, ``planning`` quantiles (median, 95 %,
    most) of the CPU time of a plan, ``steps`` those of the loop's own time for a step.
    """

    orders: int
    done: int
    hours: float
    per_hour: float
    tardiness: float
    in_time: float
    flow: float
    waiting: float
    kilometres: float
    plans: int
    plans_taken: int
    planning: tuple[float, float, float]
    steps: tuple[float, float, float]
    seconds: float


@dataclass(frozen=True, eq=False)
class DayResult:
    """A simulated day: its figures, the judge's verdict, what was driven as a plan-like record, and
    where robots waited (x, y, s).
    """

    plan: DayPlan
    figures: DayFigures
    verdict: DayVerdict
    record: PlanDict
    waits: tuple[tuple[float, float, float], ...]
    costs: tuple[tuple[float, float, float, str, bool], ...]
    jobs: tuple[DayOrder, ...]
    handled: tuple[Handled, ...] = ()


def orders_of(site: FleetRecords, plan: DayPlan) -> Iterator[Order | Task]:
    """Yield the day's orders, each due some time after it comes (``due`` - ``plan.due``)."""
    kinds = site.jobs
    if not kinds:
        raise ProblemError("the site file has no orders or tasks: those of the day are like them")
    rng, now = random.Random(f"orders {plan.seed}"), 0.0
    for number in range(10**9):
        now += rng.expovariate(plan.orders_per_hour / 3600.0)
        if now > plan.hours * 3600.0:
            return
        kind = rng.choice(kinds)
        yield replace(
            kind,
            id=f"{kind.id}-{number}",
            after=(),
            due=now + plan.due,
            weight=1.0,
            release=0.0,
            repeat=None,
        )


def mishaps_of(site: FleetRecords, plan: DayPlan) -> Mishaps:
    """Return what goes wrong in a day."""
    rng = random.Random(f"mishaps {plan.seed}")
    delays = replace(Delays.of_share(plan.delays), noise=plan.noise)
    broken = [
        (rng.uniform(0.1, 0.8) * plan.hours * 3600.0, rng.choice([*site.robots]), plan.repair)
        for _ in range(plan.breakdowns)
    ]
    return Mishaps(delays, plan.lost, plan.twice, tuple(sorted(broken)))


def simulate_day(
    fleet: Fleet,
    plan: DayPlan,
    store: Path,
    *,
    speed: float = 0.0,
    operation: type[Operation] = Operation,
) -> DayResult:
    """Simulate a day on a site and judge it."""
    begun, site = time.monotonic(), with_places(fleet.records)
    empty = _without_jobs(fleet, plan.hours)
    robots = SimulatedRobots(
        {n: site.places[r.start].pose for n, r in site.robots.items()},
        mishaps_of(site, plan),
        plan.seed,
        site,
    )
    clock = SteppedClock(SimulatedClock(speed=speed), robots)
    day = operation(
        empty,
        store=Store(store, durable=False),
        robots=robots,
        clock=clock,
        settings=Settings(seed=plan.seed),
    )
    try:
        steps = _run(day, robots, [*orders_of(site, plan)], plan)
        robots.close()
        jobs = tuple(day.jobs.values())
        verdict = judge_day(site, day.jobs, robots.initial, robots.drives, robots.handled)
        seconds = time.monotonic() - begun
        figures = figures_of(plan, day, robots, steps, seconds)
        waits = tuple((*p[:2], b - a) for w in robots.waits.values() for a, b, p, _ in w)
        map_file = str((fleet.folder / site.map).resolve())
        record = record_of_day(replace(site, map=map_file), robots.initial, robots.drives)
        done = tuple(robots.handled)
        return DayResult(plan, figures, verdict, record, waits, tuple(day.costs), jobs, done)
    finally:
        day.close()


def _without_jobs(fleet: Fleet, hours: float) -> Fleet:
    """Return a fleet without orders and tasks, and with the breaks that begin in a day of so many
    hours.
    """

    def soon(rest: Break) -> bool:
        return rest.window[0] < 3600.0 * hours

    empty = Fleet.__new__(Fleet)
    empty.folder = fleet.folder
    robots = {
        name: replace(robot, breaks=tuple(filter(soon, robot.breaks)))
        for name, robot in fleet.records.robots.items()
    }
    empty._hold(dataclasses.replace(fleet.records, orders=(), tasks=(), robots=robots))
    return empty


def _run(
    day: Operation,
    robots: SimulatedRobots,
    orders: Sequence[Order | Task],
    plan: DayPlan,
) -> list[float]:
    """Run the day to its end; return how long (CPU s) the loop took for each step."""
    left, steps = list(orders), []
    known: dict[str, float] = {}
    while left or not day.idle:
        now = day.clock.now()
        if now > plan.hours * 3600.0 + AFTER:
            break
        while left and left[0].due is not None and left[0].due - plan.due <= now:
            day.add(left.pop(0))
        for name in robots.broken:
            known.setdefault(name, now)
        for name, since in [*known.items()]:
            if name not in robots.broken:
                del known[name]
                if name in day.away:
                    day.join(name)
            elif name not in day.away and now >= since + NOTICED:
                day.leave(name, "broken down")
        cpu = time.thread_time()
        day.step()
        steps.append(time.thread_time() - cpu)
    return steps


def figures_of(
    plan: DayPlan,
    day: Operation,
    robots: SimulatedRobots,
    steps: Sequence[float],
    seconds: float,
) -> DayFigures:
    """Return the figures of a day that ends now."""
    now, costs = day.clock.now(), day.costs
    jobs = [j for j in day.jobs.values() if not j.id.startswith((BREAK, CHARGE))]
    done = [j for j in jobs if j.state is OrderState.DONE and j.done is not None]
    ended = [*done, *(replace(j, done=now) for j in jobs if j.state.open)]
    driven = waited = metres = 0.0
    for drive in robots.drives:
        rows = drive.rows
        if len(rows) > 1:
            driven += driven_until(rows) - float(rows[0, 0])
            metres += float(np.hypot(*np.diff(rows[:, 1:3], axis=0).T).sum())
    waited = sum(b - a for w in robots.waits.values() for a, b, *_ in w)
    last = max((j.done for j in ended if j.done is not None), default=0.0)
    hours = max(plan.hours, last / 3600.0)
    return DayFigures(
        orders=len(jobs),
        done=len(done),
        hours=round(hours, 3),
        per_hour=round(len(done) / hours, 2),
        tardiness=round(_mean([j.tardiness for j in ended], 0.0), 1),
        in_time=round(_mean([j.tardiness <= 0.0 for j in ended], 1.0), 3),
        flow=round(_mean([(j.done or 0.0) - j.came for j in ended], 0.0), 1),
        waiting=round(waited / max(driven, 1e-9), 4),
        kilometres=round(metres / 1000.0, 3),
        plans=len(costs),
        plans_taken=sum(c[4] for c in costs),
        planning=_quantiles([c[2] for c in costs]),
        steps=_quantiles(steps),
        seconds=round(seconds, 1),
    )


def _mean(values: Sequence[float], otherwise: float) -> float:
    return statistics.fmean(values or [otherwise])


def _quantiles(values: Sequence[float]) -> tuple[float, float, float]:
    found = np.quantile(np.asarray(values or [0.0]), (0.5, 0.95, 1.0))
    return round(float(found[0]), 4), round(float(found[1]), 4), round(float(found[2]), 4)


# ------------------ Its report: figures in words, who drove when, what was late, where robots stood


CELL = 1.0
"""m: cells of the heat map of waiting."""


def draw_gantt(result: DayResult, file: Path) -> Path:
    """Draw for each robot when it drove, and above when plans were taken over."""
    names = [o["name"] for o in result.record["objects"]]
    ax = figure_axes(12, 1.2 + 0.32 * len(names))
    for k, name in enumerate(names):
        drives = [np.array(m["samples"]) for m in result.record["motions"] if m["object"] == name]
        spans = [(rows[0, 0] / 60.0, (driven_until(rows) - rows[0, 0]) / 60.0) for rows in drives]
        ax.broken_barh(spans, (k - 0.3, 0.6), color="#4878a8", linewidth=0)
        mine = [h for h in result.handled if h.robot == name]
        spans = [(h.start / 60.0, (h.end - h.start) / 60.0) for h in mine]
        ax.broken_barh(spans, (k - 0.4, 0.8), color="#dd8452", linewidth=0)
    taken = [c[0] / 60.0 for c in result.costs if c[4]]
    ax.plot(taken, [-0.9] * len(taken), "|", color="#c44e52", label="a plan is taken over")
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    ax.set_xlabel("min since the day's start")
    ax.set_title("who drove (blue) and handled orders (orange) when")
    ax.legend(loc="upper right", frameon=False, fontsize=8)
    return save_figure(ax, file)


def draw_orders(result: DayResult, file: Path) -> Path:
    """Draw how many orders were open, and how late those were that were done."""
    ax = figure_axes(12, 3.6)
    events = [(j.came, 1) for j in result.jobs]
    events += [(j.done, -1) for j in result.jobs if j.done is not None]
    times, steps = zip(*sorted(events), strict=True) if events else ((0.0,), (0,))
    ax.step(np.array(times) / 60.0, np.cumsum(steps), where="post", color="#4878a8")
    ax.set_ylabel("orders that are open")
    ax.set_xlabel("min since the day's start")
    late = ax.twinx()
    done = [j for j in result.jobs if j.done is not None]
    when = [(j.done or 0.0) / 60.0 for j in done]
    late.plot(when, [j.tardiness for j in done], ".", color="#c44e52")
    late.set_ylabel("s late", color="#c44e52")
    late.set_ylim(-0.5, max(10.0, *(1.05 * j.tardiness for j in done)) if done else 10.0)
    ax.set_title("orders")
    return save_figure(ax, file)


def draw_waiting(result: DayResult, file: Path) -> Path:
    """Draw where robots stood though they had a motion to drive, on the map."""
    ground = ground_of(result.record)
    panels = map_panels(ground, None, "where robots waited")
    x, right, y, top = ground.extent
    where = np.array([(w[0], w[1]) for w in result.waits]).reshape(-1, 2)
    bins = (np.arange(x, right + CELL, CELL), np.arange(y, top + CELL, CELL))
    seconds, _, _ = np.histogram2d(
        where[:, 0], where[:, 1], bins=bins, weights=[w[2] for w in result.waits]
    )
    shown = np.ma.masked_less(seconds.T / 60.0, 1.0 / 60.0)
    for ax in panels:
        picture = ax.pcolormesh(*bins, shown, cmap="YlOrRd", alpha=0.8)
    panels[0].figure.colorbar(picture, ax=panels, label="min waited")
    return save_figure(panels[0], file)


def write_report(result: DayResult, folder: Path) -> list[Path]:
    """Write ``day.json``, ``day.txt`` and pictures (``gantt.png``, ``orders.png``,
    ``waiting.png``) into a folder; return the files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in ("day.json", "day.txt")]
    told = {"plan": asdict(result.plan), "figures": asdict(result.figures)}
    told["verdict"] = asdict(result.verdict)
    files[0].write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    files[1].write_text(report_text(result) + "\n", encoding="utf-8")
    for name, draw in (("gantt", draw_gantt), ("orders", draw_orders), ("waiting", draw_waiting)):
        files.append(draw(result, folder / f"{name}.png"))
    return files


def report_text(result: DayResult) -> str:
    """Return a day in words."""
    f, v = result.figures, result.verdict
    why: dict[str, int] = {}
    for *_, reason, taken in result.costs:
        if taken:
            kind = reason.replace("again: ", "")
            kind = "an order came" if kind.startswith("order") else kind.partition("'")[0].strip()
            why[kind] = why.get(kind, 0) + 1
    reasons = ", ".join(f"{n} {k}" for k, n in sorted(why.items(), key=lambda i: -i[1]))
    return "\n".join((
        f"{f.done} of {f.orders} orders done in {f.hours:g} h: {f.per_hour:g} an hour",
        f"mean tardiness {f.tardiness:g} s, {100 * f.in_time:.0f} % in time, "
        f"{f.flow:g} s from coming to done",
        f"{f.kilometres:g} km driven, {100 * f.waiting:.1f} % of the driving time waited",
        f"{f.plans} plans, {f.plans_taken} taken ({reasons})",
        "CPU of a plan: median {:.2f} s, 95 % {:.2f} s, most {:.2f} s".format(*f.planning),
        "CPU of a step: median {:.1f} ms, 95 % {:.1f} ms, most {:.1f} ms".format(
            *(1000 * s for s in f.steps)
        ),
        f"judged: {', '.join(f'{len(found)} {kind}' for kind, found in vars(v).items())}",
        f"simulated in {f.seconds:g} s",
    ))  # fmt: skip
