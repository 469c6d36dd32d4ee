"""The live floor: a page and an interface over HTTP for an operation, with three tokens.

Whoever has the read-only token sees; whoever has the robots' drives them, where they are behind
HTTP; whoever has the operator's may add and cancel orders, hold and release, block areas. Nothing
here touches the operation: what is asked waits for the loop, which does it between two steps
(:meth:`FloorPage.serve`) and publishes what is to be seen.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import math
import queue
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from concurrent.futures import Future
from importlib import resources
from typing import Any

import numpy as np
import uvicorn
from fastapi import Depends, FastAPI, HTTPException, Request
from fastapi.responses import HTMLResponse, Response, StreamingResponse
from starlette.concurrency import run_in_threadpool

from up_samp.execution.reports import Command, Do, Go, Hold
from up_samp.fleet.fields import Point, Pose, corners_of
from up_samp.fleet.files import read_record
from up_samp.fleet.meanings import Kind
from up_samp.fleet.records import Zone
from up_samp.model import ProblemError, SampError
from up_samp.operate.choice import BACK, OUT
from up_samp.operate.horizon import DELIVERS
from up_samp.operate.loop import Operation
from up_samp.operate.planner import is_open
from up_samp.operate.records import DayOrder
from up_samp.operate.remote import RemoteRobots, RobotTold
from up_samp.operate.store import clock_text
from up_samp.server.guard import LOCAL, Guard

OFTEN = 0.4
"""Seconds between two looks that are published."""
WAIT = 10.0
"""Seconds that a request waits for the loop."""
MOST = 1_000_000
"""Bytes of a request."""
TOKENS = ("read", "robots", "operator")
"""Who may more comes later."""
SHOWN = 60
"""So many orders are shown, those that are open first."""


class FloorPage:
    """A server in a thread of its own, and what waits for the loop.

    It can be asked from the beginning: the port is taken (any free one for 0) before the thread
    starts.

    :raises ProblemError: where another program has the port.
    """

    def __init__(self, day: Operation, host: str, port: int) -> None:
        self.day = day
        with day.store:
            self.read, self.drive, self.write = self.tokens = [
                str(day.store.day(f"token {kind}", secrets.token_urlsafe(18))) for kind in TOKENS
            ]
        self._asked: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = queue.SimpleQueue()
        self._at = -math.inf
        self.shown = b"{}"
        self.version = 0
        app = create_floor_app(self, {host})
        self._server = uvicorn.Server(uvicorn.Config(app, log_level="warning"))
        self._door = _taken(host, port)
        self._thread = threading.Thread(target=self._server.run, args=([self._door],), daemon=True)
        self._thread.start()
        base = f"http://{host}:{self._door.getsockname()[1]}/?token="
        self.told = [f"to look: {base}{self.read}", f"to operate: {base}{self.write}"]
        if isinstance(day.robots, RemoteRobots):
            self.told.append(f"to drive robots: {base}{self.drive}")

    def serve(self) -> None:
        """Do what is asked for, and publish what is to be seen; called by the loop."""
        while not self._asked.empty():  # nobody else takes from it
            do, future = self._asked.get()
            try:
                future.set_result(do())
            except Exception as error:
                future.set_exception(error)
        if time.monotonic() >= self._at + OFTEN:
            self._at = time.monotonic()
            self.shown = json.dumps(floor_data(self.day)).encode()
            self.version += 1

    def ask(self, do: Callable[[], Any]) -> Any:
        """Let the loop do something; return its answer."""
        future: Future[Any] = Future()
        self._asked.put((do, future))
        try:
            return future.result(WAIT)
        except SampError as error:
            raise HTTPException(422, str(error)) from error
        except TimeoutError as error:
            raise HTTPException(503, "the floor does not answer") from error

    def close(self) -> None:
        """End the server."""
        self._server.should_exit = True
        self._thread.join(5.0)
        self._door.close()


def _taken(host: str, port: int) -> socket.socket:
    """Return a socket at which somebody may ask already."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise ProblemError(f"the floor's page cannot be at {host}, port {port}: {error}") from error


def create_floor_app(page: FloorPage, hosts: Collection[str]) -> FastAPI:
    """Return the application; it answers requests to this machine's names and ``hosts``."""
    app = FastAPI(title="up_samp floor", docs_url=None, redoc_url=None, openapi_url=None)
    app.add_middleware(Guard, hosts=LOCAL | {h.lower() for h in hosts}, most=MOST)
    _add_looks(app, page)
    _add_deeds(app, page)
    return app


