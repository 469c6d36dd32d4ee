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

    def _solve_with_params(self, problem, **keywords):
        slow = problem.clone()
        slow.add_constraint(Or(LE(30, a.end) for a in slow.activities))
        result = super()._solve_with_params(slow, **keywords)
        if result.plan is None:
            return result
        status = PlanGenerationResultStatus.SOLVED_OPTIMALLY
        return PlanGenerationResult(status, result.plan, self.name)
