"""`cpid log`: checks logs, finds out what their columns mean, and converts them."""

import sys
from collections import Counter
from pathlib import Path

from cpid_drake.commands import options
from cpid_drake.commands.groups import group
from cpid_drake.commands.options import CHECK_FAILED
from cpid_drake.dynamics.rows import RELATIVE_ROWS, STANDARD_ROWS
from cpid_drake.files.drafts import write_text
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import check_log, left_out_warnings
from cpid_drake.identification.checks import label_of
from cpid_drake.identification.log_conventions import with_conventions
from cpid_drake.logs.channels import look_at
from cpid_drake.logs.conventions import Findings
from cpid_drake.logs.files import inspect_log, read_log, read_table, write_log
from cpid_drake.logs.guess.guess import guess_map
from cpid_drake.report.log_contents import contents

log = group("log")
_SHOWN = 100  # problems of a file that are listed; more of them say nothing new
_ROWS = (RELATIVE_ROWS.name, STANDARD_ROWS.name)  # without the position, and with it


@log.command
def check(
    log: options.LogFile,
    /,
    *,
    craft: options.SpacecraftOptions = options.SpacecraftOptions(),
    reading: options.ReadingOptions = options.ReadingOptions(),
) -> int:
    """List the contents and all problems of a log, and what was not checked.

    With a spacecraft, the joints are compared with the model's, and units and conventions with the
    conservation of momentum.

    Exit codes: 0 no error, perhaps warnings; 2 at least one error.
    """
    spacecraft = craft.known().make() if craft != options.SpacecraftOptions() else None
    joints = None if spacecraft is None else spacecraft.joint_names
    found = inspect_log(log, topics=reading.topics(), columns=reading.columns, joints=joints)
    rejected, failures, said = Counter(found.partial), list[str](), Findings()
    warnings = left_out_warnings(found.left_out_joints)
    try:
        checked = check_log(spacecraft, found.log)
        if spacecraft is not None:
            checked = with_conventions(checked, Arguments(spacecraft), _ROWS)
    except InputError as error:
        failures, seen = [str(error)], look_at(found.log)
        warnings, channels = [*warnings, *seen.warnings], seen.table
    else:
        failures, said, channels = [*checked.failures], checked.conventions, checked.channels
        warnings += checked.warnings
        rejected += Counter(checked.rejected)
    warnings += [f"unusable samples of {label_of(name)}: {n}" for name, n in rejected.items()]
    problems, unchecked = [*found.problems, *failures], [*said.unchecked, *said.not_compared]
    if failures and not said.comparisons:
        unchecked.append("units, signs and frames: nothing was compared, because of the errors")
    lines = [*contents(found, log, channels, said.comparisons)]
    lines += [f"warning: {warning}" for warning in warnings]
    lines += [f"error: {problem}" for problem in [*found.problems[:_SHOWN], *failures]]
    if len(found.problems) > _SHOWN:
        lines.append(f"... and {len(found.problems) - _SHOWN} more")
    lines += [f"not checked: {text}" for text in unchecked]
    if not problems:
        counts = f"no errors; warnings: {len(warnings)}, not checked: {len(unchecked)}"
        lines.append(counts if warnings or unchecked else "no problems found")
    options.log_console(stderr=False).print("\n".join(lines))
    if problems:
        plural = "s" * (len(problems) > 1)
        raise InputError(f"{log}: {len(problems)} problem{plural} found, listed above")
    return 0


@log.command(name="map")
def map_columns(
    log: options.LogFile,
    /,
    *,
    craft: options.SpacecraftOptions = options.SpacecraftOptions(),
    out: options.File | None = None,
    frame_rate: options.Rate | None = None,
    topic: options.Topics | None = None,
    force: options.Force = False,
) -> int:
    """Guess what the columns of a log mean, say why, and check the guess.

    Names, units and values of columns, limits of joints, the agreement of positions with rates, and
    the conservation of momentum are compared. The map is printed, and with --out written, as YAML
    with the reasons as comments; `--columns` of other commands reads it.

    Exit codes: 0 the log agrees with the map; 2 columns are missing; 4 the log does not agree with
    the map, or an attitude, a unit or a direction is open.

    Args:
        out: YAML file to write the map to.
        frame_rate: Frames per second, if the log counts frames.

    """
    check_outputs([("--out", out)], [log, *craft.files()], force=force)
    known, spacecraft = craft.known(), craft.known().make()
    topics = options.ReadingOptions(topic=topic).topics()
    with prefix_errors(log):
        guess = guess_map(read_table(log, topics), spacecraft, known.base, frame_rate)
    warnings, failures = tuple[str, ...](), tuple[str, ...]()
    try:
        checked = check_log(spacecraft, guess.log)
        checked = with_conventions(checked, Arguments(spacecraft), _ROWS)
        warnings, failures = checked.warnings, checked.failures
    except InputError as error:
        failures = (str(error),)
    if guess.column_map.attitude.columns and "time.unit" not in guess.free:
        for failure in failures:
            guess.say("", f"The log does not agree with this map: {failure}")
    text = guess.text(f"Map of the columns of {Path(log).name}, guessed by `cpid log map`.")
    options.log_console(stderr=False).print(text)
    if out is not None:
        write_text(out, text)
    wrong = ""
    if guess.missing:
        wrong = f"complete this map: {'; '.join(guess.missing)}"
    elif failures:
        wrong = f"does not agree with this map: {failures[0]}"
    if wrong:
        print(f"{log}: {wrong}", file=sys.stderr)
        return CHECK_FAILED
    options.print_warnings(warnings)
    if out is not None:
        print(f"{out}: written; read the log with --columns {out}", file=sys.stderr)
    return 0


@log.command
def convert(
    log: options.LogFile,
    /,
    *,
    reading: options.ReadingOptions = options.ReadingOptions(),
    out: options.File,
    leave_out_bad: options.LeaveOutBad = False,
    force: options.Force = False,
) -> None:
    """Write a log in the package's own columns, SI units and radians.

    Angular velocities are written in the body's axes, as gyros measure them.

    Args:
        out: File to write: .csv, .npz or .parquet.

    """
    check_outputs([("--out", out)], [log, reading.columns], force=force)
    found = read_log(
        log, leave_out_bad=leave_out_bad, topics=reading.topics(), columns=reading.columns
    )
    write_log(out, found)
    options.log_console().print(f"{out}: written, {len(found.joint_names)} joints")
