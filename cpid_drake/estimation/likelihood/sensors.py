"""Sensors of the base: residuals of their samples and derivatives w.r.t. the motion.

`sensor_models` chooses the class by the quantity that a sensor measures. If several sensors measure
one quantity, each of them enters the likelihood with its own samples and noise.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.estimation.likelihood.gyro_bias import GyroBias
from cpid_drake.estimation.likelihood.motion import BaseMotion, Instants, Trajectory
from cpid_drake.sensing.measurements import Samples
from cpid_drake.sensing.sensors import (
    ANGULAR_VELOCITY,
    ATTITUDE,
    POSITION,
    SENSORS,
    VELOCITY,
    AttitudeSensor,
    Gyro,
)
from cpid_drake.sensing.suite import SensorSuite


@dataclass(frozen=True, eq=False)
class MotionChange:
    """First-order change of the base's motion by n quantities.

    Attributes:
        xi: (N, 3, n) change of the attitude at the grid's nodes, a rotation in W.
        w: (N, 3, n) change of the angular velocity at the nodes, in B.
        com: returns for M instants the change (M, 3, n) of the centre of mass ρ from B's origin,
            and the change of its rate as seen from B, both in B.

    """

    xi: NDArray[np.float64]
    w: NDArray[np.float64]
    com: Callable[[Instants], tuple[NDArray[np.float64], NDArray[np.float64]]]


class SensorModel:
    """Samples of one sensor with their σ.

    Args:
        name: name of the sensor.
        samples: M samples at times within the motion.
        suite: the sensors' errors.
        motion: motion of the base.

    """

    def __init__(self, name: str, samples: Samples, suite: SensorSuite, motion: BaseMotion) -> None:
        self.name, self.samples, self.sigmas = name, samples, suite.sigmas(name)
        self._start = motion.nodes[0]
        self._weights = motion.interpolation(samples.time)

    def residuals(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """Return measured minus predicted values (M, 3) in units of σ."""
        return np.asarray(self._error(trajectory) / self.sigmas)

    def jacobian(
        self, trajectory: Trajectory, change: MotionChange, columns: Mapping[str, slice]
    ) -> NDArray[np.float64]:
        """Return the derivative (3 M, n) of the predicted values, which are in units of σ.

        Args:
            trajectory: the trajectory to linearize about.
            change: change of the motion by n quantities.
            columns: columns of the unknowns that act on sensors directly; empty if the n quantities
                are not the unknowns.

        """
        rows = self._derivative(trajectory, change)
        self._add_direct(rows, columns)
        return np.asarray((rows / self.sigmas[:, None]).reshape(-1, rows.shape[-1]))

    def _error(self, trajectory: Trajectory) -> NDArray[np.float64]:
        raise NotImplementedError

    def _derivative(self, trajectory: Trajectory, change: MotionChange) -> NDArray[np.float64]:
        raise NotImplementedError

    def _add_direct(self, rows: NDArray[np.float64], columns: Mapping[str, slice]) -> None:
        """Add the derivatives with respect to unknowns that do not act through the motion."""

    def _at_samples(self, at_nodes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate values (N, 3, n) at the nodes to the times of the samples, (M, 3, n)."""
        flat = self._weights @ at_nodes.reshape(len(at_nodes), -1)
        return np.asarray(flat.reshape(-1, *at_nodes.shape[1:]))


class AttitudeModel(SensorModel):
    """A star tracker; errors are about the axes of its boresight frame."""

    def __init__(self, name: str, samples: Samples, suite: SensorSuite, motion: BaseMotion) -> None:
        super().__init__(name, samples, suite, motion)
        errors = suite[name]
        assert isinstance(errors, AttitudeSensor)
        self._R_BS = errors.R_BS
        self._measured = Rotation.from_quat(samples.value, scalar_first=True)

    def _error(self, trajectory: Trajectory) -> NDArray[np.float64]:
        predicted = Rotation.from_matrix(trajectory.rotations(self.samples.time))
        return np.asarray((predicted.inv() * self._measured).as_rotvec() @ self._R_BS)

    def _derivative(self, trajectory: Trajectory, change: MotionChange) -> NDArray[np.float64]:
        R = trajectory.rotations(self.samples.time)
        return self._R_BS.T @ np.swapaxes(R, -1, -2) @ self._at_samples(change.xi)


