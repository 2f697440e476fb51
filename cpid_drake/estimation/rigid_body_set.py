"""The rigid bodies that agree with what is known of a target: bounds of its ten parameters.

What an estimator knows is a confidence region |A x − b| ≤ r of its unknowns x, of any rank. A body
is physically consistent if its pseudo-inertia is positive semidefinite, and it has a plausible size
if no part of it is farther than a radius R from C's origin. Both conditions are convex in x, so the
extreme values of a parameter over all such bodies are semidefinite programs. They bound also the
parameters that the samples do not determine: Ixx follows from Izz, the mass and R, for example.

Masses are linear in x, and centres of mass are ratios h/m, which become linear when all unknowns
are divided by m (Charnes & Cooper 1962). The inertia about the centre of mass, Σ − m c cᵀ, is not
linear. The matrix m c cᵀ is replaced by a matrix H that satisfies the convex conditions

    [H, h; hᵀ, m] ⪰ 0     and     H_ii ≤ (l_i + u_i) h_i − l_i u_i m     if l_i ≤ c_i ≤ u_i,

which the true one satisfies, so the bounds are valid. They are exact if c is known, and for the
largest moments of inertia (McCormick 1976; Wensing et al. 2018).
"""

import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import (
    EQ18,
    REPORT_ORDER,
    inertia_of_second_moment,
    second_moment,
    standard_to_pseudo_inertia,
    tensor_to_vector,
    vector_to_tensor,
)
from cpid_drake.estimation.gaussian import Gaussian

if TYPE_CHECKING:
    from pydrake.solvers import MathematicalProgramResult

Array = NDArray[np.float64]

LEAST_SIGMA = 3e-5
"""Least σ of a combination of unknowns, as a share of its plausible size.

Solvers round, and a simulation conserves momentum only up to its own tolerance.
"""

ROUNDING = 1e-7
"""Rounding error of the solver, as a share of the plausible size."""

_H = [vector_to_tensor(unit) for unit in np.eye(6)]


@dataclass(frozen=True, eq=False)
class RigidBodySet:
    """All rigid bodies in a confidence region.

    Attributes:
        rows: what is known of the unknowns: A x = b with unit errors, of any rank. No combination
            has a smaller σ than `LEAST_SIGMA`: smaller differences are rounding.
        radius: radius r of the confidence region, in σ.
        form: name of the parameterization of the unknowns.
        known_mass: mass of the known bodies, which relative unknowns depend on [kg].
        mass: plausible mass of the target, the unit of the computation [kg].
        size: largest distance R of a part of the target from C's origin [m].

    """

    rows: Gaussian
    radius: float
    form: str
    known_mass: float
    mass: float
    size: float
    scale: Array = field(init=False)

    def __post_init__(self) -> None:
        m, R = self.mass, self.size
        first = [1 / m, R, R, R] if self.form == EQ18.name else [m, m * R, m * R, m * R]
        scale = np.array([*first, *6 * [m * R**2]])
        object.__setattr__(self, "scale", scale)
        U, sizes, axes = self.rows.singular_parts(scale)
        factor = np.minimum(1.0, 1 / LEAST_SIGMA / sizes)
        A = (factor * sizes)[:, None] * axes / scale
        rows = np.column_stack([A, factor * (U.T @ self.rows.z)])
        object.__setattr__(self, "rows", Gaussian.of_rows(self.rows.sizes, rows))

    def nearest(self) -> tuple[float, Array]:
        """Return the smallest |A x − b| of a rigid body, in σ, and the unknowns (10,) of this body.

        It is at most the radius if there is a body in the set. NaN if the solver fails. Unknowns
        that are not determined have arbitrary values.
        """
        return _Program(self, np.inf).nearest()

    def bounds(self) -> Array | None:
        """Return the extreme values (10, 2) of π over all bodies of the set; None if it is empty.

        An infinite value means that nothing bounds the parameter.
        """
        heaviest = _Program(self, np.inf).extremes(np.eye(10)[0])
        if heaviest is None:
            return None
        low, high = heaviest
        masses = self._masses(low, high)
        result = np.full((10, 2), [-np.inf, np.inf])
        result[0] = masses
        largest = masses[1]
        com = self._centre_of_mass(largest)
        if com is None:
            return None
        result[1:4] = com
        program = _Program(self, largest, com)
        for place, weights in enumerate(_inertia_weights(self.form), start=4):
            found = program.extremes(weights)
            if found is None:
                return None
            result[place] = np.array(found) * self.mass * self.size**2
        result[4:7] = np.maximum(result[4:7], 0.0)
        return result

    def _masses(self, low: float, high: float) -> Array:
        """Return the extreme masses from those of the first unknown, in its unit."""
        if self.form == EQ18.name:
            with np.errstate(divide="ignore"):
                return self.mass / np.maximum(np.array([high, low]), 0.0)
        first = np.maximum(np.array([low, high]), 0.0) * self.mass
        if self.form == "relative":
            rest = np.maximum(self.known_mass - first, 0.0)
            with np.errstate(divide="ignore", invalid="ignore"):
                first = np.where(rest > 0, first * self.known_mass / rest, np.inf)
        return first

    def _centre_of_mass(self, largest: float) -> Array | None:
        """Return the extreme coordinates (3, 2) of the centre of mass."""
        if self.form == EQ18.name:
            program = _Program(self, largest)
        else:
            program = _Program(self, largest, is_divided=True)
        result = np.empty((3, 2))
        for k in range(3):
            found = program.extremes(np.eye(10)[1 + k])
            if found is None:
                return None
            result[k] = np.clip(found, -1.0, 1.0) * self.size  # the solver may find no bound
        return result


