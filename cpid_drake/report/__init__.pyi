from .page import Report, Section, Table
from .pages.study import study_report
from .plan import motion_table, plan_pictures, rank_correlation
from .terminal import print_table, print_tables

__all__ = [
    "Report",
    "Section",
    "Table",
    "motion_table",
    "plan_pictures",
    "print_table",
    "print_tables",
    "rank_correlation",
    "study_report",
]
