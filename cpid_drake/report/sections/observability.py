"""The section that says which parameters the motion determines well."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, parameter_scale
from cpid_drake.identification.result import ADVICE
from cpid_drake.identification.result_files import IdentificationResult
from cpid_drake.report.figures import (
    Picture,
    singular_value_picture,
)
from cpid_drake.report.page import Cell, Section, Table


@dataclass(frozen=True, eq=False)
class Observability(Section):
    """How well the log determines what."""

    result: IdentificationResult
    title: ClassVar[str] = "What the motion shows"
    template: ClassVar[str] = "pictures.html.j2"

    @property
    def texts(self) -> list[str]:
        """What is weakly observed."""
        result = self.result
        if result.rank < 10:
            return [
                f"Not all ten are known: {result.not_observable}.",
                f"To see the rest: {ADVICE}.",
            ]
        texts = []
        if np.isfinite(result.condition):
            texts.append(
                "The smallest singular value is that of the combination that the motion shows "
                f"least, {result.condition:.3g} times less than the one it shows best."
            )
        weakest = weakest_combination(result.parameters, result.covariance)
        if weakest is not None:
            weights, sigma = weakest
            order = np.argsort(-np.abs(weights))
            parts = [f"{PARAMETER_NAMES[i]} ({weights[i]:+.2f})" for i in order]
            shown = [part for part, i in zip(parts, order) if abs(weights[i]) > 0.2]
            which = f"the combination {', '.join(shown)}"
            if len(shown) == 1:
                which = PARAMETER_NAMES[order[0]]
            texts.append(
                f"Known least, for its size, is {which}: σ is "
                f"{100 * sigma:.2g} % of its scale. Scales: m of the mass, the radius of gyration "
                "of c, and the trace of the inertia."
            )
        return texts

    @property
    def table(self) -> Table | None:
        """Relative σ of the ten."""
        result = self.result
        scale = _scale(result.parameters)
        if scale is None:
            return None
        share = 100 * np.sqrt(np.diag(result.covariance)) / scale
        if not np.isfinite(share).all():
            return None
        cells = [Cell(f"{value:.2g}") for value in share]
        return Table(["", *PARAMETER_NAMES], [["σ, % of scale", *cells]])

    @property
    def pictures(self) -> list[Picture]:
        """The singular values, if the result holds them."""
        values = self.result.singular_values
        return [] if values is None or np.isnan(values).any() else [singular_value_picture(values)]


def _scale(parameters: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return what each of the ten is compared with; None if no body is anywhere near."""
    mass, trace = parameters[0], parameters[4:7].sum()
    if not (0 < mass < np.inf and 0 < trace < np.inf):
        return None
    return parameter_scale(parameters)


def weakest_combination(
    parameters: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float] | None:
    """Return the scaled combination (10,) of parameters that is known least, and its σ.

    None where not all ten are known, or no rigid body is anywhere near.
    """
    scale = _scale(parameters)
    if scale is None:
        return None
    with np.errstate(all="ignore"):  # numbers of any size may be in a file
        scaled = covariance / scale / scale[:, None]
    try:
        values, axes = np.linalg.eigh((scaled + scaled.T) / 2)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(values).all():
        return None
    weights = axes[:, -1] * np.sign(axes[np.abs(axes[:, -1]).argmax(), -1])
    return weights, float(np.sqrt(max(values[-1], 0.0)))
