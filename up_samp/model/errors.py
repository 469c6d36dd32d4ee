"""Errors that users see. Each names the object, file or activity and what to do."""

from __future__ import annotations

import re
import reprlib
from typing import Any


class SampError(Exception):
    """Base of all errors raised on purpose by this package."""


class ProblemError(SampError, ValueError):
    """The problem is wrong or incomplete (a missing map, an unknown parameter, ...)."""


class UnsupportedError(SampError, NotImplementedError):
    """The problem is fine but uses a feature that is not supported; the feature is named."""


class EngineError(SampError, RuntimeError):
    """A wrapped engine crashed, answered wrongly, or overran its deadline."""


class InterruptedSearch(KeyboardInterrupt):
    """Ctrl-C (or whatever raises ``KeyboardInterrupt``) after the search had found a plan:
    ``result`` is the UP result with the best one until then.
    """

    def __init__(self, result: Any) -> None:
        super().__init__("the search was stopped; its best plan is in 'result'")
        self.result = result


class OutOfTimeError(SampError):
    """No time is left: the stage in which that is raised did not finish, and left nothing half
    done behind.
    """


def short(value: object, size: int = 80) -> str:
    """Return a value for a message: of bounded length, whatever a user's file may hold."""
    if isinstance(value, str):
        return value if len(value) <= size else f"{value[: size - 3]}..."
    if isinstance(value, int | float | bool | None):
        if isinstance(value, int) and abs(value) > 10**size:
            return "a very large number"  # Python refuses to print numbers of many digits
        return repr(value)
    return _SHORT.repr(value)[:size]


def in_words(text: str) -> str:
    """Return a text with the names that ``Fleet`` makes (``second@gate``) as people say them. No
    name that a user gives there has ``@`` or spaces, so what differs still does.
    """
    return re.sub(r"(?<=\w)@(?=\w)", " of ", re.sub(r"\bsecond@", "the other leaf of ", text))


_SHORT = reprlib.Repr()
_SHORT.maxlevel = 2
