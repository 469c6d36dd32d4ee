"""The robots' side of the floor over HTTP: what each is to do now, its path, and what it tells.

Whoever has the robots' token (or the operator's) may ask and tell; see
:mod:`up_samp.operate.remote` for what is asked and told.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from fastapi import Depends, FastAPI, HTTPException, Request

from up_samp.model import ProblemError
from up_samp.operate.remote import RemoteRobots


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
        """Return what a robot is to do, once that is not number ``after`` any more, or after
        ``wait`` s.
        """
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
