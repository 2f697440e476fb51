"""`cpid telemetry`."""

from typing import Annotated

import typer
from rich.console import Console

telemetry = typer.Typer(no_args_is_help=True, help="Look into telemetry files.")


@telemetry.callback()
def _common() -> None:
    """Keep `check` a subcommand while it is the only one."""


@telemetry.command()
def check(
    file: Annotated[str, typer.Argument(metavar="FILE", help="CSV, NPZ, Parquet or ROS 2 bag.")],
    spacecraft: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="Compare its joints as well; needs the next two."),
    ] = None,
    base: Annotated[str | None, typer.Option(metavar="NAME", help="Its base body.")] = None,
    capture_frame: Annotated[
        str | None, typer.Option(metavar="NAME", help="The frame that holds the target.")
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND=/NAME", help="Topic of a bag: see `cpid identify --help`."),
    ] = None,
) -> int:
    """Say what is in a telemetry file and what is wrong with it, line by line.

    Exit codes: 0 nothing is wrong; 2 something is.
    """
    from cpid_drake.errors import InputError
    from cpid_drake.identification.telemetry_identification import check_log, of_spacecraft
    from cpid_drake.report.telemetry import contents
    from cpid_drake.sensing.files.consistency import check_consistency
    from cpid_drake.sensing.files.telemetry_files import inspect_telemetry
    from cpid_drake.spacecraft.spacecraft import Spacecraft

    out = Console(markup=False, highlight=False, soft_wrap=True)
    given = [spacecraft, base, capture_frame]
    if any(given) and not all(given):
        raise InputError("--spacecraft, --base and --capture-frame belong together")
    found = inspect_telemetry(file, topics=topics_of(topic))
    out.print("\n".join(contents(found, file)))
    errors = [str(problem) for problem in found.problems.first]
    warnings = []
    try:
        if spacecraft and base and capture_frame:
            craft = Spacecraft(spacecraft, base=base, capture_frame=capture_frame)
            warnings = check_log(craft, of_spacecraft(found.measurements, craft))
        else:
            consistency = check_consistency(found.measurements)
            errors, warnings = errors + consistency.errors, consistency.warnings
    except InputError as error:
        errors.append(str(error))
    for warning in warnings:
        out.print(f"warning: {warning}")
    for error in errors:
        out.print(f"error: {error}")
    hidden = found.problems.count - len(found.problems.first)
    if hidden > 0:
        out.print(f"... and {hidden} more")
    if not errors:
        out.print("nothing is wrong with it")
        return 0
    raise InputError(f"{file}: {len(errors) + max(hidden, 0)} things are wrong: see above")


def topics_of(entries: list[str] | None) -> dict[str, str]:
    """Return the topics that --topic KIND=/NAME names, by kind.

    Raises:
        InputError: an entry of another form.

    """
    from cpid_drake.errors import InputError

    topics = {}
    for entry in entries or []:
        kind, separator, name = entry.partition("=")
        if not (kind and separator):
            raise InputError(f"--topic {entry}: give KIND=/NAME, such as imu=/imu/data")
        topics[kind] = name
    return topics
