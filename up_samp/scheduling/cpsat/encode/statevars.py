"""Ground fluents with who writes and who reads them, and when."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from up_samp.scheduling.cpsat.encode.forms import Lin, Literal

Key = tuple[Any, ...]


@dataclass
class Write:
    """An effect on a ground fluent: assignment of ``value``, or increase by it if ``add``."""

    owner: int | None
    active: Literal
    time: Lin
    value: Lin
    add: bool = False


@dataclass
class Read:
    """A value that must be one of ``allowed`` (if given), equals ``value`` (if given), and
    must not be disturbed over the instants lo..hi.
    """

    owner: int | None
    active: Literal
    lo: Lin
    hi: Lin
    allowed: frozenset[int] | None = None
    value: Lin | None = None
    guard_only: bool = False
    loose: bool = False
    """Whether effects of others at ``hi`` are allowed (the old value counts)."""


@dataclass
class StateVar:
    """A ground fluent. ``values`` are the codes it may take (``None``: too many to list)."""

    key: Key
    bounds: tuple[int, int]
    values: list[int] | None
    initial: int | None
    writes: list[Write] = field(default_factory=list)
    reads: list[Read] = field(default_factory=list)
    _by_owner: dict[int | None, list[Write]] = field(default_factory=dict)
    _indexed: int = 0

    def exempt(self, owner: int | None) -> list[Write]:
        """Return the writes that conditions of ``owner`` are not kept apart from."""
        if owner is None:
            return self.writes
        if self._indexed != len(self.writes):
            self._by_owner = {}
            for write in self.writes:
                self._by_owner.setdefault(write.owner, []).append(write)
            self._indexed = len(self.writes)
        return [*self._by_owner.get(None, ()), *self._by_owner.get(owner, ())]

    def held(self) -> Iterable[int]:
        """Return the values that it has at first or that something gives it (all, if that hangs on
        decisions).
        """
        if self.initial is None or any(w.add or w.value.terms for w in self.writes):
            return self.values or ()
        return {self.initial, *(w.value.const for w in self.writes)}

    @property
    def numeric(self) -> bool:
        """Whether it is increased or decreased anywhere."""
        return any(w.add for w in self.writes)