def _token(request: Request) -> str:
    header = request.headers.get("authorization", "")
    kind, _, token = header.partition(" ")
    return token if kind.lower() == "bearer" else request.query_params.get("token", "")


def _same(one: str, other: str) -> bool:
    return hmac.compare_digest(one.encode(), other.encode())


def _right(page: FloorPage, request: Request, least: str) -> str:
    """Return what who asks may do, ``least`` or more; others are turned away."""
    token = _token(request)
    found = [kind for kind, known in zip(TOKENS, page.tokens, strict=True) if _same(token, known)]
    if not found:
        raise HTTPException(401, "give the token of this floor")
    if TOKENS.index(found[0]) < TOKENS.index(least):
        raise HTTPException(403, f"only who has the {least} token may")
    return found[0]


async def _sent(request: Request) -> dict[str, Any]:
    """Return what is sent with a request."""
    try:
        body = json.loads(await request.body() or b"{}")
    except ValueError as error:
        raise HTTPException(422, "the request is no JSON") from error
    if not isinstance(body, dict):
        raise HTTPException(422, "the request must be an object")
    return body


def _add_looks(app: FastAPI, page: FloorPage) -> None:
    def reader(request: Request) -> str:
        """Return what who asks may do; who may not even look is turned away."""
        return _right(page, request, "read")

    @app.get("/", response_class=HTMLResponse)
    def home() -> str:
        """Return the page; it asks for all else with its token."""
        return resources.files("up_samp.server").joinpath("floor.html").read_text("utf-8")

    @app.get("/v1/floor")
    def look(_: str = Depends(reader)) -> Response:
        """Return what is to be seen now."""
        return Response(page.shown, media_type="application/json")

    @app.get("/v1/site")
    def site(right: str = Depends(reader)) -> dict[str, Any]:
        """Return what does not change: walls, places, footprints, and what may be done."""
        return {**site_data(page.day), "operator": right == "operator"}

    @app.get("/v1/floor/events")
    async def events(_: str = Depends(reader)) -> StreamingResponse:
        """Stream what is to be seen as server-sent events."""

        async def stream() -> AsyncIterator[bytes]:
            seen = -1
            while True:
                if page.version != seen:
                    seen = page.version
                    yield b"event: floor\ndata: " + page.shown + b"\n\n"
                await asyncio.sleep(OFTEN / 2)

        return StreamingResponse(stream(), media_type="text/event-stream")


def _add_deeds(app: FastAPI, page: FloorPage) -> None:
    day = page.day

    async def operator(request: Request) -> dict[str, Any]:
        """Return what an operator sends; others are turned away."""
        _right(page, request, "operator")
        return {} if request.method == "DELETE" else await _sent(request)

    if isinstance(day.robots, RemoteRobots):

        async def driver(request: Request) -> dict[str, Any]:
            """Return what who drives robots sends; others are turned away."""
            _right(page, request, "robots")
            return await _sent(request)

        add_robots(app, day.robots, driver, day.settings.tick / 4)

    def deed(method: str, path: str, do: Callable[[Mapping[str, Any], str], Any]) -> None:
        async def done(request: Request, body: dict[str, Any] = Depends(operator)) -> Any:  # noqa: B008
            name = request.path_params.get("name", "")
            await run_in_threadpool(page.ask, lambda: do(body, name))
            return {"done": True}

        app.add_api_route(path, done, methods=[method])

    def robot(body: Mapping[str, Any]) -> str:
        return str(body.get("robot", ""))

    deed("POST", "/v1/orders", lambda body, _: day.add(body))
    deed("DELETE", "/v1/orders/{name}", lambda _, name: day.cancel(name))
    deed("POST", "/v1/hold", lambda body, _: day.hold(robot(body), str(body.get("why", "by hand"))))
    deed("POST", "/v1/release", lambda body, _: day.release(robot(body)))
    deed("POST", "/v1/robots/{name}/leave", lambda body, name: day.leave(
        name, str(body.get("why", "out of order")), _pose(body)))  # fmt: skip
    deed("POST", "/v1/robots/{name}/join", lambda body, name: day.join(name, _pose(body)))
    deed("POST", "/v1/robots/{name}/charge", lambda body, name: day.charge(name))
    deed("POST", "/v1/doors/{name}/shut", lambda body, name: day.close_door(name))
    deed("POST", "/v1/doors/{name}/mend", lambda body, name: day.close_door(name, BACK))
    deed("POST", "/v1/areas/{name}", lambda body, name: day.block(name, _corners(body)))
    deed("DELETE", "/v1/areas/{name}", lambda _, name: day.unblock(name))


