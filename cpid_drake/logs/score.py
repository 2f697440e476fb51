"""Compares the quantities of a log with each other: the score of the conventions it is read with.

Positions are compared with rates, the attitude with the angular velocity, and the motion of the
base with the conservation of momentum, with the target that explains it best. Each comparison is a
residual relative to the motion: near 0 if the log is read in the right conventions, near 1 if not.

Without external forces, the centre of mass of all bodies moves at a constant velocity. With the
share μ of the target in the total mass, its first moment h' about C's origin in units of the total
mass, and the vectors k and c in W from B's origin to the spacecraft's centre of mass and to C,

    p_WBo = a₀ + a₁ t + a₂ t² − (1 − μ) k − μ c − R_WC h'.

This is linear in μ, h' and the a, where a₂ is the effect of a constant force. It remains so for the
position p_WBo + R_WB d of another point of the base, and its derivative is linear in the same
unknowns. The angular momentum about the centre of mass is linear in the target, too
(`conserved`), whose first four unknowns are μ and h' times the known mass: one target must
explain both.

Source: Ning et al. 2016, Eqs. 5 and 9.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.momentum import MomentumSamples, momentum_samples
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import tensor_to_vector, vector_to_tensor
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.rows import conserved
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.instants import Instants
from cpid_drake.logs.noise_estimation import RESOLUTION

MOMENTUM = "momentum"
"""Name of the comparison with the conservation of momentum."""

WORSE = 1.5
"""Ratio of residuals above which one of a few possible conventions is right, and another wrong."""

_MODEL_ERROR = 0.02  # share of the total mass by which errors of the model make a mass impossible
_OPEN = 1e100  # σ of a number that rows leave open
_LEAST = 1e-9  # smallest motion [rad, m, rad/s, m/s]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two sides that are equal in the right conventions.

    Attributes:
        name: of the quantity: "q:<joint>", "position", "attitude" or `MOMENTUM`.
        sides: what the two sides are, in words.
        values: (N, k) each, at the common instants.
        residual: their difference relative to the larger one.
        delay: how much later the first side is by its stamps [s]; 0 if that explains nothing.
        residual_without: the residual without this delay.

    """

    name: str
    sides: tuple[str, str]
    values: tuple[Array, Array]
    residual: float
    delay: float = 0.0
    residual_without: float = 0.0

    @property
    def text(self) -> str:
        """How much the sides differ, and by which delay they differ less."""
        first, second = self.sides
        text = f"{first} and {second} differ by {self.residual:.2%} of the motion"
        if not self.delay:
            return text
        order = "later" if self.delay > 0 else "earlier"
        clocks = f"{1e3 * abs(self.delay):.0f} ms {order} than those of {second}"
        less = f"{self.residual_without:.2%}"
        return f"{text}, but by {less} if the stamps of {self.name} are {clocks}"


def compare_rates(given: Instants, names: tuple[str, ...]) -> list[Comparison]:
    """Return the comparisons of positions that move with measured rates."""
    comparisons, values = [], given.values
    for k, joint in enumerate(names if "joint_rates" in values else ()):
        if {f"encoders {joint}", f"joint_rates {joint}"} <= given.moving:
            sides = given.rates["encoders"][:, [k]], values["joint_rates"][:, [k]]
            comparisons.append(_compared(f"q:{joint}", f"qd:{joint}", *sides))
    if {"position", "velocity"} <= given.moving:
        sides = given.rates["position"], values["velocity"]
        comparisons.append(_compared("position", "velocity", *sides))
    turning = given.turning
    if turning is not None and {"attitude", "gyro"} <= given.moving:
        sides = turning, values["gyro"]
        comparisons.append(_compared("attitude", "angular velocity", *sides))
    return comparisons


def compare_momentum(given: Instants, tree: KinematicTree | None) -> list[Comparison]:
    """Return the comparison with the conservation of momentum, if one is possible."""
    explained = explain_by_momentum(given, tree)
    return [] if explained is None else [explained.comparison]


