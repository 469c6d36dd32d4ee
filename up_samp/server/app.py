"""The HTTP interface: ``create_app(jobs)`` is an ASGI application (FastAPI); its OpenAPI document
is at ``/openapi.json``, its page at ``/``.
"""

from __future__ import annotations

import asyncio
import dataclasses
import json
import queue
from collections.abc import AsyncIterator, Callable, Collection, Iterator
from contextlib import asynccontextmanager, contextmanager
from importlib import resources
from typing import Any

import anyio
from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.openapi.utils import get_openapi
from fastapi.responses import HTMLResponse, StreamingResponse
from pydantic import create_model

from up_samp.model.errors import short
from up_samp.server.guard import LOCAL, Guard
from up_samp.server.jobs import ENDED, Desk, Job, JobQueue
from up_samp.server.requests import REQUESTS

AGAIN = {"Retry-After": "10"}
"""What clients are told that come when there is no room."""
LOOK = 0.1
"""How often a stream looks for news, s."""


def create_app(jobs: JobQueue, hosts: Collection[str] = ()) -> FastAPI:
    """Return the application that serves ``jobs``. Whoever made ``jobs`` closes it. It answers
    requests to this machine's own names, and to ``hosts``.
    """
    from up_samp import __version__

    doors = Doors(jobs)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        with doors.desk:
            yield

    app = FastAPI(
        title="up_samp", version=__version__, docs_url=None, redoc_url=None, lifespan=lifespan
    )
    app.add_middleware(Guard, hosts=LOCAL | {h.lower() for h in hosts}, most=jobs.limits.request)

    @app.get("/", response_class=HTMLResponse, include_in_schema=False)
    def page() -> str:
        """Return the page that shows maps, progress and plans."""
        return resources.files("up_samp.server").joinpath("page.html").read_text("utf-8")

    @app.get("/editor.js", include_in_schema=False)
    def editor() -> Response:
        """Return the page's editor of sites."""
        script = resources.files("up_samp.server").joinpath("editor.js").read_bytes()
        return Response(script, media_type="text/javascript")

    _add_jobs(app, doors)
    _add_results(app, doors)
    _describe(app, jobs)
    return app


class Doors:
    """What the doors of a server share: its jobs, its desk, and the room for what arrives."""

    def __init__(self, jobs: JobQueue) -> None:
        self.jobs = jobs
        self.desk = Desk(jobs.limits)
        self._turn = anyio.CapacityLimiter(1)
        self._arriving = 0

    def find(self, name: str) -> Job:
        """Return a job by its id; else the client is told that there is none."""
        job = self.jobs.get(name)
        if job is None:
            raise HTTPException(404, f"there is no plan '{short(name)}'")
        return job

    async def ask(self, kind: str, *parts: bytes) -> tuple[dict[str, Any], bytes]:
        """Ask at the desk, when it is our turn."""
        try:
            return await anyio.to_thread.run_sync(self.desk.ask, kind, *parts, limiter=self._turn)
        except TimeoutError as error:
            raise HTTPException(422, f"the request could not be read: {error}") from error

    async def submitted(self, kind: str, request: Request) -> Job:
        """Return a job for what a client sends, once nothing is wrong with it."""
        with _room(self.jobs.check_room), self._reserved(int(request.headers["content-length"])):
            body = await self._body(request)
            answer, _ = await self.ask(kind, body)
            if answer["faults"]:
                raise HTTPException(422, answer["faults"])
            seconds = answer["timeout"] or self.jobs.limits.grace
            with _room():
                return self.jobs.submit(kind, body, seconds)

    @contextmanager
    def _reserved(self, size: int) -> Iterator[None]:
        """Keep room for a body while it arrives and is looked at."""
        if self._arriving + size > self.jobs.limits.arriving:
            raise HTTPException(503, "too many requests arrive at once", headers=AGAIN)
        self._arriving += size
        try:
            yield
        finally:
            self._arriving -= size

    async def _body(self, request: Request) -> bytes:
        seconds = self.jobs.limits.body_seconds
        try:
            return await asyncio.wait_for(request.body(), seconds)
        except TimeoutError as error:
            raise HTTPException(408, f"the request did not arrive in {seconds:g} s") from error


