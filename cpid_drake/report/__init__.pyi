from .page import Report, Section, Table
from .pages.study import study_report
from .plan import motion_table, rank_correlation, save_plan
from .terminal import print_table, print_tables

__all__ = [
    "Report",
    "Section",
    "Table",
    "motion_table",
    "print_table",
    "print_tables",
    "rank_correlation",
    "save_plan",
    "study_report",
]
