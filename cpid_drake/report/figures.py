"""Figures of an identification, for a page or as files."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS, second_moment
from cpid_drake.estimation.whiteness import scaled_sums
from cpid_drake.identification.convergence import Estimates
from cpid_drake.identification.result import Identification, ResidualSeries
from cpid_drake.logs.log import Measurements, Samples
from cpid_drake.report.findings import IdentifiedLog
from cpid_drake.report.pictures import Picture, together
from cpid_drake.report.style import COLORS, INK, label_axes

_TIME = "time [s]"
_MOST_POINTS = 1500  # points of a line in a page; a line of more points becomes an image
_LAGS = 25

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
    return [
        Picture(
            f"convergence-{name}",
            f"{name} over time with its 95 % interval",
            partial(_draw_parameter, estimates, truth, i),
        )
        for i, name in enumerate(PARAMETER_NAMES)
    ]


def residual_pictures(found: Identification) -> list[Picture]:
    """Return pictures of the residuals over time, and of their autocorrelation."""
    pictures = []
    for name, samples in found.residuals.items():
        draw = partial(_draw_residuals, samples, name)
        pictures.append(Picture(f"residuals-{name}", f"residuals of {name} over time", draw))
    if any(len(samples) >= 8 for samples in found.residuals.values()):
        draw = partial(_draw_autocorrelation, found.residuals)
        pictures.append(Picture("autocorrelation", "autocorrelation of the residuals", draw))
    return pictures


def singular_value_picture(values: NDArray[np.float64]) -> Picture:
    """Return the picture of ten singular values."""
    draw = partial(_draw_singular_values, values)
    return Picture("singular-values", "singular values of the scaled problem", draw)


def motion_pictures(measurements: Measurements) -> list[Picture]:
    """Return a picture for each sensor of the base's motion."""
    panels: dict[str, tuple[str, Samples, str]] = {}
    m = measurements
    if len(m.attitude):
        attitude = Rotation.from_quat(m.attitude.value, scalar_first=True)
        angles = np.degrees((attitude[0].inv() * attitude).as_rotvec())
        turned = Samples(m.attitude.time, angles)
        panels["attitude"] = "Base rotation", turned, "rotation vector [deg]"
    if len(m.gyro):
        rate = Samples(m.gyro.time, np.degrees(m.gyro.value))
        panels["rate"] = "Base angular velocity, in B", rate, "[deg/s]"
    if len(m.position):
        moved = m.position.value - m.position.value[0]
        factor, unit = (1e3, "mm") if np.abs(moved).max() < 0.1 else (1.0, "m")
        place = Samples(m.position.time, factor * moved)
        panels["position"] = "Base displacement", place, f"in W [{unit}]"
    if len(m.velocity):
        speed = Samples(m.velocity.time, 1e3 * m.velocity.value)
        panels["velocity"] = "Base velocity", speed, "in W [mm/s]"
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


def write_figures(
    folder: Path, log: IdentifiedLog, truth: InertialParameters | None = None
) -> list[Path]:
    """Write the figures as PNG and SVG files into an existing folder; return the files."""
    evidence, found = log.evidence, log.evidence.found
    pictures = [
        together("convergence", convergence_pictures(log.estimates, truth), 2),
        together("residuals", residual_pictures(found), 2),
        singular_value_picture(found.singular_values),
        together("base-motion", motion_pictures(evidence.log.data.thinned()), 2),
    ]
    if found.consistent is not None:
        pictures.append(together("ellipsoid", ellipsoid_pictures(found.consistent, truth), 3))
    return [
        picture.save(folder, ending)
        for picture in pictures
        if picture is not None
        for ending in ("png", "svg")
    ]


# -- drawing --------------------------------------------------------------------------------------


def _draw_parameter(
    estimates: Estimates, truth: InertialParameters | None, i: int, figure: Figure
) -> None:
    axes = figure.subplots()
    true = None if truth is None else float(truth.to_vector()[i])
    time = np.array([time for time, _ in estimates])
    value = np.array([found.parameters[i] for _, found in estimates])
    bands = np.array([found.intervals[i] for _, found in estimates])
    low, high = bands.T
    axes.fill_between(time, low, high, color=COLORS[0], alpha=0.22, linewidth=0)
    axes.plot(time, value, "o-", color=COLORS[0], markersize=3, linewidth=1.2)
    if true is not None:
        axes.axhline(true, color=COLORS[1], linewidth=1.2, linestyle="--")
    label_axes(axes, PARAMETER_NAMES[i], _TIME, f"[{PARAMETER_UNITS[i]}]")
    axes.set_xlim(0.0, time[-1])
    limits = _limits(value, bands, true)
    if limits is None:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "not known", transform=axes.transAxes, ha="center")
    else:
        axes.set_ylim(*limits)
        # If tick labels have most digits in common, an offset replaces these digits.
        long = limits[1] - limits[0] < 1e-5 * max(map(abs, limits))
        axes.ticklabel_format(axis="y", useOffset=long, scilimits=(-4, 5))
        axes.locator_params(axis="y", nbins=5)


