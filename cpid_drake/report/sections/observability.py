"""The section that shows how well the motion determines the parameters."""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, parameter_scale
from cpid_drake.identification.result import Identification
from cpid_drake.report.figures import singular_value_picture
from cpid_drake.report.page import Cell, Section, Table


def observability_section(result: Identification) -> Section:
    """Return the section with relative standard deviations and singular values."""
    values = result.singular_values
    pictures = [] if np.isnan(values).any() else [singular_value_picture(values)]
    tables = []
    scale = _scale(result.parameters)
    if scale is not None:
        share = 100 * np.sqrt(np.diag(result.covariance)) / scale
        if np.isfinite(share).all():
            cells = [Cell(f"{value:.2g}") for value in share]
            tables = [Table(["", *PARAMETER_NAMES], [["σ, % of scale", *cells]])]
    return Section("Observability", texts=_texts(result), tables=tables, pictures=pictures)


def _texts(result: Identification) -> list[str]:
    if result.rank < 10:
        return result.gap()
    texts = []
    if result.condition is not None:
        texts.append(
            "The singular values measure how strongly the motion excites ten independent "
            f"combinations of the parameters. The largest is {result.condition:.3g} times the "
            "smallest."
        )
    weakest = weakest_combination(result.parameters, result.covariance)
    if weakest is not None:
        weights, sigma = weakest
        order = np.argsort(-np.abs(weights))
        parts = [f"{PARAMETER_NAMES[i]} ({weights[i]:+.2f})" for i in order]
        shown = [part for part, i in zip(parts, order) if abs(weights[i]) > 0.2]
        which = f"combination {', '.join(shown)}"
        if len(shown) == 1:
            which = f"parameter {PARAMETER_NAMES[order[0]]}"
        texts.append(
            f"The least certain {which} has a σ of {100 * sigma:.2g} % of its scale. The scale is "
            "the mass for m, the radius of gyration for c, and the trace of the inertia for I."
        )
    return texts


def _scale(parameters: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the scale (10,) of the parameters; None without an approximate rigid body."""
    mass, trace = parameters[0], parameters[4:7].sum()
    if not (0 < mass < np.inf and 0 < trace < np.inf):
        return None
    return parameter_scale(parameters)


def weakest_combination(
    parameters: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float] | None:
    """Return the least certain combination (10,) of the scaled parameters, and its σ.

    None if not all ten are known, or there is no approximate rigid body.
    """
    scale = _scale(parameters)
    if scale is None:
        return None
    with np.errstate(all="ignore"):  # a file may contain numbers of any size
        scaled = covariance / scale / scale[:, None]
    try:
        values, axes = np.linalg.eigh((scaled + scaled.T) / 2)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(values).all():
        return None
    weights = axes[:, -1] * np.sign(axes[np.abs(axes[:, -1]).argmax(), -1])
    return weights, float(np.sqrt(max(values[-1], 0.0)))
