"""The figures of the paper's study."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cpid_drake.report.pictures import Picture, PictureGroup
from cpid_drake.report.scene import render_scenario
from cpid_drake.report.style import COLORS, INK, label_axes
from cpid_drake.studies.paper import PaperStudy
from cpid_drake.studies.paper_values import PAPER_TABLE_2
from cpid_drake.studies.parameter_errors import parameter_errors
from cpid_drake.studies.rounding import RoundedCase

_TIME = "time [s]"
_MARKERS = "os^vDP"
_CURVES = 6  # in one panel
_CURVE_COLORS = (*COLORS[:5], INK)
_DASH = 3.0  # length of a curve's part where curves coincide [line widths]
_PANEL = (3.7, 2.6)


def configuration_group(study: PaperStudy) -> PictureGroup:
    """Return Fig. 3: the spacecraft and its target at the start and at the end."""
    states = study.simulation.spacecraft.to_states(study.telemetry.select([0, -1]))
    images = render_scenario(study.simulation.scenario, list(states))
    times = study.telemetry.time[[0, -1]]
    pictures = []
    for name, word, time, image in zip("AB", ("Initial", "Final"), times, images, strict=True):
        title = f"({name}) {word} configuration, t = {time:g} s"
        draw = partial(_draw_image, image, title)
        pictures.append(Picture(f"figure3-{name}", title, draw, (4.6, 3.5)))
    return PictureGroup("Configurations (Fig. 3)", pictures)


def joint_motion_group(study: PaperStudy) -> PictureGroup:
    """Return Fig. 5: positions and rates of the joints that move, six joints in a panel."""
    telemetry = study.telemetry
    names = study.simulation.spacecraft.joint_names
    moving = np.flatnonzero(np.ptp(telemetry.q, axis=0) > 1e-6)
    parts = np.array_split(moving, max(1, -(-len(moving) // _CURVES)))
    pictures = []
    for what, values, unit in (
        ("angles", telemetry.q, "angle [deg]"),
        ("rates", telemetry.qdot, "rate [deg/s]"),
    ):
        for number, part in enumerate(parts):
            title = f"Joint {what}" + (f" ({number + 1} of {len(parts)})" if len(parts) > 1 else "")
            draw = partial(
                _draw_curves,
                title,
                unit,
                telemetry.time,
                np.degrees(values[:, part]),
                [names[k].replace("_", " ") for k in part],
            )
            pictures.append(Picture(f"figure5-{what}-{number}", title, draw, (3.7, 3.1)))
    return PictureGroup("Joint motion (Fig. 5)", pictures, len(parts))


def base_response_group(study: PaperStudy) -> PictureGroup:
    """Return Fig. 6: the motion of the base."""
    t, angles = study.telemetry, np.degrees(study.telemetry.euler_321)
    pictures = [
        _panel("figure6-A", "(A) Position of the base", "p_WB [m]", t.time, t.p_WB - t.p_WB[0]),
        _panel("figure6-B", "(B) Velocity of the base", "v_WB [m/s]", t.time, t.v_WB),
        _panel("figure6-C", "(C) Attitude, 3-2-1", "angle [deg]", t.time, angles),
        _panel("figure6-D", "(D) Angular velocity", "w_WB [deg/s]", t.time, np.degrees(t.w_WB)),
    ]
    return PictureGroup("Motion of the base (Fig. 6)", pictures)


def error_group(study: PaperStudy) -> PictureGroup:
    """Return Fig. 7: the errors of the base's motion after re-simulation."""
    time, attitude = study.telemetry.time, 1e3 * np.degrees(np.abs(study.attitude_error))
    position = 1e6 * np.abs(study.position_error)
    pictures = [
        _panel("figure7-A", "(A) Attitude error", "|error| [mdeg]", time, attitude),
        _panel("figure7-B", "(B) Position error", "|error| [µm]", time, position),
    ]
    title = "Error of the base's motion after re-simulation (Fig. 7)"
    return PictureGroup(title, pictures)


def decimals_group(study: PaperStudy) -> PictureGroup:
    """Return the error of the identified mass against the decimals of the data (Table 2)."""
    title = "Error of the mass against the decimals of the data"
    picture = Picture("table2-decimals", title, partial(_draw_decimals, study), (4.9, 3.2))
    return PictureGroup("Table 2 as a figure", [picture])


def convergence_group(study: PaperStudy) -> PictureGroup:
    """Return the error of the online estimate over time."""
    title = "Error of the online estimate over time"
    picture = Picture("online-convergence", title, partial(_draw_convergence, study), (4.9, 3.0))
    return PictureGroup("Online estimate", [picture])


