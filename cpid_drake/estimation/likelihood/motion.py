"""Motion of the base as a function of the target and other unknowns, and its derivatives.

The joint motion is given; the base's attitude and position follow from conservation of momentum
(`relative_motion`). Attitude is integrated over a grid of equal steps by the fourth-order Magnus
formula, with angular velocities from a cubic spline. Small changes ξ of the attitude (rotations in
W) obey

    ξ̇ = R J⁻¹ (−Y dψ + Rᵀ dL + Rᵀ (L × ξ)),

so every derivative is available without finite differences. Source: Ning et al. 2016, Eqs. 5 and 9,
about the system's centre of mass.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.relative_motion import RelativeDynamics, relative_dynamics
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.sensing.splines import JointSpline

_STEPS_PER_PIECE = 3.5
"""Grid steps per piece of the joint motion's splines, so that the grid resolves errors of rates."""


@dataclass(frozen=True, eq=False)
class TrajectoryState:
    """All unknowns that determine the base's motion and the readings of its sensors.

    Attributes:
        psi: (10,) relative unknowns (μ, μc, I_*).
        attitude: R_WB at the start.
        p_Wcm: (3,) the system's centre of mass at the start, in W [m].
        v_Wcm: (3,) its velocity [m/s].
        L: (3,) angular momentum about the centre of mass, in W [N·m·s].
        bias: (K, 3) biases of the gyros at K nodes, gyro after gyro [rad/s].

    """

    psi: NDArray[np.float64]
    attitude: Rotation
    p_Wcm: NDArray[np.float64]
    v_Wcm: NDArray[np.float64]
    L: NDArray[np.float64]
    bias: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The base's motion at the nodes of the grid: R (N, 3, 3), w in B (N, 3), and w's spline."""

    state: TrajectoryState
    R: NDArray[np.float64]
    w: NDArray[np.float64]
    spline: CubicSpline

    def rotations(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return R_WB (N, 3, 3) at times between the grid's ends."""
        nodes, integral = self.spline.x, self._integral
        k = np.clip(np.searchsorted(nodes, times, side="right") - 1, 0, len(nodes) - 1)
        step = Rotation.from_rotvec(integral(times) - integral(nodes[k]))
        return np.asarray(self.R[k] @ step.as_matrix())

    @cached_property
    def _integral(self) -> PPoly:
        return self.spline.antiderivative()


