"""`cpid log`: checks logs, and finds out what their columns and their noise are."""

import sys

import cpid_drake as cpid
from cpid_drake.commands import options
from cpid_drake.commands.groups import group
from cpid_drake.commands.options import CHECK_FAILED
from cpid_drake.files.drafts import write_text
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.identification.log_conventions import check_as_read
from cpid_drake.logs.formats import inspect_log, read_table, refuse_problems
from cpid_drake.logs.guess.guess import guess_map
from cpid_drake.logs.joined import log_name
from cpid_drake.logs.sensors_file import sensors_file
from cpid_drake.report.log_contents import checked_contents

log = group("log")


@log.command
def check(
    log: options.LogFile,
    /,
    *,
    craft: options.SpacecraftOptions = options.SpacecraftOptions(),
    columns: options.Columns | None = None,
    topic: options.Topics | None = None,
) -> int:
    """List the contents and all problems of a log, and what was not checked.

    With a spacecraft, the joints are compared with the model's, and units and conventions with the
    conservation of momentum.

    Exit codes: 0 no error, perhaps warnings; 2 at least one error.
    """
    spacecraft = craft.spacecraft_file().make() if craft != options.SpacecraftOptions() else None
    joints = None if spacecraft is None else spacecraft.joint_names
    file = inspect_log(log, topics=options.topics_of(topic), columns=columns, joints=joints)
    lines, count = checked_contents(file, log, spacecraft)
    options.log_console(stderr=False).print("\n".join(lines))
    if count:
        raise InputError(f"{log}: {count} problem{'s' * (count > 1)} found, listed above")
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

    Exit codes: 0 the log agrees with the map; 2 columns are missing, or rows have problems; 4 the
    log does not agree with the map, or an attitude, a unit or a direction is open.

    Args:
        out: YAML file to write the map to.
        frame_rate: Frames per second, if the log counts frames.

    """
    craft_file = craft.spacecraft_file()
    named = cpid.Request(log, craft_file.reference()).existing_files()
    check_outputs([("--out", out)], [log, *craft.files(), *named], force=force)
    spacecraft, topics = craft_file.make(), options.topics_of(topic)
    with prefix_errors(log):
        table = read_table(log, topics)
        guess = guess_map(table, spacecraft, craft_file.base, frame_rate)
    warnings, failures = tuple[str, ...](), tuple[str, ...]()
    try:
        checked = check_as_read(guess.log, spacecraft)
        warnings, failures = checked.warnings, checked.failures
    except InputError as error:
        failures = (str(error),)
    if guess.column_map.attitude.columns and "time.unit" not in guess.free:
        for failure in failures:
            guess.say("", f"The log does not agree with this map: {failure}")
    text = guess.text(f"Map of the columns of {log_name(log)}, guessed by `cpid log map`.")
    options.log_console(stderr=False).print(text)
    if out is not None:
        write_text(out, text)
    wrong = ""
    if failures:
        wrong = f"does not agree with this map: {failures[0]}"
    elif guess.missing:
        wrong = f"complete this map: {'; '.join(guess.missing)}"
    if wrong:
        print(f"{log}: {wrong}", file=sys.stderr)
        return CHECK_FAILED
    options.print_warnings(warnings)
    refuse_problems(guess.read(table).problems, log)
    if out is not None:
        print(f"{out}: written; read the log with --columns {out}", file=sys.stderr)
    return 0


@log.command
def noise(
    log: options.LogFile,
    /,
    *,
    craft: options.SpacecraftOptions = options.SpacecraftOptions(),
    out: options.File | None = None,
    columns: options.Columns | None = None,
    topic: options.Topics | None = None,
    force: options.Force = False,
) -> int:
    """Write the sensors' file that a log shows, for a laboratory without data sheets.

    Rates, the white noise of each sensor and the bias of the gyro are estimated from the log. The
    file is printed, and with --out written, as YAML with the origin of each number as a comment;
    `--sensors` of other commands reads it. What a log alone does not show is not stated.

    Exit codes: 0 success; 2 bad input, or a log of other conventions than it is read in.

    Args:
        out: YAML file to write the sensors to.

    """
    craft_file = craft.spacecraft_file() if craft != options.SpacecraftOptions() else None
    files = [] if craft_file is None else cpid.Request(log, craft_file.reference()).existing_files()
    check_outputs([("--out", out)], [log, columns, *craft.files(), *files], force=force)
    spacecraft = None if craft_file is None else craft_file.make()
    joints = None if spacecraft is None else spacecraft.joint_names
    file = inspect_log(log, topics=options.topics_of(topic), columns=columns, joints=joints)
    refuse_problems(file.problems, log)
    with prefix_errors(log):
        checked = check_as_read(file.log, spacecraft)
        if checked.failures:
            raise InputError(checked.failures[0])
        made = sensors_file(checked.measurements, log_name(log))
    options.log_console(stderr=False).print(made.text)
    if out is not None:
        write_text(out, made.text)
    options.print_warnings((*checked.warnings, *made.warnings))
    if out is not None:
        print(f"{out}: written; identify with --sensors {out}", file=sys.stderr)
    return 0
