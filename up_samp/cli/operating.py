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

from up_samp.cli.options import DEFAULT, Command, option
from up_samp.fleet import Fleet
from up_samp.fleet.spelled_out import with_places
from up_samp.model import ProblemError
from up_samp.system.imports import extra


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


_SITE = option("site", None, "SITE.yaml", Path)
COMMANDS: dict[str, Command] = {
    "operate": (_operate, (
        _SITE,
        option("--store", None, "DAY.db", Path, required=True),
        option("--mqtt", "the robots' broker (VDA 5050); none: simulated robots", "HOST:PORT",
               broker),
        option("--robots", "without a broker: simulated ones, or those that whoever drives them "
               "asks and tells of over --http (default: %(default)s)", default="simulated",
               choices=("simulated", "http")),
        option("--prefix", "of topics (default: %(default)s)", default="uagv"),
        option("--manufacturer", DEFAULT, default="up_samp"),
        option("--vda", DEFAULT, "VERSION", default="2.1.0"),
        option("--user", "of the broker; its password is in UP_SAMP_MQTT_PASSWORD"),
        option("--tls", "speak to the broker over TLS", action="store_true"),
        option("--ca", "certificates that TLS trusts (none: this machine's)", "FILE"),
        option("--localisation", "how far from the truth robots may tell to be that say nothing "
               "else in the site file (default: %(default)s)", "M", float, 0.05),
        option("--spacing", "of nodes, for robots that drive straight from node to node", "M",
               float, 0.0),
        option("--orders", "orders, listed as in a site file: looked at again whenever it changes",
               "FILE", Path),
        option("--http", "the floor's page, on this machine", "PORT", int),
        option("--host", DEFAULT, default="127.0.0.1"),
        option("--budget", "of a plan", "S", float, 2.0),
        option("--seconds", "end after so long", "S", float),
    )),
    "day": (_day, (
        _SITE,
        option("--orders-per-hour", None, "N", float, 60.0),
        option("--hours", None, "H", float, 8.0),
        option("--due", "after an order came", "S", float, 300.0),
        option("--noise", "of what robots tell", "M", float, 0.0),
        option("--delays", None, "SHARE", float, 0.0),
        option("--breakdowns", None, "N", int, 0),
        option("--speed", "times real time", "N", float, 0.0),
        option("--seed", None, "N", int, 0),
        option("--out", "folder for report and pictures", "DIR", Path),
    )),
    "why": (_why, (
        option("store", None, "DAY.db", Path),
        option("about", None, "ROBOT|ORDER"),
        option("time", "10:42 or 10:42:30, or seconds (default: the end)", nargs="?"),
        option("--lines", DEFAULT, "N", int, 8),
    )),
}  # fmt: skip
