"""The posterior of a target: one rule for fits and for rows.

A combination of the unknowns is known if the samples alone determine it to `KNOWN` of its plausible
size: that of a target as heavy and as large as the spacecraft, or as its own estimate, if this is
larger. The rule is that of `gaussian.solution_of`. However flat an estimate is, these sizes are
not. The prior of log-sizes keeps a fit among the physically consistent bodies, and identifies
nothing.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import Gaussian, LeastSquaresSolution, solution_of
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.unknowns import PSI, Model


def target_estimate(
    model: Model, psi: Array, gaussian: Gaussian, *, count: int = 0
) -> LeastSquaresSolution:
    """Return what is known of the target's ψ about the nominal mass of the spacecraft.

    Args:
        model: the unknowns.
        psi: (10,) value of the target.
        gaussian: of all unknowns about their values, with the prior of the target.
        count: number of the samples.

    """
    # R_sᵀR_s = RᵀR − R_pᵀR_p: without the prior that `Fit.posterior` has added
    samples = without(model.cone.prior(PSI, psi), gaussian.marginal([PSI]))
    return solution_of(samples.minus(-psi), psi, model.sizes(psi), row_count=count)


def estimate_of(
    unknown: str, values: Mapping[str, Array], gaussian: Gaussian
) -> tuple[Array, Array]:
    """Return an unknown (k,) and its covariance (k, k), of all unknowns about their values."""
    own = gaussian.marginal([unknown])
    return values[unknown] + own.solve(), own.covariance()


def without(part: Gaussian, whole: Gaussian, least: float = 1e-6) -> Gaussian:
    """Return what is known besides a part, such as a prior or the samples of a first half.

    Args:
        part: of the same unknowns (n,) as all.
        whole: the part and the rest together.
        least: the rest says nothing where its share of the root of the information is smaller.

    """
    scale = np.linalg.norm(whole.R, axis=0)
    scale[scale == 0] = 1.0
    # RᵀR = R₁ᵀR₁ + R₂ᵀR₂: with R₁R⁻¹ = U S Vᵀ, R₂ = √(1 − S²) VᵀR
    U, share, axes = np.linalg.svd(part.R / scale @ np.linalg.pinv(whole.R / scale))
    own = np.sqrt(np.maximum(1 - share**2, 0.0))
    own[own <= least] = 0.0
    left = axes @ whole.z - share * (U.T @ part.z)
    z = np.divide(left, own, out=np.zeros_like(own), where=own > 0)
    return Gaussian.of_rows(whole.sizes, np.column_stack([own[:, None] * (axes @ whole.R), z]))


def difference(gaussian: Gaussian, plausible: Array, names: Sequence[str]) -> tuple[float, int]:
    """Return χ² of the known combinations of differences between targets, and how many they are.

    If it is one target, they are zero, and this is χ² distributed.

    Args:
        gaussian: of all unknowns, with targets of these names, which have no prior.
        plausible: (n,) sizes of a target's unknowns.
        names: of the targets, two or more.

    """
    first, *others = names
    joint = gaussian.marginal(names)
    R = joint.R.copy()  # of the first target, and of the others less the first
    # R₁ ψ₁ + R₂ ψ₂ = (R₁ + R₂) ψ₁ + R₂ (ψ₂ − ψ₁)
    for name in others:
        R[:, joint.places[first]] += joint.R[:, joint.places[name]]
    apart = Gaussian.of_rows(joint.sizes, np.column_stack([R, joint.z])).marginal(others)
    U, sizes, _ = np.linalg.svd(apart.R * np.tile(plausible, len(others)))
    is_known = KNOWN * sizes > 1
    return float(np.sum((U.T @ apart.z)[is_known] ** 2)), int(is_known.sum())
