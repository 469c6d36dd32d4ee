"""Engines that misbehave, and one that is just unknown; they are run in worker processes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import ClassVar

from unified_planning.engines import Engine, PlanGenerationResult, PlanGenerationResultStatus
from unified_planning.engines.mixins import OneshotPlannerMixin
from unified_planning.model import ProblemKind
from unified_planning.plans import Schedule

BASIC = {
    "SCHEDULING",
    "DISCRETE_TIME",
    "CONTINUOUS_TIME",
    "MAKESPAN",
    "INT_TYPE_DURATIONS",
    "DURATION_INEQUALITIES",
    "DISJUNCTIVE_CONDITIONS",
    "NEGATIVE_CONDITIONS",
    "BOOL_ACTION_PARAMETERS",
}


class Double(Engine, OneshotPlannerMixin):
    features: ClassVar[set[str]] = BASIC

    def __init__(self, **options):
        OneshotPlannerMixin.__init__(self)
        Engine.__init__(self)
        self.options = options

    @property
    def name(self):
        return type(self).__name__

    @classmethod
    def supported_kind(cls):
        return ProblemKind(cls.features, version=2)

    @classmethod
    def supports(cls, problem_kind):
        return problem_kind <= cls.supported_kind()

    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        raise NotImplementedError


class Sleeper(Double):
    """Never comes back, and has started a process of its own."""

    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(300)"])
        with open(self.options["note"], "w", encoding="utf-8") as note:
            note.write(f"{os.getpid()} {child.pid} {os.environ['TMPDIR']}")
        time.sleep(300)


class Dying(Double):
    """Its process ends in the middle."""

    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        print("out of luck", file=sys.stderr, flush=True)
        os._exit(7)


class Raising(Double):
    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        raise ValueError("no idea")


class Wrong(Double):
    """Says that everything happens at once, and that this is optimal."""

    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        print("chatter on standard output")
        assignment = {}
        for activity in problem.activities:
            assignment[activity.start] = 0
            assignment[activity.end] = activity.duration.lower.constant_value()
            for parameter in activity.parameters:
                assignment[parameter] = True
        plan = Schedule(list(problem.activities), assignment)
        return PlanGenerationResult(
            PlanGenerationResultStatus.SOLVED_OPTIMALLY, plan, engine_name=self.name
        )


class InSequence(Double):
    """Uses all of its time for one activity after the other, and calls that satisficing."""

    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        time.sleep(timeout)
        assignment, now = {}, 0
        for activity in problem.activities:
            assignment[activity.start] = now
            now += activity.duration.lower.constant_value()
            assignment[activity.end] = now
        plan = Schedule(list(problem.activities), assignment)
        return PlanGenerationResult(
            PlanGenerationResultStatus.SOLVED_SATISFICING, plan, engine_name=self.name
        )


class Optimist(InSequence):
    """Promises optimal plans."""

    @staticmethod
    def satisfies(optimality_guarantee):
        return True


class Planless(Double):
    """Claims success without a plan (UP does not notice)."""

    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        return PlanGenerationResult(PlanGenerationResultStatus.SOLVED_SATISFICING, None, self.name)


class NotAScheduler(Double):
    features: ClassVar[set[str]] = {"ACTION_BASED"}
