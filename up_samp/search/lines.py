"""All that one robot may do, one after the other, and the units that it loses in between."""

from __future__ import annotations

from collections import ChainMap, defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from up_samp.search.gaps import closed, idle_between


@dataclass(frozen=True)
class Stop:
    """Where a robot is when an activity begins and when it ends, one of some places (None:
    somewhere). ``drives``: the activity drives it. ``setting``: what it sets at its end, which
    others that are ``reading`` it at their start see a unit later. ``loose``: its drive begins
    where one of the fluents ``reading`` says.
    """

    begins: frozenset[str] | None
    ends: frozenset[str] | None
    drives: bool = False
    loose: bool = False
    setting: frozenset[str] = frozenset()
    reading: frozenset[str] = frozenset()


class Line:
    """What one robot does in turn: its ``stops`` by activity, with the ``gaps`` that are told."""

    def __init__(self, stops: Mapping[str, Stop], gaps: dict[tuple[str, str], int]) -> None:
        self.stops, self._gaps = stops, gaps
        self._ending, self._beginning = (
            _by_place({name: stop.ends for name, stop in stops.items()}),
            _by_place({name: stop.begins for name, stop in stops.items()}),
        )

    def idle(self, members: frozenset[str]) -> int:
        """Return units in which the robot does nothing, right before or after some activities that
        are all present if one of them is.

        What comes after a drive is counted there, and not before what follows it.
        """
        told = ChainMap(closed(self._gaps, members), self._gaps)
        total = 0
        for name in sorted(members & self.stops.keys()):
            stop = self.stops[name]
            before = self._near(self._ending, stop.begins)
            total += idle_between(name, before, members, told, self._unless_driven, after=False)
            if stop.drives:
                then = self._near(self._beginning, stop.ends)
                total += idle_between(name, then, members, told, self.gap, after=True)
        return total

    def gap(self, first: str, then: str) -> int:
        """Return units between two activities, of which the second comes right after the first."""
        one, two = self.stops[first], self.stops[then]
        told = self._gaps.get((first, then), 0)
        if not one.setting & two.reading:
            return told
        # a drive that begins where a fluent says may read the older value, if that is the same
        same = two.loose and (one.begins is None or one.ends is None or bool(one.begins & one.ends))
        return told if same else max(told, 1)

    def _unless_driven(self, first: str, then: str) -> int:
        return 0 if self.stops[first].drives else self._gaps.get((first, then), 0)

    def _near(
        self, table: Mapping[str | None, list[str]], places: frozenset[str] | None
    ) -> Collection[str]:
        if places is None:
            return sorted(self.stops)
        return dict.fromkeys(n for place in (*sorted(places), None) for n in table.get(place, ()))


def _by_place(places: Mapping[str, frozenset[str] | None]) -> dict[str | None, list[str]]:
    found: dict[str | None, list[str]] = defaultdict(list)
    for name in sorted(places):
        some = places[name]
        for place in (None,) if some is None else sorted(some):
            found[place].append(name)
    return found
