"""The target's ten inertial parameters, their physical consistency, and the nearest rigid body.

`parameterizations` defines the vectors π and φ and every conversion between them. A vector φ is the
standard vector of a rigid body exactly when its pseudo-inertia [Σ, h; hᵀ, m] is positive
semidefinite (Wensing et al. 2018). That condition is convex, so the nearest consistent vector is
unique; a semidefinite program finds it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.parameterizations import (
    REPORT_ORDER,
    STANDARD,
    TENSOR_ORDER,
    inertia_of_second_moment,
    parameters_to_standard,
    point_mass_inertia,
    second_moment,
    standard_to_parameters,
    standard_to_pseudo_inertia,
    tensor_to_vector,
    vector_to_tensor,
)
from cpid_drake.errors import InputError

if TYPE_CHECKING:
    from pydrake.multibody.tree import SpatialInertia


@dataclass(frozen=True, eq=False, repr=False)
class InertialParameters:
    """Mass, centre of mass and inertia of one body, the target, in its capture frame C.

    The parameters need not be physically consistent: an estimate from noisy data can have values
    that no rigid body has. `infeasibilities()` lists the reasons, and `nearest_feasible()`
    returns the nearest parameters that a simulator accepts.

    Attributes:
        mass: m [kg].
        p_CTcm_C: (3,) centre of mass from C's origin, in C [m].
        I_TTcm_C: (3, 3) inertia about the centre of mass, in C [kg·m²].

    Raises:
        InputError: wrong shape, an entry that is not finite, or an inertia that is not symmetric.

    """

    mass: float
    p_CTcm_C: NDArray[np.float64]
    I_TTcm_C: NDArray[np.float64]

    def __post_init__(self) -> None:
        try:
            mass = float(self.mass)
            com = np.array(self.p_CTcm_C, dtype=float)
            inertia = np.array(self.I_TTcm_C, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError(f"inertial parameters must be numbers: {error}") from error
        if com.shape != (3,) or inertia.shape != (3, 3):
            raise InputError(
                f"p_CTcm_C must have shape (3,) and I_TTcm_C (3, 3), not {com.shape} and "
                f"{inertia.shape}"
            )
        if not (np.isfinite(mass) and np.isfinite(com).all() and np.isfinite(inertia).all()):
            raise InputError("inertial parameters must be finite numbers")
        if np.abs(inertia - inertia.T).max() > 1e-12 * np.abs(inertia).max():
            raise InputError("I_TTcm_C must be symmetric")
        inertia = (inertia + inertia.T) / 2
        com.flags.writeable = inertia.flags.writeable = False
        object.__setattr__(self, "mass", mass)
        object.__setattr__(self, "p_CTcm_C", com)
        object.__setattr__(self, "I_TTcm_C", inertia)

    # -- representations ---------------------------------------------------------------------

    @classmethod
    def from_vector(cls, parameters: ArrayLike) -> "InertialParameters":
        """Return the parameters of a vector π (10,) = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz)."""
        parameters = _ten(parameters, "a parameter vector")
        inertia = vector_to_tensor(parameters[4:][TENSOR_ORDER])
        return cls(parameters[0], parameters[1:4], inertia)

    def to_vector(self) -> NDArray[np.float64]:
        """Return π (10,) = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz) [kg, m, kg·m²]."""
        moments = tensor_to_vector(self.I_TTcm_C)[REPORT_ORDER]
        return np.concatenate([[self.mass], self.p_CTcm_C, moments])

    @classmethod
    def from_standard_vector(cls, phi: ArrayLike) -> "InertialParameters":
        """Return the parameters of φ (10,) = (m, m c, J about C's origin); m must not be zero."""
        return cls.from_vector(standard_to_parameters(_ten(phi, "a standard vector")))

    def to_standard_vector(self) -> NDArray[np.float64]:
        """Return φ (10,) = (m, m c, J11, J12, J13, J22, J23, J33), J about C's origin."""
        return parameters_to_standard(self.to_vector())

    @classmethod
    def from_spatial_inertia(cls, M_TCo_C: "SpatialInertia") -> "InertialParameters":
        """Return the parameters of Drake's spatial inertia about C's origin, in C."""
        M_TTcm_C = M_TCo_C.Shift(M_TCo_C.get_com())
        inertia = M_TTcm_C.CalcRotationalInertia().CopyToFullMatrix3()
        return cls(M_TCo_C.get_mass(), M_TCo_C.get_com(), inertia)

    def to_spatial_inertia(self) -> "SpatialInertia":
        """Return Drake's spatial inertia about C's origin, in C.

        For a flat body far from C, rounding can violate the limits about C's origin; the inertia is
        then changed by 1e-12 of its size.

        Raises:
            InputError: no rigid body has these parameters; use `nearest_feasible()` first.

        """
        from pydrake.multibody.tree import SpatialInertia, UnitInertia

        problems = self.infeasibilities()
        if problems:
            raise InputError(
                f"not a rigid body: {'; '.join(problems)}. Use nearest_feasible() first"
            )
        mass, com = self.mass, self.p_CTcm_C
        for inertia in (self.I_TTcm_C, inside_the_limits(mass, com, self.I_TTcm_C)):
            unit = tensor_to_vector((inertia + point_mass_inertia(mass, com)) / mass)
            G_TCo_C = UnitInertia(*unit[REPORT_ORDER])
            M_TCo_C = SpatialInertia(mass, com, G_TCo_C, skip_validity_check=True)
            if M_TCo_C.IsPhysicallyValid():
                break
        return M_TCo_C

    # -- feasibility -------------------------------------------------------------------------

    def principal_moments(self) -> NDArray[np.float64]:
        """Return the (3,) principal moments about the centre of mass, ascending [kg·m²]."""
        return np.linalg.eigvalsh(self.I_TTcm_C).astype(float)

    def infeasibilities(self) -> tuple[str, ...]:
        """Return the reasons why no rigid body can have these parameters; empty if one can.

        The limits are exact up to rounding (1e-14 of the inertia's trace): a flat body, whose
        largest principal moment equals the sum of the other two, is feasible.
        """
        problems = []
        if self.mass <= 0:
            problems.append(f"the mass {self.mass:g} kg is not positive")
        low, middle, high = self.principal_moments()
        slack = 1e-14 * max(abs(low), abs(high))  # rounding of a few hundred operations
        if low < -slack:
            problems.append(f"the principal moment {low:g} kg·m² is negative")
        if high > low + middle + slack:
            problems.append(
                f"principal moments {low:g}, {middle:g}, {high:g} kg·m² violate the triangle "
                f"inequality by {high - low - middle:.3g}"
            )
        return tuple(problems)

    def is_feasible(self) -> bool:
        """Return whether a rigid body can have these parameters."""
        return not self.infeasibilities()

    def nearest_feasible(self, information: ArrayLike | None = None) -> "InertialParameters":
        """Return the nearest physically consistent parameters, or these if they are consistent.

        Args:
            information: (10, 10) information matrix of the parameter vector π, up to a factor,
                that defines the distance; see `nearest_consistent` for the default.

        Raises:
            InputError: `information` is not a finite, symmetric, positive definite matrix, or the
                mass is exactly zero.
            RuntimeError: the solver failed.

        """
        if self.is_feasible():
            return self
        if self.mass == 0:
            raise InputError("parameters of zero mass have no nearest body: c = h/m is undefined")
        near = InertialParameters.from_standard_vector(
            nearest_consistent(self.to_standard_vector(), information)
        )
        inertia = inside_the_limits(near.mass, near.p_CTcm_C, near.I_TTcm_C)
        return InertialParameters(near.mass, near.p_CTcm_C, inertia)

    def __repr__(self) -> str:
        def row(values: NDArray[np.float64]) -> str:
            return "[" + ", ".join(f"{value:.6g}" for value in values + 0.0) + "]"

        inertia = ", ".join(row(r) for r in self.I_TTcm_C)
        return (
            f"InertialParameters(mass={self.mass:.6g}, p_CTcm_C={row(self.p_CTcm_C)}, "
            f"I_TTcm_C=[{inertia}])"
        )


def _ten(vector: ArrayLike, what: str) -> NDArray[np.float64]:
    try:
        vector = np.asarray(vector, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be of numbers: {error}") from error
    if vector.shape != (10,):
        raise InputError(f"{what} has ten entries, not shape {vector.shape}")
    return vector


# -- the nearest rigid body ----------------------------------------------------------------------


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
    from pydrake.solvers import ClarabelSolver, MathematicalProgram

    mass = abs(phi[0])
    length = max(np.sqrt(max(np.abs(phi[4:]).max(), (phi[1:4] ** 2).max()) / mass), 1e-6)
    scale = mass * np.concatenate([[1.0], 3 * [length], 6 * [length**2]])
    root = np.eye(10)
    if information is not None:
        root = _information_root(information, STANDARD.jacobian(phi) * scale)

    # A violation of 1e-10 must be removed by a change of about 1e-10, not by a change as large as
    # the solver's tolerance. Therefore the change z is measured in units of the violation, and the
    # constraint is scaled by congruence (which keeps definiteness) so that every eigenvalue of the
    # estimate is scaled to one.
    values, axes = np.linalg.eigh(standard_to_pseudo_inertia(phi / scale))
    violation = max(-values[0], 1e-14 * np.abs(values).max())
    congruence = axes / np.sqrt(np.maximum(np.abs(values), violation))
    matrices = [
        congruence.T @ standard_to_pseudo_inertia(each) @ congruence
        for each in (phi / scale, *(violation * np.eye(10)))
    ]
    # The norm is better scaled than its square, which has the same minimizer; Clarabel reaches its
    # tolerance with one of them.
    for squared in (False, True):
        program = MathematicalProgram()
        z = program.NewContinuousVariables(10, "z")
        program.AddLinearMatrixInequalityConstraint([(m + m.T) / 2 for m in matrices], z)
        if phi[0] < 0:  # a simulated body needs some mass: a thousandth of the estimate's size
            least = (1e-3 - phi[0] / scale[0]) / violation
            program.AddBoundingBoxConstraint(least, np.inf, z[0])
        if squared:
            program.AddQuadraticCost(2 * root.T @ root, np.zeros(10), z, is_convex=True)
        else:
            program.AddL2NormCostUsingConicConstraint(root, np.zeros(10), z)
        result = ClarabelSolver().Solve(program)
        if result.is_success():
            return phi + scale * violation * result.GetSolution(z)
    raise RuntimeError(
        f"Clarabel found no physically consistent parameters: {result.get_solution_result()}"
    )


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


def _information_root(information: ArrayLike, jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
    """Check that Λ is positive definite; return R (10, 10) with RᵀR = Jᵀ Λ J up to a factor."""
    information = np.asarray(information, dtype=float)
    if information.shape == (10, 10) and np.isfinite(information).all():
        sizes = np.sqrt(np.abs(np.diag(information)))
        unit = information / np.outer(sizes, sizes).clip(min=1e-300)
        values, axes = np.linalg.eigh((unit + unit.T) / 2)
        if (sizes > 0).all() and np.abs(unit - unit.T).max() < 1e-6 and values[0] > -1e-9:
            root = np.sqrt(np.maximum(values, 0))[:, None] * axes.T * sizes @ jacobian
            return root / np.abs(root).max()
    raise InputError(
        "the information matrix must be finite, symmetric, positive definite and of shape (10, 10)"
    )
