"""The tables and figures of the paper's study."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.report.scene import render_scenario
from cpid_drake.report.style import COLORS, label_axes, saved_figure
from cpid_drake.studies.paper import (
    PAPER_DIGITS,
    PAPER_FIGURE_7,
    PAPER_TABLE_1,
    PAPER_TABLE_2,
    PaperStudy,
    max_relative_error,
    parameter_errors,
)

_TIME = "time [s]"


def tables(study: PaperStudy) -> list[tuple[Table, str]]:
    """Return the study's tables, with the paper's values, and a note for each."""
    return [
        (_table_1(study), _table_1_note(study)),
        (_table_2(study), ""),
        (_samples_table(study), ""),
        (_checks_table(study), ""),
    ]


def print_tables(study: PaperStudy, console: Console) -> None:
    """Print the study's tables, with the paper's values."""
    printed = tables(study)
    for table, note in printed:
        console.print(table)
        if note:
            console.print(note, style="dim", highlight=False)
        if table is not printed[-1][0]:
            console.print()


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", header_style="bold")
    table.add_column(columns[0])
    for column in columns[1:]:
        table.add_column(column, justify="right")
    return table


def _comparable(study: PaperStudy, *cells: str) -> tuple[str, ...]:
    """Drop the last cell, the paper's value, if the target is not the paper's."""
    return cells if study.is_papers_target else cells[:-1]


def _table_1(study: PaperStudy) -> Table:
    exact = study.exact.parameters
    rounded = study.rounded_to(PAPER_DIGITS).identification.parameters
    paper = PAPER_TABLE_1.to_vector()
    table = _table(
        "Table 1. Identified parameters",
        *_comparable(
            study,
            "",
            "true",
            f"{len(study.samples)} exact samples",
            "rounded to 6 decimals",
            "paper (6 decimals)",
        ),
    )
    rows = zip(PARAMETER_NAMES, PARAMETER_UNITS, study.truth.to_vector(), exact, rounded, paper)
    for name, unit, true, ours, ours_rounded, theirs in rows:
        cells = (
            f"{name} [{unit}]",
            f"{true:.7g}",
            f"{round(ours, 9) + 0:.9f}",
            f"{round(ours_rounded, 6) + 0:.6f}",
            f"{theirs:.6f}",
        )
        table.add_row(*_comparable(study, *cells))
    table.add_section()
    errors = [max_relative_error(values, study.truth) for values in (exact, rounded, paper)]
    last = ("largest relative error", "", *(f"{error:.1e}" for error in errors))
    table.add_row(*_comparable(study, *last))
    return table


def _table_1_note(study: PaperStudy) -> str:
    note = "Errors are relative to m for m, to |c| for c, and to the trace of I for I."
    if study.is_papers_target:
        note += (
            "\nThe paper's inertia violates the triangle inequality. The paper gives its largest\n"
            "error as 5.2e-2, relative to Ixx."
        )
    return note


def _table_2(study: PaperStudy) -> Table:
    table = _table(
        "Table 2. Mass from data rounded to a number of decimals",
        *_comparable(study, "decimals", "mass [kg]", "largest relative error", "paper's mass [kg]"),
    )
    for case in study.rounded:
        theirs = PAPER_TABLE_2.get(case.decimals)
        cells = (
            str(case.decimals),
            f"{case.identification.parameters[0]:.9f}",
            f"{case.max_relative_error:.1e}",
            "" if theirs is None else f"{theirs:.6f}",
        )
        table.add_row(*_comparable(study, *cells))
    return table


def _samples_table(study: PaperStudy) -> Table:
    table = _table(
        "Rank and error by number of samples (the paper uses two)",
        "samples",
        "rank of 10",
        "largest relative error",
    )
    for case in study.by_count:
        error = case.max_relative_error
        table.add_row(
            str(case.n), str(case.rank), f"{error:.1e}" if np.isfinite(error) else "not determined"
        )
    return table


def _checks_table(study: PaperStudy) -> Table:
    table = _table("Checks", *_comparable(study, "", "here", "paper"))
    drift = [np.linalg.norm(x, axis=1).max() for x in (study.linear_drift, study.angular_drift)]
    attitude, position = study.max_attitude_relative_error, study.max_position_relative_error
    theirs = {name: f"{value:.2%}" for name, value in PAPER_FIGURE_7.items()}
    for cells in (
        ("momentum drift in the simulation, linear [N·s]", f"{drift[0]:.1e}", ""),
        ("momentum drift in the simulation, angular [N·m·s]", f"{drift[1]:.1e}", ""),
        (
            "angular momentum in data rounded to 6 decimals [N·m·s]",
            f"{study.rounded_angular_momentum:.1e}",
            "1e-2",
        ),
        ("attitude error after re-simulation (Fig. 7)", f"{attitude:.4%}", theirs["attitude"]),
        ("position error after re-simulation (Fig. 7)", f"{position:.4%}", theirs["position"]),
        ("online minus batch, relative", f"{study.online_minus_batch:.1e}", ""),
    ):
        table.add_row(*_comparable(study, *cells))
    return table


def write_figures(study: PaperStudy, folder: Path) -> list[Path]:
    """Write the study's figures as PNG files into an existing folder; return their paths."""
    drawings = {
        "figure3_configurations": _draw_configurations,
        "figure5_joint_motion": _draw_joint_motion,
        "figure6_base_response": _draw_base_response,
        "figure7_errors": _draw_errors,
        "table2_decimals": _draw_table2,
        "online_convergence": _draw_convergence,
    }
    files = []
    for name, draw in drawings.items():
        files.append(folder / f"{name}.png")
        draw(study, files[-1])
    return files