def momentum_of(given: Instants, tree: KinematicTree) -> MomentumSamples:
    """Return the momentum samples of a motion in which the base's origin rests at zero."""
    count, q = len(given.time), given.values["encoders"]
    zeros, turning = np.zeros((count, 3)), given.values.get("gyro", given.turning)
    still = Motion(
        tuple(map(str, range(q.shape[1]))),
        np.arange(count, dtype=float),
        quaternion_WB=given.quaternion / np.linalg.norm(given.quaternion, axis=1, keepdims=True),
        p_WB=zeros,
        w_WB=zeros if turning is None else rotate(given.R_WB, turning),
        v_WB=zeros,
        q=q,
        qdot=given.values.get("joint_rates", given.rates["encoders"]),
    )
    return momentum_samples(tree, still)


class Explained(NamedTuple):
    """What the conservation of momentum with the best target leaves of a log.

    Attributes:
        comparison: its residual is the geometric mean of those of the base's motion and of its
            rotation, and at least 1 if no target with its mass or inertia, or no point near the
            base, can exist.
        point_B: (3,) place of the point in B [m].
        reach: the reach of the arm [m].

    """

    comparison: Comparison
    point_B: Array
    reach: float


def explain_by_momentum(
    given: Instants, tree: KinematicTree | None, *, has_free_point: bool = False
) -> Explained | None:
    """Return what the conservation of momentum with the best target leaves of a log.

    With a free point, the positions may be those of another point than B's origin.

    It is None if nothing moves, or nothing can be compared.
    """
    is_tilted = tree is not None and tree.normal_B is not None and tree.normal_C is None
    # On a table, the centre of mass of a craft that is not planar may rise.
    if tree is None or is_tilted or not (given.moving and given.is_free):
        return None
    samples, has_spin = momentum_of(given, tree), tree.normal_B is None
    reach = float(np.linalg.norm(samples.motion.p_WC, axis=1).max())
    y = given.values.get("position", given.values.get("velocity"))
    of_turning, *of_centre = conserved(samples)
    shift = None
    if y is not None and "attitude" in given.values:
        shift = _linear(given, of_centre, y, has_free_point)
    parts, drift = [], np.empty((0, 0)) if shift is None else shift[1]
    count = 3 if has_spin and "attitude" in given.values else 0
    if shift is not None:
        T, _, b, size = shift
        parts.append((np.hstack([T, np.zeros((len(b), 6 + count)), drift]), b, size))
    if has_spin:  # the plane has too few equations
        # A ψ − b = L, which is constant; without attitudes, only zero is
        A, b = of_turning[..., :10].reshape(-1, 10), of_turning[..., 10]
        size = _rms(b - b.mean(axis=0) if count else b)
        N = np.tile(-np.eye(3)[:, :count], (len(b), 1))
        nothing = np.zeros((len(A), drift.shape[1]))
        parts.append((np.hstack([A, N, nothing]), b.ravel(), size))
    if not parts:
        return None
    # What each part leaves alone is its noise, by which both together are weighed.
    alone = [_least_squares(A, b) for A, b, _ in parts]
    noise = [max(_rms(a[1]), RESOLUTION * p[2], 1e-300) for a, p in zip(alone, parts)]
    A, b = (np.concatenate([p[k] / sigma for p, sigma in zip(parts, noise)]) for k in (0, 1))
    together = _least_squares(A, b)
    errors = np.split(together[1], [len(parts[0][1])])
    left = [
        max(_rms(e) * sigma / max(size, 1e-300), RESOLUTION)
        for e, sigma, (*_, size) in zip(errors, noise, parts)
    ]
    is_possible, point_B = not has_spin or _has_inertia(*together[::2], tree), np.zeros(3)
    for x, _, root in (*alone, together):
        share = x[0] / samples.mass
        margin = 3 * np.sqrt(root[0] @ root[0]) / samples.mass + _MODEL_ERROR
        is_possible &= bool(-margin < share < 1 + margin)
    if has_free_point and "position" in given.values and shift is not None:
        point_B = together[0][-3:]
        is_possible &= bool(np.linalg.norm(point_B) < 2 * reach + 1.0)
    values = (np.empty((0, 3)), np.empty((0, 3)))
    if shift is not None and y is not None:
        values = (y, y - noise[0] * errors[0].reshape(y.shape))
    residual = float(np.exp(np.mean(np.log(left))))
    residual = residual if is_possible else max(residual, 1.0)
    sides = "motion of the base", "motion that the conservation of momentum allows"
    return Explained(Comparison(MOMENTUM, sides, values, residual), point_B, reach)


