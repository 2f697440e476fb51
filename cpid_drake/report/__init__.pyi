from .plan import motion_table, plan_pictures, rank_correlation
from .terminal import print_table

__all__ = [
    "motion_table",
    "plan_pictures",
    "print_table",
    "rank_correlation",
]