@dataclass(frozen=True, eq=False)
class Instants:
    """Times (M,) [s], and the known bodies as seen from the base at these times."""

    times: NDArray[np.float64]
    dynamics: RelativeDynamics

    def com_velocity(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return ω × ρ + ρ' (M, 3): velocity of the centre of mass relative to B's origin, in B."""
        psi = trajectory.state.psi
        w = trajectory.spline(self.times)
        return np.asarray(np.cross(w, self.dynamics.com(psi)) + self.dynamics.com_rate(psi))


class BaseMotion:
    """Predicts the base's motion for one joint motion.

    Args:
        tree: the known spacecraft.
        joints: its joint motion.
        step: longest step of the grid [s]; a joint motion of many pieces makes it shorter.

    """

    def __init__(self, tree: KinematicTree, joints: JointSpline, step: float) -> None:
        self.tree, self.joints = tree, joints
        start, end = joints.basis.knots[0], joints.basis.knots[-1]
        pieces = np.diff(np.unique(joints.basis.knots))
        step = min(step, np.median(pieces) / _STEPS_PER_PIECE)
        self.nodes = np.linspace(start, end, max(int(np.ceil((end - start) / step)), 4) + 1)
        self.grid = self.instants(self.nodes)

    def instants(self, times: NDArray[np.float64]) -> Instants:
        """Return the known bodies' dynamics at times (M,)."""
        samples = self.joints.evaluate(times)
        return Instants(times, relative_dynamics(self.tree, samples[:, 0], samples[:, 1]))

    def trajectory(self, state: TrajectoryState, near: Trajectory | None = None) -> Trajectory:
        """Integrate the base's attitude over the grid.

        Args:
            state: the unknowns.
            near: the trajectory at which the iteration starts if there is momentum; default:
                constant attitude.

        Raises:
            InputError: the system's inertia is not positive definite for this target.

        """
        dynamics = self.grid.dynamics
        J, h = dynamics.inertia(state.psi), dynamics.momentum_at_rest(state.psi)
        if not (np.isfinite(J).all() and (np.linalg.eigvalsh(J)[:, 0] > 0).all()):
            raise InputError("the system's inertia is not positive definite for this target")
        inverse = np.linalg.inv(J)
        if not state.L.any():
            return Trajectory(state, *self._integrate(state.attitude, -rotate(inverse, h)))
        # With momentum the velocity depends on the attitude: iterate until it is constant.
        R = state.attitude.as_matrix() if near is None else near.R
        for _ in range(60):
            before = R
            R, w, spline = self._integrate(state.attitude, rotate(inverse, state.L @ R - h))
            if np.abs(R - before).max() < 1e-12:
                break
        return Trajectory(state, R, w, spline)

    def _integrate(
        self, start: Rotation, w: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], CubicSpline]:
        """Return the attitudes at the nodes, w itself and its spline."""
        spline = CubicSpline(self.nodes, w)
        h = self.nodes[1] - self.nodes[0]
        powers = h ** np.arange(4, 0, -1) / np.arange(4, 0, -1)
        angle = np.tensordot(powers, spline.c, axes=1)  # the integral of w over each step
        a, b = w[:-1].T, w[1:].T
        angle += h**2 / 12 * (a[[1, 2, 0]] * b[[2, 0, 1]] - a[[2, 0, 1]] * b[[1, 2, 0]]).T
        R = np.empty((len(w), 3, 3))
        R[0] = start.as_matrix()
        R[1:] = R[0] @ _products(Rotation.from_rotvec(angle).as_matrix())
        return R, w, spline

    def attitude_change(
        self, trajectory: Trajectory, w: NDArray[np.float64], initial: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Integrate ξ̇ = R (w + J⁻¹Rᵀ(L × ξ)).

        The first term is integrated by cubics through four nodes, the second by the trapezoidal
        rule.

        Args:
            trajectory: the trajectory to linearize about.
            w: (N, 3, n) change of the angular velocity at the nodes at unchanged attitude, in B.
            initial: (3, n) change of the attitude at the start, a rotation in W.

        Returns:
            ξ (N, 3, n), and the total change of the angular velocity (N, 3, n), in B.

        """
        h = self.nodes[1] - self.nodes[0]
        R, L = trajectory.R, trajectory.state.L
        added = _integrals(R @ w, h)
        if not L.any():
            xi = np.zeros_like(w)
            np.cumsum(added, axis=0, out=xi[1:])
            return xi + initial, w
        J = self.grid.dynamics.inertia(trajectory.state.psi)
        coupling = np.linalg.solve(J, np.swapaxes(R, -1, -2) @ skew(L))
        A = R @ coupling
        left = np.linalg.inv(np.eye(3) - h / 2 * A[1:])
        forward = left @ (np.eye(3) + h / 2 * A[:-1])
        added = left @ added
        xi = np.empty_like(w)
        xi[0] = initial
        for k in range(len(forward)):
            xi[k + 1] = forward[k] @ xi[k] + added[k]
        return xi, w + coupling @ xi

    def interpolation(self, times: NDArray[np.float64]) -> csr_array:
        """Return (M, N) weights of the nodes at times (M,): cubics through four nodes."""
        N = len(self.nodes)
        place = (times - self.nodes[0]) / (self.nodes[1] - self.nodes[0])
        first = np.clip(place.astype(int) - 1, 0, N - 4)
        x = (place - first)[:, None] - np.arange(4)
        weights = np.stack(
            [
                x[:, 1] * x[:, 2] * x[:, 3] / -6,
                x[:, 0] * x[:, 2] * x[:, 3] / 2,
                x[:, 0] * x[:, 1] * x[:, 3] / -2,
                x[:, 0] * x[:, 1] * x[:, 2] / 6,
            ],
            axis=1,
        )
        columns = first[:, None] + np.arange(4)
        ends = 4 * np.arange(len(times) + 1)
        return csr_array((weights.ravel(), columns.ravel(), ends), shape=(len(times), N))


def _products(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return S_0, S_0 S_1, S_0 S_1 S_2, … of matrices S (N, 3, 3), in blocks of about √N."""
    N = len(steps)
    size = int(np.ceil(np.sqrt(N)))
    count = -(-N // size)
    result = np.broadcast_to(np.eye(3), (count * size, 3, 3)).copy()
    result[:N] = steps
    blocks = result.reshape(count, size, 3, 3)
    for k in range(1, size):
        blocks[:, k] = blocks[:, k - 1] @ blocks[:, k]
    before = np.eye(3)
    for block in blocks:
        block[:] = before @ block
        before = block[-1].copy()
    return result[:N]


def _integrals(f: NDArray[np.float64], h: float) -> NDArray[np.float64]:
    """Return the integrals (N − 1, ...) of f (N, ...) over each of the steps h."""
    result = np.empty_like(f[1:])
    result[1:-1] = h / 24 * (13 * (f[1:-2] + f[2:-1]) - f[:-3] - f[3:])
    result[0] = h / 24 * (9 * f[0] + 19 * f[1] - 5 * f[2] + f[3])
    result[-1] = h / 24 * (9 * f[-1] + 19 * f[-2] - 5 * f[-3] + f[-4])
    return result
