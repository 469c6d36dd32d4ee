"""Plan files: a plan as a self-contained dictionary or JSON file, and back."""

from up_samp.io.files import check_plan, dump_plan, read_plan, write_plan
from up_samp.io.plan_dict import PlanDict, plan_to_dict, result_to_dict
from up_samp.io.restore import contradictions, plan_from_dict

__all__ = [
    "PlanDict",
    "check_plan",
    "contradictions",
    "dump_plan",
    "plan_from_dict",
    "plan_to_dict",
    "read_plan",
    "result_to_dict",
    "write_plan",
]
