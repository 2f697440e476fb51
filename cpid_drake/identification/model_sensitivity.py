"""Sensitivity of an estimate to the spacecraft model: its change if the model had 1 % more."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import (
    parameters_to_standard,
    relative_parameterization,
    standard_to_parameters,
)
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.gaussian import LeastSquaresSolution
from cpid_drake.estimation.roll import roll
from cpid_drake.estimation.unknowns import BODIES, PSI
from cpid_drake.identification.chosen_fit import ChosenFit

BASE_MASS, BASE_INERTIA = "mass", "inertia"
"""Of the base, with everything that is fixed to it; the inertia is about its centre of mass."""

LINK, ALL_MASSES = "the link that holds the target", "all masses and inertias"
"""Not identifiable from any samples: this link moves as the target does, and momentum is linear in
all masses."""


class _OfBase(BodyUncertainty):
    """Errors of the base alone: of what is fixed to it."""

    def all_sigmas(self, wheels: Sequence[bool], joints: int) -> Array:
        sigmas = super().all_sigmas(wheels, joints)
        sigmas[10:] = 0.0
        return sigmas


def with_larger_base(tree: KinematicTree) -> dict[str, KinematicTree]:
    """Return the spacecraft with 1 % more mass, and with 1 % more inertia, of its base."""
    base, *others = tree.lumped.bodies
    larger = {
        BASE_MASS: replace(base, mass=1.01 * base.mass),
        BASE_INERTIA: replace(base, I_BBcm=1.01 * base.I_BBcm),
    }
    return {n: replace(tree.lumped, bodies=(each, *others)) for n, each in larger.items()}


def base_sensitivity(chosen: ChosenFit, solution: LeastSquaresSolution) -> dict[str, Array]:
    """Return the change (10,) of the parameters if mass or inertia of the base were 1 % larger.

    The fit has an exact spacecraft, and the solution is its target.
    """
    fit = chosen.fit
    model = replace(fit.model, known_bodies=_OfBase(mass=0.01, inertia=0.01))
    values = fit.values | {BODIES: model.unknown(BODIES).mean}
    parts = ((log, roll(model, log, values), values) for log in fit.logs)
    total = chosen.swept(model, values, parts)
    R = total.marginal([PSI, BODIES]).R
    mass, *stretches = -solve_triangular(R[:10, :10], R[:10, 10:14]).T  # of the base, in σ
    form, open_axes = relative_parameterization(model.mass), solution.unidentifiable
    changes = {}
    for name, change in ((BASE_MASS, mass), (BASE_INERTIA, np.sum(stretches, axis=0))):
        scaled = change / solution.unit  # combinations that are not identifiable stay as they are
        scaled = scaled - open_axes.T @ (open_axes @ scaled)
        change = form.jacobian(solution.values) @ (solution.unit * scaled)
        changes[name] = np.where(np.isfinite(form.to_parameters(solution.estimate)), change, np.nan)
    return changes


def hidden_sensitivity(
    parameters: Array, tree: KinematicTree, *, has_scale: bool
) -> dict[str, Array]:
    """Return the change (10,) of the target's parameters (10,) by errors that no samples identify.

    A known momentum or force has a scale, which is that of all masses.
    """
    tree = tree.lumped
    body, R_CB = tree.bodies[tree.capture_body], tree.R_BC.T
    I_C = R_CB @ body.I_BBcm @ tree.R_BC
    link = InertialParameters(body.mass, R_CB @ (body.p_BBcm - tree.p_BC), I_C).to_vector()
    parameters = np.where(np.isfinite(parameters), parameters, np.nan)  # c, if there is no mass
    moved = parameters_to_standard(parameters) - 0.01 * parameters_to_standard(link)
    changes = {LINK: standard_to_parameters(moved) - parameters}
    if not has_scale:
        changes[ALL_MASSES] = 0.01 * parameters
        changes[ALL_MASSES][1:4] = 0.0  # the centre of mass stays
    return changes
