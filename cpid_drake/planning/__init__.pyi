from .comparison import reference_motions
from .pareto import front
from .plan_options import PlanOptions
from .planner import Plan, Planner, load_planner

__all__ = [
    "Plan",
    "PlanOptions",
    "Planner",
    "front",
    "load_planner",
    "reference_motions",
]
