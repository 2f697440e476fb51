"""`cpid spacecraft`."""

import logging
from typing import Annotated

from cyclopts import Parameter

from cpid_drake.commands import options
from cpid_drake.commands.options import CHECK_FAILED
from cpid_drake.report import model_tables
from cpid_drake.report.terminal import print_table
from cpid_drake.spacecraft.model_summary import summarize_model


def spacecraft(
    model: Annotated[options.FileName, Parameter(help="URDF, SDF, MJCF or Drake directives.")],
    /,
    *,
    base: options.Name | None = None,
    capture_frame: options.Name | None = None,
    package: Annotated[list[str] | None, Parameter(metavar="NAME=FOLDER")] = None,
) -> int:
    """Show what a model file offers as a spacecraft: the first thing to do with a new model.

    It shows the base, capture frames on offer, joints with their limits, masses, what is not read,
    bodies that cannot be or hardly are these links, and the command to go on with.

    Exit codes: 0 the model can be used; 2 bad input or usage; 4 bodies that cannot be.

    Args:
        base: Base body. Default: the link at which the heaviest tree begins.
        capture_frame: Frame or link that holds the target. Default: one that most joints carry.
        package: Folder of a package that the model's URIs name; may be repeated.

    """
    logger = logging.getLogger("cpid_drake")
    level = logger.level
    logger.setLevel(logging.ERROR)  # its warnings are in the summary
    try:
        summary = summarize_model(
            model, base=base, capture_frame=capture_frame, packages=options.packages_of(package)
        )
    finally:
        logger.setLevel(level)
    print("\n".join(model_tables.facts(summary)))
    print_table(model_tables.joint_table(summary))
    print_table(model_tables.body_table(summary))
    if summary.findings:
        print_table(model_tables.finding_table(summary))
    print(f"next: {model_tables.next_command(summary, model)}")
    return CHECK_FAILED if summary.spacecraft.file.impossible else 0
