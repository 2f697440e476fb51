"""What sensors on the base would read, as a function of the target, and its derivatives.

Joint motion is given; base attitude and position follow from conservation (`relative_motion`).
Attitude is integrated over a grid of equal steps, by the fourth-order Magnus formula with angular
velocities from a cubic spline; small changes ξ of it (turned in W) obey

    ξ̇ = R J⁻¹ (−Y dψ + Rᵀ dL + Rᵀ (L × ξ)),

which gives every derivative without differences. Source: Ning et al. 2016, Eqs. 5 and 9, about the
system's centre of mass.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PPoly
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.parameterizations import parameters_to_standard, relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.sensitivity import (
    BodyUncertainty,
    MotionSensitivity,
    body_sensitivity,
    joint_sensitivity,
)
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.splines import JointSpline, measured_by
from cpid_drake.sensing.suite import SensorSuite

BASE_SENSORS = ("attitude", "gyro", "position", "velocity")

_STEPS_A_PIECE = 3.5
"""Of the joint motion's splines: their rates' errors, too, are to be seen on the grid."""


@dataclass(frozen=True, eq=False)
class TrajectoryState:
    """All that the base's motion and its sensors' readings follow from.

    Attributes:
        psi: (10,) relative unknowns (μ, μc, I_*).
        attitude: R_WB at the start.
        p_Wcm: (3,) the system's centre of mass at the start, in W [m].
        v_Wcm: (3,) its velocity [m/s].
        L: (3,) angular momentum about it, in W [N·m·s].
        bias: (K, 3) the gyro's bias at K nodes, linear between them [rad/s].

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
        return self.R[k] @ Rotation.from_rotvec(integral(times) - integral(nodes[k])).as_matrix()

    @cached_property
    def _integral(self) -> PPoly:
        return self.spline.antiderivative()


