"""``up-samp operate``, ``day`` and ``why``: a day on the floor, a simulated one, and who was told
what.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import tempfile
import time
from pathlib import Path

from up_samp.fleet import Fleet
from up_samp.fleet.spelled_out import with_places
from up_samp.model import ProblemError
from up_samp.system.imports import extra


def add_operate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``operate``."""
    parser.add_argument("site", type=Path, metavar="SITE.yaml")
    parser.add_argument("--store", type=Path, required=True, metavar="DAY.db")
    parser.add_argument(
        "--mqtt",
        type=broker,
        metavar="HOST:PORT",
        help="the robots' broker (VDA 5050); none: simulated robots",
    )
    parser.add_argument(
        "--robots",
        choices=("simulated", "http"),
        default="simulated",
        help="without a broker: simulated ones, or those that whoever drives them asks and tells "
        "of over --http (default: %(default)s)",
    )
    parser.add_argument("--prefix", default="uagv", help="of topics (default: %(default)s)")
    parser.add_argument("--manufacturer", default="up_samp", help="(default: %(default)s)")
    parser.add_argument("--vda", default="2.1.0", metavar="VERSION", help="(default: %(default)s)")
    parser.add_argument("--user", help="of the broker; its password is in UP_SAMP_MQTT_PASSWORD")
    parser.add_argument("--tls", action="store_true", help="speak to the broker over TLS")
    parser.add_argument(
        "--ca", metavar="FILE", help="certificates that TLS trusts (none: this machine's)"
    )
    parser.add_argument(
        "--localisation",
        type=float,
        default=0.05,
        metavar="M",
        help="how far from the truth robots may tell to be that say nothing else in the site file "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--spacing", type=float, default=0.0, metavar="M",
        help="of nodes, for robots that drive straight from node to node",
    )  # fmt: skip
    parser.add_argument(
        "--orders", type=Path, metavar="FILE",
        help="orders, listed as in a site file: looked at again whenever it changes",
    )  # fmt: skip
    parser.add_argument(
        "--http", type=int, metavar="PORT", help="the floor's page, on this machine"
    )
    parser.add_argument("--host", default="127.0.0.1", help="(default: %(default)s)")
    parser.add_argument("--budget", type=float, default=2.0, metavar="S", help="of a plan")
    parser.add_argument("--seconds", type=float, metavar="S", help="end after so long")
    parser.set_defaults(run=_operate)


def broker(text: str) -> tuple[str, int]:
    """Return where a broker is: ``HOST``, or ``HOST:PORT``.

    :raises ValueError: where the port is no number.
    """
    host, _, port = text.partition(":")
    return host, int(port or 1883)


def _operate(args: argparse.Namespace) -> int:
    from up_samp.operate import Operation, RealClock, Settings, Store
    from up_samp.operate.planner import least_margin
    from up_samp.operate.remote import RemoteRobots
    from up_samp.operate.simulated import SimulatedRobots, SteppedClock

    if args.robots == "http" and (args.mqtt is not None or args.http is None):
        raise ProblemError("--robots http is without --mqtt, and needs --http PORT")
    fleet, store = Fleet.from_file(args.site), Store(args.store)
    site = with_places(fleet.records)
    epoch = store.day("epoch", time.time())
    clock = RealClock(epoch)
    settings = Settings(budget=args.budget, localisation=args.localisation)
    least = least_margin(site, args.localisation)
    if site.margin < least:
        print(f"note: robots may pass each other at less than their errors; a margin of {least:g} m"
              f" in the site file covers them, it is {site.margin:g}", flush=True)  # fmt: skip
    if args.mqtt is None and args.robots == "simulated":
        floor = SimulatedRobots(
            {n: site.places[r.start].pose for n, r in site.robots.items()}, site=site
        )
        stepped = SteppedClock(clock, floor)
        day = Operation(fleet, store=store, robots=floor, clock=stepped, settings=settings)
        with contextlib.closing(day):
            return _until(day, args)
    robots = _behind_broker(args, fleet) if args.mqtt else RemoteRobots(site)
    day = Operation(fleet, store=store, robots=robots, clock=clock, settings=settings)
    with contextlib.closing(robots), contextlib.closing(day):
        return _until(day, args)


def _behind_broker(args: argparse.Namespace, fleet: Fleet):  # type: ignore[no-untyped-def]
    import os

    with extra("a broker", "mqtt", "paho-mqtt"):
        from up_samp.operate.vda5050 import MasterControl
    return MasterControl(
        fleet.records,
        *args.mqtt,
        prefix=args.prefix,
        manufacturer=args.manufacturer,
        version=args.vda,
        user=args.user,
        password=os.environ.get("UP_SAMP_MQTT_PASSWORD"),
        tls=args.ca or args.tls,
        spacing=args.spacing,
    )


