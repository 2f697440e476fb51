"""A description of a telemetry file in words."""

from collections.abc import Sequence

import numpy as np

from cpid_drake.logs.conversion import LogFile
from cpid_drake.logs.log import Samples
from cpid_drake.logs.score import Comparison
from cpid_drake.sensors.sensors import SENSORS


def contents(found: LogFile, where: str, comparisons: Sequence[Comparison] = ()) -> list[str]:
    """Return lines on the contents of a file: sensors, number of samples, times, gaps, joints.

    Then follows how much of the motion each comparison of its quantities leaves unexplained.
    """
    log = found.log
    lines = [f"{where}: {found.row_count} rows"]
    for name, samples in log.items():
        timing = _timing(samples) if samples.value.size else "none"
        lines.append(f"  {SENSORS[name].quantity:18} {timing}")
    if len(log.thrust):
        lines.append(f"  {'thrust':18} {_timing(log.thrust)}")
    joints = log.joint_names
    lines.append(f"  {'joints':18} {len(joints)}: {', '.join(joints)}" if joints else "  no joints")
    for name, count in found.partial.items():
        label = SENSORS[name].quantity if name in SENSORS else name
        lines.append(f"  {count} samples of {label} are there in part only, and not used")
    if found.ignored:
        lines.append(f"  ignored columns: {', '.join(found.ignored[:20])}")
    for each in comparisons:
        first, second = each.sides
        lines.append(f"  {first} and {second} differ by {each.residual:.2%} of the motion")
    return lines


def _timing(samples: Samples) -> str:
    if not len(samples):
        return "none"
    text = f"{len(samples):8} samples, {samples.time[0]:.6g} to {samples.time[-1]:.6g} s"
    if len(samples) < 2:
        return text
    steps = np.diff(samples.time)
    usual = float(np.median(steps))
    text += f", every {usual:.4g} s"
    longest = int(steps.argmax())
    if steps[longest] > 3 * usual:
        text += f", longest gap {steps[longest]:.4g} s after {samples.time[longest]:.6g} s"
    return text
