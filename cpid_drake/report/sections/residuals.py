"""The section with the residuals."""

import numpy as np

from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.identification.description import residual_words
from cpid_drake.identification.result import Identification
from cpid_drake.report.figures import residual_pictures
from cpid_drake.report.page import Cell, Section, Table


def residuals_section(found: Identification) -> Section:
    """Return the section with size, whiteness and pictures of the residuals."""
    if not found.residuals:
        text = "This estimator gives no residuals, or not all ten parameters are known."
        return Section("Residuals", texts=[text])
    if all(series.unit == "σ" for series in found.residuals.values()):
        text = (
            "Measured minus predicted samples of each sensor, in units of the assumed noise; the "
            "band is ±2σ."
        )
    else:
        text = "Residuals of the momentum balance, in the capture frame."
    if any(series.every > 1 for series in found.residuals.values()):
        text += (
            " The log is long: sizes and figures are those of an even selection of the residuals, "
            "and correlations those of the beginning."
        )
    whole = found.whiteness
    if whole is None:
        text += " The samples were smoothed, so neighbours are correlated."
    else:
        text += f" Residuals: {residual_words(found)}."
    return Section(
        "Residuals", texts=[text], tables=[_table(found)], pictures=residual_pictures(found)
    )


def _table(found: Identification) -> Table:
    """Return size and whiteness of the residuals of each sensor or kind of rows."""
    rows: list[list[Cell | str]] = []
    for name, samples in found.residuals.items():
        white = whiteness(samples.neighbours)
        size = np.sqrt(np.mean(samples.value**2, axis=0))
        rows.append(
            [
                name,
                Cell(str(len(samples))),
                *(Cell(f"{value:.3g}") for value in size),
                *(Cell("") for _ in range(3 - len(size))),
                samples.unit,
                Cell(f"{white.lag_one:+.3f} ± {white.band:.3f}"),
                "yes" if white.is_white else "no",
            ]
        )
    heads = ["", "samples", "rms x", "rms y", "rms z", "unit", "lag-one correlation", "white"]
    if found.is_planar:
        heads[2:5] = ["rms 1", "rms 2", "rms 3"]  # components in the plane
    if found.whiteness is None:  # smoothed samples are not expected to be white
        return Table(heads[:-1], [row[:-1] for row in rows])
    note = (
        "White: the correlation of neighbours is within the ± band of white noise, or below 0.1, "
        "which changes no interval by more than a tenth."
    )
    return Table(heads, rows, note=note)
