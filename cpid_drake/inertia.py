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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from cpid_drake.errors import InputError

PARAMETER_NAMES = ("m", "cx", "cy", "cz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""Names of the entries of the parameter vector π, in its order."""

PARAMETER_UNITS = ("kg", "m", "m", "m") + 6 * ("kg·m²",)
"""Units of the entries of the parameter vector π, in its order."""

_ROW, _COLUMN = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])
_REPORT_ORDER = np.array([0, 3, 5, 1, 2, 4])  # (11, 12, 13, 22, 23, 33) -> (xx, yy, zz, xy, xz, yz)
_TENSOR_ORDER = np.argsort(_REPORT_ORDER)

# Rounding in the arithmetic of a few hundred operations; not a physical tolerance.
_ROUNDING = 1e-14


def tensor_to_vector(tensor: ArrayLike) -> NDArray[np.float64]:
    """Return [I#] = (I11, I12, I13, I22, I23, I33) of symmetric (..., 3, 3) tensors.

    Source: Ning et al. 2016, Eq. 12.
    """
    return np.asarray(tensor, dtype=float)[..., _ROW, _COLUMN]


def vector_to_tensor(vector: ArrayLike) -> NDArray[np.float64]:
    """Return the symmetric (..., 3, 3) tensors of vectors (I11, I12, I13, I22, I23, I33).

    Source: Ning et al. 2016, Eq. 13.
    """
    vector = np.asarray(vector, dtype=float)
    tensor = np.empty((*vector.shape[:-1], 3, 3))
    tensor[..., _ROW, _COLUMN] = vector
    tensor[..., _COLUMN, _ROW] = vector
    return tensor


def point_mass_inertia(mass: float, p: ArrayLike) -> NDArray[np.float64]:
    """Return m (|p|² 1 − p pᵀ): the (3, 3) inertia about the origin of a mass [kg] at p [m]."""
    p = np.asarray(p, dtype=float)
    return mass * (p @ p * np.eye(3) - np.outer(p, p))


def eq18_to_parameters(theta: ArrayLike) -> NDArray[np.float64]:
    """Return π (10,) of an Eq. 18 vector θ (10,). NaN stays NaN, entry by entry."""
    theta = np.asarray(theta, dtype=float)
    with np.errstate(divide="ignore"):
        return np.concatenate([1.0 / theta[:1], theta[1:4], theta[4:][_REPORT_ORDER]])


def parameters_to_eq18(parameters: ArrayLike) -> NDArray[np.float64]:
    """Return the Eq. 18 vector θ (10,) of π (10,); the inverse of `eq18_to_parameters`."""
    parameters = np.asarray(parameters, dtype=float)
    with np.errstate(divide="ignore"):
        return np.concatenate([1 / parameters[:1], parameters[1:4], parameters[4:][_TENSOR_ORDER]])


