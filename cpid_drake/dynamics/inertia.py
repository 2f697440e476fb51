"""The target's ten inertial parameters in every representation, and whether a rigid body has them.

Three vectors of ten hold the same ten numbers; the functions here are the only place that converts
between them:

- **parameters** π = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz): what is reported;
- **eq18** θ = (1/m, c, I11, I12, I13, I22, I23, I33): the unknowns of Ning et al. 2016, Eq. 18;
- **standard** φ = (m, h, J11, J12, J13, J22, J23, J33), h = m c: the unknowns that the
  pseudo-inertia, and the momentum itself, are linear in.

Here c is `p_CTcm_C` (target's centre of mass Tcm from the capture point, in the capture frame C)
[m], I is `I_TTcm_C` (about Tcm, in C) and J is `I_TC_C` (about C's origin, in C) [kg·m²]. Products
of inertia are tensor entries: I12 = −∫xy dm.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.tree import SpatialInertia, UnitInertia

from cpid_drake.dynamics.feasibility import information_root, least_change
from cpid_drake.dynamics.parameterizations import (
    REPORT_ORDER,
    TENSOR_ORDER,
    eq18_to_parameters,
    parameters_to_eq18,
    parameters_to_standard,
    pseudo_inertia_to_standard,
    standard_jacobian,
    standard_to_parameters,
    standard_to_pseudo_inertia,
    tensor_to_vector,
    vector_to_tensor,
)
from cpid_drake.errors import InputError

# Rounding in the arithmetic of a few hundred operations; not a physical tolerance.
_ROUNDING = 1e-14


@dataclass(frozen=True, eq=False, repr=False)
class InertialParameters:
    """Mass, centre of mass and inertia of one body, the target, in its capture frame C.

    Nothing demands that a rigid body can have them: an estimate from noisy data may not. Ask
    `infeasibilities()`, and use `nearest_feasible()` before handing them to a simulator.

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
        """Make it from π (10,) = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz)."""
        parameters = _ten(parameters, "a parameter vector")
        inertia = vector_to_tensor(parameters[4:][TENSOR_ORDER])
        return cls(parameters[0], parameters[1:4], inertia)

    def to_vector(self) -> NDArray[np.float64]:
        """Return π (10,) = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz) [kg, m, kg·m²]."""
        moments = tensor_to_vector(self.I_TTcm_C)[REPORT_ORDER]
        return np.concatenate([[self.mass], self.p_CTcm_C, moments])

    @classmethod
    def from_eq18_vector(cls, theta: ArrayLike) -> "InertialParameters":
        """Make it from θ (10,) = (1/m, c, I11, I12, I13, I22, I23, I33); 1/m must not be zero."""
        return cls.from_vector(eq18_to_parameters(_ten(theta, "an Eq. 18 vector")))

    def to_eq18_vector(self) -> NDArray[np.float64]:
        """Return θ (10,), the unknowns of Ning et al. 2016, Eq. 18; the mass must not be zero."""
        if self.mass == 0:
            raise InputError("a body of zero mass has no Eq. 18 vector: it holds 1/m")
        return parameters_to_eq18(self.to_vector())

    @classmethod
    def from_standard_vector(cls, phi: ArrayLike) -> "InertialParameters":
        """Make it from φ (10,) = (m, m c, inertia about C's origin); m must not be zero."""
        return cls.from_vector(standard_to_parameters(_ten(phi, "a standard vector")))

    def to_standard_vector(self) -> NDArray[np.float64]:
        """Return φ (10,) = (m, m c, J11, J12, J13, J22, J23, J33), J about C's origin."""
        return parameters_to_standard(self.to_vector())

    def to_pseudo_inertia(self) -> NDArray[np.float64]:
        """Return the (4, 4) pseudo-inertia [½tr(J)1 − J, h; hᵀ, m] (Wensing et al. 2018).

        A rigid body has these parameters exactly when this matrix is positive semidefinite.
        """
        return standard_to_pseudo_inertia(self.to_standard_vector())

    @classmethod
    def from_pseudo_inertia(cls, pseudo: ArrayLike) -> "InertialParameters":
        """Make it from a (4, 4) pseudo-inertia; its mass (the last entry) must not be zero."""
        pseudo = np.asarray(pseudo, dtype=float)
        if pseudo.shape != (4, 4):
            raise InputError(f"a pseudo-inertia has shape (4, 4), not {pseudo.shape}")
        if np.abs(pseudo - pseudo.T).max() > 1e-12 * np.abs(pseudo).max():
            raise InputError("a pseudo-inertia must be symmetric")
        return cls.from_standard_vector(pseudo_inertia_to_standard(pseudo))

    @classmethod
    def from_spatial_inertia(cls, M_TCo_C: SpatialInertia) -> "InertialParameters":
        """Make it from Drake's spatial inertia about C's origin, in C."""
        M_TTcm_C = M_TCo_C.Shift(M_TCo_C.get_com())
        inertia = M_TTcm_C.CalcRotationalInertia().CopyToFullMatrix3()
        return cls(M_TCo_C.get_mass(), M_TCo_C.get_com(), inertia)

    def to_spatial_inertia(self) -> SpatialInertia:
        """Return Drake's spatial inertia about C's origin, in C.

        Of a flat body far from C, whose limits rounding would overstep about C's origin, the
        inertia is moved inside them by 1e-12 of its size.

        Raises:
            InputError: no rigid body has these parameters; `nearest_feasible()` gives some.

        """
        problems = self.infeasibilities()
        if problems:
            raise InputError(
                f"not a rigid body: {'; '.join(problems)}. Use nearest_feasible() first"
            )
        M_TCo_C = self._unchecked_spatial_inertia()
        return (
            M_TCo_C
            if M_TCo_C.IsPhysicallyValid()
            else self._inside_the_limits()._unchecked_spatial_inertia()
        )

    def _unchecked_spatial_inertia(self) -> SpatialInertia:
        # Unit inertia about C's origin; the check is the caller's.
        phi = self.to_standard_vector()
        G = vector_to_tensor(phi[4:]) / self.mass
        return SpatialInertia(
            self.mass,
            self.p_CTcm_C,
            UnitInertia(G[0, 0], G[1, 1], G[2, 2], G[0, 1], G[0, 2], G[1, 2]),
            skip_validity_check=True,
        )

    # -- feasibility -------------------------------------------------------------------------

    def principal_moments(self) -> NDArray[np.float64]:
        """Return the (3,) principal moments about the centre of mass, ascending [kg·m²]."""
        return np.linalg.eigvalsh(self.I_TTcm_C)

    def infeasibilities(self) -> tuple[str, ...]:
        """Say in words why no rigid body has these parameters; empty when one has.

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
        """Whether a rigid body can have these parameters; `infeasibilities()` says why not."""
        return not self.infeasibilities()

    def nearest_feasible(self, information: ArrayLike | None = None) -> "InertialParameters":
        """Return the feasible parameters nearest to these, or these if they are feasible.

        The distance is (φ − φ̂)ᵀ Λ (φ − φ̂) in the standard vector φ, over pseudo-inertias that are
        positive semidefinite (Wensing et al. 2018): a semidefinite program, solved by Clarabel.

        Args:
            information: (10, 10) information matrix (inverse covariance, up to a factor) of the
                parameter vector π, carried over to φ at this estimate. Default: mass, m c and J
                count alike once each is divided by its own size.

        Raises:
            InputError: `information` is not a finite, symmetric, positive definite matrix, or the
                mass is exactly zero.
            RuntimeError: the solver failed.

        """
        if self.is_feasible():
            return self
        if self.mass == 0:
            raise InputError("parameters of zero mass have no nearest body: c = h/m is undefined")
        center = self.to_standard_vector()
        mass_scale = abs(self.mass)
        length = np.sqrt(max(np.abs(center[4:]).max(), np.abs(center[1:4]).max() ** 2) / mass_scale)
        length = max(length, 1e-6)
        scale = mass_scale * np.concatenate([[1.0], 3 * [length], 6 * [length**2]])
        root = np.eye(10)
        if information is not None:
            root = information_root(information, standard_jacobian(center) * scale)

        # A violation of 1e-10 must cost a change of 1e-10, not one of the solver's tolerance: the
        # change is measured in units of the violation, and the constraint is scaled by congruence
        # (which keeps definiteness) so that every eigenvalue of the estimate counts as one.
        values, axes = np.linalg.eigh(standard_to_pseudo_inertia(center / scale))
        violation = max(-values[0], 1e-14 * np.abs(values).max())
        congruence = axes / np.sqrt(np.maximum(np.abs(values), violation))
        directions = [center / scale, *(violation * np.eye(10))]
        matrices = [
            congruence.T @ standard_to_pseudo_inertia(phi) @ congruence for phi in directions
        ]
        # A body to be simulated has some mass: a thousandth of the estimate's magnitude.
        least = (1e-3 - center[0] / scale[0]) / violation if self.mass < 0 else -np.inf
        change = least_change(root, [(matrix + matrix.T) / 2 for matrix in matrices], least)
        solution = center + scale * violation * change
        return InertialParameters.from_standard_vector(solution)._inside_the_limits()

    def _inside_the_limits(self) -> "InertialParameters":
        """Clear the solver's tolerance and rounding: the least move to a strictly valid body."""
        inertia = self.I_TTcm_C
        second_moment = np.trace(inertia) / 2 * np.eye(3) - inertia
        values, axes = np.linalg.eigh(second_moment)
        # Drake checks about other points too, where m|c|² adds to the rounding.
        size = np.abs(values).max() + self.mass * self.p_CTcm_C @ self.p_CTcm_C
        values = np.maximum(values, 1e-12 * size)
        second_moment = axes @ np.diag(values) @ axes.T
        inertia = np.trace(second_moment) * np.eye(3) - second_moment
        return InertialParameters(self.mass, self.p_CTcm_C, (inertia + inertia.T) / 2)

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