@contextmanager
def _room(check: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Tell a client to come back where the queue is full."""
    try:
        check()
        yield
    except queue.Full as error:
        raise HTTPException(503, str(error), headers=AGAIN) from error


def _with_plan(job: Job) -> Response:
    """Return a job's state and its best plan, which is JSON already."""
    state = json.dumps(job.status())[:-1].encode()
    plan = job.plan or b"null"
    return Response(b"".join((state, b', "plan": ', plan, b"}")), media_type="application/json")


def _add_jobs(app: FastAPI, doors: Doors) -> None:
    find, jobs = doors.find, doors.jobs

    @app.post("/v1/plans", status_code=202, **_documented(408, 411, 413, 415, 422, 503))
    async def submit(request: Request) -> dict[str, Any]:
        """Queue a problem; the answer holds its ``id``."""
        return (await doors.submitted("plan", request)).status()

    @app.get("/v1/plans")
    async def all_jobs() -> list[dict[str, Any]]:
        """Return all jobs that are known, the oldest first, without their plans."""
        return [job.status() for job in jobs.all("plan")]

    @app.get("/v1/plans/{name}", **_documented(404))
    async def status(name: str) -> Response:
        """Return where a job is, its bounds, and the best plan so far (null: none yet)."""
        return _with_plan(find(name))

    @app.delete("/v1/plans/{name}", **_documented(404))
    def stop(name: str) -> Response:
        """End a job and return the best plan that it had; one that has ended stays as it is."""
        job = find(name)
        jobs.stop(job)
        return _with_plan(job)


def _add_results(app: FastAPI, doors: Doors) -> None:
    find, jobs = doors.find, doors.jobs

    @app.get("/v1/plans/{name}/events", **_documented(404, 422))
    async def events(name: str, request: Request, begin: int = 0) -> StreamingResponse:
        """Stream what happens as server-sent events; ``begin`` (or the header Last-Event-ID, which
        browsers send when they come back) tells from which event on.
        """
        job = find(name)
        seen = request.headers.get("last-event-id", "")
        first = int(seen) + 1 if seen.isdecimal() and len(seen) < 10 else max(0, begin)
        return StreamingResponse(_stream(job, first), media_type="text/event-stream")

    @app.get("/v1/plans/{name}/animation.html", response_class=HTMLResponse, **_documented(404))
    async def animation(name: str) -> HTMLResponse:
        """Return a page that plays the best plan so far."""
        job = find(name)
        if job.plan is None:
            raise HTTPException(404, f"there is no plan of '{short(name)}' yet")
        answer, drawn = await doors.ask("draw", job.body, job.plan)
        if answer.get("faults"):
            raise HTTPException(500, answer["faults"][0]["msg"])
        return HTMLResponse(drawn)

    @app.post("/v1/validate", **_documented(408, 411, 413, 415, 422, 503))
    async def validate(request: Request) -> dict[str, Any]:
        """Judge a plan; the answer holds ``valid`` and the ``violations``."""
        job = await doors.submitted("validate", request)
        try:
            while job.state not in ENDED:
                if await request.is_disconnected():
                    raise HTTPException(499, "the client has gone")
                await asyncio.sleep(LOOK)
        finally:
            await anyio.to_thread.run_sync(jobs.forget, job)
        end = job.end or {}
        if end.get("status") != "JUDGED":
            raise HTTPException(422, end.get("message", "the plan could not be judged"))
        return {"valid": end["valid"], "violations": end["violations"]}


async def _stream(job: Job, begin: int) -> AsyncIterator[str]:
    """Yield a job's events as server-sent events, and comments while nothing happens."""
    number, quiet = begin, 0.0
    while True:
        new, over = job.since(number)
        for event in new:
            yield f"id: {number}\nevent: {event['event']}\ndata: {json.dumps(event)}\n\n"
            number += 1
        if over:
            yield f"event: state\ndata: {json.dumps(job.status())}\n\n"
            return
        quiet = 0.0 if new else quiet + LOOK
        if quiet >= 1.0:
            yield ": waiting\n\n"
            quiet = 0.0
        await asyncio.sleep(LOOK)


# ---------------------------------------------------------------------- what OpenAPI says
ANSWERS = {
    403: "A page of another host asks.",
    404: "There is no such plan.",
    408: "The request did not arrive in time.",
    411: "The header Content-Length is needed.",
    413: "The request is larger than it may be.",
    415: "The request is no JSON by its header Content-Type.",
    421: "The request is meant for another host.",
    422: "Something is wrong in the request; 'detail' tells each fault with its place.",
    503: "There is no room; 'Retry-After' tells when to come back.",
}
"""What the server answers where it does not do what it is asked for."""


Fault = create_model("Fault", loc=(list[str | int], ...), msg=(str, ...), type=(str, ...))
_DETAIL: Any = str | list[Fault]  # type: ignore[valid-type]
Refusal = create_model("Refusal", detail=(_DETAIL, ...))
"""What answers hold that do not do what they are asked for."""


def _documented(*codes: int) -> dict[str, Any]:
    """Return the answers of a path other than its own, for OpenAPI."""
    every = sorted({*codes, 403, 421})
    return {"responses": {c: {"description": ANSWERS[c], "model": Refusal} for c in every}}


def _describe(app: FastAPI, jobs: JobQueue) -> None:
    """Add to the OpenAPI document what requests hold (they are read elsewhere) and the limits."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            found = get_openapi(title=app.title, version=app.version, routes=app.routes)
            found["info"]["x-limits"] = dataclasses.asdict(jobs.limits)
            schemas = found.setdefault("components", {}).setdefault("schemas", {})
            for kind, path in (("plan", "/v1/plans"), ("validate", "/v1/validate")):
                model = REQUESTS[kind].model_json_schema(
                    ref_template="#/components/schemas/{model}"
                )
                schemas.update(model.pop("$defs", {}))
                schemas[REQUESTS[kind].__name__] = model
                schema = {"$ref": f"#/components/schemas/{REQUESTS[kind].__name__}"}
                asked = {"required": True, "content": {"application/json": {"schema": schema}}}
                found["paths"][path]["post"]["requestBody"] = asked
            app.openapi_schema = found
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]
