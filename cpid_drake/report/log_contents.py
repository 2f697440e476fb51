"""A description of a telemetry file in words."""

from collections.abc import Sequence

from cpid_drake.logs.channels import Channel
from cpid_drake.logs.conversion import LogFile
from cpid_drake.logs.score import Comparison
from cpid_drake.sensors.sensors import SENSORS

HEADS = ("channel", "rows", "rate", "longest gap", "use", "found")


def contents(
    found: LogFile, where: str, channels: Sequence[Channel], comparisons: Sequence[Comparison] = ()
) -> list[str]:
    """Return lines on the contents of a file: times, joints, and the table of channels.

    Then follows how much of the motion each comparison of its quantities leaves unexplained.
    """
    log, (first, last) = found.log, found.log.interval
    times = f", {first:.6g} to {last:.6g} s" if first <= last else ""
    lines = [f"{where}: {found.row_count} rows{times}"]
    joints = log.joint_names
    lines.append(f"  {len(joints)} joints: {', '.join(joints)}" if joints else "  no joints")
    rows = [HEADS, *(channel.cells for channel in channels)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEADS) - 1)]
    for row in rows:
        padded = [cell.ljust(width) for cell, width in zip(row, widths)]
        lines.append("  " + "  ".join([*padded, row[-1]]))
    if len(log.thrust):
        lines.append(f"  thrust: {len(log.thrust)} rows, each holds until the next")
    for name, count in found.partial.items():
        label = SENSORS[name].quantity if name in SENSORS else name
        lines.append(f"  {count} samples of {label} are there in part only, and not used")
    if found.ignored:
        lines.append(f"  ignored columns: {', '.join(found.ignored[:20])}")
    for each in comparisons:
        lines.append(f"  {each.text}")
    return lines
