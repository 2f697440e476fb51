"""The nearest physically consistent inertial parameters, by a semidefinite program."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from cpid_drake.errors import InputError


def least_change(
    root: NDArray[np.float64], matrices: list[NDArray[np.float64]], least: float
) -> NDArray[np.float64]:
    """Minimize |root z| over z (10,) with F0 + Σ z_i F_i ⪰ 0 and z_0 ≥ least, by Clarabel.

    The norm is the better scaled cost; where Clarabel cannot reach its tolerance with it, its
    square has the same minimum.
    """
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
        f"Clarabel found no physically possible parameters: {result.get_solution_result()}"
    )


def information_root(information: ArrayLike, jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R (10, 10) with RᵀR = Jᵀ Λ J up to a factor, Λ checked to be positive definite."""
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
