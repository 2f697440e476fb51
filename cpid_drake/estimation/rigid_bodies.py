"""The rigid body that is nearest to what is known of a target.

Unknowns x are those of a rigid body if a matrix G(x), linear in them, is positive semidefinite: the
pseudo-inertia, or for Eq. 18 the second moment about the centre of mass beside 1/m. What is known
is A x = b with unit errors, of any rank, so that the least |A x − b| is a semidefinite program.
Source: Wensing et al. 2018.
"""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import (
    EQ18,
    Parameterization,
    second_moment,
    standard_to_pseudo_inertia,
    vector_to_tensor,
)
from cpid_drake.estimation.gaussian import Gaussian

LEAST_SIGMA = 3e-5
"""Least σ of a combination of unknowns, as a share of its plausible size.

Solvers round, and a simulation conserves momentum only up to its own tolerance.
"""

CONSTANT = np.diag([0.0, 0.0, 0.0, 0.0, 1.0])
"""G(0) (5, 5)."""


def sizes(form: Parameterization, mass: float, radius: float) -> Array:
    """Return the sizes (10,) of unknowns, from a mass [kg] and a radius of gyration [m]."""
    first, moments = mass * np.array([1.0, *3 * [radius]]), 6 * [mass * radius**2]
    return np.append([1 / mass, *3 * [radius]] if form.name == EQ18.name else first, moments)


def without_rounding(gaussian: Gaussian, scale: Array) -> Gaussian:
    """Return what is known with no σ below `LEAST_SIGMA`; the unknowns have sizes `scale` (10,)."""
    U, strength, axes = gaussian.singular_parts(scale)
    factor = np.minimum(1.0, 1 / LEAST_SIGMA / strength)
    A = (factor * strength)[:, None] * axes / scale
    rows = np.column_stack([A, factor * (U.T @ gaussian.z)])
    return Gaussian.of_rows(gaussian.sizes, rows)


def unit_matrices(form: Parameterization, mass: float) -> Array:
    """Return G (10, 5, 5) of unit vectors, less `CONSTANT`.

    The last entry is 1 − μ/mass for relative unknowns, in which a heavy target has the
    spacecraft's mass.

    Args:
        form: the parameterization of the unknowns.
        mass: that of the spacecraft's bodies, in units of the first unknown.

    """
    units, G = np.eye(10), np.zeros((10, 5, 5))
    if form.name == EQ18.name:
        G[:, :3, :3], G[:, 3, 3] = second_moment(vector_to_tensor(units[:, 4:])), units[:, 0]
    else:
        G[:, :4, :4] = standard_to_pseudo_inertia(units)
    if form.name == "relative":
        G[0, 4, 4] = -1 / mass
    return G


def nearest(
    gaussian: Gaussian, form: Parameterization, known_mass: float, scale: Array
) -> tuple[float, Array]:
    """Return the least |A x − b| of a rigid body, in σ, and the unknowns (10,) of this body.

    NaN if the solver fails. Unknowns that are not determined have arbitrary values.

    Args:
        gaussian: of the unknowns; see `without_rounding`.
        form: their parameterization.
        known_mass: mass of the spacecraft [kg].
        scale: (10,) sizes of the unknowns.

    """
    from pydrake.solvers import ClarabelSolver, MathematicalProgram

    program = MathematicalProgram()
    x = program.NewContinuousVariables(10, "x")
    matrices = [CONSTANT, *unit_matrices(form, known_mass / scale[0])]
    program.AddLinearMatrixInequalityConstraint(matrices, x)
    program.AddL2NormCostUsingConicConstraint(gaussian.R * scale, -gaussian.z, x)
    result = ClarabelSolver().Solve(program)
    if not result.is_success():
        return np.nan, np.full(10, np.nan)
    return max(float(result.get_optimal_cost()), 0.0), np.asarray(result.GetSolution(x) * scale)
