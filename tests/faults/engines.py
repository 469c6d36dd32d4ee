"""Wrapped engines that misbehave: aries-opt but for one thing, from the first call on, or (names
that end in ``Later``) from the third, when there is a plan to be kept.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from unified_planning.engines import PlanGenerationResult
from unified_planning.engines import PlanGenerationResultStatus as Status
from unified_planning.plans import Schedule
from up_aries import AriesOpt


@dataclass(frozen=True)
class Fault:
    """``do`` is given the engine, the problem and aries' own answer (a function that asks it).

    ``ends``: the statuses that are right where the first call goes wrong.
    """

    do: Callable[[Any, Any, Callable[[], Any]], Any]
    ends: tuple[str, ...] = ("INTERNAL_ERROR",)


def _changed(problem, result, change: Callable[[dict, list], None], status=None):
    """Return a result whose plan's times (by timepoint) and activities are changed."""
    if result.plan is None:
        return result
    plan = result.plan
    activities = list(plan.activities)
    times = {t: plan.get(t) for a in activities for t in (a.start, a.end)}
    values = {p: plan.get(p) for a in activities for p in a.parameters}
    change(times, activities)
    return PlanGenerationResult(
        status or result.status, Schedule(activities, times | values), "liar"
    )


def _all_at_once(times, activities):
    for activity in activities:
        length = int(times[activity.end].constant_value()) - int(
            times[activity.start].constant_value()
        )
        times[activity.start], times[activity.end] = 0, length


def _scaled(by):
    def change(times, _activities):
        for key in times:
            times[key] = by(int(times[key].constant_value()))

    return change


def _last_gone(times, activities):
    gone = activities.pop()
    del times[gone.start], times[gone.end]


def _lie(change, status=None):
    return Fault(lambda _engine, problem, ask: _changed(problem, ask(), change, status))


def _answer(status, plan=None, ends=("INTERNAL_ERROR",)):
    return Fault(lambda _e, _p, _ask: PlanGenerationResult(status, plan, "liar"), ends)


def _raises(error: type[BaseException]):
    def do(*_):
        raise error("no idea")

    return Fault(do)


def _dies(how: Callable[[], None]):
    return Fault(lambda *_: how())


def _with_children(*_):
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(900)"])
    subprocess.Popen([sys.executable, "-c", "import time; time.sleep(900)"], start_new_session=True)
    time.sleep(900)


def _deaf(*_):
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    time.sleep(900)


def _busy(*_):
    while True:
        pass


def _hungry(*_):
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31))
    hoard = []
    while True:
        hoard.append(bytearray(2**27))


def _chatty(_engine, _problem, ask):
    os.write(1, b"x" * 100_000)
    os.write(2, b"y" * 100_000)
    print("z" * 100_000)
    return ask()


def _untidy(_engine, _problem, ask):
    import tempfile

    for _ in range(3):
        handle, _name = tempfile.mkstemp(prefix="litter")
        os.close(handle)
    os.mkdir(os.path.join(tempfile.gettempdir(), "litter-folder"))
    return ask()


def _shut(_engine, _problem, ask):
    for descriptor in range(3, 64):
        try:
            os.close(descriptor)
        except OSError:
            continue
    return ask()


GOOD = ("SOLVED_OPTIMALLY",)
FAULTS: dict[str, Fault] = {
    "DiesAtOnce": _dies(lambda: os._exit(7)),
    "LeavesQuietly": _dies(lambda: os._exit(0)),
    "KilledByItself": _dies(lambda: os.kill(os.getpid(), signal.SIGKILL)),
    "Aborts": _dies(os.abort),
    "RaisesAtOnce": _raises(ValueError),
    "LeavesBySystemExit": _raises(SystemExit),
    "Interrupts": _raises(KeyboardInterrupt),
    "OutOfMemory": _raises(MemoryError),
    "Recursion": _raises(RecursionError),
    "Hangs": Fault(_with_children, ("TIMEOUT",)),
    "Deaf": Fault(_deaf, ("TIMEOUT",)),
    "Busy": Fault(_busy, ("TIMEOUT",)),
    "Hungry": Fault(_hungry, ("INTERNAL_ERROR", "TIMEOUT")),
    "Chatty": Fault(_chatty, GOOD),
    "Untidy": Fault(_untidy, GOOD),
    "ShutsDescriptors": Fault(_shut),
    "AllAtOnce": _lie(_all_at_once),
    "AllAtOnceOptimal": _lie(_all_at_once, Status.SOLVED_OPTIMALLY),
    "BeforeTime": _lie(_scaled(lambda t: t - 50)),
    "Backwards": _lie(_scaled(lambda t: 1000 - t)),
    "Halves": _lie(_scaled(lambda t: Fraction(2 * t + 1, 2))),
    "Huge": _lie(_scaled(lambda t: t * 10**12)),
    "LeavesOneOut": _lie(_last_gone),
    "Planless": _answer(Status.SOLVED_SATISFICING),
    "OptimalPlanless": _answer(Status.SOLVED_OPTIMALLY),
    "EmptyPlan": _answer(Status.SOLVED_SATISFICING, Schedule([], {})),
    "Nothing": Fault(lambda *_: None),
    "NoResult": Fault(lambda *_: "a text"),
    "WrongStatus": _answer("SOLVED"),
    "SaysUnsolvable": _answer(Status.UNSOLVABLE_PROVEN, None, ("UNSOLVABLE_INCOMPLETELY",)),
    "SaysUnsupported": _answer(Status.UNSUPPORTED_PROBLEM),
    "SaysInternalError": _answer(Status.INTERNAL_ERROR),
    "SaysOutOfTime": _answer(Status.TIMEOUT, None, ("TIMEOUT",)),
    "SaysOutOfMemory": _answer(Status.MEMOUT),
}


class Faulty(AriesOpt):
    """Aries-opt, but for one thing."""

    fault: Fault
    first: int

    def __init__(self, **options):
        super().__init__(**options)
        self.calls = 0

    @property
    def name(self):
        return type(self).__name__

    def _solve_with_params(self, problem, **keywords):
        self.calls += 1

        def ask():
            return super(Faulty, self)._solve_with_params(problem, **keywords)

        return ask() if self.calls < self.first else self.fault.do(self, problem, ask)


for _name, _fault in FAULTS.items():
    for _late, _call in (("", 1), ("Later", 3)):
        globals()[_name + _late] = type(
            _name + _late,
            (Faulty,),
            {
                "fault": _fault,
                "first": _call,
                "__module__": __name__,
                "__qualname__": _name + _late,
            },
        )