def _inertia_weights(form: str) -> list[Array]:
    """Return the weights of the unknowns (and of H) in Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
    if form == EQ18.name:
        return [np.eye(10)[4 + k] for k in REPORT_ORDER]
    of_H = np.stack([tensor_to_vector(inertia_of_second_moment(H)) for H in _H], axis=1)
    both = np.hstack([np.zeros((6, 4)), np.eye(6), -of_H])
    return list(both[REPORT_ORDER])


class _Program:
    """The conditions of a set of bodies as one semidefinite program, in units of order one.

    Args:
        bodies: the set.
        largest: largest mass [kg].
        com: (3, 2) extreme coordinates of the centre of mass [m]; None without the matrix H.
        is_divided: whether the unknowns are divided by the first one.

    """

    def __init__(
        self,
        bodies: RigidBodySet,
        largest: float,
        com: Array | None = None,
        *,
        is_divided: bool = False,
    ) -> None:
        from pydrake.solvers import MathematicalProgram

        self._bodies = bodies
        self._program = MathematicalProgram()
        is_eq18 = bodies.form == EQ18.name
        self._lifted = com is not None and not is_eq18
        size = 10 + 6 * self._lifted
        extra = int(is_divided)  # 1 / x0
        self._z = self._program.NewContinuousVariables(size + extra, "z")
        self._count = size
        self._divided = is_divided
        A, b = bodies.rows.R * bodies.scale, bodies.rows.z
        self._rows = np.zeros((len(b), size + extra))
        self._rows[:, :10], self._right = A, b
        if is_divided:
            self._rows[:, -1], self._right = -b, np.zeros(len(b))
            self._program.AddBoundingBoxConstraint(1.0, 1.0, self._z[:1])
            self._program.AddBoundingBoxConstraint(0, np.inf, self._z[-1:])
        self._heaviest = min(largest / bodies.mass, 1e6)
        if is_eq18:
            self._of_eq18()
        else:
            self._of_pseudo_inertia(com)

    def _of_eq18(self) -> None:
        matrices = [second_moment(vector_to_tensor(unit)) for unit in np.eye(10)[:, 4:]]
        self._semidefinite(matrices, np.zeros((3, 3)))
        self._program.AddBoundingBoxConstraint(0, np.inf, self._z[:1])
        trace = np.array([0, 0, 0, 0, 0.5, 0, 0, 0.5, 0, 0.5])
        self._at_most(trace, self._heaviest)
        self._cone(np.eye(10)[1:4], np.zeros(10), 1.0)

    def _of_pseudo_inertia(self, com: Array | None) -> None:
        width = len(self._z)
        P = [standard_to_pseudo_inertia(unit) for unit in np.eye(10)]
        trace = np.zeros(width)
        trace[[4, 7, 9]] = 0.5
        is_relative = self._bodies.form == "relative"
        if self._lifted:
            spread = [p[:3, :3] for p in P] + [-H for H in _H]
            self._semidefinite(spread, np.zeros((3, 3)))
            moved = np.zeros((16, 4, 4))  # [H, h; hᵀ, m]
            moved[:10] = P
            moved[:10, :3, :3] = 0.0
            moved[10:, :3, :3] = _H
            self._semidefinite(list(moved), np.zeros((4, 4)))
            of_H = np.zeros(width)
            of_H[[10, 13, 15]] = 1.0
            of_H[0] = -1.0
            self._at_most(of_H, 0.0)  # |c| ≤ R
            assert com is not None
            for k, (low, high) in enumerate(com / self._bodies.size):
                secant = np.zeros(width)
                secant[10 + (0, 3, 5)[k]] = 1.0
                secant[1 + k], secant[0] = -(low + high), low * high
                self._at_most(secant, 0.0)
        else:
            self._semidefinite(P, np.zeros((4, 4)))
        first = np.zeros(width)
        first[0] = 1.0
        self._cone(np.eye(width)[1:4], first, 0.0)  # |h| ≤ R m
        if is_relative and self._divided:
            trace[-1] = -self._heaviest
            self._at_most(trace, 0.0)
        elif is_relative:
            self._at_most(trace, self._heaviest)
        else:
            self._at_most(trace - first, 0.0)

    # -- solving -------------------------------------------------------------------------------

    def extremes(self, weights: Array) -> tuple[float, float] | None:
        """Return the smallest and the largest weighted sum of the unknowns; None if there is none.

        An infinite value means that there is no bound, or that the solver found none.
        """
        from pydrake.solvers import SolutionResult

        radius = np.zeros(len(self._z))
        right = self._bodies.radius
        if self._divided:
            radius[-1], right = right, 0.0
        if not hasattr(self, "_bounded"):
            self._cone(self._rows, radius, right, -self._right)
            self._bounded = self._program.AddLinearCost(np.zeros(len(self._z)), 0.0, self._z)
        full = np.zeros(len(self._z))
        full[: len(weights)] = weights
        found = []
        for sign in (1.0, -1.0):
            self._bounded.evaluator().UpdateCoefficients(sign * full)
            result = self._solve()
            status = result.get_solution_result()
            if status in (
                SolutionResult.kInfeasibleConstraints,
                SolutionResult.kInfeasibleOrUnbounded,
            ):
                return None
            is_solved = result.is_success()
            value = result.get_optimal_cost() - ROUNDING if is_solved else -np.inf
            found.append(sign * value)
        return found[0], found[1]

    def nearest(self) -> tuple[float, Array]:
        """Return the smallest |A x − b| in σ, and its unknowns (10,); NaN if the solver fails."""
        self._program.AddL2NormCostUsingConicConstraint(self._rows, -self._right, self._z)
        result = self._solve()
        if not result.is_success():
            return np.nan, np.full(10, np.nan)
        z = result.GetSolution(self._z)
        return max(float(result.get_optimal_cost()), 0.0), np.asarray(z[:10] * self._bodies.scale)

    def _solve(self) -> "MathematicalProgramResult":
        from pydrake.solvers import ClarabelSolver

        log = logging.getLogger("drake")
        level = log.level
        log.setLevel(logging.WARNING)  # a solver's failure is no news for the user
        try:
            return ClarabelSolver().Solve(self._program)
        finally:
            log.setLevel(level)

    # -- constraints ---------------------------------------------------------------------------

    def _semidefinite(self, matrices: list[Array], constant: Array) -> None:
        z = self._z[: len(matrices)]
        symmetric = [(m + m.T) / 2 for m in [constant, *matrices]]
        self._program.AddLinearMatrixInequalityConstraint(symmetric, z)

    def _at_most(self, weights: Array, limit: float) -> None:
        z = self._z[: len(weights)]
        self._program.AddLinearConstraint(weights[None], [-np.inf], [limit], z)

    def _cone(self, rows: Array, by: Array, constant: float, shift: Array | None = None) -> None:
        """Add |rows z + shift| ≤ by z + constant."""
        if not len(rows):
            return
        z = self._z[: rows.shape[1]]
        A = np.vstack([by[: rows.shape[1]], rows])
        b = np.concatenate([[constant], np.zeros(len(rows)) if shift is None else shift])
        self._program.AddLorentzConeConstraint(A, b, z)
