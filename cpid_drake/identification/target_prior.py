"""What is known about a target before a log: from its design, or from an earlier identification."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.errors import InputError
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.identification.result import Combinations, Identification

_ROUNDING = 1e-13  # share of the best determined combination below which there is rounding only


@dataclass(frozen=True, eq=False)
class TargetPrior:
    """A prior of the target.

    Attributes:
        name: its name in messages.
        parameters: (10,) π in the spacecraft's capture frame; NaN where not known.
        covariance: (10, 10) of `parameters`; NaN where not known.
        combinations: a prior that determines combinations of parameters, in place of the
            parameters; None if `parameters` contains everything.
        failures: reasons not to trust the prior.

    """

    name: str
    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]
    combinations: Combinations | None = None
    failures: tuple[str, ...] = ()

    def identification(self, rank: int) -> Identification:
        """Return the prior as a result that determines `rank` combinations."""
        half = quantile_95() * np.sqrt(np.diag(self.covariance))
        return Identification(
            parameters=self.parameters,
            covariance=self.covariance,
            intervals=self.parameters[:, None] + half[:, None] * np.array([-1.0, 1.0]),
            rank=rank,
            singular_values=np.full(10, np.nan),
            sample_count=0,
            estimator="prior",
        )

    def moved(self, form: Parameterization, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the unknowns `at` (10,) with the prior's values where the prior has any."""
        if self.combinations is not None:
            return self.combinations.values if self.combinations.unknowns == form.name else at
        known = np.isfinite(self.parameters)
        return form.from_parameters(np.where(known, self.parameters, form.to_parameters(at)))

    def gaussian(
        self,
        name: str,
        form: Parameterization,
        at: NDArray[np.float64],
        unit: NDArray[np.float64],
    ) -> Gaussian:
        """Return the prior about the unknowns of a parameterization.

        Args:
            name: name of the unknowns.
            form: the parameterization.
            at: (10,) unknowns about which the parameters are linearized.
            unit: (10,) plausible sizes of the unknowns.

        Raises:
            InputError: the prior determines combinations of other unknowns.

        """
        known = self.combinations
        if known is not None:
            if known.unknowns != form.name:
                raise InputError(
                    f"{self.name} determines combinations of {known.unknowns} unknowns, and the "
                    f"estimator has {form.name} unknowns: use the estimator of the prior"
                )
            sizes, axes = np.linalg.eigh(known.information * unit * unit[:, None])
            seen = sizes > _ROUNDING * max(float(sizes[-1]), 0.0)
            A = np.sqrt(sizes[seen])[:, None] * axes[:, seen].T / unit
            return Gaussian.of_rows({name: 10}, np.column_stack([A, A @ known.values]))
        given = np.isfinite(self.parameters)
        covariance = self.covariance[np.ix_(given, given)]
        sigma = np.sqrt(np.diag(covariance))
        root = np.linalg.cholesky(covariance / sigma / sigma[:, None])
        whiten = np.linalg.solve(root, np.diag(1 / sigma))
        jacobian = form.jacobian(at)[given]
        change = self.parameters[given] - form.to_parameters(at)[given]
        rows = whiten @ np.column_stack([jacobian, change + jacobian @ at])
        return Gaussian.of_rows({name: 10}, rows)
