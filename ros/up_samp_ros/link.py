"""Requests to a floor that is operated (``up-samp operate --robots http --http PORT``)."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote, urlencode

Message = dict[str, Any]


class LostError(Exception):
    """Nobody answers, or refuses; in words."""


class Link:
    """Asks ``url`` (``http://HOST:PORT``) with a token; ``patience`` s for an answer beyond what
    it is asked to wait.
    """

    def __init__(self, url: str, token: str, patience: float = 2.0) -> None:
        self.url, self.token, self.patience = url.rstrip("/"), token, patience

    def command(self, robot: str, after: int, wait: float) -> Message:
        """Return what a robot is to do, once that is not number ``after``, or after ``wait`` s."""
        return self._ask(f"/v1/robots/{robot}/command", wait=wait, query={"after": after})

    def path(self, robot: str) -> Message:
        """Return the path that a robot is to drive now."""
        return self._ask(f"/v1/robots/{robot}/path")

    def report(self, robot: str, told: Mapping[str, Any]) -> None:
        """Tell where a robot is, and what it has done."""
        self._ask(f"/v1/robots/{robot}/reports", body=told)

    def site(self) -> Message:
        """Return what does not change on the floor."""
        return self._ask("/v1/site")

    def floor(self) -> Message:
        """Return what is to be seen on the floor now."""
        return self._ask("/v1/floor")

    def hold(self, why: str) -> None:
        """Hold all robots; it takes the operator's token."""
        self._ask("/v1/hold", body={"why": why})

    def release(self) -> None:
        """Let all robots go on; it takes the operator's token."""
        self._ask("/v1/release", body={})

    def _ask(
        self,
        path: str,
        *,
        body: Mapping[str, Any] | None = None,
        query: Mapping[str, Any] | None = None,
        wait: float = 0.0,
    ) -> Message:
        asked = urlencode({**(query or {}), "wait": wait})
        headers = {"Authorization": f"Bearer {self.token}", "Content-Type": "application/json"}
        request = urllib.request.Request(
            f"{self.url}{quote(path)}?{asked}",
            None if body is None else json.dumps(body).encode(),
            headers,
        )
        try:
            with urllib.request.urlopen(request, timeout=wait + self.patience) as answer:
                found: Message = json.loads(answer.read())
        except urllib.error.HTTPError as error:
            with error:
                why = error.read().decode(errors="replace")
            raise LostError(f"{path}: {error.code} {why}") from error
        except (OSError, ValueError) as error:
            raise LostError(f"{self.url} does not answer: {error}") from error
        return found
