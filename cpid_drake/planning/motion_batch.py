"""Motion of the base for many joint motions at once, on a coarse grid of time.

The likelihood (`estimation.likelihood`) predicts the base's motion for one joint motion on a fine
grid. Its effects and its sensors need only the motion at some instants. Here the instants are those
of B joint motions, time after time, and all arrays may be complex: a step of 1e-20 i along a
parameter of a joint motion then gives the derivative of everything by this parameter without
rounding errors (Squire and Trapp 1998, "Using complex variables to estimate derivatives of real
functions").
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, kron

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.likelihood.attitude_steps import step_angles
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.likelihood.joint_motion import JointPart
from cpid_drake.estimation.likelihood.motion import (
    BaseMotion,
    Trajectory,
    TrajectoryState,
)
from cpid_drake.estimation.likelihood.uniform_spline import (
    UniformSpline,
    cubic_weights,
    step_integrals,
)


@dataclass(frozen=True, eq=False)
class PlannedJoints(JointPart):
    """Joint positions and rates (U, 2, J) of B motions at the nodes, time after time."""

    samples: NDArray[np.float64] = field(kw_only=True)

    @classmethod
    def of(cls, end: float, samples: NDArray[np.float64]) -> "PlannedJoints":
        """Return the joints of motions from t = 0 to `end` [s]; their errors are not modelled."""
        J = samples.shape[-1]
        nothing = np.zeros((0, J))
        rows = np.zeros((J, 0, 0))
        return cls(0.0, end, 1, nothing, rows, nothing.T, samples=samples)

    def evaluate(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions and rates (U, 2, J) at the nodes, whatever the times are."""
        return self.samples


@dataclass(frozen=True, eq=False)
class BatchTrajectory(Trajectory):
    """The base's motion in B joint motions; `R`, `w` and `inverse` are at U = N B instants."""

    motion: "MotionBatch" = field(kw_only=True)

    def rotations(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return R_WB (M, 3, 3) at times (M,), each of them for all B motions."""
        return self.motion.at(times, self.R)


class _Interpolation(UniformSpline):
    """Values (U, 3) at the nodes as a function of time, in the place of a spline."""

    def __init__(self, motion: "MotionBatch", values: NDArray[np.float64]) -> None:
        self._motion, self._values = motion, values

    def __call__(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._motion.at(times, self._values)


class MotionBatch(BaseMotion):
    """Predicts the base's motion for B joint motions without external forces.

    Args:
        tree: the known spacecraft.
        times: (N,) equidistant nodes from zero [s].
        samples: (N, B, 2, J) positions and rates of the joints, real or complex.
        constants: the constant errors.

    Attributes:
        count: B.
        nodes: (U,) time of each instant, U = N B, time after time [s].

    """

    def __init__(
        self,
        tree: KinematicTree,
        times: NDArray[np.float64],
        samples: NDArray[np.float64],
        constants: Constants,
    ) -> None:
        self.tree, self.constants = tree, constants
        self.orbit = self.thrust = None
        self.zeros = np.zeros(1)
        self.count, self._times = samples.shape[1], times
        self.joints = PlannedJoints.of(times[-1], samples.reshape(-1, *samples.shape[2:]))
        self.nodes = np.repeat(times, self.count)
        dynamics = BodyDynamics.at(tree, self.joints.samples[:, 0], self.joints.samples[:, 1])
        self.times, self.dynamics, self.grid = self.nodes, dynamics, dynamics

    def at(self, times: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values (M, ...) at times (M,) of values (U, ...) at the nodes."""
        if len(times) == len(self.nodes) and (times == self.nodes).all():
            return values
        flat = self.interpolation(times) @ values.reshape(len(values), -1)
        return np.asarray(flat).reshape(-1, *values.shape[1:])

    def interpolation(self, times: NDArray[np.float64]) -> csr_array:
        """Return (M, U) weights of the nodes at times (M,), each of them for all B motions."""
        if len(times) == len(self.nodes) and (times == self.nodes).all():
            return self._identity
        weights = cubic_weights(self._times, times[:: self.count])
        return csr_array(kron(weights, eye_array(self.count)))

    @cached_property
    def _identity(self) -> csr_array:
        return csr_array(eye_array(len(self.nodes)))

    def trajectory(self, state: TrajectoryState) -> BatchTrajectory:
        """Integrate the attitude of all motions; see `BaseMotion.trajectory`.

        Raises:
            InputError: the system's inertia is not positive definite for this target.

        """
        dynamics, N, B = self.dynamics, len(self._times), self.count
        inverse, h = dynamics.mobility(state.psi), dynamics.momentum_at_rest(state.psi)
        first = np.broadcast_to(state.attitude.as_matrix(), (B, 3, 3))
        R = np.broadcast_to(first, (N, B, 3, 3)).reshape(-1, 3, 3)
        for _ in range(60 if state.L.any() else 1):
            before, w = R, rotate(inverse, state.L @ R - h)
            R = self._attitudes(first, w.reshape(N, B, 3))
            if np.abs(R - before).max() < 1e-12:
                break
        spline = _Interpolation(self, w)
        return BatchTrajectory(state, R, w, inverse, spline, state.L, None, motion=self)

    def _attitudes(self, first: NDArray[np.float64], w: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the attitudes (U, 3, 3) from angular velocities (N, B, 3) in B."""
        h = self._times[1]
        angle = step_angles(step_integrals(w, h), w, h)
        R = np.empty((*w.shape, 3), np.result_type(first, w))
        R[0] = first
        for k, step in enumerate(_exponentials(angle)):
            np.matmul(R[k], step, out=R[k + 1])
        return R.reshape(-1, 3, 3)

    def pose_change(
        self, trajectory: Trajectory, w: NDArray[np.float64], initial: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Integrate the change of the attitude of all motions; see `BaseMotion.pose_change`."""
        N, B, h = len(self._times), self.count, self._times[1]
        R, n = trajectory.R, w.shape[-1]
        rates = step_integrals((R @ w).reshape(N, B, 3, n), h)
        change = np.empty((N, B, 3, n), rates.dtype)
        change[0] = initial
        if not trajectory.L.any():
            np.cumsum(rates, axis=0, out=change[1:])
            change[1:] += initial
            return change.reshape(-1, 3, n), w
        coupling = trajectory.inverse @ np.swapaxes(R, -1, -2) @ skew(trajectory.L)
        A = (R @ coupling).reshape(N, B, 3, 3)
        left = np.linalg.inv(np.eye(3) - h / 2 * A[1:])
        forward = left @ (np.eye(3) + h / 2 * A[:-1])
        for k, added in enumerate(left @ rates):
            change[k + 1] = forward[k] @ change[k] + added
        xi = change.reshape(-1, 3, n)
        return xi, w + coupling @ xi


def _exponentials(r: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotations (..., 3, 3) of real or complex rotation vectors (..., 3) below 1 rad."""
    square = np.sum(r * r, axis=-1)[..., None, None]
    a, b = np.ones_like(square), np.full_like(square, 0.5)
    term_a, term_b = a, b
    for k in range(1, 7):  # sin(x)/x and (1 − cos x)/x² as series in x²
        term_a = -term_a * square / ((2 * k) * (2 * k + 1))
        term_b = -term_b * square / ((2 * k + 1) * (2 * k + 2))
        a, b = a + term_a, b + term_b
    K = skew(r)
    return np.asarray(np.eye(3) + a * K + b * (K @ K))
