"""Motion of the base in many joint motions at once, and what they ask of base and motors.

Without external forces the angular momentum L about the system's centre of mass is constant, and
with ψ the target's relative unknowns and all but L in the base's frame B (`BodyDynamics`),

    ω = J(ψ)⁻¹ (Rᵀ L − h(ψ)),      R' = R ω̃,      p_WB = p_Wcm − R ρ(ψ).

A grid of nodes resolves the joint motions. Heun's method integrates the attitude. All arrays are
node after node, U = N B rows for N nodes and B motions.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.outboard import Outboard
from cpid_drake.dynamics.rotations import cross, exponentials, rotate
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree

BASE_LIMITS = ("base attitude", "base rate", "base displacement")
"""Limits of the base: its rotation [rad], rate [rad/s], displacement of its origin [m]."""

PEAK = 60
"""Exponent p of (Σ xᵖ)^(1/p), the smooth largest value over time: up to 6 % above for 30 nodes."""


@dataclass(frozen=True, eq=False)
class PlannedBaseMotion:
    """Motion of the base in B joint motions with one target, at N nodes.

    Attributes:
        times: (N,) the nodes, equidistant from zero [s].
        dynamics: the spacecraft's bodies at U = N B instants.
        momentum: the total momentum.
        psi: (10,) the target's relative unknowns.
        mobility: (U, 3, 3) J(ψ)⁻¹, in B.
        R: (U, 3, 3) attitude of B in W; the identity at the start.
        w: (U, 3) angular velocity, in B [rad/s].

    """

    times: Array
    dynamics: BodyDynamics
    momentum: TotalMomentum
    psi: Array
    mobility: Array
    R: Array
    w: Array

    @classmethod
    def of(
        cls, times: Array, dynamics: BodyDynamics, momentum: TotalMomentum, psi: Array
    ) -> "PlannedBaseMotion":
        """Integrate the attitude.

        Raises:
            InputError: the system's inertia is not positive definite for this target.

        """
        N, L, step = len(times), momentum.L_WScm_W, times[1]
        inverse = dynamics.mobility(psi)
        mobility = inverse.reshape(N, -1, 3, 3)
        h = dynamics.momentum_at_rest(psi).reshape(N, -1, 3)
        R, w = np.empty_like(mobility), np.empty_like(h)
        R[0] = np.eye(3)
        for k in range(N):
            w[k] = rotate(mobility[k], L @ R[k] - h[k])
            if k + 1 < N:
                ahead = R[k] @ exponentials(step * w[k]) if L.any() else R[k]
                later = rotate(mobility[k + 1], L @ ahead - h[k + 1])
                R[k + 1] = R[k] @ exponentials(step / 2 * (w[k] + later))
        return cls(times, dynamics, momentum, psi, inverse, R.reshape(-1, 3, 3), w.reshape(-1, 3))

    def by_node(self, values: Array) -> Array:
        """Return values (U, ...) as (N, B, ...)."""
        return values.reshape(len(self.times), -1, *values.shape[1:])

    def displacement(self) -> Array:
        """Return the displacement (N, B, 3) of the base's origin from the start, in W [m]."""
        from_base = self.by_node(rotate(self.R, self.dynamics.com(self.psi)))
        drift = self.times[:, None, None] * self.momentum.v_WScm_W
        return np.asarray(drift + from_base[0] - from_base)

    def lengths(self) -> dict[str, Array]:
        """Return what `BASE_LIMITS` names, (N, B) each."""
        cosine = (np.trace(self.R, axis1=1, axis2=2) - 1) / 2
        values = (
            self.by_node(np.arccos(np.clip(cosine, -1.0, 1.0))),
            self.by_node(np.linalg.norm(self.w, axis=1)),
            np.linalg.norm(self.displacement(), axis=2),
        )
        return dict(zip(BASE_LIMITS, values, strict=True))

    def efforts(self, tree: KinematicTree, samples: Array, phi: Array) -> Array:
        """Return the efforts (N, B, J) of the joints [N·m or N]; see `Outboard.efforts`.

        A spline through the nodes gives the rates of the momenta.

        Args:
            tree: the spacecraft model.
            samples: (N, B, 2, J) positions and rates.
            phi: (10,) the target's standard vector.

        """
        q, qdot = np.moveaxis(samples.reshape(-1, *samples.shape[2:]), 1, 0)
        v = -(cross(self.w, self.dynamics.com(self.psi)) + self.dynamics.com_rate(self.psi))
        outboard = Outboard.at(tree.with_target(phi), q, qdot, self.w, v)
        derivative = CubicSpline(self.times, np.eye(len(self.times)))(self.times, 1)
        momentum = outboard.momentum
        rate = derivative @ momentum.reshape(len(momentum), len(self.times), -1)
        return self.by_node(outboard.efforts(rate.reshape(momentum.shape)))


def smooth_peak(values: Array) -> Array:
    """Return a smooth upper bound (...) of the largest of values ≥ 0 (N, ...)."""
    scale = values.max(axis=0) + 1e-12
    return np.asarray(scale * np.sum((values / scale) ** PEAK, axis=0) ** (1 / PEAK))


def known_instants(tree: KinematicTree, samples: Array) -> BodyDynamics:
    """Return the spacecraft's bodies at positions and rates (N, B, 2, J), U = N B instants."""
    flat = samples.reshape(-1, *samples.shape[2:])
    return BodyDynamics.at(tree, flat[:, 0], flat[:, 1])
