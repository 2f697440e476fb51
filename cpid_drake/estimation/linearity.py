"""How far a fit is linear about its target: error and change of the system's inertia."""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.estimation.fit import Fit
from cpid_drake.estimation.likelihood.joint_model import ORDER
from cpid_drake.estimation.roll import Values
from cpid_drake.estimation.unknowns import BODIES, PSI

WELL_KNOWN = 5e-3
"""Relative error of the system's inertia from which derivatives at one target serve for ever."""

SECOND_ORDER = 0.02
"""Share of its error by which a relative change of the system's inertia, squared, is negligible."""


def inertia_error(fit: Fit) -> float:
    """Return the relative error of the system's inertia about its centre of mass.

    It is the root mean square of Wᵀ δJ W, with J = W⁻ᵀW⁻¹, along the axes that can rotate. Errors
    of the spacecraft's bodies, which stay uncertain for ever, are not in it.
    """
    exact = {BODIES: 0.0} if BODIES in fit.posterior.places else {}
    covariance = fit.posterior.condition(exact).marginal([PSI]).covariance()
    B = _by_inertia(fit)
    # √(tr B P Bᵀ / axes), B = ∂(WᵀJ W)/∂ψ
    return float(np.sqrt(np.trace(B @ covariance @ B.T) / np.sqrt(len(B))))


def inertia_change(fit: Fit, psi: Array) -> Array:
    """Return the relative changes d (...,) of the system's inertia from other targets ψ (..., 10).

    What is linear about such a target is wrong by d².
    """
    B = _by_inertia(fit)
    step = (fit.values[PSI] - psi) @ B.T
    return np.asarray(np.linalg.norm(step, axis=-1) / len(B) ** 0.25)


def linear_at(fit: Fit) -> Values:
    """Return the values of target and hardware at which later blocks have their derivatives."""
    [log], values = fit.logs, fit.values
    if log.past is not None and inertia_error(fit) < WELL_KNOWN:
        return {**log.past.first}
    # Its past, if it has one, says little.
    return {u.name: values[u.name] for u in fit.model.table if u.scope != "log"}


def is_linear(fit: Fit, psi: Array) -> bool:
    """Return whether what is linear about other targets ψ (n, 10) is so about that of a fit.

    The error says by how much the inertia may change in the future.
    """
    error, change = inertia_error(fit), float(np.max(inertia_change(fit, psi)))
    return error < WELL_KNOWN and change**2 < SECOND_ORDER * error


def change_beyond_linear(fit: Fit) -> float:
    """Return the relative change d of the system's inertia since it was well known.

    It is 0 if its second-order effect d² is below the error of the inertia.
    """
    [log] = fit.logs
    change = 0.0 if log.past is None else float(inertia_change(fit, log.past.first[PSI]))
    return change if change**2 > inertia_error(fit) else 0.0


def _by_inertia(fit: Fit) -> Array:
    """Return the derivative (9, 10) of Wᵀ J W by ψ at the end of a log; (1, 10) on a table."""
    tree, psi = fit.model.tree, fit.values[PSI]
    q = fit.logs[0].states[-1].joints.coefficients[-ORDER][None]
    dynamics = BodyDynamics.at(tree, q, np.zeros_like(q))
    J, none = dynamics.inertia(psi)[0], dynamics.inertia(np.zeros(10))[0]
    normal_B = tree.normal_B
    if normal_B is None:
        W = np.linalg.inv(np.linalg.cholesky(J)).T
    else:
        W = normal_B[:, None] / np.sqrt(normal_B @ J @ normal_B)
    # J is linear in ψ
    by = W.T @ (dynamics.inertia(np.eye(10))[:, 0] - none) @ W
    return np.asarray(by.reshape(10, -1).T)