def _draw_configurations(study: PaperStudy, path: Path) -> None:
    states = study.simulation.spacecraft.to_states(study.telemetry.select([0, -1]))
    pictures = render_scenario(study.simulation.scenario, list(states))
    times = study.telemetry.time[[0, -1]]
    with saved_figure(path, 11.0, 4.4) as figure:
        panels = figure.subplots(1, 2)
        for axes, picture, time, name in zip(panels, pictures, times, "AB", strict=True):
            axes.imshow(picture)
            axes.set_axis_off()
            word = "Initial" if name == "A" else "Final"
            axes.set_title(f"({name}) {word} configuration, t = {time:g} s")


def _draw_joint_motion(study: PaperStudy, path: Path) -> None:
    telemetry = study.telemetry
    names = study.simulation.spacecraft.joint_names
    moving = np.ptp(telemetry.q, axis=0) > 1e-6
    with saved_figure(path, 9.5, 4.0) as figure:
        panels = figure.subplots(1, 2)
        lines = []
        for k, (name, moves) in enumerate(zip(names, moving, strict=True)):
            if not moves:
                continue
            style = {
                "color": COLORS[k % 6],
                "linestyle": "-" if k < 6 else "--",
                "label": name.replace("_", " "),
            }
            lines += panels[0].plot(telemetry.time, np.degrees(telemetry.q[:, k]), **style)
            panels[1].plot(telemetry.time, np.degrees(telemetry.qdot[:, k]), **style)
        label_axes(panels[0], "Joint angles", _TIME, "angle [deg]")
        label_axes(panels[1], "Joint rates", _TIME, "rate [deg/s]")
        figure.legend(handles=lines, loc="outside right center")


