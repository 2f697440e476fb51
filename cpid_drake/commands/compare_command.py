"""`cpid compare`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import cpid_drake as cpid
from cpid_drake.commands import options
from cpid_drake.commands.options import CHECK_FAILED, NOT_ALL_KNOWN
from cpid_drake.files.drafts import write_text
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.report.pages.comparison import (
    comparison_report,
    differences_table,
    interval_table,
)
from cpid_drake.report.terminal import print_table


def compare(
    results: Annotated[list[Path], Parameter(metavar="FILE")],
    /,
    *,
    report: options.File | None = None,
    scene: options.File | None = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> int:
    """Compare results: whether they have the same target, and what differs.

    The difference of the targets is tested by its χ², with errors that are independent: one target
    fails in one comparison of 10,000. What differs in logs, requests and checks is listed.

    Exit codes: 0 the results agree with one target; 2 bad input or usage; 3 it is not
    decided, because a result failed its own checks, or they determine nothing in common; 4 they do
    not have the same target.

    Args:
        results: Result files of `cpid identify --json`, two or more.
        report: Write the comparison to this file, one HTML page.
        scene: Write the ellipsoids of inertia of all results on their spacecraft, and of three
            sigma of their centres of mass, to this file, one HTML page.

    """
    check_outputs([("--report", report), ("--scene", scene)], results, force=force)
    comparison = cpid.compare(results)
    if report is not None:
        comparison_report(comparison).write(report)
    if scene is not None:
        from cpid_drake.report.comparison_scene import comparison_scene  # Drake's takes a second

        write_text(scene, comparison_scene(comparison))
    options.print_warnings(comparison.warnings)
    if not quiet:
        print(comparison.verdict)
        print_table(interval_table(comparison, is_drawn=True))
        if comparison.differences:
            print_table(differences_table(comparison))
    if comparison.is_same_target is None:
        return NOT_ALL_KNOWN
    return 0 if comparison.is_same_target else CHECK_FAILED
