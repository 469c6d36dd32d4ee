"""The tunables of problems with many motions: shares of the jobs, tours, and better ones."""

from __future__ import annotations

from dataclasses import dataclass

from up_samp.model.tunable import Tunables, share_of, tunable


@dataclass(frozen=True)
class InOrderTuning(Tunables):
    """Motions of many robots decided one after the other (``search/fleet/sequential.py``)."""

    motions: int = tunable(
        14,
        "motions",
        "that may meet, from which on a candidate's motions are not first tried as scheduled",
        least=2,
    )
    share: float = share_of(0.6, "of the remaining time, for one candidate")


@dataclass(frozen=True)
class ToursTuning(Tunables):
    """Whole tours decided one robot after the other (``search/fleet/tours.py``)."""

    past: int = tunable(
        2, "ways", "past the places where others stand, that are looked for first", least=0
    )
    rounds: int = tunable(
        16, "rounds", "in which all tours are decided in the order of time", least=0
    )
    each: int = tunable(16, "rounds", "after which other ways are looked for in one", least=1)
    hopeless: int = tunable(
        6, "rounds", "without tours, after which they are decided whole", least=1
    )
    noise: float = tunable(3.0, "s", "at most, by which turns are changed at random", least=0)
    heard: float = share_of(0.3, "of how much later a robot ended, by which its turn comes sooner")
    kept: float = share_of(0.9, "of that, that is kept from round to round")
    sooner: float = tunable(20.0, "s", "by which turns of who is late come sooner", least=0)
    orders: int = tunable(
        12, "orders", "of the robots; who finds no tour goes first in the next one", least=1
    )
    looks: int = tunable(
        1, "times", "that other ways from pose to pose are looked for, if one is known", least=0
    )


@dataclass(frozen=True)
class DealsTuning(Tunables):
    """Who does which job, before any motion is known (``search/fleet/assignment.py``)."""

    exchanges: int = tunable(2000, "changes a job", "of annealing over who does what", least=0)
    warm: float = share_of(0.03, "of all cost, by which a change may be worse at first")
    cold: float = share_of(0.0003, "of all cost, by which a change may be worse in the end")
    steep: int = tunable(6, "power", "of a tour's end that counts: the last one most", least=1)
    traffic: float = tunable(
        1.3,
        "factor",
        "by which tours are expected to take longer than alone, if one is due",
        least=1,
    )
    noise: float = share_of(0.06, "of what a job costs, by which guesses differ at first")
    handover: float = tunable(
        5.0,
        "s",
        "from who leaves a shared place to who comes next, as far as one can guess",
        least=0,
    )
    rounds: int = tunable(
        4,
        "times",
        "at most, that the drives of a share are planned and jobs dealt out anew",
        least=0,
    )


@dataclass(frozen=True)
class LargeTuning(Tunables):
    """Problems that are solved in parts (``search/fleet/solve.py``)."""

    activities: int = tunable(
        240, "optional activities", "from which on jobs are dealt out first", least=1
    )
    deals: int = tunable(8, "shares of the jobs", "at most, until there is a plan", least=1)
    stale: int = tunable(1_000, "changes", "of tours in a row that may bring nothing", least=1)
    again_dealt: int = tunable(
        6, "shares of the jobs", "that are tried before the tours of the best are changed", least=0
    )
    steep: int = tunable(12, "power", "of a tour's end that counts in those", least=1)
    looks: int = tunable(
        4, "times", "that other ways from pose to pose are looked for, for better tours", least=0
    )
    looking: float = share_of(0.1, "of the changes, in which other ways are looked for")
    together: int = tunable(
        5, "tours", "at most, that are decided anew with one of the last", least=1
    )
    choice: int = tunable(
        6, "exchanges of jobs", "that look best, of which one is tried at random", least=1
    )
    turns: tuple[int, ...] = tunable(
        (1, 1, 2, 3, 5), "robots", "whose turns change at once: one of these", least=1
    )
    sooner: float = tunable(10.0, "s", "at most, by which turns come sooner or later", least=0)
    motions: int = tunable(2, "motions", "of a robot that look for other ways at once", least=1)
    delayed: float = tunable(
        6.0, "s", "by which a motion takes longer than alone, if it looks for other ways", least=0
    )
