"""Travellers who can do the same in the same times: beginnings that differ in who of them did what
are one. Where they start is their own, so only those that have done something are exchanged; all of
them, where everybody begins anywhere.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from up_samp.scheduling.cpsat.routing.labels import Labels
from up_samp.scheduling.cpsat.routing.rules import Rules


@dataclass(frozen=True)
class Twins:
    """``groups`` of two or more travellers that are alike. ``same`` has, for each choice (the last
    row: for none) and traveller, the number of the same task at the same place (-1: it is no twin).
    """

    groups: list[list[int]]
    same: Any
    anywhere: bool = False

    @staticmethod
    def of(rules: Rules, *, anywhere: bool = False) -> Twins:
        """Return who is alike by the rules. ``anywhere``: all may begin where they like.

        Assumes: twins have the same ways, choices, homes and doors; where they begin is their own.
        """
        count = len(rules.ways)
        mine: list[dict[tuple[int, int], int]] = [{} for _ in range(count)]
        for number, choice in enumerate(rules.choices):
            mine[choice.traveller][choice.task, choice.place] = number
        sizes = [sum(c.traveller == axis for c in rules.choices) for axis in range(count)]
        groups: list[list[int]] = []
        for axis in range(count):
            if len(mine[axis]) < sizes[axis]:
                continue  # one task in two ways at one place
            found = (g for g in groups if _are_alike(rules, mine, g[0], axis))
            group = next(found, None)
            if group is None:
                groups.append([axis])
            else:
                group.append(axis)
        same = np.full((len(rules.choices) + 1, count), -1, dtype=np.int64)
        for group in groups:
            for one, other in itertools.product(group, group):
                for what, number in mine[one].items():
                    same[number, other] = mine[other][what]
        return Twins([group for group in groups if len(group) > 1], same, anywhere)

    def ordered(self, labels: Labels) -> Labels:
        """Return the labels with twins that did something in the order of what they did last."""
        turned = labels.turned.copy()
        for group in self.groups:
            first = self.same[labels.last[:, group], group[0]]
            used = ((labels.last[:, group] >= 0) | self.anywhere) @ (1 << np.arange(len(group)))
            for pattern in np.unique(used).tolist():
                places = np.flatnonzero(pattern >> np.arange(len(group)) & 1)
                rows = np.flatnonzero(used == pattern)
                order = np.argsort(first[np.ix_(rows, places)], axis=1, kind="stable")
                axes = np.array(group)[places]
                if len(axes) > 1:
                    turned[np.ix_(rows, axes)] = axes[order]
        moved = np.flatnonzero((turned != np.arange(turned.shape[1])).any(1))
        if not len(moved):
            return labels
        return self._turned(labels, moved, turned[moved])

    def _turned(self, labels: Labels, rows: Any, turned: Any) -> Labels:
        """Return the labels with the travellers of some rows exchanged."""
        found = {}
        for name in ("last", "free", "leave", "used", "spent"):
            found[name] = getattr(labels, name).copy()
            found[name][rows] = np.take_along_axis(found[name][rows], turned, axis=1)
        done = found["last"][rows]
        own = self.same[done, np.arange(turned.shape[1])]
        # who is nobody's twin has stayed
        found["last"][rows] = np.where(done >= 0, np.where(own >= 0, own, done), -1)
        found["ready"] = labels.ready.copy()
        found["ready"][rows] = np.take_along_axis(labels.ready[rows], turned[:, :, None], axis=1)
        found["turned"] = labels.turned.copy()
        found["turned"][rows] = turned
        return replace(labels, **found)


def _are_alike(rules: Rules, mine: list[dict[tuple[int, int], int]], one: int, other: int) -> bool:
    """Return whether two travellers have the same ways, choices and rules."""
    ways, routes = rules.ways, rules.programme.routes
    if mine[one].keys() != mine[other].keys() or rules.shape[one] != rules.shape[other]:
        return False
    for what, number in mine[one].items():
        a, b = rules.choices[number], rules.choices[mine[other][what]]
        if (a.spot, a.late, a.back) != (b.spot, b.late, b.back):
            return False
    tables = ("travel", "detour", "hop", "leading")
    if not all(np.array_equal(getattr(ways[one], t), getattr(ways[other], t)) for t in tables):
        return False
    if (routes[one].gap, routes[one].step) != (routes[other].gap, routes[other].step):
        return False
    return (
        np.array_equal(rules.homes[one], rules.homes[other])
        and _doors_alike(rules, one, other)
        and _hand_over_alike(rules.handovers, one, other)
    )


def _doors_alike(rules: Rules, one: int, other: int) -> bool:
    """Return whether doors open alike, and stand still for both or none."""
    for doors in rules.doors:
        a, b = ({(p, d) for axis, p, d in doors if axis == who} for who in (one, other))
        if a != b:
            return False
    for change in rules.changes:
        if change is None:
            continue
        if change.still.get(one) != change.still.get(other):
            return False
        if one in change.still and not np.array_equal(change.shut[one], change.shut[other]):
            return False
    return True


def _hand_over_alike(handovers: Any, one: int, other: int) -> bool:
    """Return whether exchanging the two changes nothing where only one fits."""
    order = list(range(len(handovers)))
    order[one], order[other] = other, one
    return np.array_equal(handovers, handovers[order][:, :, order])
