"""Sensors of the base: residuals of their samples and derivatives w.r.t. the motion.

`model_classes` chooses the class by the quantity that a sensor measures. If several sensors measure
one quantity, each of them enters the likelihood with its own samples and noise.

If a table carries the base, only the components in the plane enter: the yaw, the yaw rate, and the
horizontal components of position and velocity. The others are constants of the table, whatever a
log contains, and say nothing about the target.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import cross, exponentials, right_jacobian, rotate, skew
from cpid_drake.estimation.likelihood.constants import Constants
from cpid_drake.estimation.likelihood.error_effects import Way
from cpid_drake.estimation.likelihood.motion_change import MotionChange
from cpid_drake.estimation.likelihood.motion_model import BaseMotion, Trajectory
from cpid_drake.estimation.likelihood.uniform_spline import GAUSS_LEGENDRE
from cpid_drake.files.errors import InputError
from cpid_drake.logs.log import Log, Samples
from cpid_drake.logs.screening import LONGEST_DELAY
from cpid_drake.sensors.sensors import SENSORS, AttitudeSensor, Gyro
from cpid_drake.sensors.suite import SensorSuite

ENCODERS = "encoders"
"""The sensor to whose clock the joint motion belongs."""

_STEP = 1e-3
"""Step of differences in time [s]."""


class SensorModel(ABC):
    """Samples of one sensor with their σ.

    Args:
        name: name of the sensor.
        samples: M samples at times within the motion.
        suite: the sensors' errors.
        motion: motion of the base.
        instants: rows of the samples in `BaseMotion.times`, if the sensor needs them there.
        clock: (2, M) by how much its stamps are later than those of the encoders [s], and by how
            much the clock of the encoders is fast.

    Attributes:
        scale: (d,) σ of the components of a sample that enter: 3, or those in a table's plane.

    """

    at_instants = False
    """Whether the sensor needs the spacecraft's dynamics at its samples."""

    def __init__(
        self,
        name: str,
        samples: Samples,
        suite: SensorSuite,
        motion: BaseMotion,
        instants: slice,
        clock: Array,
    ) -> None:
        self.name, self.samples, self.sigmas = name, samples, suite.sigmas(name)
        self._errors, self._at = suite[name], instants
        (late, self._fast), self._motion = clock, motion
        self._times = samples.time - late
        normal = motion.tree.normal_B
        self._is_planar = normal is not None
        self._axes = np.eye(3) if normal is None else self._measured(normal)
        self.scale = np.sqrt(self._axes**2 @ np.broadcast_to(self.sigmas**2, 3))

    def residuals(self, trajectory: Trajectory) -> Array:
        """Return measured minus predicted values (M, d) in units of σ."""
        error = self._error(trajectory)
        if self._fast.any():
            error = error - self._fast[:, None] * self._per_second(trajectory)
        return self.normalized(error[..., None])[..., 0]

    def normalized(self, values: Array) -> Array:
        """Return the components (M, d, n) in units of σ of values (M, 3, n) in SI units."""
        if self._is_planar:
            values = self._axes @ values
        return values / self.scale[:, None]

    def by_unknowns(self, trajectory: Trajectory) -> dict[str, Array]:
        """Return the derivatives (M, 3, size) of the readings by unknowns at the same motion.

        They are in SI units, by the names of constant errors in units of their σ.
        """
        constants, by = self._motion.constants, dict[str, Array]()
        for way, of in self._by(trajectory).items():
            for error in constants.acting[way, self.name]:
                by[error.name] = error.sigma * (of @ error.effect.how)
        # y(t − late), of which ∂late/∂e = a + b t; if the encoders are late, this is early, and if
        # their clock is fast, so is the motion, whose rates this shows as they are
        own, common = constants.acting["clock", self.name], constants.acting["clock", ENCODERS]
        if own or common:
            rate, elapsed = self._rate(trajectory), self.samples.time - self._motion.origin
            grown = elapsed[:, None] * rate
            faster = grown + self._per_second(trajectory)
        for error in own:
            a, b = error.effect.how
            by[error.name] = -error.sigma * (a * rate + b * grown)[..., None]
        for error in common:
            a, b = error.effect.how
            by[error.name] = error.sigma * (a * rate + b * faster)[..., None]
        return by

    def _measured(self, normal_B: Array) -> Array:
        """Return the axes (d, 3) of the components in the plane, in the errors' frame."""
        return np.eye(3)[:2]

    @abstractmethod
    def _error(self, trajectory: Trajectory) -> Array: ...

    @abstractmethod
    def jacobian(self, trajectory: Trajectory, change: MotionChange, xi: Array) -> Array:
        """Return the derivative (M, 3, n) of the predicted values, which are in SI units.

        Args:
            trajectory: the trajectory to linearize about.
            change: change of the motion by n quantities; its `w` includes the effect of `xi`.
            xi: (N, 3, n) change of the attitude at the nodes, a rotation in W.

        """

    @abstractmethod
    def _rate(self, trajectory: Trajectory) -> Array:
        """Return the rates of change (M, 3) of the predicted values."""

    def _per_second(self, trajectory: Trajectory) -> Array:
        """Return what of the predicted values (M, 3) is proportional to the rate of the motion."""
        return np.zeros((len(self.samples), 3))

    @abstractmethod
    def _by(self, trajectory: Trajectory) -> dict[str, Array]:
        """Return the derivatives (M, 3, n) of the readings by what errors change, by the way."""

    def _sum(self, trajectory: Trajectory, way: Way, size: int = 3) -> Array:
        """Return what this sensor's errors of a way change together, (size,)."""
        return self._motion.constants.sum(trajectory.state.constants, self.name, way, size)

    @cached_property
    def _weights(self) -> Array:
        """Weights (M, N) of the nodes in the values at the samples."""
        return self._motion.interpolation(self._times)

    def _at_samples(self, at_nodes: Array) -> Array:
        """Interpolate values (N, 3, ...) at the nodes to the samples' states, (M, 3, ...)."""
        flat = self._weights @ at_nodes.reshape(len(at_nodes), -1)
        return np.asarray(flat.reshape(-1, *at_nodes.shape[1:]))


