"""The likelihood of all samples: residuals and their derivatives, in units of σ, with priors."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.relative_motion import RelativeDynamics
from cpid_drake.dynamics.rotations import skew
from cpid_drake.dynamics.sensitivity import BodyUncertainty, MotionSensitivity
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.estimation.likelihood.errors import body_errors, joint_errors
from cpid_drake.estimation.likelihood.motion import (
    BaseMotion,
    Instants,
    Trajectory,
    TrajectoryState,
)
from cpid_drake.estimation.likelihood.sensors import (
    GyroModel,
    MotionChange,
    SensorModel,
    sensor_models,
)
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.sensors import ATTITUDE, POSITION, SENSORS, VELOCITY, Quantity
from cpid_drake.sensing.splines import JointSpline, measured_by
from cpid_drake.sensing.suite import SensorSuite


class TrajectoryModel:
    """Predicts the base's sensors from a target, for one joint motion.

    Args:
        tree: the known spacecraft.
        joints: the spacecraft's joint motion.
        measurements: samples of the spacecraft's sensors. Samples before or after the joint motion,
            and samples of sensors that the suite lacks, are ignored.
        suite: the sensors' errors.
        momentum: the total momentum of spacecraft and target; default: zero.
        psi_prior: mean and σ, (10,) each, of the relative unknowns; None for no prior.
        step: longest step of the grid [s]; a joint motion of many pieces makes it shorter.

    Attributes:
        sensors: models of the sensors that have samples, by name.
        columns: columns of the Jacobian, by unknown.

    Raises:
        InputError: there is no attitude sensor, or it has no samples during the joint motion.

    """

    def __init__(
        self,
        tree: KinematicTree,
        joints: JointSpline,
        measurements: Measurements,
        suite: SensorSuite,
        *,
        momentum: TotalMomentum | None = None,
        psi_prior: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
        step: float = 0.025,
    ) -> None:
        self.motion, self.joints, self.suite = BaseMotion(tree, joints, step), joints, suite
        self.nodes = self.motion.nodes
        self.measurements = measured_by(suite, measurements).between(self.nodes[0], self.nodes[-1])
        self.momentum, self.psi_prior = momentum or TotalMomentum.zero(), psi_prior
        self.sensors = sensor_models(self.measurements.samples, suite, self.motion)
        if _first_samples(self.sensors, ATTITUDE) is None:
            raise InputError("no attitude samples while the joints are known: none to start from")
        self._biases, count = [], 0
        for sensor in self.sensors.values():
            if isinstance(sensor, GyroModel):
                self._biases.append(sensor.bias)
                sensor.bias.rows = slice(count, count + len(sensor.bias.nodes))
                count = sensor.bias.rows.stop
        self._bias_prior = block_diag(np.empty((0, 0)), *(bias.prior() for bias in self._biases))
        self.columns = _layout(self.sensors, self.momentum.is_unknown, len(self._bias_prior))

    @property
    def dynamics(self) -> RelativeDynamics:
        """The known bodies at the nodes."""
        return self.motion.grid.dynamics

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.columns["bias"].stop)

    def start(self, psi: NDArray[np.float64]) -> TrajectoryState:
        """Return the state at which a fit starts: first samples, given momentum, no bias."""
        first = _first_samples(self.sensors, ATTITUDE)
        position = _first_samples(self.sensors, POSITION)
        assert first is not None
        attitude = Rotation.from_quat(first.value[0], scalar_first=True)
        v_Wcm, L = self.momentum.v_WScm_W, self.momentum.L_WScm_W
        bias = np.zeros((len(self._bias_prior) // 3, 3))
        state = TrajectoryState(psi, attitude, np.zeros(3), v_Wcm, L, bias)
        if position is not None:
            rho = self.dynamics.com(psi)[0]
            state = replace(state, p_Wcm=position.value[0] + attitude.apply(rho))
        return state

    def retracted(self, state: TrajectoryState, change: NDArray[np.float64]) -> TrajectoryState:
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
        """Return the base's motion; see `BaseMotion.trajectory`."""
        return self.motion.trajectory(state, near)

    def residuals(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return measured minus predicted in units of σ, all sensors, then the priors."""
        parts = [sensor.residuals(trajectory).ravel() for sensor in self.sensors.values()]
        if self.psi_prior is not None:
            mean, sigma = self.psi_prior
            parts.append((mean - trajectory.state.psi) / sigma)
        return np.concatenate([*parts, -self._bias_prior @ trajectory.state.bias.ravel()])

    def sample_rows(self) -> NDArray[np.intp]:
        """Return for every row of the residuals the index of its sample; −1 for priors."""
        count = sum(len(sensor.samples) for sensor in self.sensors.values())
        prior = np.full(len(self._bias_prior) + 10 * (self.psi_prior is not None), -1)
        return np.concatenate([np.repeat(np.arange(count), 3), prior])

    def jacobian(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return the derivative of predicted readings w.r.t. the unknowns, in units of σ."""
        xi, w = self._change_by_unknowns(trajectory)

        def com(at: Instants) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            by_psi = at.dynamics.com_regressor(), at.dynamics.com_rate_regressor()
            return _padded(by_psi[0], self.size), _padded(by_psi[1], self.size)

        rows = self._rows(trajectory, MotionChange(xi, w, com), self.columns)
        priors = len(rows) - len(self._bias_prior)
        rows[priors:, self.columns["bias"]] = self._bias_prior
        if self.psi_prior is not None:
            rows[priors - 10 : priors, self.columns["psi"]] = np.diag(1 / self.psi_prior[1])
        return rows

    def end_attitude_jacobian(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return the derivative (3, size) of the attitude at the end, as a rotation in W."""
        return self._change_by_unknowns(trajectory)[0][-1]

    def joint_jacobian(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return the derivative of the rows of `jacobian` w.r.t. errors of the joint motion.

        Each coefficient of the joints' splines has one column, in units of its σ. The errors of
        the coefficients are independent.
        """
        return self._error_rows(trajectory, lambda at: joint_errors(self.motion, trajectory, at))

    def body_jacobian(
        self, trajectory: Trajectory, uncertainty: BodyUncertainty
    ) -> NDArray[np.float64]:
        """Return the derivative w.r.t. errors of the known bodies' parameters, in units of σ."""
        return self._error_rows(
            trajectory, lambda at: body_errors(self.motion, trajectory, at, uncertainty)
        )

    def _change_by_unknowns(
        self, trajectory: Trajectory
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the change of attitude and angular velocity at the nodes, (N, 3, size) each."""
        columns = self.columns
        moment = np.zeros((len(self.nodes), 3, self.size))
        moment[:, :, columns["psi"]] = -self.dynamics.regressor(trajectory.w)
        if "L" in columns:
            moment[:, :, columns["L"]] = np.swapaxes(trajectory.R, -1, -2)
        w = np.asarray(np.linalg.solve(self.dynamics.inertia(trajectory.state.psi), moment))
        initial = np.zeros((3, self.size))
        initial[:, columns["attitude"]] = np.eye(3)
        return self.motion.attitude_change(trajectory, w, initial)

    def _error_rows(
        self, trajectory: Trajectory, sensitivity: Callable[[Instants], MotionSensitivity]
    ) -> NDArray[np.float64]:
        def com(at: Instants) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            change, rho = sensitivity(at), at.dynamics.com(trajectory.state.psi)
            w = trajectory.spline(at.times)
            # v = −(ω × ρ + ρ'), solved for the change of ρ'
            return change.com, skew(rho) @ change.w - skew(w) @ change.com - change.v

        w = sensitivity(self.motion.grid).w
        initial = np.zeros((3, w.shape[-1]))
        xi, w = self.motion.attitude_change(trajectory, w, initial)
        return self._rows(trajectory, MotionChange(xi, w, com), {})

    def _rows(
        self, trajectory: Trajectory, change: MotionChange, columns: dict[str, slice]
    ) -> NDArray[np.float64]:
        """Return the rows of all sensors, then zeros for the priors."""
        parts = [s.jacobian(trajectory, change, columns) for s in self.sensors.values()]
        priors = len(self._bias_prior) + 10 * (self.psi_prior is not None)
        return np.vstack([*parts, np.zeros((priors, change.w.shape[-1]))])


def _first_samples(sensors: Mapping[str, SensorModel], quantity: Quantity) -> Samples | None:
    """Return the samples of one sensor of a quantity: the sensor with the earliest sample."""
    samples = [s.samples for name, s in sensors.items() if SENSORS[name].quantity is quantity]
    return min(samples, key=lambda each: each.time[0], default=None)


def _layout(
    sensors: Mapping[str, SensorModel], unknown_momentum: bool, biases: int
) -> dict[str, slice]:
    """Return the columns of the unknowns that these sensors can determine."""
    sizes, quantities = {"psi": 10, "attitude": 3}, {SENSORS[name].quantity for name in sensors}
    if POSITION in quantities:
        sizes["p_Wcm"] = 3
    if unknown_momentum:
        sizes["L"] = 3
        if quantities & {POSITION, VELOCITY}:
            sizes["v_Wcm"] = 3
    sizes["bias"] = biases
    ends = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(end - n, end) for (name, n), end in zip(sizes.items(), ends)}


def _padded(columns: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Return (N, 3, size) with the given leading columns and zeros."""
    result = np.zeros((*columns.shape[:2], size))
    result[:, :, : columns.shape[2]] = columns
    return result
