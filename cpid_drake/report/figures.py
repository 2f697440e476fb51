"""Figures of an identification, for a page or as files."""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS, second_moment
from cpid_drake.identification.identify_files import Estimates
from cpid_drake.identification.result import Identification, ResidualSeries
from cpid_drake.logs.log import Log, Samples
from cpid_drake.report.findings import Findings
from cpid_drake.report.pictures import COLORS, INK, Picture, PictureGroup, label_axes

_TIME = "time [s]"
_MOST_POINTS = 1500  # of a line in a page; a line of more points becomes an image, which is smaller

FIGURE_FILES = tuple(
    f"{name}.{ending}"
    for name in ("convergence", "residuals", "singular-values", "base-motion", "ellipsoid")
    for ending in ("png", "svg")
)
"""Names of the files that `write_figures` writes."""


def convergence_pictures(
    estimates: Estimates, truth: InertialParameters | None = None
) -> list[Picture]:
    """Return a picture for each parameter: its estimates over time, with 95 % intervals."""
    true = None if truth is None else truth.to_vector()
    return [
        Picture(
            f"convergence-{name}",
            f"{name} over time with its 95 % interval",
            partial(_draw_parameter, estimates, None if true is None else float(true[i]), i),
        )
        for i, name in enumerate(PARAMETER_NAMES)
    ]


def residual_pictures(found: Identification) -> list[Picture]:
    """Return pictures of the residuals over time."""
    return [
        Picture(
            f"residuals-{name}",
            f"residuals of {name} over time",
            partial(_draw_vector, name, series, f"residual [{series.unit}]", line="none"),
        )
        for name, series in found.residuals.items()
    ]


def singular_value_picture(values: NDArray[np.float64]) -> Picture:
    """Return the picture of ten singular values."""

    def draw(axes: Axes) -> None:
        label_axes(axes, "Singular values", "number", "scaled value")
        axes.stem(np.arange(1, len(values) + 1), values, basefmt=" ")
        if (values > 0).all():
            axes.set_yscale("log")
        axes.set_xticks(np.arange(1, len(values) + 1))
        axes.margins(x=0.05)

    return Picture("singular-values", "singular values of the scaled problem", draw)


def motion_pictures(measurements: Log) -> list[Picture]:
    """Return a picture for each sensor of the base's motion."""
    panels: dict[str, tuple[str, Samples, str]] = {}
    m = measurements
    if len(m.attitude):
        attitude = Rotation.from_quat(m.attitude.value, scalar_first=True)
        turned = Samples(m.attitude.time, (attitude[0].inv() * attitude).as_rotvec(degrees=True))
        panels["attitude"] = "Base rotation", turned, "rotation vector [deg]"
    if len(m.gyro):
        rate = Samples(m.gyro.time, np.degrees(m.gyro.value))
        panels["rate"] = "Base angular velocity, in B", rate, "[deg/s]"
    if len(m.position):
        place = Samples(m.position.time, m.position.value - m.position.value[0])
        panels["position"] = "Base displacement", place, "in W [m]"
    if len(m.velocity):
        panels["velocity"] = "Base velocity", m.velocity, "in W [m/s]"
    return [
        Picture(f"base-{name}", f"{title} over time", partial(_draw_vector, title, samples, label))
        for name, (title, samples, label) in panels.items()
    ]


def ellipsoid_pictures(
    target: InertialParameters, truth: InertialParameters | None
) -> list[Picture]:
    """Return the solid ellipsoid of equal mass and inertia, seen along each axis of C."""
    return [
        Picture(
            f"ellipsoid-{'xyz'[i]}{'xyz'[j]}",
            f"the solid ellipsoid of the same inertia, {'xyz'[i]} and {'xyz'[j]}",
            partial(_draw_ellipsoid, target, truth, (i, j)),
            (3.7, 3.0),
        )
        for i, j in ((0, 1), (0, 2), (1, 2))
    ]


