"""The predicted σ of motions beside each other on the terminal, and the picture of a front."""

from collections.abc import Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from rich.console import Console

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.planning.prediction import Prediction
from cpid_drake.report.page import Table
from cpid_drake.report.pictures import COLORS, Picture
from cpid_drake.report.terminal import print_table

LEGEND = (
    "σ: Cramér-Rao bound with all errors that the sensors declare and the spacecraft's "
    "uncertainty. Scale: the mass, 0.5 m, and the trace of I of the assumed target."
)
"""The explanation of the table."""


def print_predictions(predictions: Mapping[str, Prediction], title: str, console: Console) -> None:
    """Print the table of `prediction_table`, and its explanation."""
    print_table(console, prediction_table(predictions, title))


def prediction_table(predictions: Mapping[str, Prediction], title: str) -> Table:
    """Return the predicted σ of each parameter, one column for each motion.

    Args:
        predictions: the predictions for one target, by the motions' names.
        title: of the table.

    """
    columns = predictions.values()
    rows = [
        (f"σ({name}), {unit}", *(each.sigma[k] for each in columns))
        for k, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True))
    ]
    rows += [
        ("worst σ, % of scale", *(100 * each.worst for each in columns)),
        ("condition number", *(each.condition for each in columns)),
        ("turn of the base, deg", *(np.degrees(each.base_angle) for each in columns)),
        ("its rate, deg/s", *(np.degrees(each.base_rate) for each in columns)),
        ("its shift, m", *(each.base_shift for each in columns)),
    ]
    cells = [[name, *(_number(value) for value in values)] for name, *values in rows]
    return Table(["", *predictions], cells, title, LEGEND)


def front_picture(values: NDArray[np.float64]) -> Picture:
    """Return the picture of a front.

    Args:
        values: (N, 2) turn of the base [deg] and worst σ [% of scale] of N motions.

    """
    draw = partial(_draw_front, values)
    return Picture("front", "worst σ of motions over their turn of the base", draw, (4.5, 3.2))


def _draw_front(values: NDArray[np.float64], axes: Axes) -> None:
    axes.plot(values[:, 0], values[:, 1], "o-", color=COLORS[0])
    axes.set_ylim(0.0, 1.1 * values[:, 1].max())
    axes.set_xlabel("largest turn of the base [deg]")
    axes.set_ylabel("worst σ [% of scale]")
    axes.set_title("Precision against disturbance of the base")


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "–"