def _pose(body: Mapping[str, Any]) -> Pose | None:
    """Return where somebody says that a robot stands (None: nobody does)."""
    found: RobotTold = read_record(RobotTold, {"pose": body.get("pose")})
    return found.pose


def _corners(body: Mapping[str, Any]) -> tuple[Point, ...]:
    """Return the ``corners`` of an area: ``[[x, y], ...]``."""
    found: Zone = read_record(Zone, {"polygon": body.get("corners")})
    return found.polygon


# ------------------ What is to be seen


def site_data(day: Operation) -> dict[str, Any]:
    """Return what does not change on a floor, as JSON would hold it."""
    from up_samp.geometry.maps import load_map

    grid = load_map(day.folder / day.site.map)
    rows, cols = np.nonzero(grid.occupied)
    height, width = (n * grid.resolution for n in grid.occupied.shape)
    step = max(1, round(0.1 / grid.resolution))
    cells = sorted({(int(c) // step, int(r) // step) for r, c in zip(rows, cols, strict=True)})
    return {
        "name": day.site.name,
        "size": [width, height],
        "origin": list(grid.origin[:2]),
        "cell": step * grid.resolution,
        "walls": cells,
        "places": {n: list(p.pose) for n, p in day.site.places.items()},
        "doors": {n: [list(c) for c in corners_of(d.leaf)] for n, d in day.site.doors.items()},
        "zones": [
            {"name": n, "polygon": [list(c) for c in z.polygon], "says": _rule(z)}
            for n, z in day.site.zones.items()
        ],
        "robots": {
            n: [list(c) for c in corners_of(day.site.robot_types[r.type].footprint)]
            for n, r in day.site.robots.items()
        },
    }


def _rule(zone: Zone) -> str:
    """Return what a zone asks for, in words."""
    told = (
        (zone.max_robots, f"{zone.max_robots} at a time"),
        (zone.keep_out, f"not for {', '.join(zone.keep_out)}"),
        (zone.v_max, f"at most {zone.v_max} m/s"),
        (zone.one_way is not None, f"one way, heading {zone.one_way} rad"),
        (zone.pivoting == "never", "no turning on the spot"),
    )
    return ", ".join(words for is_so, words in told if is_so)


def floor_data(day: Operation) -> dict[str, Any]:
    """Return what is to be seen on a floor now, as JSON would hold it."""
    now = day.clock.now()
    jobs = sorted(day.jobs.values(), key=lambda j: (not j.state.open, -j.came))[:SHOWN]
    ends = _forecast(day)
    return {
        "time": clock_text(now, day.store.day("epoch")),
        "now": round(now, 1),
        "plan": day.number,
        "why": day.wanted,
        "robots": {n: _robot(day, n) for n in day.site.robots},
        "doors": _doors(day),
        "areas": {n: [list(c) for c in shape] for n, shape in day.areas.items()},
        "orders": [
            {
                "id": j.id,
                "state": j.state.value,
                "robot": j.robot or ends.get(j.id, ("", 0.0))[0],
                "release": _ahead(j, now),
                "due": None if j.record.due is None else round(j.record.due - now),
                "forecast": round(ends[j.id][1] - now) if j.id in ends and j.state.open else None,
                "late": round(j.tardiness),
            }
            for j in jobs
        ],
    }


def _ahead(job: DayOrder, now: float) -> int | None:
    """Return in how many seconds an order that is to be done is released (None: it is)."""
    later = job.record.release - now
    return round(later) if job.state.open and later > 0.0 else None


def _forecast(day: Operation) -> dict[str, tuple[str, float]]:
    """Return by order who does it, and when it will be done (s of the day)."""
    ahead = day.executor.retime()
    return {
        m.what: (m.robot, ahead.span(n)[1] + day.origin)
        for n, m in day.meanings.items()
        if m.kind in DELIVERS
    }


def _doors(day: Operation) -> dict[str, dict[str, Any]]:
    """Return where each door's leaf stands, whether that is open, and who waits for it."""
    openings = {a: m.what for a, m in day.meanings.items() if m.kind is Kind.OPEN}
    doing = {getattr(day.commands.get(r), "activity", ""): r for r in day.site.robots}
    awaited = {(openings.get(w, w), r) for r in day.site.robots for w in day.executor.waits_for(r)}
    awaited -= {(door, doing.get(a, "")) for a, door in openings.items()}
    return {
        n: {
            "pose": list(day.pose(n)),
            "open": is_open(door, day.pose(n)),
            "waiting": sorted(r for what, r in awaited if what == n),
            "shut": day.shut.get(n) == OUT,
        }
        for n, door in day.site.doors.items()
    }


def _waits(day: Operation, name: str, command: Command | None) -> list[str]:
    """Return the robots, and the doors, that a robot waits for which stands, or soon will."""
    if isinstance(command, Do) or name in day.off_plan():
        return []
    under = day.executor.state.of_object.get(name)
    gone = 0.0 if under is None else under.progress + day.gone.get(under.activity, 0.0)
    near = 5 * day.error(name)
    if isinstance(command, Go) and command.until > gone + near:
        return []
    awaited = {day.meanings.get(w, w) for w in day.executor.waits_for(name)}
    found = {
        w if isinstance(w, str) else w.what if w.kind is Kind.OPEN else w.robot for w in awaited
    }
    return sorted(found - {name, "time", ""})


def _robot(day: Operation, name: str) -> dict[str, Any]:
    command, executor = day.commands.get(name), day.executor
    what, way, why = "idle", [], ""
    if isinstance(command, Go):
        what = f"drives to {command.motion.rpartition('_to_')[2].partition('#')[0]}"
    elif isinstance(command, Do):
        what = f"does: {command.activity.partition('#')[0]}"
    elif isinstance(command, Hold) and command.waiting_for:
        event, _, told = command.waiting_for[0].partition(" (")
        what, why = "stands", told.removesuffix(")") or event
    if (under := executor.state.of_object.get(name)) is not None:
        path = executor.drives[under.activity, name].path
        at = np.linspace(min(under.progress, path.length), path.length, 30)
        way = [[round(float(v), 2) for v in p[:2]] for p in path.poses_at(at)]
    return {
        "pose": [round(v, 3) for v in day.pose(name)],
        "what": what,
        "waits": _waits(day, name, command),
        "why": why,
        "way": way,
        "held": day.held.get(name, ""),
        "away": day.away.get(name, ""),
        "adrift": name in day.adrift(),
        "charges": day.site.kind_of(name).battery is not None,
        "battery": None if (level := day.robots.levels.get(name)) is None else round(100 * level),
    }


# ------------------ The robots' side: what each is to do now, its path, and what it tells


def add_robots(
    app: FastAPI, robots: RemoteRobots, driver: Callable[[Request], Any], often: float
) -> None:
    """Add the requests of those who drive robots: ``driver`` returns what they send, and turns away
    whoever may not. ``often``: seconds between two looks for another command.
    """

    def told(robot: str, look: Callable[[str], dict[str, Any]]) -> dict[str, Any]:
        try:
            return look(robot)
        except ProblemError as error:
            raise HTTPException(404, str(error)) from error

    @app.get("/v1/robots/{name}/command")
    async def command(
        name: str,
        after: int = 0,
        wait: float = 5.0,
        _: dict[str, Any] = Depends(driver),  # noqa: B008
    ) -> dict[str, Any]:
        """Return what a robot is to do: once it is not number ``after``, or after ``wait`` s."""
        looks = round(min(max(wait, 0.0), 30.0) / often)
        while (found := told(name, robots.command))["number"] == after and looks > 0:
            looks -= 1
            await asyncio.sleep(often)
        return found

    @app.get("/v1/robots/{name}/path")
    def path(name: str, _: dict[str, Any] = Depends(driver)) -> dict[str, Any]:  # noqa: B008
        """Return the path of the motion that a robot is to drive now."""
        return told(name, robots.path)

    @app.post("/v1/robots/{name}/reports")
    async def report(name: str, sent: dict[str, Any] = Depends(driver)) -> dict[str, Any]:  # noqa: B008
        """Take in what a robot tells."""
        told(name, robots.command)
        try:
            robots.take(name, sent)
        except ProblemError as error:
            raise HTTPException(422, str(error)) from error
        return {"taken": True}
