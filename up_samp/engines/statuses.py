"""UP's status for how a scheduler ended."""

from __future__ import annotations

from unified_planning.engines import PlanGenerationResultStatus

from up_samp.model import ScheduleStatus

STATUSES = {
    ScheduleStatus.OPTIMAL: PlanGenerationResultStatus.SOLVED_OPTIMALLY,
    ScheduleStatus.FOUND: PlanGenerationResultStatus.SOLVED_SATISFICING,
    ScheduleStatus.INFEASIBLE: PlanGenerationResultStatus.UNSOLVABLE_PROVEN,
    ScheduleStatus.NOT_FOUND: PlanGenerationResultStatus.UNSOLVABLE_INCOMPLETELY,
    ScheduleStatus.OUT_OF_TIME: PlanGenerationResultStatus.TIMEOUT,
    ScheduleStatus.ERROR: PlanGenerationResultStatus.INTERNAL_ERROR,
}
