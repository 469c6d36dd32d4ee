"""Reachability in graphs."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

Node = TypeVar("Node", bound=Hashable)


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
