"""The one bounded cache of maps and motions: what was used longest ago is forgotten."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class Memory(Generic[Value]):
    """Values by key, at most ``size`` of them. Keys say what a value depends on, by content."""

    def __init__(self, size: int) -> None:
        if size < 1:
            raise ValueError(f"a memory needs room for one value at least, not {size}")
        self._size = size
        self._values: OrderedDict[Hashable, Value] = OrderedDict()

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, key: Hashable) -> bool:
        return key in self._values

    def values(self) -> list[Value]:
        """Return all values, those used longest ago first."""
        return list(self._values.values())

    def get(self, key: Hashable) -> Value | None:
        """Return what is known for ``key``, if anything."""
        if key not in self._values:
            return None
        self._values.move_to_end(key)
        return self._values[key]

    def put(self, key: Hashable, value: Value) -> Value:
        """Remember and return ``value``."""
        self._values[key] = value
        self._values.move_to_end(key)
        while len(self._values) > self._size:
            self._values.popitem(last=False)
        return value

    def get_or(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return what is known for ``key``, made now where it is not known yet."""
        if key in self._values:
            self._values.move_to_end(key)
            return self._values[key]
        return self.put(key, make())
