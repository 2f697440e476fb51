"""`cpid telemetry`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options
from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.output_files.overwriting import LOGS, YAML, Output, check_outputs
from cpid_drake.resources import package_folders, resolve_model

if TYPE_CHECKING:
    from cpid_drake.logs.conversion import TelemetryFile
    from cpid_drake.spacecraft.spacecraft import Spacecraft

telemetry = typer.Typer(
    no_args_is_help=True,
    help="Check telemetry files, find out what their columns mean, and convert them. A log of any "
    "origin takes three steps: `map` writes a map of its columns, `check --columns` and "
    "`identify --columns` read the log with it.",
)

_SHOWN = 100  # problems of a file that are listed

FileArgument = Annotated[str, typer.Argument(metavar="FILE", help=options.LOG_KINDS)]


@telemetry.command()
def check(
    file: FileArgument,
    spacecraft: options.ModelOption[str | None] = None,
    base: options.BaseOption[str | None] = None,
    capture_frame: options.CaptureFrameOption[str | None] = None,
    columns: options.ColumnsOption = None,
    package: options.PackageOption = None,
    topic: options.TopicOption = None,
) -> int:
    """List the contents and all problems of a telemetry file, and what was not checked.

    With --spacecraft, --base and --capture-frame, the joints are compared with the model's, and
    units and conventions with the conservation of momentum.

    Exit codes: 0 no problem; 2 at least one problem.
    """
    given = [spacecraft, base, capture_frame]
    if any(given) and not all(given):
        raise InputError("give all of --spacecraft, --base and --capture-frame, or none of them")
    topics, packages = options.topics_of(topic), options.packages_of(package)
    from cpid_drake.logs.files import inspect_telemetry

    craft = None
    if spacecraft and base and capture_frame:
        from cpid_drake.spacecraft.spacecraft import Spacecraft

        craft = Spacecraft(spacecraft, base=base, capture_frame=capture_frame, packages=packages)
    joints = None if craft is None else craft.joint_names
    found = inspect_telemetry(file, topics=topics, columns=columns, joints=joints)
    from cpid_drake.report.telemetry import contents

    out = Console(markup=False, highlight=False, soft_wrap=True)
    out.print("\n".join(contents(found, file)))
    errors, warnings, unchecked = _comparisons(found, craft)
    hidden = max(len(found.problems) - _SHOWN, 0)
    errors = [*found.problems[:_SHOWN], *errors]
    for warning in warnings:
        out.print(f"warning: {warning}")
    for problem in errors:
        out.print(f"error: {problem}")
    if hidden:
        out.print(f"... and {hidden} more")
    for text in unchecked:
        out.print(f"not checked: {text}")
    if not errors:
        out.print("no problems found")
        return 0
    count = len(errors) + hidden
    raise InputError(f"{file}: {count} problem{'s' * (count > 1)} found, listed above")


def _comparisons(
    found: "TelemetryFile", craft: "Spacecraft | None"
) -> tuple[list[str], list[str], list[str]]:
    """Return errors, warnings, and what could not be compared."""
    from cpid_drake.logs.consistency import check_consistency
    from cpid_drake.logs.motion_checks import not_checked

    unchecked = not_checked(found.measurements, has_spacecraft=craft is not None)
    if craft is None:
        consistency = check_consistency(found.measurements)
        return consistency.errors, consistency.warnings, unchecked
    from cpid_drake.identification.checked_log import check_log
    from cpid_drake.identification.requirements import left_out_warning

    warnings = [left_out_warning(found.left_out_joints)] if found.left_out_joints else []
    try:
        log = check_log(craft, found.measurements)
    except InputError as error:
        return [str(error)], warnings, unchecked
    return list(log.failures), [*warnings, *log.warnings], [*unchecked, *log.unchecked]


@telemetry.command(name="map")
def map_columns(
    file: FileArgument,
    spacecraft: options.ModelOption[str],
    base: options.BaseOption[str],
    capture_frame: options.CaptureFrameOption[str],
    out: Annotated[
        Path | None, typer.Option(metavar="YAML", help="Write the map to this file.")
    ] = None,
    frame_rate: Annotated[
        float | None,
        typer.Option(
            "--frame-rate", metavar="HZ", help="Frames per second, if the log counts frames."
        ),
    ] = None,
    package: options.PackageOption = None,
    topic: options.TopicOption = None,
    force: options.ForceOption = False,
) -> int:
    """Guess what the columns of a log mean, say why, and check the guess.

    Names, units and values of columns, limits of joints, the agreement of positions with rates, and
    the conservation of momentum are compared. The map is printed, and with --out written, as YAML
    with the reasons as comments; `--columns` of other commands reads it.

    Exit codes: 0 the log agrees with the map; 2 columns are missing; 4 the log does not agree with
    the map, or an attitude, a unit or a direction is open.
    """
    packages, topics = options.packages_of(package), options.topics_of(topic)
    if frame_rate is not None and not 0 < frame_rate < 1e6:
        raise InputError(f"--frame-rate {frame_rate:g}: must be from 0 to 1e6 Hz")
    if out is not None:
        inputs: list[str | Path] = [file, resolve_model(spacecraft, package_folders(packages))]
        check_outputs([Output("--out", out, YAML)], inputs, force=force)
    from cpid_drake.identification.checked_log import check_log
    from cpid_drake.logs.guess.guess import guess_map
    from cpid_drake.logs.guess.map_text import column_map_text
    from cpid_drake.logs.guess.raw_log import read_raw
    from cpid_drake.output_files.drafts import write_text
    from cpid_drake.spacecraft.spacecraft import Spacecraft

    craft = Spacecraft(spacecraft, base=base, capture_frame=capture_frame, packages=packages)
    with prefix_errors(file):
        guess = guess_map(read_raw(file, topics), craft, base, frame_rate)
    heading = [f"Map of the columns of {Path(file).name}, guessed by `cpid telemetry map`."]
    text = column_map_text(guess.column_map, guess.reasons, heading)
    console = Console(markup=False, highlight=False, soft_wrap=True)
    console.print(text)
    if out is not None:
        write_text(out, text)
    log = options.log_console()
    try:
        checked = check_log(craft, guess.measurements)
    except InputError as error:
        raise InputError(f"{file}: does not agree with this map: {error}") from error
    if guess.missing:
        log.print(f"{file}: complete this map: {'; '.join(guess.missing)}")
        return 4
    if checked.failures:
        log.print(f"{file}: does not agree with this map: {checked.failures[0]}")
        return 4
    for warning in checked.warnings:
        log.print(f"warning: {warning}")
    if out is not None:
        log.print(f"{out}: written; read the log with --columns {out}")
    return 0


@telemetry.command()
def convert(
    file: FileArgument,
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="File to write: .csv, .npz or .parquet.")
    ],
    columns: options.ColumnsOption = None,
    topic: options.TopicOption = None,
    leave_out_bad: options.LeaveOutBadOption = False,
    force: options.ForceOption = False,
) -> int:
    """Write a log in the package's own columns, SI units and radians.

    Angular velocities are written in the body's axes, as gyros measure them.
    """
    topics = options.topics_of(topic)
    kind = next((k for k in LOGS if out.name.lower().endswith(k.endings)), LOGS[0])
    inputs = [file, *([] if columns is None else [columns])]
    check_outputs([Output("", out, kind)], inputs, force=force)
    from cpid_drake.logs.files import read_telemetry, write_telemetry

    log = read_telemetry(file, leave_out_bad=leave_out_bad, topics=topics, columns=columns)
    write_telemetry(out, log)
    options.log_console().print(f"{out}: written, {len(log.joint_names)} joints")
    return 0
