"""The target's ten inertial parameters, their physical consistency, and the nearest rigid body.

`parameterizations` defines the vectors π and φ and every conversion between them. A vector φ is the
standard vector of a rigid body exactly when its pseudo-inertia [Σ, h; hᵀ, m] is positive
semidefinite (Wensing et al. 2018).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import (
    REPORT_ORDER,
    TENSOR_ORDER,
    inertia_of_second_moment,
    parameters_to_standard,
    point_mass_inertia,
    second_moment,
    standard_to_parameters,
    tensor_to_vector,
    vector_to_tensor,
)
from cpid_drake.files.errors import InputError

if TYPE_CHECKING:
    from pydrake.multibody.tree import SpatialInertia


@dataclass(frozen=True, eq=False, repr=False)
class InertialParameters:
    """Mass, centre of mass and inertia of one body, the target, in its capture frame C.

    The parameters need not be physically consistent: an estimate from noisy data can have values
    that no rigid body has. `inconsistencies()` lists the reasons, and `nearest_consistent()`
    returns near parameters that a simulator accepts.

    Attributes:
        mass: m [kg].
        p_CTcm_C: (3,) centre of mass from C's origin, in C [m].
        I_TTcm_C: (3, 3) inertia about the centre of mass, in C [kg·m²].

    Raises:
        InputError: wrong shape, an entry that is not finite, or an inertia that is not symmetric.

    """

    mass: float
    p_CTcm_C: Array
    I_TTcm_C: Array

    def __post_init__(self) -> None:
        if any(
            isinstance(each, (str, bytes)) for each in (self.mass, self.p_CTcm_C, self.I_TTcm_C)
        ):
            raise InputError("inertial parameters must be numbers, not text")
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

    @classmethod
    def from_vector(cls, parameters: ArrayLike) -> "InertialParameters":
        """Return the parameters of a vector π (10,) = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz)."""
        parameters = _ten(parameters, "a parameter vector")
        inertia = vector_to_tensor(parameters[4:][TENSOR_ORDER])
        return cls(parameters[0], parameters[1:4], inertia)

    def to_vector(self) -> Array:
        """Return π (10,) = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz) [kg, m, kg·m²]."""
        moments = tensor_to_vector(self.I_TTcm_C)[REPORT_ORDER]
        return np.concatenate([[self.mass], self.p_CTcm_C, moments])

    @classmethod
    def from_standard_vector(cls, phi: ArrayLike) -> "InertialParameters":
        """Return the parameters of φ (10,) = (m, m c, J about C's origin); m must not be zero."""
        return cls.from_vector(standard_to_parameters(_ten(phi, "a standard vector")))

    def to_standard_vector(self) -> Array:
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
            InputError: no rigid body has these parameters; use `nearest_consistent()` first.

        """
        from pydrake.multibody.tree import SpatialInertia, UnitInertia

        problems = self.inconsistencies()
        if problems:
            raise InputError(
                f"not a rigid body: {'; '.join(problems)}. Use nearest_consistent() first"
            )
        mass, com = self.mass, self.p_CTcm_C
        for inertia in (self.I_TTcm_C, inside_the_limits(mass, com, self.I_TTcm_C)):
            unit = tensor_to_vector((inertia + point_mass_inertia(mass, com)) / mass)
            G_TCo_C = UnitInertia(*unit[REPORT_ORDER])
            M_TCo_C = SpatialInertia(mass, com, G_TCo_C, skip_validity_check=True)
            if M_TCo_C.IsPhysicallyValid():
                break
        return M_TCo_C

    def principal_moments(self) -> Array:
        """Return the (3,) principal moments about the centre of mass, ascending [kg·m²]."""
        return np.linalg.eigvalsh(self.I_TTcm_C).astype(float)

    def inconsistencies(self) -> tuple[str, ...]:
        """Return the reasons why no rigid body can have these parameters; empty if one can.

        The limits are exact up to rounding (1e-14 of the inertia's trace): a flat body, whose
        largest principal moment equals the sum of the other two, is physically consistent.
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

    def is_physically_consistent(self) -> bool:
        """Return whether a rigid body can have these parameters."""
        return not self.inconsistencies()

    def nearest_consistent(self) -> "InertialParameters":
        """Return the nearest physically consistent inertia, or these parameters if they are.

        The centre of mass stays, and the mass, which becomes a thousandth of its size if it is
        negative. The second moment about the centre of mass loses its negative eigenvalues: the
        nearest one by the sum of squares of its entries.

        Raises:
            InputError: the mass is exactly zero.

        Source: Wensing et al. 2018; Higham 1988, Computing a nearest symmetric positive
        semidefinite matrix.

        """
        if self.is_physically_consistent():
            return self
        if self.mass == 0:
            raise InputError("parameters of zero mass have no nearest body: c = h/m is undefined")
        mass = max(self.mass, -1e-3 * self.mass)
        inertia = inside_the_limits(mass, self.p_CTcm_C, self.I_TTcm_C)
        return InertialParameters(mass, self.p_CTcm_C, inertia)

    def __repr__(self) -> str:
        def row(values: Array) -> str:
            return "[" + ", ".join(f"{value:.6g}" for value in values + 0.0) + "]"

        inertia = ", ".join(row(r) for r in self.I_TTcm_C)
        return (
            f"InertialParameters(mass={self.mass:.6g}, p_CTcm_C={row(self.p_CTcm_C)}, "
            f"I_TTcm_C=[{inertia}])"
        )


def _ten(vector: ArrayLike, what: str) -> Array:
    try:
        vector = np.asarray(vector, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be of numbers: {error}") from error
    if vector.shape != (10,):
        raise InputError(f"{what} has ten entries, not shape {vector.shape}")
    return vector


def inside_the_limits(mass: ArrayLike, com: Array, inertia: Array) -> Array:
    """Return inertias (..., 3, 3) changed by about the rounding error, so that Drake accepts them.

    The change is at most 1e-12 of the body's size where the body is physically consistent up to
    rounding or a solver's tolerance.

    Args:
        mass: (...) [kg].
        com: (..., 3) centre of mass from the frame's origin [m].
        inertia: (..., 3, 3) inertia about the centre of mass [kg·m²].

    """
    values, axes = np.linalg.eigh(second_moment(inertia))
    # Drake also checks the inertia about other points, where m|c|² adds to the rounding error.
    size = np.abs(values).max(axis=-1) + mass * np.sum(com**2, axis=-1)
    values = np.maximum(values, 1e-12 * size[..., None])
    inertia = inertia_of_second_moment(axes * values[..., None, :] @ np.swapaxes(axes, -1, -2))
    return (inertia + np.swapaxes(inertia, -1, -2)) / 2
