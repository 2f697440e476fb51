"""What is known of a target: one posterior, and one rule.

The posterior of ψ is a Gaussian of samples and of the prior of log-sizes; see `target`. In
coordinates in which the prior is N(0, 1), with the singular values s of the posterior's R,

- a combination of ψ is known if s² ≥ `LEARNED`: the samples reduce its variance so many times;
- an entry of ψ is known if the open combinations make less than `OPEN_SHARE` of its variance; if
  all entries are known, no combination is called open.

Known combinations are told without the prior: their information is s² − 1, and their values are
those of the samples alone. The open ones have values and variance of the posterior.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.gaussian import Gaussian, LeastSquaresSolution
from cpid_drake.estimation.unknowns import PSI, Model

LEARNED = 2.0
"""Least factor by which samples reduce the prior's variance of what is known: they tell as much.

About a flat estimate the prior of log-sizes is narrow. A factor of ten would call a size open that
the samples tell well, and with it all that shares its scale, such as the mass that thrust shows.
"""

OPEN_SHARE = 0.1
"""Largest share of open combinations in the variance of what is known: 5 % of σ."""


def known_target(
    model: Model, psi: NDArray[np.float64], gaussian: Gaussian, *, count: int = 0
) -> LeastSquaresSolution:
    """Return what is known of the target's ψ about the nominal mass of the known bodies.

    Args:
        model: the unknowns.
        psi: (10,) value of the target.
        gaussian: of all unknowns about their values, with the prior of the target.
        count: number of the samples.

    """
    target, prior = gaussian.marginal([PSI]), model.cone.prior(PSI, psi)
    D = np.linalg.inv(prior.R)
    U, sizes, axes = np.linalg.svd(target.R @ D)
    is_known = sizes**2 >= LEARNED
    information = np.where(is_known, np.maximum(sizes**2 - 1, 1e-300), sizes**2)
    told = sizes * (U.T @ target.z) - np.where(is_known, axes @ prior.z, 0.0)
    y = axes.T @ (told / information)
    root = D @ axes.T / np.sqrt(information)
    covariance = root @ root.T
    is_open = np.sum(root[:, ~is_known] ** 2, axis=1) > OPEN_SHARE * np.diag(covariance)
    covariance[is_open, :] = covariance[:, is_open] = np.nan
    values = psi + D @ y
    A = np.sqrt(information)[is_known, None] * axes[is_known] @ prior.R
    unit = np.sqrt(np.sum(D**2, axis=1))
    open_axes = np.linalg.qr(D @ axes[~is_known].T / unit[:, None])[0].T[: 10 * is_open.any()]
    return LeastSquaresSolution(
        estimate=np.where(is_open, np.nan, values),
        covariance=covariance,
        known=Gaussian.of_rows({PSI: 10}, np.column_stack([A, A @ values])),
        rank=10 - len(open_axes),
        singular_values=sizes,
        unobservable=open_axes,
        residual_rms=np.nan,
        row_count=count,
        values=values,
        unit=unit,
    )


def difference(gaussian: Gaussian, prior: Gaussian, names: Sequence[str]) -> tuple[float, int]:
    """Return χ² of the known combinations of differences between targets, and how many they are.

    If it is one target, they are zero, and this is χ² distributed.

    Args:
        gaussian: of all unknowns, with targets of these names, which have no prior.
        prior: of one target.
        names: of the targets, two or more.

    """
    first, *others = names
    joint, count = gaussian.marginal(names), len(others)
    R = joint.R.copy()  # of the first target, and of the others less the first
    for name in others:
        R[:, joint.places[first]] += joint.R[:, joint.places[name]]
    apart = Gaussian.of_rows(joint.sizes, np.column_stack([R, joint.z])).marginal(others)
    root = np.linalg.cholesky(np.eye(count) + 1.0)  # of the prior covariance of differences
    U, sizes, _ = np.linalg.svd(apart.R @ np.kron(root, np.linalg.inv(prior.R)))
    is_known = sizes**2 >= LEARNED - 1
    return float(np.sum((U.T @ apart.z)[is_known] ** 2)), int(is_known.sum())
