"""An engine that takes its time and calls that optimal."""

from unified_planning.engines import PlanGenerationResult, PlanGenerationResultStatus
from unified_planning.shortcuts import LE, Or
from up_aries import Aries


class Hasty(Aries):
    @property
    def name(self):
        return "hasty"

    @staticmethod
    def satisfies(optimality_guarantee):
        return True

    def _solve(self, problem, heuristic=None, timeout=None, output_stream=None):
        slow = problem.clone()
        slow.add_constraint(Or(LE(30, a.end) for a in slow.activities))
        result = super()._solve(slow, heuristic, timeout, output_stream)
        if result.plan is None:
            return result
        status = PlanGenerationResultStatus.SOLVED_OPTIMALLY
        return PlanGenerationResult(status, result.plan, self.name)