def write_figures(folder: Path, findings: Findings) -> None:
    """Write the figures of a log as PNG and SVG files into an existing folder."""
    assert findings.evidence is not None
    found, truth = findings.evidence.found, findings.truth
    shown = findings.evidence.log.data.thinned()
    body = found.consistent
    for group in (
        PictureGroup("convergence", "", convergence_pictures(findings.estimates, truth)),
        PictureGroup("residuals", "", residual_pictures(found)),
        PictureGroup("singular-values", "", [singular_value_picture(found.singular_values)]),
        PictureGroup("base-motion", "", motion_pictures(shown)),
        PictureGroup("ellipsoid", "", ellipsoid_pictures(body, truth) if body else [], 3),
    ):
        for ending in ("png", "svg"):
            group.save(folder, ending)


# -- drawing --------------------------------------------------------------------------------------


def _draw_parameter(estimates: Estimates, true: float | None, i: int, axes: Axes) -> None:
    time = np.array([time for time, _ in estimates])
    value = np.array([found.parameters[i] for _, found in estimates])
    bands = np.array([found.intervals[i] for _, found in estimates])
    axes.fill_between(time, *bands.T, color=COLORS[0], alpha=0.22, linewidth=0)
    axes.plot(time, value, "o-", color=COLORS[0], markersize=3)
    if true is not None:
        axes.axhline(true, color=COLORS[1], linestyle="--")
    label_axes(axes, PARAMETER_NAMES[i], _TIME, f"[{PARAMETER_UNITS[i]}]")
    axes.set_xlim(0.0, time[-1])
    known = np.flatnonzero(np.isfinite(value))
    if not known.size:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center")
        return
    # The limits show the later estimates: the first intervals are too wide.
    late = known[len(known) // 3 :]
    shown = np.concatenate(
        [value[late], bands[late].ravel(), [value[known[-1]] if true is None else true]]
    )
    low, high = np.nanmin(shown), np.nanmax(shown)
    margin = 0.08 * (high - low) or 1e-3 * max(abs(high), 1e-9)
    axes.set_ylim(low - margin, high + margin)


def _draw_vector(
    title: str, samples: Samples | ResidualSeries, label: str, axes: Axes, line: str = "-"
) -> None:
    for column, name, color in zip(samples.value.T, "xyz", COLORS):
        axes.plot(
            samples.time,
            column,
            color=color,
            label=name,
            linestyle=line,
            marker="." if line == "none" else "",
            markersize=2.5 if len(samples) > 300 else 5.0,
            rasterized=len(samples) > _MOST_POINTS or line == "none",
        )
    label_axes(axes, title, _TIME, label)
    _legend_above(axes)


def _legend_above(axes: Axes) -> None:
    """Put the legend to the right of the title, outside the data."""
    axes.legend(
        ncols=4, loc="lower right", bbox_to_anchor=(1.02, 0.98), borderpad=0.1, columnspacing=0.8
    )


def _draw_ellipsoid(
    target: InertialParameters,
    truth: InertialParameters | None,
    plane: tuple[int, int],
    axes: Axes,
) -> None:
    bodies = [(target, COLORS[0], "-", "estimate")]
    if truth is not None:
        bodies.append((truth, COLORS[1], "--", "truth"))
    for body, color, line, name in bodies:
        middle = body.p_CTcm_C[list(plane)]
        axes.plot(*(middle[:, None] + ellipse(body, plane)), line, color=color, label=name)
        axes.plot(*middle, "+", color=color, markersize=7)
    axes.plot(0.0, 0.0, "s", color=INK, markersize=4, label="capture frame")
    x, y = ("xyz"[k] for k in plane)
    label_axes(axes, "", f"{x} in C [m]", f"{y} in C [m]")
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    _legend_above(axes)


def ellipse(body: InertialParameters, plane: tuple[int, int]) -> NDArray[np.float64]:
    """Return the outline (2, N) of a body's ellipsoid of equal inertia, seen along an axis [m].

    Its second moments of mass are those of the body, Σ = (tr(I)/2) 1 − I; those of a solid
    ellipsoid of semi-axes a are m a²/5.

    Args:
        body: the body.
        plane: the two axes of C that are seen.

    """
    moments = second_moment(body.I_TTcm_C)
    values, axes = np.linalg.eigh(5 / body.mass * moments[np.ix_(plane, plane)])
    angle = np.linspace(0, 2 * np.pi, 121)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return (axes * np.sqrt(np.maximum(values, 0.0))) @ circle
