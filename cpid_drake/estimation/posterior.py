"""The posterior of a target: one rule for fits and for rows.

A combination of the unknowns is known if the samples alone determine it to `KNOWN` of its plausible
size: that of a target as heavy and as large as the spacecraft, or as its own estimate, if this is
larger. The rule is that of `gaussian.solution_of`. However flat an estimate is, these sizes are
not. The prior of log-sizes keeps a fit among the physically consistent bodies, and identifies
nothing.
"""

from collections.abc import Sequence

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import Gaussian, LeastSquaresSolution, solution_of
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.unknowns import PSI, Model


def known_target(
    model: Model, psi: Array, gaussian: Gaussian, *, count: int = 0
) -> LeastSquaresSolution:
    """Return what is known of the target's ψ about the nominal mass of the spacecraft.

    Args:
        model: the unknowns.
        psi: (10,) value of the target.
        gaussian: of all unknowns about their values, with the prior of the target.
        count: number of the samples.

    """
    samples = _without(model.cone.prior(PSI, psi), gaussian.marginal([PSI]))
    return solution_of(samples.moved(-psi), psi, model.sizes(psi), row_count=count)


def _without(prior: Gaussian, posterior: Gaussian) -> Gaussian:
    """Return what the samples say alone."""
    U, sizes, axes = np.linalg.svd(posterior.R @ np.linalg.inv(prior.R))
    own = np.sqrt(np.maximum(sizes**2 - 1, 0.0))
    said = sizes * (U.T @ posterior.z) - axes @ prior.z
    z = np.divide(said, own, out=np.zeros_like(own), where=own > _ROUNDING)
    A = np.where(own > _ROUNDING, own, 0.0)[:, None] * axes @ prior.R
    return Gaussian.of_rows(posterior.sizes, np.column_stack([A, z]))


_ROUNDING = 1e-6  # less information than this, in units of the prior, is rounding


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
    for name in others:
        R[:, joint.places[first]] += joint.R[:, joint.places[name]]
    apart = Gaussian.of_rows(joint.sizes, np.column_stack([R, joint.z])).marginal(others)
    U, sizes, _ = np.linalg.svd(apart.R * np.tile(plausible, len(others)))
    is_known = KNOWN * sizes > 1
    return float(np.sum((U.T @ apart.z)[is_known] ** 2)), int(is_known.sum())