def standard_to_parameters(phi: ArrayLike) -> NDArray[np.float64]:
    """Return π (10,) of a standard vector φ (10,). NaN where an entry it depends on is NaN."""
    phi = np.asarray(phi, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        com = phi[1:4] / phi[0]
        moments = tensor_to_vector(vector_to_tensor(phi[4:]) - point_mass_inertia(phi[0], com))
    return np.concatenate([phi[:1], com, moments[_REPORT_ORDER]])


def parameters_to_standard(parameters: ArrayLike) -> NDArray[np.float64]:
    """Return the standard vector φ (10,) of π (10,); the inverse of `standard_to_parameters`."""
    parameters = np.asarray(parameters, dtype=float)
    mass, com = parameters[0], parameters[1:4]
    shift = tensor_to_vector(point_mass_inertia(mass, com))
    return np.concatenate([[mass], mass * com, parameters[4:][_TENSOR_ORDER] + shift])


def standard_to_pseudo_inertia(phi: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (4, 4) pseudo-inertia [½tr(J)1 − J, h; hᵀ, m] of a standard vector (10,)."""
    inertia = vector_to_tensor(phi[4:])
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    pseudo[:3, 3] = pseudo[3, :3] = phi[1:4]
    pseudo[3, 3] = phi[0]
    return pseudo


def pseudo_inertia_to_standard(pseudo: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard vector (10,) of a (4, 4) pseudo-inertia; both are linear in the other."""
    second_moment = pseudo[:3, :3]
    inertia = np.trace(second_moment) * np.eye(3) - second_moment
    return np.concatenate([[pseudo[3, 3]], pseudo[:3, 3], tensor_to_vector(inertia)])


def eq18_jacobian(theta: ArrayLike) -> NDArray[np.float64]:
    """Return ∂π/∂θ (10, 10) at an Eq. 18 vector θ (10,)."""
    theta = np.asarray(theta, dtype=float)
    jacobian = np.zeros((10, 10))
    jacobian[0, 0] = -1.0 / theta[0] ** 2
    jacobian[1:4, 1:4] = np.eye(3)
    jacobian[4 + np.arange(6), 4 + _REPORT_ORDER] = 1.0
    return jacobian


def standard_jacobian(phi: ArrayLike) -> NDArray[np.float64]:
    """Return ∂π/∂φ (10, 10) at a standard vector φ (10,)."""
    phi = np.asarray(phi, dtype=float)
    mass, h = phi[0], phi[1:4]
    jacobian = np.zeros((10, 10))
    jacobian[0, 0] = 1.0
    jacobian[1:4, 0] = -h / mass**2
    jacobian[1:4, 1:4] = np.eye(3) / mass
    # I = J − (|h|² 1 − h hᵀ)/m
    jacobian[4:, 0] = tensor_to_vector(point_mass_inertia(1.0, h) / mass**2)[_REPORT_ORDER]
    for k, unit in enumerate(np.eye(3)):
        derivative = 2 * h[k] * np.eye(3) - np.outer(unit, h) - np.outer(h, unit)
        jacobian[4:, 1 + k] = tensor_to_vector(-derivative / mass)[_REPORT_ORDER]
    jacobian[4 + np.arange(6), 4 + _REPORT_ORDER] = 1.0
    return jacobian


@dataclass(frozen=True)
class UnknownVector:
    """A vector of ten that some row family is linear in, and its way back to the parameters π."""

    name: str
    entries: tuple[str, ...]
    to_parameters: Callable[[ArrayLike], NDArray[np.float64]]
    from_parameters: Callable[[ArrayLike], NDArray[np.float64]]
    jacobian: Callable[[ArrayLike], NDArray[np.float64]]


_TENSOR_ENTRIES = ("11", "12", "13", "22", "23", "33")
EQ18 = UnknownVector(
    "eq18",
    ("1/m", "cx", "cy", "cz", *("I" + ij for ij in _TENSOR_ENTRIES)),
    eq18_to_parameters,
    parameters_to_eq18,
    eq18_jacobian,
)
STANDARD = UnknownVector(
    "standard",
    ("m", "m·cx", "m·cy", "m·cz", *("J" + ij for ij in _TENSOR_ENTRIES)),
    standard_to_parameters,
    parameters_to_standard,
    standard_jacobian,
)


def relative_unknowns(known_mass: float) -> UnknownVector:
    """Return the unknowns (μ, μc, I_*) of the relative rows, for known bodies of this mass [kg].

    μ = m_k m/(m_k + m) is the reduced mass and I_* = I + μ (|c|² 1 − c cᵀ): the standard vector of
    a body of mass μ in the target's place.
    """

    def to_parameters(psi: ArrayLike) -> NDArray[np.float64]:
        parameters = standard_to_parameters(psi)
        with np.errstate(divide="ignore"):
            parameters[0] *= known_mass / (known_mass - parameters[0])
        return parameters

    def from_parameters(parameters: ArrayLike) -> NDArray[np.float64]:
        parameters = np.array(parameters, dtype=float)
        parameters[0] *= known_mass / (known_mass + parameters[0])
        return parameters_to_standard(parameters)

    def jacobian(psi: ArrayLike) -> NDArray[np.float64]:
        result = standard_jacobian(psi)
        result[0] *= (known_mass / (known_mass - np.asarray(psi)[0])) ** 2
        return result

    entries = ("μ", "μ·cx", "μ·cy", "μ·cz", *("I*" + ij for ij in _TENSOR_ENTRIES))
    return UnknownVector("relative", entries, to_parameters, from_parameters, jacobian)


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
        inertia = vector_to_tensor(parameters[4:][_TENSOR_ORDER])
        return cls(parameters[0], parameters[1:4], inertia)

    def to_vector(self) -> NDArray[np.float64]:
        """Return π (10,) = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz) [kg, m, kg·m²]."""
        moments = tensor_to_vector(self.I_TTcm_C)[_REPORT_ORDER]
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
            root = _information_root(information, standard_jacobian(center) * scale)

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
        change = _least_change(root, [(matrix + matrix.T) / 2 for matrix in matrices], least)
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


def _least_change(
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


def _information_root(information: ArrayLike, jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
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