def _panel(
    name: str, title: str, label: str, time: NDArray[np.float64], values: NDArray[np.float64]
) -> Picture:
    """Return a picture of three curves (N, 3)."""
    names = ("yaw", "pitch", "roll") if "ttitude" in title else ("x", "y", "z")
    return Picture(name, title, partial(_draw_curves, title, label, time, values, names), _PANEL)


def _draw_image(image: NDArray[np.uint8], title: str, figure: Figure) -> None:
    axes = figure.subplots()
    axes.imshow(image)
    axes.set_axis_off()
    axes.set_title(title)


def _draw_curves(
    title: str,
    label: str,
    time: NDArray[np.float64],
    values: NDArray[np.float64],
    names: list[str] | tuple[str, ...],
    figure: Figure,
) -> None:
    """Draw curves (N, K) over time, with a legend below.

    Curves that coincide are drawn as dashes of alternating colour, and their markers alternate, so
    that each of them is visible.
    """
    axes = figure.subplots()
    count = values.shape[1]
    for k, (name, twins) in enumerate(zip(names, coinciding_curves(values), strict=True)):
        n, place = len(twins), twins.index(k)
        line = "-" if n == 1 else (place * _DASH, (_DASH, (n - 1) * _DASH))
        step = max(1, len(time) // 5)
        axes.plot(
            time,
            values[:, k],
            color=_CURVE_COLORS[k % 6],
            linestyle=line,
            marker=_MARKERS[k % 6] if count > 3 else "",
            markersize=3.5,
            markevery=((k * step) // count, step),
            label=name,
        )
    label_axes(axes, title, _TIME, label)
    figure.legend(loc="outside lower center", ncols=2 if count > 3 else 3, handlelength=2.6)


def coinciding_curves(values: NDArray[np.float64]) -> list[list[int]]:
    """Return, for each curve (N, K), the curves that coincide with it, itself included."""
    near = 0.005 * np.ptp(values)
    apart = np.abs(values[:, :, None] - values[:, None, :]).max(axis=0)
    return [list(map(int, np.flatnonzero(row <= near))) for row in apart]


def _draw_decimals(study: PaperStudy, figure: Figure) -> None:
    axes, truth = figure.subplots(), study.truth
    if study.is_papers_target:
        theirs = [abs(mass / truth.mass - 1) for mass in PAPER_TABLE_2.values()]
        axes.plot(list(PAPER_TABLE_2), theirs, "s--", color=COLORS[1], label="paper (printed)")
    series = [("here, motion of Fig. 5", "o-", COLORS[0], study.rounded)]
    if study.exciting is not None:
        series.append(("here, exciting motion", "^-", COLORS[2], study.exciting.by_fit))
    refused = False
    for name, style, color, cases in series:
        answers = [case for case in cases if not case.objection]
        others = [case for case in cases if case.objection and np.isfinite(case.mass)]
        axes.plot(*_mass_errors(answers, truth.mass), style, color=color, label=name)
        axes.plot(*_mass_errors(others, truth.mass), "x", color=color)
        refused |= bool(others)
    if refused:
        axes.plot([], [], "x", color=INK, label="no answer")
    axes.set_yscale("log")
    label_axes(axes, "Error of the mass", "decimals of the data", "relative error")
    axes.set_xticks([case.decimals for case in study.rounded])
    axes.legend()


def _mass_errors(cases: Sequence[RoundedCase], mass: float) -> tuple[list[int], list[float]]:
    return [case.decimals for case in cases], [abs(case.mass / mass - 1) for case in cases]


def _draw_convergence(study: PaperStudy, figure: Figure) -> None:
    time = study.telemetry.time
    errors = np.array([parameter_errors(row, study.truth) for row in study.online_parameters])
    groups = (("mass", [0]), ("centre of mass", [1, 2, 3]), ("inertia", [4, 5, 6, 7, 8, 9]))
    axes: Axes = figure.subplots()
    for (name, columns), color in zip(groups, COLORS, strict=False):
        worst = np.abs(errors[:, columns]).max(axis=1)
        axes.semilogy(time, worst, drawstyle="steps-pre", color=color, label=name)
    complete = next(case.n for case in study.by_count if case.rank == 10)
    start = study.samples.time[complete - 1]
    axes.axvspan(time[0], start, color=INK, alpha=0.15, linewidth=0)
    axes.text(
        (time[0] + start) / 2,
        0.5,
        "fewer than ten\nparameters\ndetermined",
        transform=axes.get_xaxis_transform(),
        ha="center",
        va="center",
        fontsize=8,
    )
    label_axes(
        axes,
        "Error from exact samples: the integration error",
        _TIME,
        "largest relative error",
    )
    axes.set_xlim(time[0], time[-1])
    axes.legend()
