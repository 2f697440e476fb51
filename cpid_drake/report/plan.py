"""The predicted σ of motions beside each other on the terminal, and the picture of a front."""

from collections.abc import Mapping
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.planning.prediction import Prediction
from cpid_drake.report.pictures import Picture
from cpid_drake.report.style import COLORS
from cpid_drake.report.terminal import light_table, print_in_parts

LEGEND = (
    "σ: Cramér-Rao bound with all errors that the sensors declare and the spacecraft's "
    "uncertainty. Scale: the mass, 0.5 m, and the trace of I of the assumed target."
)
"""The explanation of the table."""


def print_predictions(predictions: Mapping[str, Prediction], title: str, console: Console) -> None:
    """Print the table of `prediction_table`, and its explanation."""
    print_in_parts(console, prediction_table(predictions, title))
    console.print(LEGEND)


def prediction_table(predictions: Mapping[str, Prediction], title: str) -> Table:
    """Return the predicted σ of each parameter, one column for each motion.

    Args:
        predictions: the predictions for one target, by the motions' names.
        title: of the table.

    """
    table = light_table(title)
    table.add_column("", no_wrap=True)
    for name in predictions:
        table.add_column(name, justify="right", no_wrap=True)
    for k, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)):
        row = [_number(each.sigma[k]) for each in predictions.values()]
        table.add_row(f"σ({name}), {unit}", *row)
    table.add_section()
    columns = predictions.values()
    table.add_row("worst σ, % of scale", *(_number(100 * each.worst) for each in columns))
    table.add_row("condition number", *(_number(each.condition) for each in columns))
    table.add_row("turn of the base, deg", *(_number(np.degrees(p.base_angle)) for p in columns))
    table.add_row("its rate, deg/s", *(_number(np.degrees(p.base_rate)) for p in columns))
    table.add_row("its shift, m", *(_number(each.base_shift) for each in columns))
    return table


def front_picture(values: NDArray[np.float64], criterion: str) -> Picture:
    """Return the picture of a front.

    Args:
        values: (N, 2) turn of the base [deg] and criterion [% of scale] of N motions.
        criterion: its name.

    """
    draw = partial(_draw_front, values, criterion)
    return Picture("front", "criterion of motions over their turn of the base", draw, (4.5, 3.2))


def _draw_front(values: NDArray[np.float64], criterion: str, figure: Figure) -> None:
    axes = figure.subplots()
    axes.plot(values[:, 0], values[:, 1], "o-", color=COLORS[0])
    axes.set_ylim(0.0, 1.1 * values[:, 1].max())
    axes.set_xlabel("largest turn of the base [deg]")
    axes.set_ylabel(f"{criterion} σ [% of scale]")
    axes.set_title("Precision against disturbance of the base")


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"