def _linear(
    given: Instants, of_centre: Sequence[Array], y: Array, has_free_point: bool
) -> tuple[Array, Array, Array, float] | None:
    """Return rows of the positions, or velocities, y: of (μ, μc), of drift and point; y; its size.

    None if nothing moves. `of_centre` are the rows of velocity and place of the centre of mass.
    """
    clock = given.time / max(given.time[-1], 1e-300)
    has_position = "position" in given.values
    powers = [np.ones_like(clock), clock, *([clock**2] if has_position else [])]
    drift = np.stack(powers, axis=1)
    size = _rms(y - drift @ np.linalg.lstsq(drift, y, rcond=None)[0])
    if not size > _LEAST * max(np.abs(y).max(), 1e-3):
        return None
    rows = of_centre[1 if has_position else 0]
    columns = [power[:, None, None] * np.eye(3) for power in powers]
    D = np.concatenate([*columns, *([given.R_WB] if has_free_point and has_position else [])], 2)
    # y + k = D d − A (μ, μc), with the spacecraft's k = −b: the base's origin is at zero in samples
    moved = (y - rows[..., 10]).ravel()
    return -rows[..., :4].reshape(y.size, 4), D.reshape(y.size, -1), moved, size


def _has_inertia(x: Array, root: Array, tree: KinematicTree) -> bool:
    """Return whether the target's inertia I_* may be positive, with errors of noise and model.

    Else the target takes away the spacecraft's inertia, and explains any motion: of joints that
    hardly move, as in a wrong unit, nothing else remains.
    """
    values, vectors = np.linalg.eigh(vector_to_tensor(x[4:10]))
    if values[0] >= 0:
        return True
    # d(vᵀ I v) of the six entries (11, 12, 13, 22, 23, 33), of which the products count twice.
    v = vectors[:, 0]
    weights = tensor_to_vector(np.outer(v, v) * (2.0 - np.eye(3)))
    margin = 3 * float(np.linalg.norm(weights @ root[4:10]))
    margin += _MODEL_ERROR * float(np.trace(tree.at_rest.I_BBcm))
    return bool(values[0] > -margin)


def _least_squares(A: Array, b: Array) -> tuple[Array, Array, Array]:
    """Return the solution x, the residuals, and a root C of the covariance C Cᵀ of x.

    Of directions that the rows leave open, x is zero and σ is `_OPEN`.
    """
    scale = np.linalg.norm(A, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    U, s, Vt = np.linalg.svd(A / scale, full_matrices=False)
    kept = s > 1e-7 * s[0]
    x = (Vt[kept].T / s[kept] @ (U[:, kept].T @ b)) / scale
    error = b - A @ x
    noise = _rms(error) * np.sqrt(b.size / max(b.size - A.shape[1], 1))
    determined, free = noise * Vt[kept].T / s[kept], _OPEN * (np.abs(Vt[~kept]) > 1e-6).T
    return x, error, np.concatenate([determined, free], axis=1) / scale[:, None]


def _compared(name: str, rate: str, moved: Array, measured: Array) -> Comparison:
    size = max(np.sum(moved**2), np.sum(measured**2), 1e-300)
    residual = max(float(np.sqrt(np.sum((moved - measured) ** 2) / size)), RESOLUTION)
    return Comparison(name, (f"changes of {name}", rate), (moved, measured), residual)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
