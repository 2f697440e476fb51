"""Momentum filter: online estimation from sensors that each come at their own rate.

An error-state Kalman filter on (ψ, attitude by momentum, attitude by gyro, centre of mass, gyro
bias, momentum). The two attitudes are one and the same to the spacecraft, but come by different
roads: the first from joint motion through conservation of angular momentum, the second from the
gyro. That they must agree is what tells ψ; both roads' noise is white, the encoders' because it
does not add up: only the latest encoder sample's error is in the attitude by momentum.

ψ are the relative unknowns. In them conservation is linear, whatever they are linearized about
(see `relative_motion`), as long as the angular velocity in the regressor is the true one: the
gyro's is. So the filter may start from a prior as vague as one likes.

Source: Ning et al. 2016, Eqs. 5 and 9, about the centre of mass; the filter is ours.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.relative_motion import RelativeDynamics
from cpid_drake.sensors import SENSOR_NAMES, Measurements, SensorSuite

PSI, BY_MOMENTUM, BY_GYRO, COM, BIAS, ANGULAR, VELOCITY = (
    slice(0, 10),
    slice(10, 13),
    slice(13, 16),
    slice(16, 19),
    slice(19, 22),
    slice(22, 25),
    slice(25, 28),
)
"""Where in the error state: ψ, the two attitudes (turned in W), p_Wcm, gyro bias, L and v_Wcm."""

SIZE = 28
GATE = 35.0
"""Innovations whose normalized square (3 degrees of freedom) is above are not used: 1e-7."""

IN_A_ROW = {"agreement": 5, "attitude": 3, "position": 3, "velocity": 3}
"""So many rejections in a row are not outliers: momentum has changed, or the prediction is lost."""

FASTEST = 2.0
"""Angular acceleration of the base that arms can cause [rad/s²]; more is a gyro sample to doubt."""

LARGEST_STEP = 0.03
"""Change of the base's angular velocity that a thruster is expected to cause at once [rad/s]."""

LONGEST_GAP = 0.25
"""Integration does not bridge longer gaps in gyro or encoder samples [s]."""

SLOWEST = 200.0
"""For so many samples, at most, a creeping joint's rounding error is taken to be the same."""

_SENSORS = (*SENSOR_NAMES, "agreement")
_GYRO, _ENCODERS = _SENSORS.index("gyro"), _SENSORS.index("encoders")

ATTITUDE_KNOWN, CHANGES, CHANGE_TIME, DOUBTFUL_TIME, COM_KNOWN, NOISE_TIME = range(6)

FILTER_ORDER = ("gyro", "attitude", "encoders", "position", "velocity")
"""The order in which samples of one instant are best given to the filter."""


@dataclass(frozen=True)
class FilterPrior:
    """What is taken to be known before the first sample.

    Attributes:
        psi: (10,) mean of the relative unknowns, those of a rigid body.
        psi_sigma: (10,) their σ.
        momentum_known: whether the momentum is zero, instead of unknown.
        angular_momentum: σ of an unknown angular momentum [N·m·s].
        velocity: σ of an unknown velocity of the centre of mass [m/s].

    """

    psi: NDArray[np.float64]
    psi_sigma: NDArray[np.float64]
    momentum_known: bool
    angular_momentum: float
    velocity: float


def vague_prior(
    known_mass: float, known_inertia: NDArray[np.float64], unknown_momentum: bool = False
) -> FilterPrior:
    """Return a prior that says no more than that the target is no larger than the spacecraft.

    Its mean is a solid sphere of a tenth of the spacecraft's mass about C's origin; σ is that of a
    target as heavy as the spacecraft, with its radius of gyration.

    Args:
        known_mass: of the known bodies [kg].
        known_inertia: (3, 3) their inertia about their centre of mass [kg·m²].
        unknown_momentum: whether the momentum is unknown instead of zero.

    """
    radius = np.sqrt(np.trace(known_inertia) / 2 / known_mass)
    mass = 0.1 * known_mass / 1.1  # reduced
    sphere = 0.4 * mass * radius**2
    psi = np.array([mass, 0, 0, 0, sphere, 0, 0, sphere, 0, sphere], dtype=float)
    sigma = psi_scale(known_mass, known_inertia)
    moment = np.trace(known_inertia) / 3
    return FilterPrior(psi, sigma, not unknown_momentum, 0.2 * moment, 0.2)


