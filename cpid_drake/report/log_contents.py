"""A description of a telemetry file in words: its contents, its problems, what was not checked."""

from collections import Counter
from collections.abc import Iterator, Sequence

from cpid_drake.files.errors import InputError
from cpid_drake.identification.checked_log import left_out_warnings
from cpid_drake.identification.log_conventions import check_as_read
from cpid_drake.identification.words import label_of
from cpid_drake.logs.channels import Channel, look_at
from cpid_drake.logs.conventions import Findings
from cpid_drake.logs.conversion import LogFile
from cpid_drake.spacecraft.spacecraft import Spacecraft

HEADS = ("channel", "rows", "rate", "longest gap", "use", "found")

_SHOWN = 100  # problems of a file that are listed; more of them say nothing new


def checked_contents(
    file: LogFile, where: str, spacecraft: Spacecraft | None
) -> tuple[list[str], int]:
    """Return lines on a log's file, and how many problems it has.

    Args:
        file: the file.
        where: its name.
        spacecraft: with the joints of the log; None to check what the log alone shows.

    """
    rejected, failures, conventions = Counter(file.partial), list[str](), Findings()
    warnings = left_out_warnings(file.left_out_joints)
    try:
        checked = check_as_read(file.log, spacecraft)
    except InputError as error:
        failures, looked = [str(error)], look_at(file.log)
        warnings, channels = [*warnings, *looked.warnings], looked.table
    else:
        failures, conventions, channels = [*checked.failures], checked.conventions, checked.channels
        warnings += checked.warnings
        rejected += Counter(checked.rejected)
    warnings += [f"unusable samples of {label_of(name)}: {n}" for name, n in rejected.items()]
    unchecked = [*conventions.unchecked, *conventions.not_compared]
    if failures and not conventions.comparisons:
        unchecked.append("units, signs and frames: nothing was compared, because of the errors")
    lines = [
        *_contents(file, where, channels),
        *(f"  {each.text}" for each in conventions.comparisons),
    ]
    lines += [f"warning: {warning}" for warning in warnings]
    lines += [f"error: {problem}" for problem in [*file.problems[:_SHOWN], *failures]]
    if len(file.problems) > _SHOWN:
        lines.append(f"... and {len(file.problems) - _SHOWN} more")
    lines += [f"not checked: {text}" for text in unchecked]
    count = len(file.problems) + len(failures)
    if not count:
        counts = f"no errors; warnings: {len(warnings)}, not checked: {len(unchecked)}"
        lines.append(counts if warnings or unchecked else "no problems found")
    return lines, count


def _contents(file: LogFile, where: str, channels: Sequence[Channel]) -> Iterator[str]:
    """Yield lines on times, joints, channels, and columns that are not used."""
    log, (first, last) = file.log, file.log.interval
    yield f"{where}: {file.row_count} rows" + (
        f", {first:.6g} to {last:.6g} s" if first <= last else ""
    )
    joints = log.joint_names
    yield f"  {len(joints)} joints: {', '.join(joints)}" if joints else "  no joints"
    rows = [HEADS, *(channel.cells for channel in channels)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEADS) - 1)]
    for row in rows:
        padded = [cell.ljust(width) for cell, width in zip(row, widths)]
        yield "  " + "  ".join([*padded, row[-1]])
    if len(log.thrust):
        yield f"  thrust: {len(log.thrust)} rows, each holds until the next"
    for name, count in file.partial.items():
        yield f"  {count} samples of {label_of(name)} are there in part only, and not used"
    if file.ignored:
        yield f"  ignored columns: {', '.join(file.ignored[:20])}"
