"""The target's ten inertial parameters, and the check of their physical consistency.

`parameterizations` defines the vectors π and φ and every conversion between them.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.feasibility import inside_the_limits, nearest_consistent
from cpid_drake.dynamics.parameterizations import (
    REPORT_ORDER,
    TENSOR_ORDER,
    parameters_to_standard,
    standard_to_parameters,
    tensor_to_vector,
    vector_to_tensor,
)
from cpid_drake.dynamics.spatial_inertia import point_mass_inertia
from cpid_drake.errors import InputError

if TYPE_CHECKING:
    from pydrake.multibody.tree import SpatialInertia

# Rounding error of a few hundred operations; not a physical tolerance.
_ROUNDING = 1e-14


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

        def unchecked(I_TTcm_C: NDArray[np.float64]) -> SpatialInertia:
            I_TC_C = I_TTcm_C + point_mass_inertia(self.mass, self.p_CTcm_C)
            moments = tensor_to_vector(I_TC_C / self.mass)[REPORT_ORDER]
            return SpatialInertia(
                self.mass, self.p_CTcm_C, UnitInertia(*moments), skip_validity_check=True
            )

        M_TCo_C = unchecked(self.I_TTcm_C)
        if M_TCo_C.IsPhysicallyValid():
            return M_TCo_C
        return unchecked(inside_the_limits(self.mass, self.p_CTcm_C, self.I_TTcm_C))

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
        slack = _ROUNDING * max(abs(low), abs(high))
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
                that defines the distance; see `feasibility.nearest_consistent` for the default.

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
