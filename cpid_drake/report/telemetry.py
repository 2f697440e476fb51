"""A description of a telemetry file in words, and a figure of its comparisons."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cpid_drake.logs.conversion import TelemetryFile
from cpid_drake.logs.log import Samples
from cpid_drake.logs.score import Comparison
from cpid_drake.report.style import COLORS, saved_figure
from cpid_drake.sensors.sensors import SENSORS


def contents(found: TelemetryFile, where: str, comparisons: Sequence[Comparison] = ()) -> list[str]:
    """Return lines on the contents of a file: sensors, number of samples, times, gaps, joints.

    Then follows how much of the motion each comparison of its quantities leaves unexplained.
    """
    measurements = found.measurements
    lines = [f"{where}: {found.row_count} rows"]
    for name, samples in measurements.items():
        lines.append(f"  {SENSORS[name].label:18} {_timing(samples)}")
    if len(measurements.thrust):
        lines.append(f"  {'thrust':18} {_timing(measurements.thrust)}")
    joints = measurements.joint_names
    lines.append(f"  {'joints':18} {len(joints)}: {', '.join(joints)}")
    for name, count in found.partial.items():
        label = SENSORS[name].label if name in SENSORS else name
        lines.append(f"  {count} samples of {label} are there in part only, and not used")
    if found.ignored:
        lines.append(f"  ignored columns: {', '.join(found.ignored[:20])}")
    for each in comparisons:
        first, second = each.sides
        lines.append(f"  {first} and {second} differ by {each.residual:.2%} of the motion")
    return lines


def draw_comparisons(comparisons: Sequence[Comparison], path: Path) -> None:
    """Draw both sides of each comparison over time: a wrong sign or unit is seen at once.

    Raises:
        InputError: the file cannot be written.

    """
    shown = [each for each in comparisons if len(each.time)]
    with saved_figure(path, 7.0, 1.0 + 1.8 * len(shown)) as figure:
        panels = figure.subplots(max(len(shown), 1), 1, squeeze=False)[:, 0]
        for axes, each in zip(panels, shown):
            axes.set_title(f"{each.name}: {each.residual:.2%} unexplained")
            for k, (first, second) in enumerate(zip(each.values[0].T, each.values[1].T)):
                labels = each.sides if not k else (None, None)
                axes.plot(each.time, first, color=COLORS[k], label=labels[0])
                axes.plot(each.time, second, color=COLORS[k], linestyle=":", label=labels[1])
            axes.legend(loc="upper right")
            axes.set_xlabel("time [s]")


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
