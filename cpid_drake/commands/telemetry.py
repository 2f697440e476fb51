"""`cpid telemetry`."""

from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options
from cpid_drake.errors import InputError

telemetry = typer.Typer(no_args_is_help=True, help="Check telemetry files.")


@telemetry.callback()
def _common() -> None:
    """Make Typer treat `check` as a subcommand although it is the only one."""


@telemetry.command()
def check(
    file: Annotated[str, typer.Argument(metavar="FILE", help=options.LOG_KINDS)],
    spacecraft: options.ModelOption[str | None] = None,
    base: options.BaseOption[str | None] = None,
    capture_frame: options.CaptureFrameOption[str | None] = None,
    topic: options.TopicOption = None,
) -> int:
    """List the contents and all problems of a telemetry file.

    With --spacecraft, --base and --capture-frame, the joints are compared with the model's.

    Exit codes: 0 no problem; 2 at least one problem.
    """
    given = [spacecraft, base, capture_frame]
    if any(given) and not all(given):
        raise InputError("give all of --spacecraft, --base and --capture-frame, or none of them")
    topics = options.topics_of(topic)
    from cpid_drake.sensing.files.telemetry_files import inspect_telemetry

    found = inspect_telemetry(file, topics=topics)
    from cpid_drake.report.telemetry import contents

    out = Console(markup=False, highlight=False, soft_wrap=True)
    out.print("\n".join(contents(found, file)))
    errors = [str(problem) for problem in found.problems.first]
    warnings: list[str] = []
    try:
        if spacecraft and base and capture_frame:
            from cpid_drake.identification.requirements import check_log, in_joint_order
            from cpid_drake.spacecraft.spacecraft import Spacecraft

            craft = Spacecraft(spacecraft, base=base, capture_frame=capture_frame)
            warnings = check_log(craft, in_joint_order(found.measurements, craft))
        else:
            from cpid_drake.sensing.files.consistency import check_consistency

            consistency = check_consistency(found.measurements)
            errors, warnings = errors + consistency.errors, consistency.warnings
    except InputError as error:
        errors.append(str(error))
    for warning in warnings:
        out.print(f"warning: {warning}")
    for problem in errors:
        out.print(f"error: {problem}")
    hidden = max(found.problems.count - len(found.problems.first), 0)
    if hidden:
        out.print(f"... and {hidden} more")
    if not errors:
        out.print("no problems found")
        return 0
    count = len(errors) + hidden
    raise InputError(f"{file}: {count} problem{'s' * (count > 1)} found, listed above")
