"""Reachability in graphs; things grouped by a key."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

Node = TypeVar("Node", bound=Hashable)
Item = TypeVar("Item")


def reached(first: Iterable[Node], after: Callable[[Node], Iterable[Node]]) -> set[Node]:
    """Return what can be come to from some nodes, step by step, with these: ``after`` tells where
    one step leads.
    """
    found = set(first)
    todo = list(found)
    while todo:
        new = set(after(todo.pop())) - found
        found |= new
        todo += new
    return found


def grouped(items: Iterable[Item], key: Callable[[Item], Node]) -> dict[Node, list[Item]]:
    """Return things by what the key tells of them, in their order."""
    found: dict[Node, list[Item]] = {}
    for item in items:
        found.setdefault(key(item), []).append(item)
    return found
