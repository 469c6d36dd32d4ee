"""The cases for UP's engine report: judged as they say, and rightly argued."""

import pytest

from tests.benchmarks.cases import get_test_cases
from up_samp.validation import validate_plan

CASES = get_test_cases()
PLANS = [
    pytest.param(case, plan, right, id=f"{name}-{'valid' if right else 'invalid'}{i}")
    for name, case in CASES.items()
    for right, plans in ((True, case.valid_plans), (False, case.invalid_plans))
    for i, plan in enumerate(plans)
]


@pytest.mark.parametrize(("case", "plan", "right"), PLANS)
def test_plans_are_judged_rightly(case, plan, right):
    verdict = validate_plan(case.problem, plan)
    assert verdict.valid == right, verdict.violations
    if right:
        ends = [plan.get(a.end).constant_value() for a in plan.activities]
        assert case.optimum is None or max(ends) >= case.optimum


def test_cases_are_what_the_report_needs():
    assert len(CASES) >= 12
    assert {c.solvable for c in CASES.values()} == {True, False}
    for name, case in CASES.items():
        assert name == f"samp:{case.name}"
        assert (case.optimum is not None) == (case.solvable and bool(case.problem.quality_metrics))
        assert case.solvable or not case.valid_plans
        assert case.problem.kind.has_samp()
