"""Guards: requests that are turned away by their headers, before anything of them is read."""

from __future__ import annotations

from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

LOCAL = frozenset({"localhost", "127.0.0.1", "::1"})
"""Names of this machine for itself."""


class Guard:
    """Passes on requests to ``hosts`` only, of ``most`` bytes at most.

    Any page that a user of this machine looks at may send requests to it; what it cannot choose is
    the header ``Host`` (a name of its own, though that leads here) and ``Origin``.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str], most: int) -> None:
        self.app, self.hosts, self.most = app, hosts, most

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""
        refused = self._refused(scope) if scope["type"] == "http" else None
        if refused is None:
            await self.app(scope, receive, send)
            return
        status, why = refused
        # what follows is not read: the connection ends with the answer
        answer = JSONResponse({"detail": why}, status, {"Connection": "close"})
        await answer(scope, receive, send)

    def _refused(self, scope: Scope) -> tuple[int, str] | None:
        headers = Headers(scope=scope)
        if _name(f"//{headers.get('host', '')}") not in self.hosts:
            return 421, "this host is not served here; 'up-samp serve --allow-host NAME' allows it"
        origin = headers.get("origin")
        if origin is not None and _name(origin) not in self.hosts:
            return 403, "pages of other hosts may not ask"
        if scope["method"] not in ("POST", "PUT", "PATCH"):
            return None
        length = headers.get("content-length", "")
        if not length.isdecimal() or "transfer-encoding" in headers:
            return 411, "the header Content-Length is needed"
        if len(length) > 15 or int(length) > self.most:
            return 413, f"requests may hold {self.most} bytes at most"
        if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
            return 415, "the header Content-Type must be application/json"
        return None


def _name(url: str) -> str | None:
    """Return the host that a URL names, without its port."""
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None
