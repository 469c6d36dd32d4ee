"""The HTTP interface: ``create_app(jobs)`` is an ASGI application (FastAPI); its OpenAPI document
is at ``/openapi.json``, its page at ``/``.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from importlib import resources
from typing import Any

from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, StreamingResponse

from up_samp.server.jobs import Job, JobQueue, QueueFullError
from up_samp.server.requests import PlanRequest, ValidateRequest


def create_app(jobs: JobQueue) -> FastAPI:
    """Return the application that serves ``jobs``. Whoever made ``jobs`` closes it."""
    from up_samp import __version__

    app = FastAPI(title="up_samp", version=__version__, docs_url=None, redoc_url=None)
    _limit_requests(app, jobs.limits.request)

    def find(name: str) -> Job:
        job = jobs.get(name)
        if job is None:
            raise HTTPException(404, f"there is no plan '{name}'")
        return job

    @app.get("/", response_class=HTMLResponse, include_in_schema=False)
    def page() -> str:
        """Return the page that shows maps, progress and plans."""
        return resources.files("up_samp.server").joinpath("page.html").read_text("utf-8")

    @app.post("/v1/plans", status_code=202)
    def submit(request: PlanRequest) -> dict[str, Any]:
        """Queue a problem; the answer holds its ``id``."""
        return _submitted(jobs, request.model_dump(mode="json")).status()

    @app.get("/v1/plans/{name}")
    def status(name: str) -> dict[str, Any]:
        """Return where a job is, its bounds, and the best plan so far (null: none yet)."""
        job = find(name)
        return {**job.status(), "plan": job.plan}

    @app.get("/v1/plans/{name}/events")
    def events(name: str, request: Request, begin: int = 0) -> StreamingResponse:
        """Stream what happens as server-sent events; ``begin`` (or the header Last-Event-ID, which
        browsers send when they come back) tells from which event on.
        """
        job = find(name)
        seen = request.headers.get("last-event-id", "")
        first = int(seen) + 1 if seen.isdecimal() else max(0, begin)
        return StreamingResponse(_stream(job, first), media_type="text/event-stream")

    @app.delete("/v1/plans/{name}")
    def stop(name: str) -> dict[str, Any]:
        """End a job and return the best plan that it had."""
        job = find(name)
        jobs.stop(job)
        return {**job.status(), "plan": job.plan}

    _add_animation(app, find)
    _add_validation(app, jobs)
    return app


def _add_animation(app: FastAPI, find: Callable[[str], Job]) -> None:
    @app.get("/v1/plans/{name}/animation.html", response_class=HTMLResponse)
    def animation(name: str) -> str:
        """Return a page that plays the best plan so far."""
        from up_samp.server.drawing import animation_of

        job = find(name)
        if job.plan is None:
            raise HTTPException(404, f"there is no plan of '{name}' yet")
        return animation_of(job.plan, job.request["map"])


def _add_validation(app: FastAPI, jobs: JobQueue) -> None:
    @app.post("/v1/validate")
    def validate(request: ValidateRequest) -> dict[str, Any]:
        """Judge a plan; the answer holds ``valid`` and the ``violations``."""
        asked = {**request.model_dump(mode="json"), "timeout": jobs.limits.grace}
        job = _submitted(jobs, asked)
        for _ in job.follow():
            pass
        end = job.end or {}
        if end.get("status") != "JUDGED":
            raise HTTPException(422, end.get("message", "the plan could not be judged"))
        return {"valid": end["valid"], "violations": end["violations"]}


def _submitted(jobs: JobQueue, request: dict[str, Any]) -> Job:
    """Queue a job; where there is no room the client is told to come back."""
    try:
        return jobs.submit(request)
    except QueueFullError as error:
        raise HTTPException(503, str(error), headers={"Retry-After": "10"}) from error


def _limit_requests(app: FastAPI, most: int) -> None:
    """Turn away requests that are larger than ``most`` bytes, before they are read."""

    @app.middleware("http")
    async def limit(request: Request, call_next: Any) -> Response:
        length = request.headers.get("content-length")
        if request.method in ("POST", "PUT", "PATCH"):
            if length is None or not length.isdecimal():
                return JSONResponse({"detail": "the header Content-Length is needed"}, 411)
            if int(length) > most:
                return JSONResponse({"detail": f"requests may hold {most} bytes at most"}, 413)
        answer: Response = await call_next(request)
        return answer


async def _stream(job: Job, begin: int) -> AsyncIterator[str]:
    """Yield a job's events as server-sent events, and comments while nothing happens."""
    source = job.follow(begin)
    while True:
        item = await asyncio.to_thread(next, source, StopIteration)
        if item is StopIteration:
            yield f"event: state\ndata: {json.dumps(job.status())}\n\n"
            return
        if item is None:
            yield ": waiting\n\n"
            continue
        number, event = item  # type: ignore[misc]
        yield f"id: {number}\nevent: {event['event']}\ndata: {json.dumps(event)}\n\n"