def _draw_base_response(study: PaperStudy, path: Path) -> None:
    telemetry = study.telemetry
    with saved_figure(path, 9.5, 6.0) as figure:
        panels = figure.subplots(2, 2, sharex=True)
        _draw_axes(panels[0, 0], telemetry.time, telemetry.p_WB - telemetry.p_WB[0], "xyz")
        label_axes(panels[0, 0], "(A) Position of the base", "", "p_WB [m]")
        _draw_axes(panels[0, 1], telemetry.time, telemetry.v_WB, "xyz")
        label_axes(panels[0, 1], "(B) Velocity of the base", "", "v_WB [m/s]")
        angles = np.degrees(telemetry.euler_321)
        _draw_axes(panels[1, 0], telemetry.time, angles, ("yaw", "pitch", "roll"))
        label_axes(panels[1, 0], "(C) Attitude of the base, 3-2-1", _TIME, "angle [deg]")
        _draw_axes(panels[1, 1], telemetry.time, np.degrees(telemetry.w_WB), "xyz")
        label_axes(panels[1, 1], "(D) Angular velocity of the base", _TIME, "w_WB [deg/s]")


def _draw_errors(study: PaperStudy, path: Path) -> None:
    time = study.telemetry.time
    with saved_figure(path, 9.5, 3.6) as figure:
        panels = figure.subplots(1, 2)
        attitude = 1e3 * np.degrees(np.abs(study.attitude_error))
        _draw_axes(panels[0], time, attitude, ("yaw", "pitch", "roll"))
        label_axes(
            panels[0],
            f"(A) Attitude error, at most {study.max_attitude_relative_error:.4%} of the motion",
            _TIME,
            "|error| [mdeg]",
        )
        _draw_axes(panels[1], time, 1e6 * np.abs(study.position_error), "xyz")
        label_axes(
            panels[1],
            f"(B) Position error, at most {study.max_position_relative_error:.4%} of the motion",
            _TIME,
            "|error| [µm]",
        )


def _draw_axes(
    axes: Axes, time: NDArray[np.float64], values: NDArray[np.float64], names: str | tuple
) -> None:
    for column, name, color in zip(values.T, names, COLORS, strict=False):
        axes.plot(time, column, color=color, label=name)
    axes.legend(ncols=3, loc="best")


def _draw_table2(study: PaperStudy, path: Path) -> None:
    decimals = [case.decimals for case in study.rounded]
    mass = [
        abs(parameter_errors(case.identification.parameters, study.truth)[0])
        for case in study.rounded
    ]
    theirs = [abs(value - study.truth.mass) / study.truth.mass for value in PAPER_TABLE_2.values()]
    with saved_figure(path, 6.5, 3.8) as figure:
        axes = figure.subplots()
        largest = [case.max_relative_error for case in study.rounded]
        if study.is_papers_target:
            axes.semilogy(list(PAPER_TABLE_2), theirs, "s--", color=COLORS[1], label="paper, mass")
        axes.semilogy(decimals, mass, "o-", color=COLORS[0], label="here, mass")
        axes.semilogy(decimals, largest, "^-", color=COLORS[2], label="here, largest of ten")
        label_axes(
            axes,
            "The error falls with every decimal of the data",
            "decimals of the data",
            "relative error",
        )
        axes.set_xticks(decimals)
        axes.legend()


def _draw_convergence(study: PaperStudy, path: Path) -> None:
    time = study.telemetry.time
    errors = np.array([parameter_errors(row, study.truth) for row in study.online_parameters])
    groups = (("mass", [0]), ("centre of mass", [1, 2, 3]), ("inertia", [4, 5, 6, 7, 8, 9]))
    with saved_figure(path, 7.0, 3.8) as figure:
        axes = figure.subplots()
        for (name, columns), color in zip(groups, COLORS, strict=False):
            worst = np.abs(errors[:, columns]).max(axis=1)
            axes.semilogy(time, worst, drawstyle="steps-pre", color=color, label=name)
        complete = next(case.n for case in study.by_count if case.rank == 10)
        start = study.samples.time[complete - 1]
        axes.axvspan(time[0], start, color="#bbbbbb", alpha=0.35, linewidth=0)
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
            "Online estimate from exact samples (rest: integration error)",
            _TIME,
            "largest relative error",
        )
        axes.set_xlim(time[0], time[-1])
        axes.legend()
