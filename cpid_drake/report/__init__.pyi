from .pictures import save_pictures
from .plan import comparison_table, plan_pictures, prediction_table, rank_correlation
from .terminal import print_table

__all__ = [
    "comparison_table",
    "plan_pictures",
    "prediction_table",
    "print_table",
    "rank_correlation",
    "save_pictures",
]
