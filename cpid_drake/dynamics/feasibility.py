"""The nearest physically consistent inertial parameters, by a semidefinite program.

A vector φ is the standard vector of a rigid body exactly when its pseudo-inertia [Σ, h; hᵀ, m] is
positive semidefinite (Wensing et al. 2018). That condition is convex, so the nearest consistent
vector is unique.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.parameterizations import standard_jacobian, standard_to_pseudo_inertia
from cpid_drake.dynamics.spatial_inertia import inertia_of_second_moment, second_moment
from cpid_drake.errors import InputError


def nearest_consistent(phi: NDArray[np.float64], information: ArrayLike | None) -> NDArray:
    """Return the standard vector of a rigid body that is nearest to φ̂ (10,), up to rounding.

    It minimizes (φ − φ̂)ᵀ Λ (φ − φ̂) over positive semidefinite pseudo-inertias.

    Args:
        phi: φ̂, with a mass that is not zero.
        information: (10, 10) information matrix (inverse covariance, up to a factor) of the
            parameter vector π, converted to φ at φ̂. Default: mass, m c and J, each divided by its
            own size, have equal weight.

    Raises:
        InputError: `information` is not a finite, symmetric, positive definite matrix.
        RuntimeError: the solver failed.

    Source: Wensing et al. 2018.

    """
    mass_scale = abs(phi[0])
    length = np.sqrt(max(np.abs(phi[4:]).max(), np.abs(phi[1:4]).max() ** 2) / mass_scale)
    length = max(length, 1e-6)
    scale = mass_scale * np.concatenate([[1.0], 3 * [length], 6 * [length**2]])
    root = np.eye(10)
    if information is not None:
        root = _information_root(information, standard_jacobian(phi) * scale)

    # A violation of 1e-10 must be removed by a change of about 1e-10, not by a change as large as
    # the solver's tolerance. Therefore the change is measured in units of the violation, and the
    # constraint is scaled by congruence (which keeps definiteness) so that every eigenvalue of the
    # estimate is scaled to one.
    values, axes = np.linalg.eigh(standard_to_pseudo_inertia(phi / scale))
    violation = max(-values[0], 1e-14 * np.abs(values).max())
    congruence = axes / np.sqrt(np.maximum(np.abs(values), violation))
    directions = [phi / scale, *(violation * np.eye(10))]
    matrices = [congruence.T @ standard_to_pseudo_inertia(phi) @ congruence for phi in directions]
    # A simulated body needs some mass: here at least a thousandth of the estimate's magnitude.
    least_mass = (1e-3 - phi[0] / scale[0]) / violation if phi[0] < 0 else -np.inf
    change = _least_change(root, [(matrix + matrix.T) / 2 for matrix in matrices], least_mass)
    return phi + scale * violation * change


def inside_the_limits(mass: float, com: NDArray, inertia: NDArray) -> NDArray[np.float64]:
    """Return the inertia (3, 3) changed by about the rounding error, so that Drake accepts it.

    The change is at most 1e-12 of the body's size where the body is physically consistent up to
    rounding or a solver's tolerance.

    Args:
        mass: [kg].
        com: (3,) centre of mass from the frame's origin [m].
        inertia: (3, 3) inertia about the centre of mass [kg·m²].

    """
    values, axes = np.linalg.eigh(second_moment(inertia))
    # Drake also checks the inertia about other points, where m|c|² adds to the rounding error.
    size = np.abs(values).max() + mass * com @ com
    inertia = inertia_of_second_moment(axes @ np.diag(np.maximum(values, 1e-12 * size)) @ axes.T)
    return (inertia + inertia.T) / 2


def _least_change(
    root: NDArray[np.float64], matrices: list[NDArray[np.float64]], least: float
) -> NDArray[np.float64]:
    """Minimize |root z| over z (10,) with F0 + Σ z_i F_i ⪰ 0 and z_0 ≥ least, by Clarabel.

    The cost is the norm, which is better scaled than its square. If Clarabel does not reach its
    tolerance with the norm, the square is minimized instead; it has the same minimizer.
    """
    from pydrake.solvers import ClarabelSolver, MathematicalProgram

    for squared in (False, True):
        program = MathematicalProgram()
        z = program.NewContinuousVariables(10, "z")
        program.AddLinearMatrixInequalityConstraint(matrices, z)
        if np.isfinite(least):
            program.AddBoundingBoxConstraint(least, np.inf, z[0])
        if squared:
            program.AddQuadraticCost(2 * root.T @ root, np.zeros(10), z, is_convex=True)
        else:
            program.AddL2NormCostUsingConicConstraint(root, np.zeros(10), z)
        result = ClarabelSolver().Solve(program)
        if result.is_success():
            return result.GetSolution(z)
    raise RuntimeError(
        f"Clarabel found no physically consistent parameters: {result.get_solution_result()}"
    )


def _information_root(information: ArrayLike, jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
    """Check that Λ is positive definite; return R (10, 10) with RᵀR = Jᵀ Λ J up to a factor."""
    information = np.asarray(information, dtype=float)
    if information.shape != (10, 10) or not np.isfinite(information).all():
        raise InputError("the information matrix must be finite and of shape (10, 10)")
    sizes = np.sqrt(np.abs(np.diag(information)))
    if (sizes == 0).any():
        raise InputError("the information matrix must be positive definite: a diagonal entry is 0")
    unit = information / np.outer(sizes, sizes)
    if np.abs(unit - unit.T).max() > 1e-6:
        raise InputError("the information matrix must be symmetric")
    values, axes = np.linalg.eigh((unit + unit.T) / 2)
    if values[0] < -1e-9:
        raise InputError("the information matrix must be positive definite")
    root = np.sqrt(np.maximum(values, 0))[:, None] * axes.T * sizes
    root = root @ jacobian
    return root / np.abs(root).max()