class GyroModel(SensorModel):
    """A gyro with its bias. The model sets `bias` to the gyro's place in the state."""

    def __init__(self, name: str, samples: Samples, suite: SensorSuite, motion: BaseMotion) -> None:
        super().__init__(name, samples, suite, motion)
        errors = suite[name]
        assert isinstance(errors, Gyro)
        self.bias = GyroBias(errors, motion.nodes[0], motion.nodes[-1])

    def _error(self, trajectory: Trajectory) -> NDArray[np.float64]:
        bias = self.bias.weights(self.samples.time) @ trajectory.state.bias[self.bias.rows]
        return np.asarray(self.samples.value - trajectory.spline(self.samples.time) - bias)

    def _derivative(self, trajectory: Trajectory, change: MotionChange) -> NDArray[np.float64]:
        return self._at_samples(change.w)

    def _add_direct(self, rows: NDArray[np.float64], columns: Mapping[str, slice]) -> None:
        if "bias" in columns:
            weights = np.kron(self.bias.weights(self.samples.time), np.eye(3))
            own = self.bias.columns(columns["bias"].start)
            rows[:, :, own] = weights.reshape(len(rows), 3, -1)


class PositionModel(SensorModel):
    """A sensor of the position of B's origin in W."""

    def __init__(self, name: str, samples: Samples, suite: SensorSuite, motion: BaseMotion) -> None:
        super().__init__(name, samples, suite, motion)
        self._instants = motion.instants(samples.time)

    def _error(self, trajectory: Trajectory) -> NDArray[np.float64]:
        state, R = trajectory.state, trajectory.rotations(self.samples.time)
        elapsed = (self.samples.time - self._start)[:, None]
        p_Wcm = state.p_Wcm + state.v_Wcm * elapsed
        return self.samples.value - (p_Wcm - rotate(R, self._instants.dynamics.com(state.psi)))

    def _derivative(self, trajectory: Trajectory, change: MotionChange) -> NDArray[np.float64]:
        R = trajectory.rotations(self.samples.time)
        arm = rotate(R, self._instants.dynamics.com(trajectory.state.psi))
        com, _ = change.com(self._instants)
        return np.asarray(skew(arm) @ self._at_samples(change.xi) - R @ com)

    def _add_direct(self, rows: NDArray[np.float64], columns: Mapping[str, slice]) -> None:
        if "p_Wcm" in columns:
            rows[:, :, columns["p_Wcm"]] += np.eye(3)
        if "v_Wcm" in columns:
            elapsed = (self.samples.time - self._start)[:, None, None]
            rows[:, :, columns["v_Wcm"]] += elapsed * np.eye(3)


class VelocityModel(PositionModel):
    """A sensor of the velocity of B's origin in W."""

    def _error(self, trajectory: Trajectory) -> NDArray[np.float64]:
        R = trajectory.rotations(self.samples.time)
        velocity = rotate(R, self._instants.com_velocity(trajectory))
        return np.asarray(self.samples.value - trajectory.state.v_Wcm + velocity)

    def _derivative(self, trajectory: Trajectory, change: MotionChange) -> NDArray[np.float64]:
        R = trajectory.rotations(self.samples.time)
        arm = rotate(R, self._instants.com_velocity(trajectory))
        rho = self._instants.dynamics.com(trajectory.state.psi)
        w = trajectory.spline(self.samples.time)
        com, com_rate = change.com(self._instants)
        rotation = skew(w) @ com - skew(rho) @ self._at_samples(change.w)
        return np.asarray(skew(arm) @ self._at_samples(change.xi) - R @ (rotation + com_rate))

    def _add_direct(self, rows: NDArray[np.float64], columns: Mapping[str, slice]) -> None:
        if "v_Wcm" in columns:
            rows[:, :, columns["v_Wcm"]] += np.eye(3)


_MODELS: dict[str, type[SensorModel]] = {
    ATTITUDE.name: AttitudeModel,
    ANGULAR_VELOCITY.name: GyroModel,
    POSITION.name: PositionModel,
    VELOCITY.name: VelocityModel,
}


def sensor_models(
    measurements: Mapping[str, Samples], suite: SensorSuite, motion: BaseMotion
) -> dict[str, SensorModel]:
    """Return the models of the base's sensors that have samples, in the order of the table."""
    return {
        name: _MODELS[sensor.quantity.name](name, measurements[name], suite, motion)
        for name, sensor in SENSORS.items()
        if sensor.quantity.name in _MODELS and len(measurements.get(name, ()))
    }