class TrajectoryModel:
    """Predicts the base's sensors from a target, for one joint motion.

    Args:
        tree: the known spacecraft.
        joints: its joint motion.
        measurements: from its sensors; samples outside the joint motion are left out, and those of
            sensors that the suite lacks.
        suite: how good they are.
        unknown_momentum: whether the momentum is an unknown constant, and not known.
        momentum: (L, v_Wcm), (3,) each, in W: the angular momentum about the system's centre of
            mass and that centre's velocity; of an unknown one, where to start. None for zero.
        psi_prior: mean and σ, (10,) each, of the relative unknowns; None for no prior.
        step: longest step of the grid [s]; a joint motion of many pieces makes it shorter.

    Raises:
        InputError: there is no attitude sensor, or it has no samples in the joint motion.

    """

    def __init__(
        self,
        tree: KinematicTree,
        joints: JointSpline,
        measurements: Measurements,
        suite: SensorSuite,
        *,
        unknown_momentum: bool = False,
        momentum: tuple[ArrayLike, ArrayLike] | None = None,
        psi_prior: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
        step: float = 0.025,
    ) -> None:
        start, end = joints.basis.knots[0], joints.basis.knots[-1]
        self.tree, self.joints, self.suite = tree, joints, suite
        self.measurements = measured_by(suite, measurements).between(start, end)
        self.unknown_momentum, self.psi_prior = unknown_momentum, psi_prior
        L, v_Wcm = (np.zeros(3), np.zeros(3)) if momentum is None else momentum
        self.momentum = np.array(L, dtype=float), np.array(v_Wcm, dtype=float)
        if not len(self.measurements.attitude):
            raise InputError("no attitude samples while the joints are known: none to start from")
        pieces = np.diff(np.unique(joints.basis.knots))
        step = min(step, np.median(pieces) / _STEPS_A_PIECE)
        self.nodes = np.linspace(start, end, max(int(np.ceil((end - start) / step)), 4) + 1)
        self.dynamics = self._dynamics(self.nodes)
        self._position_dynamics = self._dynamics(self.measurements.position.time)
        self._velocity_dynamics = self._dynamics(self.measurements.velocity.time)
        self.sensors = [name for name in BASE_SENSORS if len(getattr(self.measurements, name))]
        self._at = {name: self._interpolation(name) for name in self.sensors}
        self.bias_nodes = self._bias_nodes()
        self.columns = self._layout()

    def _dynamics(self, times: NDArray[np.float64]):
        samples = self.joints.evaluate(times)
        return relative_dynamics(self.tree, samples[:, 0], samples[:, 1])

    def _bias_nodes(self) -> NDArray[np.float64]:
        """One node for a constant bias, else one a second."""
        if "gyro" not in self.sensors:
            return np.empty(0)
        start, end = self.nodes[0], self.nodes[-1]
        if not self.suite.gyro.bias_growth:
            return np.array([start])
        return np.linspace(start, end, int(np.ceil(end - start)) + 1)

    def _layout(self) -> dict[str, slice]:
        """Which columns of the Jacobian belong to what."""
        sizes = {"psi": 10, "attitude": 3}
        if "position" in self.sensors:
            sizes["p_Wcm"] = 3
        if self.unknown_momentum:
            sizes["L"] = 3
            if "position" in self.sensors or "velocity" in self.sensors:
                sizes["v_Wcm"] = 3
        sizes["bias"] = 3 * len(self.bias_nodes)
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(end - n, end) for (name, n), end in zip(sizes.items(), ends)}

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.columns["bias"].stop)

    def start(self, psi: NDArray[np.float64]) -> TrajectoryState:
        """Return a state to start from: the first samples, the momentum given, no bias."""
        attitude = Rotation.from_quat(self.measurements.attitude.value[0], scalar_first=True)
        L, v_Wcm = self.momentum
        state = TrajectoryState(
            psi, attitude, np.zeros(3), v_Wcm, L, np.zeros((len(self.bias_nodes), 3))
        )
        if "position" in self.sensors:
            rho = self.dynamics.com(psi)[0]
            state = replace(state, p_Wcm=self.measurements.position.value[0] + attitude.apply(rho))
        return state

    def moved(self, state: TrajectoryState, change: NDArray[np.float64]) -> TrajectoryState:
        """Return the state after a change (size,) of the unknowns."""
        part = {name: change[columns] for name, columns in self.columns.items()}
        zero = np.zeros(3)
        return TrajectoryState(
            psi=state.psi + part["psi"],
            attitude=Rotation.from_rotvec(part["attitude"]) * state.attitude,
            p_Wcm=state.p_Wcm + part.get("p_Wcm", zero),
            v_Wcm=state.v_Wcm + part.get("v_Wcm", zero),
            L=state.L + part.get("L", zero),
            bias=state.bias + part["bias"].reshape(-1, 3),
        )

    def trajectory(self, state: TrajectoryState, near: Trajectory | None = None) -> Trajectory:
        """Integrate the base's attitude over the grid.

        Args:
            state: what it follows from.
            near: one that is thought to be near: of use with momentum.

        Raises:
            InputError: the system's inertia is not positive definite for this target.

        """
        J, h = self.dynamics.inertia(state.psi), self.dynamics.momentum_at_rest(state.psi)
        if not (np.isfinite(J).all() and (np.linalg.eigvalsh(J)[:, 0] > 0).all()):
            raise InputError("the system's inertia is not positive definite for this target")
        inverse = np.linalg.inv(J)
        if not state.L.any():
            w = -rotate(inverse, h)
            return Trajectory(state, *self._integrate(state.attitude, w))
        # With momentum the velocity depends on the attitude: repeat until it no longer moves.
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
        turn = np.tensordot(powers, spline.c, axes=1)  # its integral over each step
        a, b = w[:-1].T, w[1:].T
        turn += h**2 / 12 * (a[[1, 2, 0]] * b[[2, 0, 1]] - a[[2, 0, 1]] * b[[1, 2, 0]]).T
        R = np.empty((len(w), 3, 3))
        R[0] = start.as_matrix()
        R[1:] = R[0] @ _products(Rotation.from_rotvec(turn).as_matrix())
        return R, w, spline

    # -- residuals and derivatives, whitened ------------------------------------------------------

    def residuals(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return measured minus predicted in units of σ, all sensors, then the priors."""
        state, m = trajectory.state, self.measurements
        parts = []
        for name in self.sensors:
            samples, sigmas = getattr(m, name), self.suite.sigmas(name)
            if name == "attitude":
                predicted = Rotation.from_matrix(trajectory.rotations(samples.time))
                measured = Rotation.from_quat(samples.value, scalar_first=True)
                error = (predicted.inv() * measured).as_rotvec() @ self.suite.attitude.R_BS
            elif name == "gyro":
                bias = self._bias_weights() @ state.bias
                error = samples.value - trajectory.spline(samples.time) - bias
            elif name == "position":
                rho = self._position_dynamics.com(state.psi)
                R = trajectory.rotations(samples.time)
                elapsed = (samples.time - self.nodes[0])[:, None]
                error = samples.value - (state.p_Wcm + state.v_Wcm * elapsed - rotate(R, rho))
            else:
                R = trajectory.rotations(samples.time)
                error = samples.value - state.v_Wcm + rotate(R, self._com_velocity(trajectory))
            parts.append((error / sigmas).ravel())
        if self.psi_prior is not None:
            mean, sigma = self.psi_prior
            parts.append((mean - state.psi) / sigma)
        return np.concatenate([*parts, *self._bias_prior(state.bias)])

    def sample_rows(self) -> NDArray[np.intp]:
        """Return for every row of the residuals which sample it is of; −1 for priors."""
        counts = [len(getattr(self.measurements, name)) for name in self.sensors]
        prior = np.full(3 * len(self.bias_nodes) + 10 * (self.psi_prior is not None), -1)
        return np.concatenate([np.repeat(np.arange(sum(counts)), 3), prior])

    def jacobian(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return the derivative of predicted readings by the unknowns, in units of σ."""
        w, initial = self._unknowns_drive(trajectory)
        com = [
            _padded(dynamics.com_regressor(), self.size)
            for dynamics in (self._position_dynamics, self._velocity_dynamics)
        ]
        rate = _padded(self._velocity_dynamics.com_rate_regressor(), self.size)
        return self._rows(trajectory, w, initial, *com, rate, of_unknowns=True)

    def _unknowns_drive(
        self, trajectory: Trajectory
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Change of the angular velocity at the nodes, and of the first attitude, by unknowns."""
        state = trajectory.state
        Y = self.dynamics.regressor(trajectory.w)
        N, columns = len(self.nodes), self.columns
        force = np.zeros((N, 3, self.size))
        force[:, :, columns["psi"]] = -Y
        if "L" in columns:
            force[:, :, columns["L"]] = np.swapaxes(trajectory.R, -1, -2)
        w = np.linalg.solve(self.dynamics.inertia(state.psi), force)
        initial = np.zeros((3, self.size))
        initial[:, columns["attitude"]] = np.eye(3)
        return w, initial

    def end_change(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return how the attitude at the end, turned in W, changes with the unknowns: (3, size)."""
        w, initial = self._unknowns_drive(trajectory)
        return self._attitude_change(trajectory, w, initial)[0][-1]

    def nuisance(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return the same by errors of the joint motion, each in units of its own σ.

        One column for every coefficient of the joints' splines, made independent of each other by
        the square root of their covariance.
        """
        psi = trajectory.state.psi
        root = np.linalg.cholesky(self.joints.covariance)
        sampled = {}
        for name, times, dynamics in (
            ("nodes", self.nodes, self.dynamics),
            ("position", self.measurements.position.time, self._position_dynamics),
            ("velocity", self.measurements.velocity.time, self._velocity_dynamics),
        ):
            by_q, by_qdot = joint_sensitivity(
                *self._seen_from_base(trajectory, times, dynamics), psi, dynamics
            )
            B, B_dot = self.joints.basis(times) @ root, self.joints.basis(times, 1) @ root
            sampled[name] = MotionSensitivity(
                *(
                    (
                        getattr(by_q, part)[..., None] * B[:, None, None, :]
                        + getattr(by_qdot, part)[..., None] * B_dot[:, None, None, :]
                    ).reshape(len(times), 3, B.shape[1] * by_q.w.shape[2])
                    for part in ("w", "com", "v")
                )
            )
        return self._sensitivity_rows(trajectory, sampled)

    def known_bodies(
        self, trajectory: Trajectory, uncertainty: BodyUncertainty
    ) -> NDArray[np.float64]:
        """Return the same by errors of the known bodies' parameters, each in units of its σ."""
        psi, known = trajectory.state.psi, len(self.tree.bodies)
        sigmas = np.tile(uncertainty.sigmas, known)
        sampled = {}
        for name, times, dynamics in (
            ("nodes", self.nodes, self.dynamics),
            ("position", self.measurements.position.time, self._position_dynamics),
            ("velocity", self.measurements.velocity.time, self._velocity_dynamics),
        ):
            by_body = body_sensitivity(
                *self._seen_from_base(trajectory, times, dynamics), psi, dynamics, known
            )
            sampled[name] = MotionSensitivity(
                by_body.w * sigmas, by_body.com * sigmas, by_body.v * sigmas
            )
        return self._sensitivity_rows(trajectory, sampled)

    def _sensitivity_rows(
        self, trajectory: Trajectory, sampled: dict[str, MotionSensitivity]
    ) -> NDArray[np.float64]:
        initial = np.zeros((3, sampled["nodes"].w.shape[-1]))
        at = sampled["velocity"]
        rho = self._velocity_dynamics.com(trajectory.state.psi)
        w = trajectory.spline(self.measurements.velocity.time)
        rate = skew(rho) @ at.w - skew(w) @ at.com - at.v  # v = −(ω × ρ + ρ')
        return self._rows(
            trajectory, sampled["nodes"].w, initial, sampled["position"].com, at.com, rate
        )

    def _rows(
        self,
        trajectory: Trajectory,
        w: NDArray[np.float64],
        initial: NDArray[np.float64],
        com: NDArray[np.float64],
        com_at_velocity: NDArray[np.float64],
        com_rate: NDArray[np.float64],
        of_unknowns: bool = False,
    ) -> NDArray[np.float64]:
        """Return the rows of all sensors from how the motion changes, by n quantities.

        Args:
            trajectory: to linearize about.
            w: (N, 3, n) change of the angular velocity at the nodes at unchanged attitude, in B.
            initial: (3, n) change of the attitude at the start, turned in W.
            com: (M, 3, n) change of ρ at the position samples.
            com_at_velocity: (M, 3, n) change of ρ at the velocity samples.
            com_rate: (M, 3, n) change of the rate of ρ there.
            of_unknowns: whether the n quantities are the unknowns themselves.

        """
        xi, w = self._attitude_change(trajectory, w, initial)
        state, columns = trajectory.state, self.columns
        parts = []
        for name in self.sensors:
            samples = getattr(self.measurements, name)
            sigmas = self.suite.sigmas(name)
            if name == "gyro":
                rows = self._interpolated(w, name)
                if of_unknowns:
                    weights = self._bias_weights()
                    rows[:, :, columns["bias"]] = np.kron(weights, np.eye(3)).reshape(
                        len(samples), 3, -1
                    )
                parts.append((rows / sigmas[:, None]).reshape(-1, w.shape[-1]))
                continue
            R = trajectory.rotations(samples.time)
            turn = self._interpolated(xi, name)
            if name == "attitude":
                R_SW = self.suite.attitude.R_BS.T @ np.swapaxes(R, -1, -2)
                rows = R_SW @ turn
            elif name == "position":
                arm = rotate(R, self._position_dynamics.com(state.psi))
                rows = skew(arm) @ turn - R @ com
                if of_unknowns:
                    rows[:, :, columns["p_Wcm"]] += np.eye(3)
                    if "v_Wcm" in columns:
                        elapsed = (samples.time - self.nodes[0])[:, None, None]
                        rows[:, :, columns["v_Wcm"]] += elapsed * np.eye(3)
            else:
                arm = rotate(R, self._com_velocity(trajectory))
                rho = self._velocity_dynamics.com(state.psi)
                w_B = trajectory.spline(samples.time)
                w_change = self._interpolated(w, name)
                turning = skew(w_B) @ com_at_velocity - skew(rho) @ w_change
                rows = skew(arm) @ turn - R @ (turning + com_rate)
                if of_unknowns and "v_Wcm" in columns:
                    rows[:, :, columns["v_Wcm"]] += np.eye(3)
            parts.append((rows / sigmas[:, None]).reshape(-1, w.shape[-1]))
        if self.psi_prior is not None:
            rows = np.zeros((10, w.shape[-1]))
            if of_unknowns:
                rows[:, columns["psi"]] = np.diag(1 / self.psi_prior[1])
            parts.append(rows)
        prior = np.zeros((3 * len(self.bias_nodes), w.shape[-1]))
        if of_unknowns and len(prior):
            prior[:, columns["bias"]] = self._bias_prior_matrix()
        return np.vstack([*parts, prior])

    def _attitude_change(
        self, trajectory: Trajectory, w: NDArray[np.float64], initial: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Integrate ξ̇ = R (w + J⁻¹Rᵀ(L × ξ)); return ξ and all of w.

        Cubics through four nodes for the first term, the trapezoidal rule for the second.
        """
        h = self.nodes[1] - self.nodes[0]
        R, L = trajectory.R, trajectory.state.L
        added = _integrals(R @ w, h)
        if not L.any():
            xi = np.zeros_like(w)
            np.cumsum(added, axis=0, out=xi[1:])
            return xi + initial, w
        J = self.dynamics.inertia(trajectory.state.psi)
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

    def _interpolation(self, name: str) -> csr_array:
        """Return (M, N) weights of the nodes at a sensor's samples: cubics through four nodes."""
        times, N = getattr(self.measurements, name).time, len(self.nodes)
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

    def _interpolated(self, values: NDArray[np.float64], name: str) -> NDArray[np.float64]:
        """Return (M, 3, n) at a sensor's samples of (N, 3, n) at the nodes."""
        return (self._at[name] @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])

    def _com_velocity(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """ω × ρ + ρ' at the velocity samples, in B: how fast the centre of mass moves off B."""
        psi, times = trajectory.state.psi, self.measurements.velocity.time
        dynamics = self._velocity_dynamics
        return np.cross(trajectory.spline(times), dynamics.com(psi)) + dynamics.com_rate(psi)

    def _seen_from_base(self, trajectory: Trajectory, times, dynamics):
        """Return the tree with the target, and its motion with the base's pose the identity."""
        psi = trajectory.state.psi
        parameterization = relative_parameterization(dynamics.mass)
        phi = parameters_to_standard(parameterization.to_parameters(psi))
        samples, w = self.joints.evaluate(times), trajectory.spline(times)
        v = -(np.cross(w, dynamics.com(psi)) + dynamics.com_rate(psi))
        telemetry = Telemetry.seen_from_base(samples[:, 0], samples[:, 1], w, v)
        return self.tree.with_target(phi), telemetry

    # -- the gyro's bias -------------------------------------------------------------------------

    def _bias_weights(self) -> NDArray[np.float64]:
        """(N, K) weights of the bias nodes at the gyro's samples."""
        times, nodes = self.measurements.gyro.time, self.bias_nodes
        if len(nodes) == 1:
            return np.ones((len(times), 1))
        return np.stack([np.interp(times, nodes, unit) for unit in np.eye(len(nodes))], axis=1)

    def _bias_prior_matrix(self) -> NDArray[np.float64]:
        """(3 K, 3 K): the first node has the constant bias's σ, each next one walks on."""
        K, gyro = len(self.bias_nodes), self.suite.gyro
        matrix = np.zeros((K, K))
        matrix[0, 0] = 1 / max(gyro.bias_sigma, 1e-9)
        if K > 1:
            sigma = gyro.bias_growth * np.sqrt(np.diff(self.bias_nodes))
            rows = np.arange(1, K)
            matrix[rows, rows], matrix[rows, rows - 1] = 1 / sigma, -1 / sigma
        return np.kron(matrix, np.eye(3))

    def _bias_prior(self, bias: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        return [-self._bias_prior_matrix() @ bias.ravel()] if len(bias) else []


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


def _padded(columns: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Return (N, 3, size) with the given leading columns and zeros."""
    result = np.zeros((*columns.shape[:2], size))
    result[:, :, : columns.shape[2]] = columns
    return result