def _until(day, args: argparse.Namespace) -> int:  # type: ignore[no-untyped-def]
    from up_samp.operate.order_file import OrderFile

    orders = None if args.orders is None else OrderFile(day, args.orders)
    page = None
    if args.http is not None:
        with extra("the floor's page", "server", "fastapi uvicorn"):
            from up_samp.server.floor import FloorPage
        page = FloorPage(day, args.host, args.http)
        print("\n".join(page.told), flush=True)
    stop = None if args.seconds is None else time.monotonic() + args.seconds
    print(f"operating '{args.site}', kept in '{args.store}'", flush=True)
    try:
        while stop is None or time.monotonic() < stop:
            if page is not None:
                page.serve()
            for words in () if orders is None else orders.look():
                print(f"note: {words}", flush=True)
            day.step()
    finally:
        if page is not None:
            page.close()
    return 0


def add_day(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``day``."""
    parser.add_argument("site", type=Path, metavar="SITE.yaml")
    parser.add_argument("--orders-per-hour", type=float, default=60.0, metavar="N")
    parser.add_argument("--hours", type=float, default=8.0, metavar="H")
    parser.add_argument("--due", type=float, default=300.0, metavar="S", help="after an order came")
    parser.add_argument("--noise", type=float, default=0.0, metavar="M", help="of what robots tell")
    parser.add_argument("--delays", type=float, default=0.0, metavar="SHARE")
    parser.add_argument("--breakdowns", type=int, default=0, metavar="N")
    parser.add_argument("--speed", type=float, default=0.0, metavar="N", help="times real time")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for report and pictures")
    parser.set_defaults(run=_day)


def _day(args: argparse.Namespace) -> int:
    from up_samp.operate.day import DayPlan, report_text, simulate_day, write_report

    plan = DayPlan(
        hours=args.hours, orders_per_hour=args.orders_per_hour, due=args.due, noise=args.noise,
        delays=args.delays, breakdowns=args.breakdowns, seed=args.seed,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        store = (args.out or Path(folder)) / "day.db"
        store.parent.mkdir(parents=True, exist_ok=True)
        if store.exists():
            raise ProblemError(f"'{store}' is there already: name another folder")
        result = simulate_day(Fleet.from_file(args.site), plan, store, speed=args.speed)
    print(report_text(result))
    if args.out is not None:
        print("\n".join(str(f) for f in write_report(result, args.out)))
    return 0 if result.verdict.good else 1


def add_why(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``why``."""
    parser.add_argument("store", type=Path, metavar="DAY.db")
    parser.add_argument("about", metavar="ROBOT|ORDER")
    parser.add_argument("time", nargs="?", help="10:42 or 10:42:30, or seconds (default: the end)")
    parser.add_argument("--lines", type=int, default=8, metavar="N", help="(default: %(default)s)")
    parser.set_defaults(run=_why)


def _why(args: argparse.Namespace) -> int:
    from up_samp.operate.store import Store, clock_text

    store = Store(args.store, write=False)
    epoch = store.day("epoch")
    until = None if args.time is None else _seconds(args.time, epoch)
    lines = store.notes(args.about, until, args.lines)
    store.close()
    if not lines:
        raise ProblemError(f"nothing was told of '{args.about}' until then")
    for when, kind, about, what, why in lines:
        because = f"  because: {why}" if why else ""
        print(f"{clock_text(when, epoch)}  {kind} {about}: {what}{because}")
    return 0


def _seconds(text: str, epoch: float | None) -> float:
    """Return a time since the day's start (s)."""
    if re.fullmatch(r"\d+(\.\d+)?", text):
        return float(text)
    found = re.fullmatch(r"(\d{1,2}):([0-5]\d)(?::([0-5]\d))?", text)
    if found is None:
        raise ProblemError(f"'{text}' is no time: write 10:42, 10:42:30, or seconds")
    h, m, s = (int(v or 0) for v in found.groups())
    # all of the minute, where no seconds are named
    clock = 3600 * h + 60 * m + (s if found[3] else 59)
    if epoch is None:
        return float(clock)
    begun = time.localtime(epoch)
    return float(clock - 3600 * begun.tm_hour - 60 * begun.tm_min - begun.tm_sec) % 86400.0
