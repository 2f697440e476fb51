"""Mass distributions: moments, and vectors of a target's ten inertial parameters.

Three vectors hold the same ten numbers. Only the functions of this module convert between them:

- **parameters** π = (m, c, Ixx, Iyy, Izz, Ixy, Ixz, Iyz): what is reported;
- **eq18** θ = (1/m, c, I11, I12, I13, I22, I23, I33): the unknowns of Ning et al. 2016, Eq. 18;
- **standard** φ = (m, h, J11, J12, J13, J22, J23, J33), h = m c: the pseudo-inertia
  and the target's momentum are linear in it.

Here c is `p_CTcm_C` (target's centre of mass Tcm from the capture point, in the capture frame C)
[m], I is `I_TTcm_C` (about Tcm, in C) and J is `I_TC_C` (about C's origin, in C) [kg·m²]. Products
of inertia are tensor entries: I12 = −∫xy dm.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.array import Array

PARAMETER_NAMES = ("m", "cx", "cy", "cz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""Names of the entries of the parameter vector π, in its order."""

PARAMETER_UNITS = ("kg", "m", "m", "m", *("kg·m²" for name in PARAMETER_NAMES if "I" in name))
"""Units of the entries of the parameter vector π, in its order."""

SCALE_LENGTH = 0.5
"""Length to which errors of the centre of mass are compared in campaigns and plans [m]."""

_ROW, _COLUMN = np.triu_indices(3)
REPORT_ORDER = np.array([0, 3, 5, 1, 2, 4])  # (11, 12, 13, 22, 23, 33) -> (xx, yy, zz, xy, xz, yz)
TENSOR_ORDER = np.argsort(REPORT_ORDER)


def tensor_to_vector(tensor: ArrayLike) -> Array:
    """Return [I#] = (I11, I12, I13, I22, I23, I33) of symmetric (..., 3, 3) tensors.

    Source: Ning et al. 2016, Eq. 12.
    """
    return np.asarray(tensor, dtype=float)[..., _ROW, _COLUMN]


def vector_to_tensor(vector: ArrayLike) -> Array:
    """Return the symmetric (..., 3, 3) tensors of vectors (I11, I12, I13, I22, I23, I33).

    Source: Ning et al. 2016, Eq. 13.
    """
    vector = np.asarray(vector, dtype=float)
    tensor = np.empty((*vector.shape[:-1], 3, 3))
    tensor[..., _ROW, _COLUMN] = vector
    tensor[..., _COLUMN, _ROW] = vector
    return tensor


UNIT_TENSORS = vector_to_tensor(np.eye(6))[REPORT_ORDER]
"""(6, 3, 3) the symmetric tensors with one entry: xx, yy, zz, xy, xz, yz."""


