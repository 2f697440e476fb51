from .comparison import predictions, reference_motions
from .plan_file import write_plan
from .plan_options import PlanOptions
from .planner import Plan, Planner, load_planner

__all__ = [
    "Plan",
    "PlanOptions",
    "Planner",
    "load_planner",
    "predictions",
    "reference_motions",
    "write_plan",
]