def psi_scale(known_mass: float, known_inertia: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (10,) magnitudes of ψ for a target as heavy and as large as the spacecraft."""
    radius = np.sqrt(np.trace(known_inertia) / 2 / known_mass)
    mass = known_mass / 2
    return mass * np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]])


@dataclass(eq=False)
class FilterState:
    """All that the filter remembers; the estimates are the means, `P` their covariance.

    Attributes:
        psi: (10,) relative unknowns.
        R_by_momentum, R_by_gyro: (3, 3) attitude R_WB by either road.
        p_Wcm: (3,) the system's centre of mass [m].
        bias: (3,) of the gyro [rad/s].
        L: (3,) angular momentum about the centre of mass, in W [N·m·s].
        v_Wcm: (3,) velocity of the centre of mass [m/s].
        P: (28, 28) covariance of the error state.
        joints: (2, 1 + J) time and joint positions where the attitude by momentum has got to, and
            of one later sample that waits for the next; NaN for none.
        q_before: (J,) joint positions when the joint noise was last computed.
        joint_noise, com_noise: (3, 3) what one encoder sample's error does to the attitude by
            momentum and to the centre of mass, in B; `unsure_noise` the part of the first that is
            for not knowing ψ.
        rate_noise: growth of the attitude by momentum's variance [rad²/s] by the noise of the
            angular velocity in its regressor.
        w: (3,) latest angular velocity, in B [rad/s]; `w_before` the one that momentum predicts.
        gyro: (4, 4) time and value of the latest gyro samples, the newest last.
        doubtful_gyro: (3,) a gyro sample that waits to be confirmed.
        times: latest stamp used, of every sensor [s]; −inf before the first.
        used, rejected: number of samples, of every sensor and of the two attitudes' agreement.
        in_a_row: rejections in a row.
        flags: single numbers; see `momentum_changes` and `momentum_change_time` for two of them.

    """

    psi: NDArray[np.float64]
    P: NDArray[np.float64]
    joints: NDArray[np.float64]
    q_before: NDArray[np.float64]
    joint_noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    com_noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    unsure_noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    rate_noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros(1))
    R_by_momentum: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    R_by_gyro: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    p_Wcm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    bias: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    L: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    v_Wcm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    w: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    w_before: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    gyro: NDArray[np.float64] = field(default_factory=lambda: np.full((4, 4), np.nan))
    doubtful_gyro: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    times: NDArray[np.float64] = field(default_factory=lambda: np.full(len(_SENSORS), -np.inf))
    used: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(_SENSORS)))
    rejected: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(_SENSORS)))
    in_a_row: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(_SENSORS)))
    flags: NDArray[np.float64] = field(
        default_factory=lambda: np.array([0.0, 0.0, np.nan, np.nan, 0.0, -np.inf])
    )

    @property
    def momentum_changes(self) -> int:
        """How often the momentum was found to have changed."""
        return int(self.flags[CHANGES])

    @property
    def momentum_change_time(self) -> float:
        """When it was last found to have changed [s]; NaN for never."""
        return float(self.flags[CHANGE_TIME])

    def pack(self) -> NDArray[np.float64]:
        """Return all of it as one vector."""
        return np.concatenate([np.ravel(value) for value in vars(self).values()])

    def unpack(self, vector: NDArray[np.float64]) -> "FilterState":
        """Return the state that `pack` has made a vector of; this one gives the shapes."""
        parts, start = {}, 0
        for name, value in vars(self).items():
            parts[name] = vector[start : start + value.size].reshape(value.shape).copy()
            start += value.size
        return FilterState(**parts)


class MomentumFilter:
    """The filter's equations, for one spacecraft and one suite of sensors; it holds no state.

    Args:
        suite: the sensors.
        joint_count: J.
        dynamics: (q (J,), qdot (N, J)) -> the known bodies seen from the base, as `KnownBodies`.
        prior: before the first sample.

    """

    def __init__(
        self,
        suite: SensorSuite,
        joint_count: int,
        dynamics: Callable[[NDArray[np.float64], NDArray[np.float64]], RelativeDynamics],
        prior: FilterPrior,
    ) -> None:
        self.suite, self.joint_count, self.prior = suite, joint_count, prior
        self.dynamics = dynamics
        self._has_gyro = suite.gyro is not None
        if self._has_gyro:
            self._gyro_variance = suite.sigmas("gyro")[0] ** 2
            self._attitude_growth = self._gyro_variance / suite.gyro.rate
            self._bias_growth = suite.gyro.bias_growth**2
        self._joint_sigma = suite.sigmas("encoders")[0]
        self._variance = {
            name: suite.sigmas(name)[0] ** 2 * np.eye(3)
            for name in ("position", "velocity")
            if getattr(suite, name) is not None
        }
        if suite.attitude is not None:
            R_BS = suite.attitude.R_BS
            self._variance["attitude"] = R_BS * suite.sigmas("attitude") ** 2 @ R_BS.T

    def start(self) -> FilterState:
        """Return the state before the first sample."""
        prior, J = self.prior, self.joint_count
        P = np.zeros((SIZE, SIZE))
        P[PSI, PSI] = np.diag(prior.psi_sigma**2)
        if self._has_gyro:
            P[BIAS, BIAS] = max(self.suite.gyro.bias_sigma, 1e-9) ** 2 * np.eye(3)
        state = FilterState(
            prior.psi.copy(), P, joints=np.full((2, 1 + J), np.nan), q_before=np.zeros(J)
        )
        if not prior.momentum_known:
            self._open_momentum(state, angular=True)
        return state

    def update(self, state: FilterState, name: str, time: float, value: NDArray) -> FilterState:
        """Return the state after one sample of a sensor; what cannot be used is counted.

        Samples of one instant are best given in `FILTER_ORDER`. The given state is
        not changed.

        Args:
            state: before.
            name: of the sensor.
            time: the sample's stamp [s].
            value: as in `Measurements`, (width,).

        """
        new = FilterState(**{key: entry.copy() for key, entry in vars(state).items()})
        self.take(new, name, time, value)
        return new

    def take(self, state: FilterState, name: str, time: float, value: NDArray) -> None:
        """As `update`, in place."""
        k = _SENSORS.index(name)
        if not (np.isfinite(time) and np.isfinite(value).all() and time > state.times[k]):
            state.rejected[k] += 1
            return
        if name == "joint_rates":
            return  # the filter uses encoders only: their noise does not add up
        now = state.times[[_ENCODERS, _GYRO]].max()
        if name not in ("encoders", "gyro") and time < now - LONGEST_GAP:
            state.rejected[k] += 1
            return
        outcome = getattr(self, f"_{name}")(state, time, value)
        if outcome:
            state.used[k] += 1
            state.times[k] = time
            state.in_a_row[k] = 0
        elif outcome is not None:
            state.rejected[k] += 1

    @staticmethod
    def index(name: str) -> int:
        """Return a sensor's place in `FilterState.times`, `used`, `rejected` and `in_a_row`."""
        return _SENSORS.index(name)

    def resume(
        self, state: FilterState, time: float, q: NDArray, measurements: Measurements
    ) -> None:
        """Set what else a state needs to go on at `time`, after the last of these measurements."""
        state.flags[ATTITUDE_KNOWN] = 1.0
        state.flags[COM_KNOWN] = float(len(measurements.position) > 0)
        state.joints[0, 0], state.joints[0, 1:] = time, q
        before = np.searchsorted(measurements.encoders.time, time - 0.1)
        state.q_before[:] = measurements.encoders.value[min(before, len(measurements.encoders) - 1)]
        state.flags[NOISE_TIME] = time - 0.1
        gyro = measurements.gyro
        count = min(len(gyro), len(state.gyro))
        if count:
            state.gyro[-count:, 0] = gyro.time[-count:]
            state.gyro[-count:, 1:] = gyro.value[-count:]
            state.w[:] = gyro.value[-1] - state.bias
            # The attitude is that at `time`; the gyro's may be a little older.
            turn = _exp(state.w * (gyro.time[-1] - time))
            state.R_by_gyro = state.R_by_gyro @ turn
        self._refresh_joint_noise(state, time)
        R = state.R_by_momentum
        state.P[BY_MOMENTUM, BY_MOMENTUM] += R @ state.joint_noise @ R.T

    def well_known(self, state: FilterState) -> bool:
        """Whether ψ is known well enough for this filter to go on with.

        Encoder errors are in the regressors too. That does no harm once it hardly matters to their
        effect which of the still possible ψ is the true one: 1 % of its variance here.
        """
        self._refresh_joint_noise(state, state.joints[0, 0])
        return bool(np.trace(state.unsure_noise) < 0.01 * np.trace(state.joint_noise))

    # -- sensors ---------------------------------------------------------------------------------

    def _attitude(self, state: FilterState, time: float, value: NDArray) -> bool:
        norm = np.sqrt(value @ value)
        if abs(norm - 1) > 1e-3:
            return False
        R = _rotation_of(value / norm)
        noise = self._variance["attitude"]
        if not state.flags[ATTITUDE_KNOWN]:
            at = state.gyro[-1, 0]
            behind = time - at if np.isfinite(at) else 0.0
            self._set_attitude(state, R @ _exp(-state.w * behind), noise)
            return True
        where, R_state, at = self._best_attitude(state)
        R_predicted = R_state @ _exp(state.w * (time - at)) if np.isfinite(at) else R_state
        H = np.zeros((3, SIZE))
        H[:, where] = R_predicted.T
        if where == BY_MOMENTUM:
            noise = noise + state.joint_noise
        innovation = _log(R_predicted.T @ R)
        if self._correct(state, innovation, H, noise):
            return True
        if self._too_many(state, "attitude"):
            if where == BY_MOMENTUM:
                self._momentum_changed(state, time, angular=True)
            self._set_attitude(state, R, self._variance["attitude"])
            return True
        return False

    def _gyro(self, state: FilterState, time: float, value: NDArray) -> bool | None:
        last, doubtful = state.gyro[-1, 0], state.flags[DOUBTFUL_TIME]
        if not (state.flags[ATTITUDE_KNOWN] and time - last <= LONGEST_GAP):
            # Nothing to carry on from: the attitude by momentum stands in until now.
            self._adopt(state, BY_GYRO, "R_by_gyro", BY_MOMENTUM, state.R_by_momentum)
            state.gyro[:] = np.nan
            state.gyro[-1] = [time, *value]
            state.w[:] = value - state.bias
            state.flags[DOUBTFUL_TIME] = np.nan
            return True
        if not np.isnan(doubtful):
            if time <= doubtful:
                return False
            state.flags[DOUBTFUL_TIME] = np.nan
            if self._alike(state.doubtful_gyro, value, time - doubtful):
                # Confirmed: a step between two samples, at an unknown instant.
                self._turn_by_gyro(state, doubtful, state.doubtful_gyro, stepped=True)
                state.used[_GYRO] += 1
            else:
                state.rejected[_GYRO] += 1
        if not self._alike(state.gyro[-1, 1:], value, time - state.gyro[-1, 0]):
            state.doubtful_gyro[:], state.flags[DOUBTFUL_TIME] = value, time
            return None  # the next sample decides
        self._turn_by_gyro(state, time, value)
        return True

    def _alike(self, one: NDArray, other: NDArray, elapsed: float) -> bool:
        """Whether two gyro samples can follow each other: no arm jerks a base harder."""
        step = other - one
        limit = 10 * np.sqrt(self._gyro_variance) + FASTEST * elapsed
        return step @ step <= limit**2

    def _turn_by_gyro(
        self, state: FilterState, time: float, value: NDArray, stepped: bool = False
    ) -> None:
        (before, last), (w_before, w_last) = state.gyro[-2:, 0], state.gyro[-2:, 1:]
        elapsed, gap = time - last, last - before
        if stepped or not gap <= LONGEST_GAP:
            mean = (value + w_last) / 2
        else:
            # The mean over the interval of the parabola through three samples.
            newest = (elapsed / 3 + gap / 2) / (elapsed + gap)
            oldest = -(elapsed**2) / (6 * gap * (elapsed + gap))
            mean = newest * value + oldest * w_before + (1 - newest - oldest) * w_last
        turn = (mean - state.bias) * elapsed
        turn += elapsed**2 / 12 * _cross(w_last - state.bias, value - state.bias)
        A = np.eye(SIZE)
        A[BY_GYRO, BIAS] = -elapsed * state.R_by_gyro
        state.P = A @ state.P @ A.T
        growth = self._attitude_growth * elapsed
        if stepped:
            jump = value - w_last
            growth += (jump @ jump) * elapsed**2 / 12
        index = np.arange(BY_GYRO.start, BY_GYRO.stop)
        state.P[index, index] += growth
        index = np.arange(BIAS.start, BIAS.stop)
        state.P[index, index] += self._bias_growth * elapsed
        state.R_by_gyro = state.R_by_gyro @ _exp(turn)
        if stepped:
            state.gyro[:] = np.nan
        state.gyro[:-1] = state.gyro[1:]
        state.gyro[-1] = [time, *value]
        state.w[:] = value - state.bias
        state.times[_GYRO] = time

    def _encoders(self, state: FilterState, time: float, value: NDArray) -> bool:
        start, middle = state.joints
        last = state.times[_ENCODERS]
        if not (state.flags[ATTITUDE_KNOWN] and time - last <= LONGEST_GAP):
            self._start_joints(state, time, value)
            return True
        if np.isnan(middle[0]):
            middle[0], middle[1:] = time, value
            return True
        self._turn_by_momentum(state, time, value)
        start[0], start[1:], middle[0] = time, value, np.nan
        if time - state.flags[NOISE_TIME] > 0.1 - 1e-9:
            self._refresh_joint_noise(state, time)
        if self._has_gyro:
            self._agree(state, time)
        return True

    def _start_joints(self, state: FilterState, time: float, value: NDArray) -> None:
        """Begin with the joints anew, at the attitude by gyro if there is one."""
        lost = np.isfinite(state.times[_ENCODERS])
        state.joints[0, 0], state.joints[0, 1:], state.joints[1, 0] = time, value, np.nan
        state.q_before[:] = value
        self._refresh_joint_noise(state, time)
        if state.flags[ATTITUDE_KNOWN] and self._has_gyro:
            self._rejoin(state)
        elif lost:
            state.flags[ATTITUDE_KNOWN] = 0.0  # no gyro to bridge the gap: wait for an attitude

    def _turn_by_momentum(self, state: FilterState, time: float, value: NDArray) -> None:
        """Integrate over two encoder intervals: a parabola through three samples, and Simpson."""
        (t0, *_), (t1, *_) = state.joints
        q0, q1 = state.joints[:, 1:]
        T, part = time - t0, (t1 - t0) / (time - t0)
        curved = 0.0
        if 0.2 < part < 0.8:
            curved = ((value - q0) - (q1 - q0) / part) / (1 - part)
        slope = (value - q0) - curved
        q = np.stack([q0, q0 + slope / 2 + curved / 4, value])
        qdot = np.stack([slope, slope + curved, slope + 2 * curved]) / T
        dynamics = _joined([self.dynamics(q[i], qdot[i : i + 1]) for i in range(3)])

        psi = state.psi
        J, h = dynamics.inertia(psi), dynamics.momentum_at_rest(psi)
        if not _well_positive(J[1], dynamics.I_K[1]):
            psi = self.prior.psi  # any ψ will do to linearize about, but a possible one
            J, h = dynamics.inertia(psi), dynamics.momentum_at_rest(psi)
        inverse = np.linalg.inv(J)
        fresh = self._has_gyro and time - state.gyro[-1, 0] <= LONGEST_GAP
        mean = state.w if fresh else state.w_before
        to_nodes = np.stack([np.eye(3), _exp(mean * T / 2), _exp(mean * T)])
        # The attitude for the derivatives: the gyro's is the better one.
        R = state.R_by_gyro @ _exp(-state.w * T) if fresh else state.R_by_momentum
        R_nodes = R @ to_nodes
        R_inverse = np.swapaxes(R_nodes, -1, -2)
        if fresh:
            w_true = self._angular_velocities(state, np.array([t0, t0 + T / 2, time]))
        else:
            w_true = (inverse @ (R_inverse @ state.L - h)[..., None])[..., 0]
        Y = dynamics.regressor(w_true)
        momentum = np.swapaxes(state.R_by_momentum @ to_nodes, -1, -2) @ state.L
        w = (inverse @ (momentum - h - Y @ (state.psi - psi))[..., None])[..., 0]

        turn = T / 6 * (w[0] + 4 * w[1] + w[2]) + T**2 / 12 * _cross(w[0], w[2])
        by_momentum = R_nodes @ inverse * (T / 6 * np.array([1.0, 4.0, 1.0]))[:, None, None]
        A = np.eye(SIZE)
        A[BY_MOMENTUM, PSI] = -(by_momentum @ Y).sum(axis=0)
        spread = (by_momentum @ R_inverse).sum(axis=0)
        A[BY_MOMENTUM, ANGULAR] = spread
        if state.L.any():
            A[BY_MOMENTUM, BY_MOMENTUM] += spread @ _skew(state.L)
        A[COM, VELOCITY] = T * np.eye(3)
        state.P = A @ state.P @ A.T
        index = np.arange(BY_MOMENTUM.start, BY_MOMENTUM.stop)
        state.P[index, index] += state.rate_noise * T
        state.R_by_momentum = state.R_by_momentum @ _exp(turn)
        state.w_before[:] = w[2]
        state.p_Wcm += state.v_Wcm * T
        if not fresh:
            state.w[:] = w[2]

    def _angular_velocities(self, state: FilterState, times: NDArray) -> NDArray:
        """Return the gyro's angular velocities, without bias, at times in its latest samples."""
        known = np.isfinite(state.gyro[:, 0])
        at, samples = state.gyro[known, 0], state.gyro[known, 1:]
        return np.stack([np.interp(times, at, axis) for axis in samples.T], axis=1) - state.bias

    def _agree(self, state: FilterState, time: float) -> None:
        """Both roads lead to one attitude, but for the latest encoder sample's error."""
        behind = time - state.gyro[-1, 0]
        if not 0 <= behind <= LONGEST_GAP or not np.isnan(state.flags[DOUBTFUL_TIME]):
            return
        R = state.R_by_gyro @ _exp(state.w * behind) if behind > 1e-9 else state.R_by_gyro
        H = np.zeros((3, SIZE))
        H[:, BY_MOMENTUM] = R.T
        H[:, BY_GYRO] = -R.T
        innovation = _log(state.R_by_momentum.T @ R)
        if self._correct(state, innovation, H, state.joint_noise):
            state.used[-1] += 1
            state.in_a_row[-1] = 0
            return
        state.rejected[-1] += 1
        if self._too_many(state, "agreement"):
            self._momentum_changed(state, time, angular=True)

    def _position(self, state: FilterState, time: float, value: NDArray) -> bool:
        return self._about_com(state, time, value, "position")

    def _velocity(self, state: FilterState, time: float, value: NDArray) -> bool:
        return self._about_com(state, time, value, "velocity")

    def _about_com(self, state: FilterState, time: float, value: NDArray, name: str) -> bool:
        start, middle = state.joints
        if not state.flags[ATTITUDE_KNOWN] or np.isnan(start[0]):
            return False
        ahead = time - start[0]
        if not -LONGEST_GAP <= ahead <= LONGEST_GAP:
            return False
        # The joints from the latest samples, carried on or back a little.
        qdot = np.zeros_like(start[1:])
        if not np.isnan(middle[0]):
            qdot = (middle[1:] - start[1:]) / (middle[0] - start[0])
        dynamics = self.dynamics(start[1:] + qdot * ahead, qdot[None])
        where, R, at = self._best_attitude(state)
        R = R @ _exp(state.w * (time - at)) if abs(time - at) > 1e-9 else R
        H = np.zeros((3, SIZE))
        noise = self._variance[name] + R @ state.com_noise @ R.T
        rho, by_rho = dynamics.com(state.psi)[0], dynamics.com_regressor()[0]
        if name == "position":
            arm = rho
            predicted = state.p_Wcm + state.v_Wcm * ahead - R @ rho
            H[:, COM] = np.eye(3)
            H[:, VELOCITY] = ahead * np.eye(3)
            H[:, :4] = -R @ by_rho
        else:
            W = _skew(state.w)
            arm = W @ rho + dynamics.com_rate(state.psi)[0]
            predicted = state.v_Wcm - R @ arm
            H[:, VELOCITY] = np.eye(3)
            H[:, :4] = -R @ (W @ by_rho + dynamics.com_rate_regressor()[0])
            # Rates from differences of two encoder samples, and the gyro's own noise.
            period = 1 / self.suite.encoders.rate
            noise = noise + R @ state.com_noise @ R.T * (2 / period**2 - 1)
            if self._has_gyro:
                lever = _skew(rho)
                noise = noise + self._gyro_variance * R @ lever @ lever.T @ R.T
        H[:, where] = _skew(R @ arm)
        if name == "position" and not state.flags[COM_KNOWN]:
            state.p_Wcm[:] = value + R @ rho
            state.P[COM, :] = state.P[:, COM] = 0.0
            state.P[COM, COM] = 1e2 * (1 + rho @ rho) * np.eye(3)
            state.flags[COM_KNOWN] = 1.0
            predicted = value
        if self._correct(state, value - predicted, H, noise):
            return True
        if self._too_many(state, name):
            self._momentum_changed(state, time, angular=False)
        return False

    # -- the filter's steps ----------------------------------------------------------------------

    def _best_attitude(self, state: FilterState) -> tuple[slice, NDArray, float]:
        """Return the attitude that sensors of the pose are compared with, and its time."""
        if self._has_gyro and np.isfinite(state.times[_GYRO]):
            return BY_GYRO, state.R_by_gyro, state.gyro[-1, 0]
        return BY_MOMENTUM, state.R_by_momentum, state.joints[0, 0]

    def _correct(self, state: FilterState, innovation: NDArray, H: NDArray, noise: NDArray) -> bool:
        """Take an innovation in, unless it is out of the gate."""
        P = state.P
        PHt = P @ H.T
        S = H @ PHt + noise
        solved = np.linalg.solve(S, np.column_stack([PHt.T, innovation]))
        if innovation @ solved[:, -1] > GATE:
            return False
        K = solved[:, :-1].T
        change = K @ innovation
        A = np.eye(SIZE) - K @ H
        P = A @ P @ A.T + K @ noise @ K.T
        state.P = (P + P.T) / 2
        state.psi += change[PSI]
        state.R_by_momentum = _exp(change[BY_MOMENTUM]) @ state.R_by_momentum
        state.R_by_gyro = _exp(change[BY_GYRO]) @ state.R_by_gyro
        state.p_Wcm += change[COM]
        state.bias += change[BIAS]
        state.L += change[ANGULAR]
        state.v_Wcm += change[VELOCITY]
        return True

    def _too_many(self, state: FilterState, name: str) -> bool:
        k = _SENSORS.index(name)
        state.in_a_row[k] += 1
        return state.in_a_row[k] >= IN_A_ROW[name]

    def _momentum_changed(self, state: FilterState, time: float, angular: bool) -> None:
        """Forget the momentum, and what was integrated with it; keep all else."""
        state.flags[CHANGES] += 1
        state.flags[CHANGE_TIME] = time
        state.in_a_row[:] = 0
        self._open_momentum(state, angular)
        if angular and self._has_gyro:
            # The step came at an unknown instant between two gyro samples.
            slip = LARGEST_STEP / self.suite.gyro.rate
            state.P[BY_GYRO, BY_GYRO] += slip**2 * np.eye(3)
            self._rejoin(state)

    def _open_momentum(self, state: FilterState, angular: bool) -> None:
        state.P[VELOCITY, VELOCITY] += self.prior.velocity**2 * np.eye(3)
        # The centre of mass may have moved since, unnoticed.
        state.P[COM, COM] += (0.1 * self.prior.velocity) ** 2 * np.eye(3)
        if angular:
            state.P[ANGULAR, ANGULAR] += self.prior.angular_momentum**2 * np.eye(3)

    def _rejoin(self, state: FilterState) -> None:
        """Put the attitude by momentum onto that by gyro, but for the latest encoder error."""
        R = state.R_by_gyro
        self._adopt(state, BY_MOMENTUM, "R_by_momentum", BY_GYRO, R)
        state.P[BY_MOMENTUM, BY_MOMENTUM] += R @ state.joint_noise @ R.T

    def _adopt(self, state: FilterState, where: slice, name: str, other: slice, R: NDArray) -> None:
        """Make one of the two attitudes a copy of the other."""
        setattr(state, name, R.copy())
        state.P[where, :] = state.P[other, :]
        state.P[:, where] = state.P[:, other]

    def _set_attitude(self, state: FilterState, R: NDArray, noise: NDArray) -> None:
        """Take the attitude from one sample, with no memory of what it was."""
        variance = R @ noise @ R.T
        for where in (BY_MOMENTUM, BY_GYRO):
            state.P[where, :] = state.P[:, where] = 0.0
        for a in (BY_MOMENTUM, BY_GYRO):
            for b in (BY_MOMENTUM, BY_GYRO):
                state.P[a, b] = variance
        R_noise = R @ state.joint_noise @ R.T
        state.P[BY_MOMENTUM, BY_MOMENTUM] += R_noise
        state.R_by_momentum, state.R_by_gyro = R.copy(), R.copy()
        state.flags[ATTITUDE_KNOWN] = 1.0

    def _refresh_joint_noise(self, state: FilterState, time: float) -> None:
        """Compute what one encoder sample's error does to attitude and centre of mass, in B."""
        unit = self.dynamics(state.joints[0, 1:], np.eye(self.joint_count))
        psi = state.psi
        inertia = unit.inertia(psi)[0]
        if not _well_positive(inertia, unit.I_K[0]):
            psi = self.prior.psi
            inertia = unit.inertia(psi)[0]
        inverse, P = np.linalg.inv(inertia), state.P[PSI, PSI]
        Y = unit.regressor(np.zeros((self.joint_count, 3)))
        turn, com = inverse @ unit.momentum_at_rest(psi).T, unit.com_rate(psi).T
        variance = np.full(self.joint_count, self._joint_sigma**2)
        step, elapsed = self.suite.encoders.step, time - state.flags[NOISE_TIME]
        q = state.joints[0, 1:]
        if step:
            # Rounding is white only where every sample is another step; a joint that creeps makes
            # the same error for as long as it takes to the next step.
            moved = np.abs(q - state.q_before) / max(elapsed * self.suite.encoders.rate, 1.0)
            variance *= np.clip(step / np.maximum(moved, 1e-300), 1.0, SLOWEST)
        # A ψ that is not well known does not say well what an error of the joints does.
        unsure = np.einsum("j,jik,jlk->il", variance, Y @ P, Y)
        # 1e-9 rad and m: what the arithmetic of a filter in double precision is good for.
        state.unsure_noise = inverse @ unsure @ inverse.T
        state.joint_noise = turn * variance @ turn.T + state.unsure_noise + 1e-18 * np.eye(3)
        state.com_noise = com * variance @ com.T + 1e-18 * np.eye(3)
        if self._has_gyro:
            still = self.dynamics(q, np.zeros((1, self.joint_count)))
            D = np.concatenate([still.regressor(axis[None]) for axis in np.eye(3)])
            unsure = inverse @ np.einsum("jik,jlk->il", D @ P, D) @ inverse.T
            state.rate_noise[:] = self._attitude_growth * np.trace(unsure) / 3
        state.q_before[:] = q
        state.flags[NOISE_TIME] = time


def _joined(parts: list[RelativeDynamics]) -> RelativeDynamics:
    """Put single instants together."""
    arrays = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in vars(parts[0])
        if name != "mass"
    }
    return RelativeDynamics(mass=parts[0].mass, **arrays)


