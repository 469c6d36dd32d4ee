"""Plans for many robots by construction: a candidate's motions are decided one after the other.

A candidate's motions are decided in order of their starts, each among those decided before (see
:mod:`up_samp.search.decisions`). Who finds no way lets those go first that are in its way; those
that wait for each other in a ring are decided together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from up_samp.model import Deadline
from up_samp.scheduling.partial_order import Earliest
from up_samp.search.bounds import Incumbent
from up_samp.search.decisions import QUICK, Decisions, can_decide, times_of
from up_samp.search.events import Phase
from up_samp.search.large_tuning import InOrderTuning
from up_samp.search.search import Search
from up_samp.search.world import groups_of
from up_samp.upio import Itinerary


@dataclass(frozen=True)
class InOrder:
    """The component: see the module. It is for candidates with many motions at once."""

    tuning: InOrderTuning = field(default_factory=InOrderTuning)

    def __call__(self, search: Search, itinerary: Itinerary) -> Incumbent | None:
        """Return a plan with the activities of a candidate, or None where none is found."""
        most = max((len(g) for g in groups_of(itinerary.motions)), default=0)
        if most < self.tuning.motions or not can_decide(search, itinerary):
            return None
        search.tell.stage(Phase.GROUP, count=len(itinerary.motions))
        deadline = search.budget.share(self.tuning.share, float("inf"))
        with search.budget.motion_time():
            times = times_of(search, itinerary)
            if times is None:
                return None
            line = Line(search, itinerary, times, self.tuning)
            if not line.decide(deadline):
                return None
        return search.plan_of(line.schedule(), line.trajectories())


class Line(Decisions):
    """Motions that wait to be decided, and those that are."""

    def __init__(
        self, search: Search, itinerary: Itinerary, times: Earliest, tuning: InOrderTuning
    ) -> None:
        super().__init__(search, itinerary, times, tuning)
        self._turns: dict[str, int] = {}
        """When those that found no way are asked again (units)."""
        self._failed: dict[str, tuple[int, dict[str, int]]] = {}
        """Motions that found no way: at which effort, and how much was decided of whom then."""

    # -- deciding ------------------------------------------------------------------------------
    def decide(self, deadline: Deadline) -> bool:
        """Decide all motions; return whether that was possible."""
        while self._waiting:
            if deadline.expired():
                return False
            ready = self._ready()
            decided = self._decide_next(ready, deadline) if ready else self._decide_ring(deadline)
            if not decided:
                return False
        return True

    def _decide_next(self, ready: Sequence[str], deadline: Deadline) -> bool:
        """Decide the motion that can begin first; who finds no way is asked again once one of those
        in its way can have left. So all is decided in the order of time, and nobody far ahead.
        """
        for _ in range(self._tuning.turns * len(ready)):
            name = min(ready, key=lambda m: (self._turn(m), m))
            blockers = self._decide_one(name, deadline)
            if blockers is None:
                return True
            if deadline.expired():
                return False
            turns = (self._turn(m) for m in self._heads() if self._waiting[m].object in blockers)
            self._turns[name] = 1 + max(self._turn(name), min(turns, default=0))
        return self._try_harder(ready, deadline)

    def _turn(self, name: str) -> int:
        """Return when it is a motion's turn to be decided (units)."""
        return max(self._start(name), self._turns.get(name, 0))

    def _decide_one(self, name: str, deadline: Deadline) -> frozenset[str] | None:
        """Decide a motion and return None; or return who is in its way if it has to wait."""
        effort, known = self._failed.get(name, (self._tuning.effort, {}))
        if known and all(self._floor.decided(o) == count for o, count in known.items()):
            return frozenset(known)
        motion = self._timed(name)
        self._place_changed(name)
        attempt = self._floor.plan(motion, deadline, min(effort, QUICK))
        late = attempt.run is not None and attempt.run.arrival > motion.due
        if effort > QUICK and (late or effort == self._tuning.harder):
            other = self._floor.plan(motion, deadline, effort)
            attempt = other if other.run is not None else attempt
        met = attempt.met | (attempt.report.blockers if attempt.report else frozenset())
        if attempt.run is not None and self._take(name, attempt.run):
            return None
        # those that rest for good cannot be waited for
        moving = {m.object for m in self._waiting.values()}
        self._failed[name] = effort, {o: self._floor.decided(o) for o in sorted(met & moving)}
        return met

    def _decide_ring(self, deadline: Deadline) -> bool:
        """Decide those together that wait for each other to leave, or the first of them alone."""
        heads = [m for m in self._heads() if not self._must[m] & self._waiting.keys()]
        for name in sorted(heads, key=lambda m: (self._start(m), m)):
            ring = [name]
            for other in ring:
                blocking = self._leave[other] & self._waiting.keys()
                ring += sorted(m for m in blocking if m in heads and m not in ring)
            if len(ring) <= self._tuning.together and self._decide_all(ring, deadline):
                return True
        return False

    def _try_harder(self, ready: Sequence[str], deadline: Deadline) -> bool:
        """Decide one of those that found no way with more effort, or with who is in its way."""
        ranked = sorted(ready, key=lambda m: (self._start(m), m))
        for name in ranked:
            self._failed[name] = self._tuning.harder, {}
            if self._decide_one(name, deadline) is None:
                return True
        heads = self._heads()
        for name in ranked:
            known = self._failed[name][1]
            some = [name, *(m for m in heads if self._waiting[m].object in known and m != name)]
            some = [m for m in some if not self._must[m] & self._waiting.keys()]
            if 1 < len(some) <= self._tuning.together and self._decide_all(some, deadline):
                return True
        return False

    def _decide_all(self, names: Sequence[str], deadline: Deadline) -> bool:
        """Decide motions of several objects at once."""
        self._place_changed(names[0])
        timed = [self._timed(name) for name in names]
        runs = self._floor.together(timed, deadline, top=self._tuning.harder)
        if runs is None:
            return False
        for name in sorted(names, key=lambda n: (runs[n].arrival, n)):
            if not self._take(name, runs[name]):
                return False
        return True

    # -- who is next ---------------------------------------------------------------------------
    def _heads(self) -> list[str]:
        """Return the next motion of each object."""
        found: dict[str, str] = {}
        for name, motion in self._waiting.items():
            found.setdefault(motion.object, name)
        return list(found.values())

    def _ready(self) -> list[str]:
        """Return the motions that wait for no other one."""
        waiting = self._waiting.keys()
        return [
            m for m in self._heads() if not (self._must[m] & waiting or self._leave[m] & waiting)
        ]
