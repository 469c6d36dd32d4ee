"""What the independent validator has against a plan, for the search to learn from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Refusal:
    """One broken rule: ``kind`` is the validator's word for it, ``what`` is for people.

    ``activities`` and ``objects`` are those it is about, ``time`` (s) when it is first broken, as
    far as it is about any.
    """

    kind: str
    what: str
    activities: tuple[str, ...] = ()
    objects: tuple[str, ...] = ()
    time: float | None = None