class AttitudeModel(SensorModel):
    """A star tracker; errors are about the axes of its boresight frame."""

    def _measured(self, normal_B: Array) -> Array:
        return np.asarray((normal_B @ self._R_BS)[None])

    def _error(self, trajectory: Trajectory) -> Array:
        # log((R exp(m))ᵀ R_measured) about the axes S
        turned = np.swapaxes(self._predicted(trajectory), -1, -2) @ self._R_WB
        return np.asarray(Rotation.from_matrix(turned).as_rotvec() @ self._R_BS)

    def jacobian(self, trajectory: Trajectory, change: MotionChange, xi: Array) -> Array:
        """See `SensorModel`."""
        # Rᵀ ξ about the axes S, with R and S of the mounted sensor
        R = self._predicted(trajectory)
        return self._R_BS.T @ np.swapaxes(R, -1, -2) @ self._at_samples(xi)

    def _rate(self, trajectory: Trajectory) -> Array:
        turn = exponentials(self._sum(trajectory, "turn"))
        return trajectory.spline(self._times) @ turn @ self._R_BS

    def _by(self, trajectory: Trajectory) -> dict[str, Array]:
        # exp(m + dm) = exp(m) exp(J_r dm)
        by = self._R_BS.T @ right_jacobian(self._sum(trajectory, "turn"))
        return {"turn": np.broadcast_to(by, (len(self.samples), 3, 3))}

    def _predicted(self, trajectory: Trajectory) -> Array:
        """Return the attitudes (M, 3, 3) that an exact sensor would measure."""
        return trajectory.rotations(self._times) @ exponentials(self._sum(trajectory, "turn"))

    @cached_property
    def _R_WB(self) -> Array:
        """The measured attitudes (M, 3, 3)."""
        return np.asarray(Rotation.from_quat(self.samples.value, scalar_first=True).as_matrix())

    @cached_property
    def _R_BS(self) -> Array:
        assert isinstance(self._errors, AttitudeSensor)
        return self._errors.R_BS