def point_mass_moments(mass: ArrayLike, p: Array) -> Array:
    """Return [#] of m (|p|² 1 − p pᵀ) (..., 6): inertias about the origin of masses at p (..., 3).

    By the parallel-axis theorem it is also the change of a body's inertia from its centre of mass
    to a point that is p away. Entries that do not depend on an unknown coordinate (NaN) are known.
    """
    x, y, z = np.moveaxis(p, -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    moments = np.stack([yy + zz, -x * y, -x * z, xx + zz, -y * z, xx + yy], axis=-1)
    return np.asarray(np.asarray(mass)[..., None] * moments)


def point_mass_inertia(mass: ArrayLike, p: ArrayLike) -> Array:
    """Return the same as tensors (..., 3, 3)."""
    return vector_to_tensor(point_mass_moments(mass, np.asarray(p, dtype=float)))


def second_moment(inertia: Array) -> Array:
    """Return Σ = ∫ r rᵀ dm = ½ tr(I) 1 − I (..., 3, 3) of inertias I about the same point.

    Source: Wensing et al. 2018.
    """
    return _spheres(inertia) / 2 - inertia


def inertia_of_second_moment(sigma: Array) -> Array:
    """Return I = tr(Σ) 1 − Σ (..., 3, 3) of second moments: the inverse of `second_moment`."""
    return _spheres(sigma) - sigma


def _spheres(tensors: Array) -> Array:
    """Return tr(T) 1 (..., 3, 3) of tensors T (..., 3, 3)."""
    return np.asarray(np.trace(tensors, axis1=-2, axis2=-1)[..., None, None] * np.eye(3))


def moved_moments(mass: ArrayLike, I_cm: Array, R: Array, p: Array) -> tuple[Array, Array]:
    """Return first moments (..., 3) and inertias (..., 3, 3) about another frame's origin, in it.

    Args:
        mass: (...) [kg].
        I_cm: (..., 3, 3) inertia about the centre of mass, in the body's frame [kg·m²].
        R: (..., 3, 3) attitude of the body's frame in the other.
        p: (..., 3) centre of mass from the other frame's origin [m].

    """
    turned = R @ I_cm @ np.swapaxes(R, -1, -2)
    return np.asarray(mass)[..., None] * p, turned + point_mass_inertia(mass, p)


def parameter_scale(parameters: Array, length: float | None = None) -> Array:
    """Return the scale (10,) of errors of π: m for m, a length for c, the trace of I for I.

    Args:
        parameters: (10,) π of a body with a positive mass and trace of I.
        length: scale of the centre of mass [m]; default: the radius of gyration √(tr I / 2m).

    """
    mass, trace = parameters[0], parameters[4:7].sum()
    radius = np.sqrt(trace / 2 / mass) if length is None else length
    return np.array([mass, *3 * [radius], *6 * [trace]])


def eq18_to_parameters(theta: ArrayLike) -> Array:
    """Return π (..., 10) of Eq. 18 vectors θ (..., 10). An entry that is NaN remains NaN."""
    theta = np.asarray(theta)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = [1 / theta[..., :1], theta[..., 1:4], theta[..., 4:][..., REPORT_ORDER]]
    return np.concatenate(parts, axis=-1)


def parameters_to_eq18(parameters: ArrayLike) -> Array:
    """Return the Eq. 18 vector θ (..., 10) of π (..., 10); inverse of `eq18_to_parameters`."""
    parameters = np.asarray(parameters, dtype=float)
    moments = parameters[..., 4:][..., TENSOR_ORDER]
    with np.errstate(divide="ignore"):
        return np.concatenate([1 / parameters[..., :1], parameters[..., 1:4], moments], axis=-1)


def standard_to_parameters(phi: ArrayLike) -> Array:
    """Return π (..., 10) of standard vectors φ. An entry of π that depends on a NaN is NaN."""
    phi = np.asarray(phi)
    mass = phi[..., :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        com = phi[..., 1:4] / mass
        moments = phi[..., 4:] - point_mass_moments(mass[..., 0], com)
    return np.concatenate([mass, com, moments[..., REPORT_ORDER]], axis=-1)


def parameters_to_standard(parameters: ArrayLike) -> Array:
    """Return the standard vector φ (..., 10) of π (..., 10); see `standard_to_parameters`."""
    parameters = np.asarray(parameters)
    mass, com = parameters[..., :1], parameters[..., 1:4]
    moments = parameters[..., 4:][..., TENSOR_ORDER] + point_mass_moments(mass[..., 0], com)
    return np.concatenate([mass, mass * com, moments], axis=-1)


def standard_to_relative(phi: Array, known_mass: float) -> Array:
    """Return ψ = (μ, μc, I_*) (..., 10) of φ (..., 10); see `relative_parameterization`."""
    total = known_mass + phi[..., :1]
    moments = phi[..., 4:] - point_mass_moments(1 / total[..., 0], phi[..., 1:4])
    return np.concatenate([known_mass / total * phi[..., :4], moments], axis=-1)


def standard_to_pseudo_inertia(phi: Array) -> Array:
    """Return the pseudo-inertias [½tr(J)1 − J, h; hᵀ, m] (..., 4, 4) of standard vectors."""
    pseudo = np.empty((*phi.shape[:-1], 4, 4))
    pseudo[..., :3, :3] = second_moment(vector_to_tensor(phi[..., 4:]))
    pseudo[..., :3, 3] = pseudo[..., 3, :3] = phi[..., 1:4]
    pseudo[..., 3, 3] = phi[..., 0]
    return pseudo


@dataclass(frozen=True)
class Parameterization:
    """A vector of ten unknowns in which a row family is linear, and its conversion to π.

    `entries` says in the names of parameters what each unknown stands for: the reduced mass for m.
    In the first `bent` unknowns π is not linear; the first one alone gives the `mass`, infinite at
    a pole. `to_parameters` and `from_parameters` take vectors (..., 10), the first also complex
    ones.
    """

    name: str
    entries: tuple[str, ...]
    bent: int
    mass: Callable[[float], float]
    to_parameters: Callable[[ArrayLike], Array]
    from_parameters: Callable[[ArrayLike], Array]

    def jacobian(self, vector: ArrayLike) -> Array:
        """Return ∂π/∂vector (..., 10, 10), by complex steps: exact up to rounding."""
        step = 1e-30
        steps = np.asarray(vector)[..., None, :] + 1j * step * np.eye(10)
        return np.swapaxes(np.imag(self.to_parameters(steps)), -1, -2) / step

    def covariance(self, vector: Array, root: Array) -> Array:
        """Return the covariance (10, 10) of π, to second order in normal errors of the vector.

        With π = J x + ½ xᵀ H x for normal errors x of unit covariance, it is J Jᵀ + ½ tr(H_i H_j):
        what is known of all ten together is bent by as much as the mass is not known. Parameters
        that are not finite have zero.

        Args:
            vector: the unknowns; NaN where not known.
            root: (10, k) a square root of their covariance, root rootᵀ; zero where not known. If it
                is not finite, no entry of the result is.

        """
        if not np.isfinite(root).all():
            return np.full((10, 10), np.nan)
        n = self.bent
        P = root[:n] @ root[:n].T
        step = 1e-4 * np.sqrt(P.diagonal()) + 1e-300
        points = np.tile(vector, (2 * n + 1, 1))
        points[1 : n + 1, :n] += np.diag(step)
        points[n + 1 :, :n] -= np.diag(step)
        J = self.jacobian(points)
        J[np.isnan(J)] = 0.0
        # H_i P for each parameter i, with H in the unknowns in which π is bent.
        H = (J[1 : n + 1, :, :n] - J[n + 1 :, :, :n]) / (2 * step[:, None, None])
        HP = H.transpose(1, 0, 2) @ P
        bends = HP.reshape(10, -1) @ HP.transpose(0, 2, 1).reshape(10, -1).T
        first = J[0] @ root
        return np.asarray(first @ first.T + bends / 2)


_MOMENTS = ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
EQ18 = Parameterization(
    "eq18",
    ("1/m", "cx", "cy", "cz", *_MOMENTS),
    1,
    lambda inverse: 1 / inverse if inverse else np.inf,
    eq18_to_parameters,
    parameters_to_eq18,
)
STANDARD = Parameterization(
    "standard",
    ("m", "m·cx", "m·cy", "m·cz", *(f"{name} about C" for name in _MOMENTS)),
    4,
    float,
    standard_to_parameters,
    parameters_to_standard,
)


def relative_parameterization(known_mass: float) -> Parameterization:
    """Return the unknowns (μ, μc, I_*) of the relative rows, for a spacecraft of this mass [kg].

    μ = m_k m/(m_k + m) is the reduced mass and I_* = I + μ (cᵀc 1 − c cᵀ): the standard vector of
    a body of mass μ in the target's place.
    """

    def to_parameters(psi: ArrayLike) -> Array:
        parameters = standard_to_parameters(psi)
        with np.errstate(divide="ignore", invalid="ignore"):
            parameters[..., 0] *= known_mass / (known_mass - parameters[..., 0])
        return parameters

    def from_parameters(parameters: ArrayLike) -> Array:
        return standard_to_relative(parameters_to_standard(parameters), known_mass)

    entries = ("m", "m·cx", "m·cy", "m·cz", *_MOMENTS)

    def mass(mu: float) -> float:
        return known_mass * mu / (known_mass - mu) if mu != known_mass else np.inf

    return Parameterization("relative", entries, 4, mass, to_parameters, from_parameters)