def _well_positive(J: NDArray, reference: NDArray) -> bool:
    """Whether J is at least a third of the known bodies' own inertia, in every direction."""
    try:
        np.linalg.cholesky(J - reference / 3)
    except np.linalg.LinAlgError:
        return False
    return True


def _skew(v: NDArray) -> NDArray:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _cross(a: NDArray, b: NDArray) -> NDArray:
    return _skew(a) @ b


def _exp(r: NDArray) -> NDArray:
    """Rotation (3, 3) of a rotation vector (3,)."""
    angle = np.sqrt(r @ r)
    K = _skew(r)
    if angle < 1e-6:
        return np.eye(3) + K + K @ K / 2
    return np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K


def _log(R: NDArray) -> NDArray:
    """Rotation vector (3,) of a rotation by less than a half turn."""
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine, cosine = np.sqrt(v @ v), (np.trace(R) - 1) / 2
    angle = np.arctan2(sine, cosine)
    return v * (angle / sine if sine > 1e-9 else 1.0)


def _rotation_of(quaternion: NDArray) -> NDArray:
    """Rotation (3, 3) of a unit quaternion (w, x, y, z)."""
    w, v = quaternion[0], quaternion[1:]
    K = _skew(v)
    return np.eye(3) + 2 * w * K + 2 * K @ K