class GyroModel(SensorModel):
    """A gyro with its bias; one that integrates measures the mean over its sample period."""

    def _measured(self, normal_B: Array) -> Array:
        return normal_B[None]

    def _error(self, trajectory: Trajectory) -> Array:
        # y − M ω − b
        w, bias = self._mean(trajectory.spline), self._sum(trajectory, "offset")
        return np.asarray(self.samples.value - w @ self._matrix(trajectory).T - bias)

    def jacobian(self, trajectory: Trajectory, change: MotionChange, xi: Array) -> Array:
        """See `SensorModel`."""
        # δy = M (δω + ∂ω/∂late δlate)
        late = self._mean(trajectory.spline.by_delay)
        by_motion = self._at_samples(change.w[: len(xi)]) + late[..., None] * change.delay
        return self._matrix(trajectory) @ by_motion

    def _rate(self, trajectory: Trajectory) -> Array:
        earlier, later = (self._mean(trajectory.spline, step) for step in (-_STEP, _STEP))
        return (later - earlier) / (2 * _STEP)

    def _per_second(self, trajectory: Trajectory) -> Array:
        return self._mean(trajectory.spline)

    def _by(self, trajectory: Trajectory) -> dict[str, Array]:
        w = self._mean(trajectory.spline)
        # y = M w + b, ∂y/∂b = 1: of the entries of M, row by row, each row has wᵀ
        matrix = np.eye(3)[:, :, None] * w[:, None, None]
        offset = np.broadcast_to(np.eye(3), (len(w), 3, 3))
        return {"offset": offset, "matrix": matrix.reshape(len(w), 3, 9)}

    def _matrix(self, trajectory: Trajectory) -> Array:
        """Return the matrix M (3, 3) of scales and misalignments that multiplies w."""
        return np.eye(3) + self._sum(trajectory, "matrix", 9).reshape(3, 3)

    @cached_property
    def _points(self) -> tuple[tuple[float, float], ...]:
        """Times relative to the stamp at which w is averaged [s], each with its weight."""
        assert isinstance(self._errors, Gyro)
        if not self._errors.integrates:
            return ((0.0, 1.0),)
        points, weights = GAUSS_LEGENDRE
        times = (points - 1) / (2 * self._errors.rate)
        return tuple(zip(times.tolist(), (weights / 2).tolist(), strict=True))

    @cached_property
    def _weights(self) -> Array:
        return self._mean(self._motion.interpolation)

    def _mean(self, of: Callable[[Array], Array], later: float = 0.0) -> Array:
        """Return values at the samples, averaged over the sample period if the gyro integrates."""
        times = self._times + later
        return np.asarray(sum(w * of(times + t) for t, w in self._points))


class TranslationModel(SensorModel):
    """A sensor of the position or velocity in W of B's origin, or of a point near it."""

    at_instants = True

    def _arms(self, trajectory: Trajectory, rows: slice) -> tuple[Array, Array, Array]:
        """Return R_WB, and arms from the point to the centre of mass and their rates, in B."""
        dynamics, psi = self._motion.dynamics.part(rows), trajectory.state.psi
        # a = ρ − l, and a' = ω × a + ρ' in W, seen in B
        arm = dynamics.com(psi) - self._sum(trajectory, "point")
        rate = cross(trajectory.w[rows], arm) + dynamics.com_rate(psi)
        return trajectory.R[rows], arm, rate

    def _velocity(self, trajectory: Trajectory, rows: slice) -> Array:
        """Return the velocity (M, 3) of the measured point, in W, at instants."""
        # v = v_cm − R a'
        R, _, rate = self._arms(trajectory, rows)
        return self._motion.com_motion(trajectory, rows)[:, 3:] - rotate(R, rate)


