from .comparison import predictions, reference_motions
from .pareto import front, write_plan
from .plan_options import PlanOptions
from .planner import Plan, Planner, load_planner

__all__ = [
    "Plan",
    "PlanOptions",
    "Planner",
    "front",
    "load_planner",
    "predictions",
    "reference_motions",
    "write_plan",
]