def _limits(
    values: NDArray[np.float64], bands: NDArray[np.float64], true: float | None
) -> tuple[float, float] | None:
    """Return limits that show the later estimates; the first intervals are too wide."""
    known = np.flatnonzero(np.isfinite(values))
    if not known.size:
        return None
    late = known[len(known) // 3 :]
    shown = np.append(values[late], bands[late].ravel())
    shown = shown if true is None else np.append(shown, true)
    shown = shown[np.isfinite(shown)]
    low, high = float(shown.min()), float(shown.max())
    margin = 0.08 * (high - low) or 1e-3 * max(abs(high), 1e-9)
    return low - margin, high + margin


def _draw_residuals(series: ResidualSeries, name: str, figure: Figure) -> None:
    of_sensor = series.unit == "σ"
    title = f"{'Samples' if of_sensor else 'Rows'}: {name}"
    axes = _draw_vector(title, series, f"residual [{series.unit}]", figure, line="none")
    if of_sensor:
        axes.axhspan(-2, 2, color=COLORS[5], alpha=0.15, linewidth=0)


def _draw_vector(
    title: str, samples: Samples | ResidualSeries, label: str, figure: Figure, line: str = "-"
) -> Axes:
    axes = figure.subplots()
    for column, name, color in zip(samples.value.T, "xyz", COLORS):
        axes.plot(
            samples.time,
            column,
            color=color,
            label=name,
            linestyle=line,
            linewidth=1.2,
            marker="." if line == "none" else "",
            markersize=2.5 if len(samples) > 300 else 5.0,
            rasterized=len(samples) > _MOST_POINTS or line == "none",
        )
    label_axes(axes, title, _TIME, label)
    _legend_above(axes)
    return axes


def _legend_above(axes: Axes) -> None:
    """Put the legend to the right of the title, outside the data."""
    axes.legend(
        ncols=4,
        loc="lower right",
        bbox_to_anchor=(1.02, 0.98),
        borderpad=0.1,
        columnspacing=0.8,
        handlelength=1.0,
        handletextpad=0.3,
        markerscale=2,
    )


def _draw_autocorrelation(residuals: Mapping[str, ResidualSeries], figure: Figure) -> None:
    axes = figure.subplots()
    widest = 0.0
    for (name, samples), color in zip(residuals.items(), COLORS):
        sums = scaled_sums(samples.neighbours)
        rho = sums.correlation
        if len(rho) < 4:
            continue
        widest = max(widest, 2 / np.sqrt(sums.pairs[0]))
        lags = np.arange(1, min(_LAGS + 1, len(rho)))
        axes.plot(lags, rho[lags], ".-", color=color, linewidth=0.9, markersize=4, label=name)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.axhspan(-widest, widest, color=COLORS[5], alpha=0.2, linewidth=0)
    label_axes(axes, "Autocorrelation", "lag [samples]", "correlation")
    axes.set_ylim(min(-0.35, axes.get_ylim()[0]), max(0.35, axes.get_ylim()[1]))
    axes.legend(ncols=2, loc="best", handlelength=1.2)


def _draw_singular_values(values: NDArray[np.float64], figure: Figure) -> None:
    axes = figure.subplots()
    place, largest = np.arange(1, len(values) + 1), float(np.max(values))
    smallest = np.min(values[values > 0], initial=largest)
    wide = 0 < smallest < largest / 10
    bottom = smallest / 3 if wide else 0.0
    axes.vlines(place, bottom, np.maximum(values, bottom), color=COLORS[0], linewidth=1.2)
    axes.plot(place[values > 0], values[values > 0], "o", color=COLORS[0], markersize=4)
    if wide:
        axes.set_yscale("log")
    label_axes(axes, "Singular values", "number", "scaled value")
    axes.set_ylim(bottom=bottom)
    axes.set_xticks(place)
    axes.set_xlim(0.5, len(values) + 0.5)


def _draw_ellipsoid(
    target: InertialParameters,
    truth: InertialParameters | None,
    plane: tuple[int, int],
    figure: Figure,
) -> None:
    axes = figure.subplots()
    bodies = [(target, COLORS[0], "-", "estimate")]
    if truth is not None:
        bodies.append((truth, COLORS[1], "--", "truth"))
    for body, color, line, name in bodies:
        middle = body.p_CTcm_C[list(plane)]
        outline = middle[:, None] + ellipse(body, plane)
        axes.plot(*outline, color=color, linestyle=line, linewidth=1.4, label=name)
        axes.plot(*middle, "+", color=color, markersize=7)
    axes.plot(0.0, 0.0, "s", color=INK, markersize=4, label="capture frame", linestyle="none")
    x, y = ("xyz"[k] for k in plane)
    label_axes(axes, "", f"{x} in C [m]", f"{y} in C [m]")
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(
        ncols=3, loc="lower right", bbox_to_anchor=(1.02, 0.98), borderpad=0.1, columnspacing=1.0
    )


def ellipse(body: InertialParameters, plane: tuple[int, int]) -> NDArray[np.float64]:
    """Return the outline (2, N) of a body's ellipsoid of equal inertia, seen along an axis [m].

    Its second moments of mass are those of the body, Σ = (tr(I)/2) 1 − I; those of a solid
    ellipsoid of semi-axes a are m a²/5.

    Args:
        body: the body.
        plane: the two axes of C that are seen.

    """
    moments = second_moment(body.I_TTcm_C)
    shape = 5 / body.mass * moments[np.ix_(plane, plane)]
    values, axes = np.linalg.eigh(shape)
    angle = np.linspace(0, 2 * np.pi, 121)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return (axes * np.sqrt(np.maximum(values, 0.0))) @ circle