class PositionModel(TranslationModel):
    """A sensor of the position in W."""

    def _error(self, trajectory: Trajectory) -> Array:
        # p = p_cm − R a
        R, arm, _ = self._arms(trajectory, self._at)
        com = self._motion.com_motion(trajectory, self._at)[:, :3]
        return np.asarray(self.samples.value - (com - rotate(R, arm)))

    def jacobian(self, trajectory: Trajectory, change: MotionChange, xi: Array) -> Array:
        """See `SensorModel`."""
        # δp = δp_cm + (R a) × ξ − R δρ
        R, arm, _ = self._arms(trajectory, self._at)
        turned = skew(rotate(R, arm)) @ self._at_samples(xi)
        return np.asarray(turned - R @ change.com[self._at] + change.position[self._at])

    def _by(self, trajectory: Trajectory) -> dict[str, Array]:
        return {"point": trajectory.R[self._at]}

    def _rate(self, trajectory: Trajectory) -> Array:
        return self._velocity(trajectory, self._at)


class VelocityModel(TranslationModel):
    """A sensor of the velocity in W."""

    def _error(self, trajectory: Trajectory) -> Array:
        return np.asarray(self.samples.value - self._velocity(trajectory, self._at))

    def jacobian(self, trajectory: Trajectory, change: MotionChange, xi: Array) -> Array:
        """See `SensorModel`."""
        # δv = δv_cm + (R a') × ξ − R (ω × δρ − a × δω + δρ')
        R, arm, rate = self._arms(trajectory, self._at)
        turned = skew(trajectory.w[self._at]) @ change.com[self._at]
        late = trajectory.spline.by_delay(self._times)[..., None] * change.delay
        turned -= skew(arm) @ (self._at_samples(change.w[: len(xi)]) + late)
        relative = skew(rotate(R, rate)) @ self._at_samples(xi)
        by_com = R @ (turned + change.com_rate[self._at])
        return np.asarray(change.velocity[self._at] + relative - by_com)

    def _by(self, trajectory: Trajectory) -> dict[str, Array]:
        # v = ... + R (ω × l)
        return {"point": trajectory.R[self._at] @ skew(trajectory.w[self._at])}

    def _rate(self, trajectory: Trajectory) -> Array:
        times, weights = self._times, self._motion.interpolation
        slope = (weights(times + _STEP) - weights(times - _STEP)) / (2 * _STEP)
        return np.asarray(slope @ self._velocity(trajectory, slice(0, slope.shape[1])))

    def _per_second(self, trajectory: Trajectory) -> Array:
        return self._velocity(trajectory, self._at)


def clock_of(name: str, stamps: Array, constants: Constants, values: Array, origin: float) -> Array:
    """Return by how much a sensor's stamps are later than those of the encoders [s].

    Args:
        name: of the sensor.
        stamps: (M,) [s].
        constants: the constant errors.
        values: (k,) their values in units of their σ.
        origin: time at which clocks that drift have their delays [s].

    Returns:
        (2, M) the latter, and by how much the clock of the encoders is fast.

    Raises:
        InputError: the delay is so long that the motion is not known so far from the block.

    """
    clock = np.zeros((2, len(stamps)))
    for owner, sign in ((name, 1.0), (ENCODERS, -1.0)):
        for error in constants.acting["clock", owner]:
            (a, b), value = error.effect.how, constants.value(values, error)
            clock[0] += sign * value * (a + b * (stamps - origin))
            clock[1] += (sign < 0) * value * b
    worst = clock[0, np.argmax(np.abs(clock[0]))] if len(stamps) else 0.0
    if not abs(worst) < LONGEST_DELAY:
        raise InputError(f"{name}: a delay of {worst:.3g} s cannot be modelled")
    return clock


_MODELS: dict[str, type[SensorModel]] = {
    "attitude": AttitudeModel,
    "angular velocity": GyroModel,
    "position": PositionModel,
    "velocity": VelocityModel,
}


def model_classes(measurements: Log, suite: SensorSuite) -> dict[str, type[SensorModel]]:
    """Return the classes of the base's sensors with samples and errors, as in the table."""
    present = suite.present()
    return {
        name: _MODELS[sensor.quantity]
        for name, sensor in SENSORS.items()
        if name in present and sensor.quantity in _MODELS and len(measurements[name])
    }
