"""Figures of an identification."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.files.pictures import COLORS, Picture, curves, label_axes
from cpid_drake.identification.result import History
from cpid_drake.logs.log import Log


def convergence_pictures(
    estimates: History, truth: InertialParameters | None = None
) -> list[Picture]:
    """Return a picture for each parameter: its estimates over time, with 95 % intervals."""
    true = np.full(10, np.nan) if truth is None else truth.to_vector()
    return [
        Picture(
            f"{name} over time with its 95 % interval",
            partial(_draw_parameter, estimates, float(true[i]), i),
        )
        for i, name in enumerate(PARAMETER_NAMES)
    ]


def singular_value_picture(values: Array) -> Picture:
    """Return the picture of ten singular values."""

    def draw(axes: Axes) -> None:
        label_axes(axes, "Singular values", "number", "scaled value")
        axes.stem(np.arange(1, len(values) + 1), values, basefmt=" ")
        axes.set_yscale("log" if (values > 0).all() else "linear")
        axes.set_xticks(np.arange(1, len(values) + 1))
        axes.margins(x=0.05)

    return Picture("singular values of the scaled problem", draw)


def motion_pictures(log: Log) -> list[Picture]:
    """Return a picture for each sensor of the base's motion that the log has."""
    found = []
    if len(log.attitude):
        attitude = Rotation.from_quat(log.attitude.value, scalar_first=True)
        turned = (attitude[0].inv() * attitude).as_rotvec(degrees=True)
        found.append(("Base rotation", log.attitude.time, turned, "rotation vector [deg]"))
    if len(log.gyro):
        rate = np.degrees(log.gyro.value)
        found.append(("Base angular velocity", log.gyro.time, rate, "in B [deg/s]"))
    if len(log.position):
        moved = log.position.value - log.position.value[0]
        found.append(("Base displacement", log.position.time, moved, "in W [m]"))
    if len(log.velocity):
        found.append(("Base velocity", log.velocity.time, log.velocity.value, "in W [m/s]"))
    return [curves(*each) for each in found]


def _draw_parameter(estimates: History, true: float, i: int, axes: Axes) -> None:
    time = np.array([time for time, _ in estimates])
    value = np.array([found.parameters[i] for _, found in estimates])
    bands = np.array([found.intervals[i] for _, found in estimates])
    axes.fill_between(time, *bands.T, color=COLORS[0], alpha=0.22, linewidth=0)
    axes.plot(time, value, "o-", color=COLORS[0], markersize=3)
    if np.isfinite(true):
        axes.axhline(true, color=COLORS[1], linestyle="--")
    label_axes(axes, PARAMETER_NAMES[i], "time [s]", f"[{PARAMETER_UNITS[i]}]")
    axes.set_xlim(0.0, time[-1])
    known = np.flatnonzero(np.isfinite(value))
    if not known.size:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "not identifiable", transform=axes.transAxes, ha="center")
        return
    # The limits show the later estimates: the first intervals are too wide.
    late = known[len(known) // 3 :]
    shown = np.concatenate([value[late], bands[late].ravel(), [true]])
    low, high = np.nanmin(shown), np.nanmax(shown)
    margin = 0.08 * (high - low) or 1e-3 * max(abs(high), 1e-9)
    axes.set_ylim(low - margin, high + margin)
