"""Momentum filter: online estimation from sensors with different sample rates.

An error-state Kalman filter on (ψ, attitude by momentum, attitude by gyro, centre of mass, gyro
bias, momentum). Both attitudes estimate the attitude of the base. The first is propagated by the
joint motion through conservation of angular momentum, the second by the gyro. Their difference
determines ψ. The noise of both is white: encoder errors do not accumulate, because only the latest
encoder sample's error enters the attitude by momentum.

A thruster's firing is detected in two ways. After a strong firing, several successive innovations
fail their gates. To detect a weak firing, the filter assumes a jump of momentum at each of some
recent instants, propagates the effect of the jump on its errors and innovations, and tests whether
a jump explains the innovations (the generalized likelihood ratio test of Willsky & Jones 1976). If
a jump explains them, the filter corrects the estimate and its covariance by the effect of that
jump.

ψ are the relative unknowns. The conservation of angular momentum is linear in ψ at any point of
linearization (see `relative_motion`) if the regressor contains the true angular velocity. The gyro
measures the true angular velocity. The filter can therefore start from an arbitrarily vague prior.

Sources: Ning et al. 2016, Eqs. 5 and 9, about the centre of mass; Willsky & Jones 1976, A
generalized likelihood ratio approach to the detection and estimation of jumps in linear systems,
IEEE TAC 21(1). The filter itself was developed in this project.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.relative_motion import RelativeDynamics
from cpid_drake.dynamics.rotations import exp, log, quaternion_to_matrix, skew
from cpid_drake.dynamics.rows import relative_regressor
from cpid_drake.estimation.likelihood.priors import psi_scale
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.sensors import STANDARD_SENSORS, Gyro, JointSensor
from cpid_drake.sensing.suite import SensorSuite

PSI, BY_MOMENTUM, BY_GYRO, COM, BIAS, ANGULAR, VELOCITY = (
    slice(0, 10),
    slice(10, 13),
    slice(13, 16),
    slice(16, 19),
    slice(19, 22),
    slice(22, 25),
    slice(25, 28),
)
"""Slices of the error state: ψ, both attitudes (rotation vectors in W), p_Wcm, bias, L, v_Wcm."""

SIZE = 28

FILTER_ORDER = ("gyro", "attitude", "encoders", "position", "velocity")
"""The best order for samples of the same instant."""

Sample = tuple[str, float, NDArray[np.float64]]
"""Sensor, time [s] and value, as in `Measurements`."""

# -- limits for the screening of samples ---------------------------------------------------------

GATE = 35.0
"""Largest normalized squared innovation (χ² of 3): good samples exceed it once in 1e7."""

IN_A_ROW = {"agreement": 3, "attitude": 3, "position": 3, "velocity": 3}
"""After this number of successive rejections, the prediction is wrong and not the sensor."""

LARGEST = 1e9
"""Largest reading of any sensor, in SI units."""

LONGEST_GAP = 0.25
"""The filter integrates across gaps between gyro or encoder samples up to this length [s]."""

LONGEST_SILENCE = 1.0
"""A sample later than all earlier ones by more than this [s] must be confirmed by the next one."""

SPIKE = 8.0
"""A sample that deviates by more than this number of σ, and by more than the motion allows, must be
confirmed by the next sample."""

SMOOTHEST = {"gyro": (2.0, 10.0, 30.0), "encoders": (10.0, 10.0, 30.0)}
"""Largest first, second and third derivative of smooth motion: of the gyro's signal [rad/s², …] and
of joint positions [rad/s, …]."""

FASTEST_JOINT = 20.0
"""Largest joint rate [rad/s]."""

HARDEST_BRAKE = 1.0
"""If all joints stop at once with a larger deceleration, the sensor is stuck [rad/s²]."""

SLOWEST = 200.0
"""Largest number of samples for which a slow joint's rounding error is taken to be constant."""

# -- changes of momentum -------------------------------------------------------------------------

LARGEST_STEP = 0.03
"""Largest jump of the base's angular velocity that a thruster is expected to cause [rad/s]."""

JUMPS, SPACING = 6, 0.2
"""Number of instants that are tested for a jump of momentum, and least time between them [s]."""

CHANGED = 60.0
"""Likelihood ratio (χ² of 6) above which momentum has jumped.

Noise exceeds it with a probability of 5e-11; a single outlier does not reach it.
"""

OFFSETS = (0.003, 0.003)
"""σ of the attitude [rad] and centre of mass [m] that a jump between two such instants causes."""

SAME_CAUSE = 1.0
"""If both attitudes differ again within this time after a reset, momentum has jumped [s]."""

_SENSORS = (*STANDARD_SENSORS, "agreement")
_INDEX = {name: k for k, name in enumerate(_SENSORS)}
_GYRO, _ENCODERS, _AGREEMENT = _INDEX["gyro"], _INDEX["encoders"], _INDEX["agreement"]
_IN_ORDER = np.arange(SIZE)


@dataclass(frozen=True)
class FilterPrior:
    """What is known before the first sample.

    Attributes:
        psi: (10,) mean of the relative unknowns, those of a rigid body.
        psi_sigma: (10,) their σ.
        momentum_known: whether `L` and `v_Wcm` are the momentum; otherwise it is unknown.
        angular_momentum: σ of an unknown angular momentum [N·m·s].
        velocity: σ of an unknown velocity of the centre of mass [m/s].
        L: (3,) mean of the angular momentum about the centre of mass, in W [N·m·s].
        v_Wcm: (3,) mean of the velocity of the centre of mass, in W [m/s].
        plausible: (10,) largest plausible deviations of ψ, if `psi_sigma` is information that
            enters the final estimate; None if `psi_sigma` only describes which targets are
            plausible.

    """

    psi: NDArray[np.float64]
    psi_sigma: NDArray[np.float64]
    momentum_known: bool
    angular_momentum: float
    velocity: float
    L: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    v_Wcm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    plausible: NDArray[np.float64] | None = None


def vague_prior(
    known_mass: float, known_inertia: NDArray[np.float64], unknown_momentum: bool = False
) -> FilterPrior:
    """Return a vague prior: the target is about as large as the spacecraft, or smaller.

    Its mean is a solid sphere of a tenth of the spacecraft's mass about C's origin; σ corresponds
    to a target with the mass and the radius of gyration of the spacecraft.

    Args:
        known_mass: mass of the known bodies [kg].
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


def guessed_prior(vague: FilterPrior, psi: NDArray[np.float64], sigma: float) -> FilterPrior:
    """Return a prior around a guess of the target, with the vague prior's momentum.

    The relative unknowns are uncorrelated. The σ of each is the share `sigma` of its scale: μ,
    μ k or μ k², with k the radius of gyration of `psi` about C's origin.

    Args:
        vague: the prior from `vague_prior`.
        psi: (10,) mean of the relative unknowns, of a rigid body that is not a point at C's origin.
        sigma: σ of each relative unknown, divided by the unknown's scale.

    """
    radius = np.sqrt((psi[4] + psi[7] + psi[9]) / 2 / psi[0])
    scale = psi[0] * np.concatenate([[1.0], 3 * [radius], 6 * [radius**2]])
    return replace(vague, psi=psi, psi_sigma=sigma * scale, plausible=vague.psi_sigma)


@dataclass(eq=False)
class FilterState:
    """The filter's complete state: arrays and numpy scalars, each with a `copy` method.

    J is the number of joints and n the number of sensors; the agreement of both attitudes is
    treated as the last sensor.

    Attributes:
        psi: (10,) relative unknowns.
        P: (28, 28) covariance of the error state.
        R_by_momentum, R_by_gyro: (3, 3) attitude R_WB, propagated by momentum and by the gyro.
        p_Wcm: (3,) the system's centre of mass [m].
        bias: (3,) bias of the gyro [rad/s].
        L: (3,) angular momentum about the centre of mass, in W [N·m·s].
        v_Wcm: (3,) velocity of the centre of mass [m/s].
        momentum_known: whether the momentum is known from the start and has not jumped since.
        attitude_known, com_known: whether a sample has initialized them.
        momentum_changes: number of detected jumps of momentum.
        momentum_change_time: time of the latest detection [s]; NaN if there is none.
        joints: (2, 1 + J) time and joint positions, first of the sample up to which the attitude by
            momentum is propagated, then of a later sample that is not processed yet; NaN for none.
        rates: (J,) joint rates at the first of these samples [rad/s].
        response: (3, J + 3, 10) derivative w.r.t. ψ of the angular momentum at those positions, for
            each unit joint rate and unit angular velocity; `known_part` (3, J + 3) is the part of
            the known bodies.
        com_part: (3, 5) the centre of mass from B's origin at those positions, in B: the known
            bodies' part, and the derivative with respect to (μ, μc).
        q_before: (J,) joint positions when the joint noise was last computed, at `noise_time`.
        joint_noise: (3, 3) covariance of the attitude by momentum due to the error of one encoder
            sample, in B; `unsure_noise` is its part that is due to the uncertainty of ψ.
        com_noise: (3, 3) covariance of the centre of mass due to the error of one encoder sample,
            in B.
        rate_noise: rate at which noise of the angular velocity in the regressor increases the
            variance of the attitude by momentum [rad²/s].
        w: (3,) latest angular velocity, in B [rad/s]; `w_before` is the one that momentum predicts.
        gyro: (4, 4) time and value of the latest gyro samples, the newest last; NaN for none.
        rejoin_time: time of the latest reset of the attitude by momentum to the attitude by gyro
            [s].
        effects: (28, 12 · JUMPS) effect on the error state of unit jumps at the tested instants:
            angular (L, attitude by momentum), then linear (v_Wcm, p_Wcm).
        jump_information, jump_score: (JUMPS, 12, 12), (JUMPS, 12) the information about these jumps
            in the innovations after them, and the product of this information with the most likely
            jumps.
        jump_times: (JUMPS,) the tested instants [s].
        used, rejected: (n,) number of used and of rejected samples.
        in_a_row: (n,) number of consecutive rejections.
        times: (n,) time of the latest accepted sample [s]; −inf before the first.
        latest: (n, max(4, J)) value of the latest sample; `repeats` (n,) how often it was repeated.
        recent_gyro, recent_encoders: (3, 4), (3, 1 + J) latest accepted samples, the newest last.
        doubtful_gyro, doubtful_encoders: (4,), (1 + J,) a sample that must be confirmed.
        late: (2 + max(4, J),) sensor, time and value of a sample whose time must be confirmed.
        step_time: time of the first gyro sample after a jump of angular velocity [s].

    """

    psi: NDArray[np.float64]
    P: NDArray[np.float64]
    joints: NDArray[np.float64]
    rates: NDArray[np.float64]
    response: NDArray[np.float64]
    known_part: NDArray[np.float64]
    q_before: NDArray[np.float64]
    latest: NDArray[np.float64]
    recent_encoders: NDArray[np.float64]
    doubtful_encoders: NDArray[np.float64]
    late: NDArray[np.float64]
    momentum_known: np.bool_
    attitude_known: np.bool_ = np.False_
    com_known: np.bool_ = np.False_
    momentum_changes: np.int64 = field(default_factory=lambda: np.int64(0))
    momentum_change_time: np.float64 = field(default_factory=lambda: np.float64(np.nan))
    noise_time: np.float64 = field(default_factory=lambda: np.float64(-np.inf))
    rejoin_time: np.float64 = field(default_factory=lambda: np.float64(-np.inf))
    step_time: np.float64 = field(default_factory=lambda: np.float64(np.nan))
    rate_noise: np.float64 = field(default_factory=lambda: np.float64(0.0))
    com_part: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 5)))
    joint_noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    com_noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    unsure_noise: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    R_by_momentum: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    R_by_gyro: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    p_Wcm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    bias: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    L: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    v_Wcm: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    w: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    w_before: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    gyro: NDArray[np.float64] = field(default_factory=lambda: np.full((4, 4), np.nan))
    effects: NDArray[np.float64] = field(default_factory=lambda: np.zeros((SIZE, 12 * JUMPS)))
    jump_information: NDArray[np.float64] = field(default_factory=lambda: np.zeros((JUMPS, 12, 12)))
    jump_score: NDArray[np.float64] = field(default_factory=lambda: np.zeros((JUMPS, 12)))
    jump_times: NDArray[np.float64] = field(default_factory=lambda: np.full(JUMPS, -np.inf))
    used: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(_SENSORS)))
    rejected: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(_SENSORS)))
    in_a_row: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(_SENSORS)))
    times: NDArray[np.float64] = field(default_factory=lambda: np.full(len(_SENSORS), -np.inf))
    repeats: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(_SENSORS)))
    recent_gyro: NDArray[np.float64] = field(default_factory=lambda: np.full((3, 4), np.nan))
    doubtful_gyro: NDArray[np.float64] = field(default_factory=lambda: np.full(4, np.nan))

    def copy(self) -> "FilterState":
        """Return a copy that shares no memory with this state."""
        return FilterState(**{name: value.copy() for name, value in vars(self).items()})

    def pack(self) -> NDArray[np.float64]:
        """Return the whole state as one vector."""
        return np.concatenate([np.ravel(value) for value in vars(self).values()])

    def keep_screening(self, other: "FilterState") -> None:
        """Copy the records of samples and of jumps from another state, but not its estimates."""
        for name in _SCREENING:
            setattr(self, name, getattr(other, name))


_SCREENING = (
    *("momentum_known", "momentum_changes", "momentum_change_time", "step_time", "used"),
    *("rejected", "times", "latest", "repeats", "recent_gyro", "recent_encoders", "late"),
    *("doubtful_gyro", "doubtful_encoders"),
)


class MomentumFilter:
    """The filter's equations for one spacecraft and one sensor suite; it contains no state.

    Args:
        suite: the sensors.
        joint_count: J.
        dynamics: function of q (J,) and qdot (N, J) that returns the dynamics relative to the base,
            such as `PlantRelativeDynamics`.
        prior: what is known before the first sample.

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
        self._present = suite.present()
        self._has_gyro = suite.gyro is not None
        self._gyro_errors = suite.gyro or Gyro()
        self._encoder_errors = suite.encoders or JointSensor()
        if self._has_gyro:
            self._gyro_variance = suite.sigmas("gyro")[0] ** 2
            self._attitude_growth = self._gyro_variance / self._gyro_errors.rate
            self._bias_growth = self._gyro_errors.bias_growth**2
        self._joint_sigma = suite.sigmas("encoders")[0]
        self._variance = {
            name: suite.sigmas(name)[0] ** 2 * np.eye(3)
            for name in ("position", "velocity")
            if getattr(suite, name) is not None
        }
        if suite.attitude is not None:
            R_BS = suite.attitude.R_BS
            self._variance["attitude"] = R_BS * suite.sigmas("attitude") ** 2 @ R_BS.T
        self._unit_rates = np.eye(joint_count)
        fastest = max((sensor.rate for sensor in self._present.values()), default=1.0)
        self._silence = max(LONGEST_SILENCE, 2.5 / fastest)
        self._repeats_allowed = self._allowed_repeats()
        angular, velocity = prior.angular_momentum, prior.velocity
        self._change = np.zeros((SIZE, 12))
        for k, (where, sigma) in enumerate(
            zip((ANGULAR, BY_MOMENTUM, VELOCITY, COM), (angular, OFFSETS[0], velocity, OFFSETS[1]))
        ):
            self._change[where, 3 * k : 3 * k + 3] = sigma * np.eye(3)

    def _allowed_repeats(self) -> dict[str, int]:
        """Return how often a noisy sensor may repeat a value; a stuck sensor exceeds it."""
        sensors = self.suite.present()
        noisy = {"attitude": 1, "gyro": 0, "position": 0, "velocity": 0}
        noisy = {name: count for name, count in noisy.items() if name in sensors}
        if self.suite.rounding is not None:
            return {}
        return {
            name: count
            for name, count in noisy.items()
            if max(np.atleast_1d(getattr(sensors[name], "sigmas", 0.0)).max(), 0.0)
            or getattr(sensors[name], "sigma", 0.0)
        }

    def start(self) -> FilterState:
        """Return the state before the first sample."""
        prior, J = self.prior, self.joint_count
        P = np.zeros((SIZE, SIZE))
        P[PSI, PSI] = np.diag(prior.psi_sigma**2)
        if self._has_gyro:
            P[BIAS, BIAS] = max(self._gyro_errors.bias_sigma, 1e-9) ** 2 * np.eye(3)
        state = FilterState(
            prior.psi.copy(),
            P,
            joints=np.full((2, 1 + J), np.nan),
            rates=np.zeros(J),
            response=np.zeros((3, J + 3, 10)),
            known_part=np.zeros((3, J + 3)),
            q_before=np.zeros(J),
            latest=np.full((len(_SENSORS), max(4, J)), np.nan),
            recent_encoders=np.full((3, 1 + J), np.nan),
            doubtful_encoders=np.full(1 + J, np.nan),
            late=np.full(2 + max(4, J), np.nan),
            momentum_known=np.bool_(prior.momentum_known),
            L=np.array(prior.L, dtype=float),
            v_Wcm=np.array(prior.v_Wcm, dtype=float),
        )
        if not prior.momentum_known:
            self.open_momentum(state)
        return state

    @staticmethod
    def index(name: str) -> int:
        """Return a sensor's place in `FilterState.times`, `used`, `rejected` and `in_a_row`."""
        return _INDEX[name]

    def process(self, state: FilterState, name: str, time: float, value: NDArray) -> None:
        """Process one sample of a sensor and update the state in place; count unusable samples.

        The caller should pass samples of the same instant in `FILTER_ORDER`.

        Args:
            state: the filter's state; it is changed.
            name: name of the sensor.
            time: time of the sample [s].
            value: (width,) the sample, as in `Measurements`.

        """
        for sample in self.screen(state, name, time, value):
            self.update(state, *sample)

    # -- screening: checks that need no prediction ------------------------------------------------

    def screen(self, state: FilterState, name: str, time: float, value: NDArray) -> list[Sample]:
        """Screen a sample and return those that can now be processed: none, this one, or two.

        A sample is rejected if it is not finite, is not a valid attitude, is not later than the
        sensor's last sample, or comes from a stuck sensor (a noisy sensor that repeats a value, or
        encoders that all stop from one sample to the next). Two kinds of samples are kept until the
        next one confirms them:

        - a sample that is later than all others by more than `LONGEST_SILENCE`, and the very first
          sample: two such samples in a row indicate a gap, a single one is an error;
        - a gyro or encoder sample that no smooth motion can reach (see `SMOOTHEST`): if the next
          sample continues the earlier motion, the kept sample was a spike.
        """
        value = np.asarray(value, dtype=float)
        entries = value.tolist()
        possible = name in self._present and math.isfinite(time)
        possible = possible and all(abs(entry) < LARGEST for entry in entries)
        if possible and name == "attitude":
            possible = abs(math.hypot(*entries) - 1) < 1e-3
        if not possible:
            state.rejected[_INDEX[name]] += 1
            return []
        newest, waiting = state.times.max(), state.late[1]
        if time - newest > self._silence:
            if not abs(time - waiting) <= self._silence:
                self._forget_late(state)
                state.late[:2] = _INDEX[name], time
                state.late[2 : 2 + value.size] = value
                return []
            k = int(state.late[0])
            width = self.joint_count if _SENSORS[k] in ("encoders", "joint_rates") else 3
            first = state.late[2 : 2 + (4 if _SENSORS[k] == "attitude" else width)].copy()
            state.late[:] = np.nan
            samples = self._screened(state, _SENSORS[k], float(waiting), first)
            return samples + self._screened(state, name, time, value)
        if waiting == waiting:
            self._forget_late(state)
        return self._screened(state, name, time, value)

    @staticmethod
    def _forget_late(state: FilterState) -> None:
        if not np.isnan(state.late[0]):
            state.rejected[int(state.late[0])] += 1
            state.late[:] = np.nan

    def _screened(self, state: FilterState, name: str, time: float, value: NDArray) -> list[Sample]:
        """Screen a sample whose time is accepted; see `screen`."""
        k = _INDEX[name]
        last = state.times[k]
        if not time > last or self._is_stuck(state, k, name, time, value):
            state.rejected[k] += 1
            return []
        state.times[k] = time
        if name not in SMOOTHEST:
            return [(name, time, value)]
        sigma = self._joint_sigma if name == "encoders" else math.sqrt(self._gyro_variance)
        recent = getattr(state, f"recent_{name}")
        doubtful = getattr(state, f"doubtful_{name}")
        pending = doubtful[0] == doubtful[0]
        if time - (doubtful[0] if pending else last) > LONGEST_GAP:
            # There is nothing to compare with: start again from this sample.
            if pending:
                state.rejected[k] += 1
                doubtful[0] = np.nan
            recent[:] = np.nan
            pending = False
        elif not self._follows(recent, time, value, sigma, SMOOTHEST[name]):
            sample = np.concatenate([[time], value])
            if pending:
                earlier = doubtful.copy()
                doubtful[0] = np.nan
                if not self._follows(earlier[None], time, value, sigma, SMOOTHEST[name]):
                    state.rejected[k] += 1
                    doubtful[:] = sample
                    return []
                # The sample was a step or a jerk, not a spike: the motion continues from it.
                recent[0], recent[1], recent[2] = np.nan, earlier, sample
                if name == "gyro":
                    state.step_time = np.float64(earlier[0])
                return [(name, float(earlier[0]), earlier[1:]), (name, time, value)]
            doubtful[:] = sample
            return []
        if pending:
            state.rejected[k] += 1
            doubtful[0] = np.nan
        recent[:-1] = recent[1:]
        recent[-1, 0], recent[-1, 1:] = time, value
        return [(name, time, value)]

    def _is_stuck(self, state: FilterState, k: int, name: str, time: float, value: NDArray) -> bool:
        latest = state.latest[k, : value.size]
        same = (latest == value).all()
        if not same:
            state.latest[k, : value.size], state.repeats[k] = value, 0.0
            return False
        state.repeats[k] += 1
        if name != "encoders":
            return state.repeats[k] > self._repeats_allowed.get(name, math.inf)
        (before, last), (q, q_last) = state.recent_encoders[-2:, 0], state.recent_encoders[-2:, 1:]
        if state.repeats[k] == 1 and last - before <= LONGEST_GAP:
            moved = np.abs(q_last - q).max()
            braked = moved / (last - before) / (time - last)
            if braked > HARDEST_BRAKE and moved > 10 * self._joint_sigma:
                state.repeats[k] = math.inf  # until the value changes
        return math.isinf(state.repeats[k])

    @staticmethod
    def _follows(recent: NDArray, time: float, value: NDArray, sigma: float, bounds: tuple) -> bool:
        """Return whether a sample continues the polynomial through the recent ones (time, value).

        The bounds are the limits of the lowest derivative that is zero for the polynomial.
        """
        times = [t for t in recent[:, 0].tolist() if t == t]
        order = len(times)
        if not order:
            return True
        weights, rest = [], 1.0
        for i, t in enumerate(times):
            weight = 1.0
            for j, other in enumerate(times):
                if i != j:
                    weight *= (time - other) / (t - other)
            weights.append(weight)
            rest *= (time - t) / (i + 1)
        off = np.array(weights) @ recent[-order:, 1:] - value
        gain = math.sqrt(1 + sum(weight * weight for weight in weights))
        limit = SPIKE * gain * sigma + bounds[order - 1] * rest
        return max(off.max(), -off.min()) <= limit

    # -- processing of accepted samples -----------------------------------------------------------

    def update(self, state: FilterState, name: str, time: float, value: NDArray) -> None:
        """Update the state in place with an accepted sample; count outliers."""
        if name == "joint_rates":
            return  # the filter uses encoders only: their noise does not accumulate
        k = _INDEX[name]
        if getattr(self, f"_{name}")(state, time, value):
            state.used[k] += 1
            state.in_a_row[k] = 0
        else:
            state.rejected[k] += 1

    def resume(
        self, state: FilterState, time: float, q: NDArray, measurements: Measurements
    ) -> None:
        """Complete a state, so that the filter continues from `time` after these measurements."""
        state.attitude_known = np.True_
        state.com_known = np.bool_(len(measurements.position) > 0)
        state.joints[0, 0], state.joints[0, 1:] = time, q
        encoders = measurements.encoders
        before = min(int(np.searchsorted(encoders.time, time - 0.1)), len(encoders) - 1)
        state.q_before[:] = encoders.value[before]
        state.noise_time = np.float64(time - 0.1)
        gyro = measurements.gyro
        count = min(len(gyro), len(state.gyro))
        if count:
            state.gyro[-count:, 0] = gyro.time[-count:]
            state.gyro[-count:, 1:] = gyro.value[-count:]
            state.w[:] = gyro.value[-1] - state.bias
            # The attitude is the one at `time`; the latest gyro sample may be a little older.
            turn = exp(state.w * (gyro.time[-1] - time))
            state.R_by_gyro = state.R_by_gyro @ turn
        self._refresh_joint_noise(state, time, self._look(state))
        R = state.R_by_momentum
        state.P[BY_MOMENTUM, BY_MOMENTUM] += R @ state.joint_noise @ R.T
        self._restart_jump_tests(state, time)

    def well_known(self, state: FilterState) -> bool:
        """Return whether ψ is known well enough for this filter to start from it.

        Encoder errors also enter the regressors. They are harmless there when the uncertainty of ψ
        changes the variance of their effect only a little: here by at most 1 %.
        """
        self._refresh_joint_noise(state, state.joints[0, 0], self._look(state))
        return bool(np.trace(state.unsure_noise) < 0.01 * np.trace(state.joint_noise))

    def open_momentum(self, state: FilterState, angular: bool = True) -> None:
        """Make the momentum unknown, or only the linear momentum."""
        state.momentum_known = np.False_
        state.P[VELOCITY, VELOCITY] += self.prior.velocity**2 * np.eye(3)
        # The centre of mass may have moved before the change was detected.
        state.P[COM, COM] += (0.1 * self.prior.velocity) ** 2 * np.eye(3)
        if angular:
            state.P[ANGULAR, ANGULAR] += self.prior.angular_momentum**2 * np.eye(3)

    # -- attitude --------------------------------------------------------------------------------

    def _attitude(self, state: FilterState, time: float, value: NDArray) -> bool:
        R = quaternion_to_matrix(value)
        noise = self._variance["attitude"]
        if not state.attitude_known:
            self._set_attitude(state, R, time)
            return True
        where, R_state, at = self._best_attitude(state)
        if not abs(time - at) <= LONGEST_GAP:
            return False
        R_predicted = R_state @ exp(state.w * (time - at)) if time != at else R_state
        H = np.zeros((3, SIZE))
        H[:, where] = R_predicted.T
        if where == BY_MOMENTUM:
            noise = noise + state.joint_noise
        innovation = log(R_predicted.T @ R)
        if self._update_by(state, innovation, H, noise):
            return True
        if self._too_many(state, "attitude"):
            if where == BY_GYRO or not self._correct_jump(state, time, (0,), GATE):
                if where == BY_MOMENTUM:
                    self._momentum_changed(state, time)
                    self.open_momentum(state)
                self._set_attitude(state, R, time)
            return True
        return False

    def _best_attitude(self, state: FilterState) -> tuple[slice, NDArray, float]:
        """Return the attitude that is compared with pose sensors: its slice, value and time."""
        newest = state.gyro[-1, 0]
        if newest == newest and not state.joints[0, 0] - newest > LONGEST_GAP:
            return BY_GYRO, state.R_by_gyro, newest
        return BY_MOMENTUM, state.R_by_momentum, state.joints[0, 0]

    def _set_attitude(self, state: FilterState, R: NDArray, time: float) -> None:
        """Reset both attitudes to one sample."""
        noise = self._variance["attitude"]
        gyro, joints = state.gyro[-1, 0], state.joints[0, 0]
        behind = [0.0 if np.isnan(at) else time - at for at in (joints, gyro)]
        state.R_by_momentum = R @ exp(-state.w * behind[0])
        state.R_by_gyro = R @ exp(-state.w * behind[1])
        variance = R @ noise @ R.T
        for where in (BY_MOMENTUM, BY_GYRO):
            state.P[where, :] = state.P[:, where] = 0.0
        for a in (BY_MOMENTUM, BY_GYRO):
            for b in (BY_MOMENTUM, BY_GYRO):
                state.P[a, b] = variance
        slip = 0.0 if np.isfinite(gyro) else (LARGEST_STEP * behind[0]) ** 2
        R = state.R_by_momentum
        state.P[BY_MOMENTUM, BY_MOMENTUM] += R @ state.joint_noise @ R.T + slip * np.eye(3)
        state.attitude_known = np.True_
        self._restart_jump_tests(state, time)

    # -- gyro ------------------------------------------------------------------------------------

    def _gyro(self, state: FilterState, time: float, value: NDArray) -> bool:
        last = state.gyro[-1, 0]
        if not (state.attitude_known and time - last <= LONGEST_GAP):
            # There is no attitude to propagate.
            if last == last:
                state.P[BIAS, BIAS] += self._bias_growth * (time - last) * np.eye(3)
            state.gyro[:] = np.nan
            state.gyro[-1, 0], state.gyro[-1, 1:] = time, value
            state.w[:] = value - state.bias
            self._carry_gyro_on(state, time)
            return True
        self._propagate_by_gyro(state, time, value, stepped=time == state.step_time)
        return True

    def _carry_gyro_on(self, state: FilterState, time: float) -> None:
        """Set the attitude by gyro to the attitude by momentum."""
        behind = time - state.joints[0, 0]
        if behind > LONGEST_GAP:
            state.attitude_known = np.False_  # the attitude is too old: wait for a sample
        if not (state.attitude_known and behind > 0):
            return
        state.R_by_gyro = state.R_by_momentum @ exp(state.w * behind)
        self._adopt(state, BY_GYRO, BY_MOMENTUM)
        # One angular velocity is used for the whole interval: its change is the error.
        state.P[_BY_GYRO_DIAGONAL] += (SMOOTHEST["gyro"][0] * behind**2) ** 2 / 12

    def _propagate_by_gyro(
        self, state: FilterState, time: float, value: NDArray, stepped: bool
    ) -> None:
        (before, last), (w_before, w_last) = state.gyro[-2:, 0].tolist(), state.gyro[-2:, 1:]
        elapsed, gap = time - last, last - before
        if stepped or not gap <= LONGEST_GAP:
            mean = (value + w_last) / 2
        else:
            # This is the mean, over the interval, of the parabola through three samples.
            newest = (elapsed / 3 + gap / 2) / (elapsed + gap)
            oldest = -(elapsed**2) / (6 * gap * (elapsed + gap))
            mean = newest * value + oldest * w_before + (1 - newest - oldest) * w_last
        w = value - state.bias
        turn = (mean - state.bias) * elapsed
        turn += elapsed**2 / 12 * _cross(w_last - state.bias, w)
        M = np.zeros((3, SIZE))
        M[:, BY_GYRO] = _EYE
        M[:, BIAS] = -elapsed * state.R_by_gyro
        growth = self._attitude_growth * elapsed
        if stepped:
            # The jump was at an unknown instant between the two samples.
            jump = value - w_last
            growth += (jump @ jump) * elapsed**2 / 12
        _propagate_covariance(state.P, BY_GYRO, M, growth)
        state.P[_BIAS_DIAGONAL] += self._bias_growth * elapsed
        state.effects[BY_GYRO] = M @ state.effects
        state.R_by_gyro = state.R_by_gyro @ exp(turn)
        if stepped:
            state.gyro[:] = np.nan
        state.gyro[:-1] = state.gyro[1:]
        state.gyro[-1, 0], state.gyro[-1, 1:] = time, value
        state.w[:] = w

    # -- encoders --------------------------------------------------------------------------------

    def _encoders(self, state: FilterState, time: float, value: NDArray) -> bool:
        start, middle = state.joints
        waiting = middle[0] == middle[0]
        last = middle[0] if waiting else start[0]
        if not (state.attitude_known and time - last <= LONGEST_GAP):
            self._start_joints(state, time, value)
            return True
        if not waiting:
            middle[0], middle[1:] = time, value
            return True
        if np.abs(value - start[1:]).max() > FASTEST_JOINT * (time - start[0]):
            self._start_joints(state, time, value)
            return True
        dynamics = self._propagate_by_momentum(state, time, value)
        if time - state.noise_time > 0.1 - 1e-9:
            self._refresh_joint_noise(state, time, dynamics)
        if self._has_gyro:
            self._agree(state, time)
        self._test_jumps(state, time)
        return True

    def _start_joints(self, state: FilterState, time: float, value: NDArray) -> None:
        """Restart the propagation by momentum, from the attitude by gyro if there is one."""
        before = state.joints[0, 0]
        lost = before == before
        if lost:
            self._propagate_com(state, time - before)
        state.joints[0, 0], state.joints[0, 1:], state.joints[1, 0] = time, value, np.nan
        state.rates[:] = 0.0
        state.q_before[:] = value
        self._refresh_joint_noise(state, time, self._look(state))
        if state.attitude_known and 0 <= time - state.gyro[-1, 0] <= LONGEST_GAP:
            self._rejoin(state, time)
        elif lost:
            state.attitude_known = np.False_  # no gyro to bridge the gap: wait for an attitude
        self._restart_jump_tests(state, time)

    def _propagate_by_momentum(
        self, state: FilterState, time: float, value: NDArray
    ) -> RelativeDynamics:
        """Propagate the attitude by momentum over two encoder intervals, by Simpson's rule.

        The joint motion is a parabola through three samples.

        Returns:
            The dynamics at the end, for unit joint rates.

        """
        t0, t1 = state.joints[:, 0].tolist()
        q0, q1 = state.joints[:, 1:]
        T, part = time - t0, (t1 - t0) / (time - t0)
        curved = np.zeros(len(value))
        if 0.2 < part < 0.8:
            curved = ((value - q0) - (q1 - q0) / part) / (1 - part)
        slope = (value - q0) - curved
        rates = np.stack([slope, slope + curved, slope + 2 * curved]) / T
        middle = self.dynamics(q0 + slope / 2 + curved / 4, rates[1:2])
        parts = [(state.response, state.known_part, rates[0]), (*_response(middle), _ONE)]
        state.joints[0, 0], state.joints[0, 1:], state.joints[1, 0] = time, value, np.nan
        state.rates[:] = rates[2]
        end = self._look(state)
        parts.append((state.response, state.known_part, rates[2]))

        fresh = self._has_gyro and time - state.gyro[-1, 0] <= LONGEST_GAP
        mean = state.w if fresh else state.w_before
        half = exp(mean * (T / 2))
        nodes = np.stack([_EYE, half, half @ half])
        # For the derivatives, the attitude by gyro is more accurate than the attitude by momentum.
        R = state.R_by_gyro @ nodes[2].T if fresh else state.R_by_momentum
        R_nodes = R @ nodes

        psi = state.psi
        J, h = _momenta(parts, psi)
        if not _well_positive(J[1], middle.I_K[0]):
            psi = self.prior.psi  # any physically consistent ψ serves as point of linearization
            J, h = _momenta(parts, psi)
        inverse = np.linalg.inv(J)
        if fresh:
            w_true = self._angular_velocities(state, (t0, t0 + T / 2, time))
        else:
            L_B = state.L @ R_nodes
            w_true = (inverse @ (L_B - h)[..., None])[..., 0]
        Y = np.stack(
            [np.concatenate([by, w]) @ response for (response, _, by), w in zip(parts, w_true)]
        )
        if psi is not state.psi:
            h = h + Y @ (state.psi - psi)
        turning = state.L.any()
        nodes = state.R_by_momentum @ nodes
        for _ in range(2 if turning else 1):
            momentum = state.L @ nodes if turning else 0.0
            w = (inverse @ (momentum - h)[..., None])[..., 0]
            turn = T / 6 * (w[0] + 4 * w[1] + w[2]) + T**2 / 12 * _cross(w[0], w[2])
            if turning:  # with momentum the velocities depend on the attitude
                halfway = T / 24 * (5 * w[0] + 8 * w[1] - w[2])
                R = state.R_by_momentum
                nodes = np.stack([R, R @ exp(halfway), R @ exp(turn)])

        weighted = R_nodes @ inverse * (T / 6 * _SIMPSON)
        M = np.zeros((3, SIZE))
        M[:, PSI] = -(weighted @ Y).sum(axis=0)
        M[:, BY_MOMENTUM] = _EYE
        M[:, ANGULAR] = spread = (weighted @ R_nodes.transpose(0, 2, 1)).sum(axis=0)
        if turning:
            M[:, BY_MOMENTUM] += spread @ skew(state.L)
        _propagate_covariance(state.P, BY_MOMENTUM, M, state.rate_noise * T)
        state.effects[BY_MOMENTUM] = M @ state.effects
        state.R_by_momentum = state.R_by_momentum @ exp(turn)
        state.w_before[:] = w[2]
        self._propagate_com(state, T)
        if not fresh:
            state.w[:] = w[2]
        return end

    @staticmethod
    def _propagate_com(state: FilterState, elapsed: float) -> None:
        """Propagate the centre of mass by its velocity."""
        state.p_Wcm += state.v_Wcm * elapsed
        P = state.P
        P[COM] += elapsed * P[VELOCITY]
        P[:, COM] += elapsed * P[:, VELOCITY]
        state.effects[COM] += elapsed * state.effects[VELOCITY]

    @staticmethod
    def _angular_velocities(state: FilterState, times: tuple) -> NDArray:
        """Return the gyro's angular velocities (N, 3), without bias, at N of its latest times."""
        latest = state.gyro[-3:]
        if all(abs(a - b) < 1e-9 for a, b in zip(latest[:, 0].tolist(), times)):
            return latest[:, 1:] - state.bias
        known = np.isfinite(state.gyro[:, 0])
        at, samples = state.gyro[known, 0], state.gyro[known, 1:]
        return np.stack([np.interp(times, at, axis) for axis in samples.T], axis=1) - state.bias

    def _agree(self, state: FilterState, time: float) -> None:
        """Update by the agreement of both attitudes, except for the latest encoder error."""
        behind = time - state.gyro[-1, 0]
        if not 0 <= behind <= LONGEST_GAP or state.doubtful_gyro[0] == state.doubtful_gyro[0]:
            return
        R = state.R_by_gyro @ exp(state.w * behind) if behind > 1e-9 else state.R_by_gyro
        H = np.zeros((3, SIZE))
        H[:, BY_MOMENTUM] = R.T
        H[:, BY_GYRO] = -R.T
        innovation = log(state.R_by_momentum.T @ R)
        if self._update_by(state, innovation, H, state.joint_noise):
            state.used[_AGREEMENT] += 1
            state.in_a_row[_AGREEMENT] = 0
            return
        state.rejected[_AGREEMENT] += 1
        if not self._too_many(state, "agreement"):
            return
        if time - state.rejoin_time > SAME_CAUSE:
            # The first difference is an error of gyro or encoders that remains in one attitude.
            state.P[_BY_GYRO_DIAGONAL] += innovation @ innovation
        else:
            self._momentum_changed(state, time)
            self.open_momentum(state)
            # The jump was at an unknown instant between two gyro samples.
            state.P[_BY_GYRO_DIAGONAL] += (LARGEST_STEP / self._gyro_errors.rate) ** 2
        state.rejoin_time = np.float64(time)
        self._rejoin(state, time)
        self._restart_jump_tests(state, time)

    def _rejoin(self, state: FilterState, time: float) -> None:
        """Reset the attitude by momentum to that by gyro, except for the latest encoder error."""
        behind = time - state.gyro[-1, 0]
        state.R_by_momentum = R = state.R_by_gyro @ exp(state.w * behind)
        self._adopt(state, BY_MOMENTUM, BY_GYRO)
        state.P[BY_MOMENTUM, BY_MOMENTUM] += R @ state.joint_noise @ R.T

    @staticmethod
    def _adopt(state: FilterState, where: slice, other: slice) -> None:
        """Copy the error of one attitude to the other."""
        state.P[where, :] = state.P[other, :]
        state.P[:, where] = state.P[:, other]
        state.effects[where] = state.effects[other]

    # -- position and velocity --------------------------------------------------------------------

    def _position(self, state: FilterState, time: float, value: NDArray) -> bool:
        return self._about_com(state, time, value, "position")

    def _velocity(self, state: FilterState, time: float, value: NDArray) -> bool:
        return self._about_com(state, time, value, "velocity")

    def _about_com(self, state: FilterState, time: float, value: NDArray, name: str) -> bool:
        start, middle = state.joints
        ahead = time - start[0]
        where, R, at = self._best_attitude(state)
        if not (state.attitude_known and abs(ahead) <= LONGEST_GAP):
            return False
        if not abs(time - at) <= LONGEST_GAP:
            return False
        if abs(time - at) > 1e-9:
            R = R @ exp(state.w * (time - at))
        com_part = state.com_part
        if abs(ahead) > 1e-9:
            # The joint positions are extrapolated a little from the latest samples.
            rates = state.rates
            if middle[0] == middle[0]:
                rates = (middle[1:] - start[1:]) / (middle[0] - start[0])
            com_part = _com_part(self.dynamics(start[1:] + rates * ahead, rates[None]))
        by_rho = com_part[:, 1:]
        rho = com_part[:, 0] + by_rho @ state.psi[:4]
        H = np.zeros((3, SIZE))
        noise = self._variance[name] + R @ state.com_noise @ R.T
        if name == "position":
            arm = R @ rho
            predicted = state.p_Wcm + state.v_Wcm * ahead - arm
            H[:, COM] = _EYE
            H[:, VELOCITY] = ahead * _EYE
            H[:, :4] = -R @ by_rho
        else:
            dynamics = self.dynamics(start[1:] + state.rates * ahead, state.rates[None])
            W = skew(state.w)
            arm = R @ (W @ rho + dynamics.com_rate(state.psi)[0])
            predicted = state.v_Wcm - arm
            H[:, VELOCITY] = _EYE
            H[:, :4] = -R @ (W @ by_rho + dynamics.com_rate_regressor()[0])
            # Noise of the joint rates at the end of a parabola through three encoder samples, and
            # the gyro's own noise.
            period = 1 / self._encoder_errors.rate
            noise = noise + R @ state.com_noise @ R.T * (6.5 / period**2)
            if self._has_gyro:
                lever = R @ skew(rho)
                noise = noise + self._gyro_variance * lever @ lever.T
        H[:, where] = skew(arm)
        if name == "position" and not state.com_known:
            state.p_Wcm[:] = value + arm - state.v_Wcm * ahead
            state.P[COM, :] = state.P[:, COM] = 0.0
            state.P[COM, COM] = 1e2 * (1 + rho @ rho) * _EYE
            state.com_known = np.True_
            predicted = value
        if self._update_by(state, value - predicted, H, noise):
            return True
        if self._too_many(state, name) and not self._correct_jump(state, time, (1,), GATE):
            self._momentum_changed(state, time)
            self.open_momentum(state, angular=False)
            self._restart_jump_tests(state, time)
            state.com_known = np.False_
        return False

    # -- the filter's steps ----------------------------------------------------------------------

    def _update_by(
        self, state: FilterState, innovation: NDArray, H: NDArray, noise: NDArray
    ) -> bool:
        """Update the state by an innovation, unless the innovation fails the gate."""
        P = state.P
        PHt = P @ H.T
        inverse = np.linalg.inv(H @ PHt + noise)
        weighted = inverse @ innovation
        if not innovation @ weighted <= GATE:
            return False
        K = PHt @ inverse
        # Joseph's form, (1 − K H) P (1 − K H)ᵀ + K noise Kᵀ.
        A = _IDENTITY - K @ H
        P = A @ P @ A.T + K @ noise @ K.T
        state.P = (P + P.T) / 2
        seen = H @ state.effects
        state.effects -= K @ seen
        seen = seen.reshape(3, JUMPS, 12).transpose(1, 2, 0)
        by_change = seen @ inverse
        state.jump_information += by_change @ seen.transpose(0, 2, 1)
        state.jump_score += by_change @ innovation
        self._retract(state, K @ innovation)
        return True

    @staticmethod
    def _retract(state: FilterState, change: NDArray) -> None:
        """Add an error (28,) to the estimate."""
        state.psi += change[PSI]
        state.R_by_momentum = exp(change[BY_MOMENTUM]) @ state.R_by_momentum
        state.R_by_gyro = exp(change[BY_GYRO]) @ state.R_by_gyro
        state.p_Wcm += change[COM]
        state.bias += change[BIAS]
        state.L += change[ANGULAR]
        state.v_Wcm += change[VELOCITY]

    @staticmethod
    def _too_many(state: FilterState, name: str) -> bool:
        k = _INDEX[name]
        state.in_a_row[k] += 1
        return state.in_a_row[k] >= IN_A_ROW[name]

    # -- changes of momentum -----------------------------------------------------------------------

    @staticmethod
    def _momentum_changed(state: FilterState, time: float) -> None:
        state.momentum_changes += 1
        state.momentum_change_time = np.float64(time)
        state.in_a_row[:] = 0

    def _restart_jump_tests(self, state: FilterState, time: float) -> None:
        """Drop all tested instants, and test this one from now on."""
        state.effects[:] = 0.0
        state.jump_information[:] = 0.0
        state.jump_score[:] = 0.0
        state.jump_times[:] = -np.inf
        self._add_jump_test(state, 0, time)

    def _add_jump_test(self, state: FilterState, slot: int, time: float) -> None:
        state.effects[:, 12 * slot : 12 * slot + 12] = self._change
        state.jump_information[slot] = 0.0
        state.jump_score[slot] = 0.0
        state.jump_times[slot] = time

    def _test_jumps(self, state: FilterState, time: float) -> None:
        """Test for a jump of momentum once in `SPACING`, and add an instant to test."""
        if time - state.jump_times.max() < SPACING - 1e-9:
            return
        if not self._correct_jump(state, time, (0, 1), CHANGED):
            # Older instants are spaced more widely: drop the one closest to its neighbours.
            age = time - state.jump_times
            order = np.argsort(age)
            older = np.append(age[order[1:]], np.inf)
            younger = np.insert(age[order[:-1]], 0, 0.0)
            slot = (
                order[(older - younger)[:-1].argmin()] if np.isfinite(age).all() else age.argmax()
            )
            self._add_jump_test(state, int(slot), time)

    def _correct_jump(
        self, state: FilterState, time: float, groups: tuple[int, ...], threshold: float
    ) -> bool:
        """Correct for the most likely jump of momentum, if one is likely enough.

        Args:
            state: the filter's state; it is changed.
            time: now [s].
            groups: 0 for angular, 1 for linear momentum.
            threshold: threshold of the likelihood ratio.

        """
        started = np.isfinite(state.jump_times)
        columns: list[int] = []
        for group in groups:
            mine = np.arange(6 * group, 6 * group + 6)
            if self._most_likely_jumps(state, mine)[1][started].max(initial=0.0) > threshold:
                columns.extend(mine.tolist())
        if not columns:
            return False
        found, ratio, covariance = self._most_likely_jumps(state, np.array(columns))
        slot = int(np.where(started, ratio, -1.0).argmax())
        effects = np.asarray(state.effects[:, 12 * slot + np.array(columns, dtype=np.intp)])
        self._retract(state, effects @ found[slot])
        P = state.P + effects @ covariance[slot] @ effects.T
        state.P = (P + P.T) / 2
        state.momentum_known = np.False_
        self._momentum_changed(state, time)
        self._restart_jump_tests(state, time)
        return True

    @staticmethod
    def _most_likely_jumps(
        state: FilterState, columns: NDArray[np.intp]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the most likely jumps (JUMPS, n), their likelihood ratios and covariances."""
        information = state.jump_information[:, columns[:, None], columns]
        score = state.jump_score[:, columns]
        covariance = np.linalg.inv(information + np.eye(len(columns)))
        found = (covariance @ score[..., None])[..., 0]
        ratio = np.asarray((found * score).sum(axis=-1))
        return found, ratio, np.asarray(covariance)

    # -- joints ---------------------------------------------------------------------------------

    def _look(self, state: FilterState) -> RelativeDynamics:
        """Store the response at the positions `joints[0]`; return the dynamics for unit rates."""
        dynamics = self.dynamics(state.joints[0, 1:], self._unit_rates)
        state.response, state.known_part = _response(dynamics)
        state.com_part = _com_part(dynamics)
        return dynamics

    def _refresh_joint_noise(
        self, state: FilterState, time: float, dynamics: RelativeDynamics
    ) -> None:
        """Compute the covariances that one encoder sample's error causes, in B."""
        joints, psi = self.joint_count, state.psi
        response, known = state.response, state.known_part
        momenta = response @ psi + known
        if not _well_positive(momenta[:, joints:], dynamics.I_K[0]):
            psi = self.prior.psi
            momenta = response @ psi + known
        inverse = np.linalg.inv(momenta[:, joints:])
        turn, com = inverse @ momenta[:, :joints], dynamics.com_rate(psi).T
        variance = np.full(joints, self._joint_sigma**2)
        step, elapsed = self._encoder_errors.step, time - state.noise_time
        q = state.joints[0, 1:]
        if step:
            # Rounding errors are white only if every sample is rounded to a different step. A slow
            # joint keeps the same rounding error until its next step.
            moved = np.abs(q - state.q_before) / max(elapsed * self._encoder_errors.rate, 1.0)
            variance *= np.clip(step / np.maximum(moved, 1e-300), 1.0, SLOWEST)
        # The uncertainty of ψ makes the effect of joint errors uncertain.
        by_psi = (response @ state.P[PSI, PSI]).reshape(3, -1)
        weights = np.concatenate([variance, np.zeros(3)])[:, None]
        unsure = by_psi @ (weights * response).reshape(3, -1).T
        # 1e-9 rad and m: about the precision of a filter in double precision.
        state.unsure_noise = inverse @ unsure @ inverse.T
        state.joint_noise = turn * variance @ turn.T + state.unsure_noise + 1e-18 * _EYE
        state.com_noise = com * variance @ com.T + 1e-18 * _EYE
        if self._has_gyro:
            by_turn = response[:, joints:]
            unsure = by_psi.reshape(3, -1, 10)[:, joints:].reshape(3, -1) @ by_turn.reshape(3, -1).T
            variance_of_rate = np.trace(inverse @ unsure @ inverse.T) / 3
            state.rate_noise = np.float64(self._attitude_growth * variance_of_rate)
        state.q_before[:] = q
        state.noise_time = np.float64(time)


# -- angular momentum as a linear function ---------------------------------------------------------

_EYE, _ONE, _IDENTITY = np.eye(3), np.ones(1), np.eye(SIZE)
_SIMPSON = np.array([1.0, 4.0, 1.0])[:, None, None]
_BIAS_DIAGONAL = (_IN_ORDER[BIAS], _IN_ORDER[BIAS])
_BY_GYRO_DIAGONAL = (_IN_ORDER[BY_GYRO], _IN_ORDER[BY_GYRO])


def _regressor_of_units() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return relative regressors for unit (ṡ, ω): at s = 0 (3, 6, 10), and the part by s (3, 180).

    The regressor is linear in (ṡ, ω), with coefficients that are linear in s.
    """
    units, still = np.eye(6), np.zeros((6, 3))
    at = [
        relative_regressor(still + s, units[:, :3], units[:, 3:]).transpose(1, 0, 2)
        for s in (np.zeros(3), *np.eye(3))
    ]
    return at[0], np.stack([(one - at[0]).ravel() for one in at[1:]])


_AT_ZERO, _BY_S = _regressor_of_units()


def _response(dynamics: RelativeDynamics) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the angular momentum about the centre of mass, in B, for N rates and unit ω.

    Returns:
        Its derivative w.r.t. ψ (3, N + 3, 10) and the known bodies' part (3, N + 3). For the given
        rates times x (N,) and an angular velocity ω it is (known + derivative · ψ) [x, ω].

    """
    R_BC, s = dynamics.R_BC[0], dynamics.s[0]
    N = len(dynamics.sdot)
    motions = np.empty((N + 3, 6))
    motions[:N, :3], motions[:N, 3:] = dynamics.sdot, dynamics.w_BC
    motions[N:, :3], motions[N:, 3:] = R_BC @ skew(s), R_BC
    in_C = motions @ (_AT_ZERO + (s @ _BY_S).reshape(3, 6, 10))
    known = np.empty((3, N + 3))
    known[:, :N], known[:, N:] = dynamics.h_K.T, dynamics.I_K[0]
    return (R_BC @ in_C.reshape(3, -1)).reshape(3, N + 3, 10), known


def _momenta(parts: list[tuple], psi: NDArray) -> tuple[NDArray, NDArray]:
    """Return J (n, 3, 3) and h (n, 3) of n responses with their rates."""
    momenta = [response @ psi + known for response, known, _ in parts]
    J = np.stack([momentum[:, -3:] for momentum in momenta])
    h = np.stack([m[:, :-3] @ rates for m, (_, _, rates) in zip(momenta, parts)])
    return J, h


def _com_part(dynamics: RelativeDynamics) -> NDArray[np.float64]:
    """Return (3, 5): ρ of the known bodies, and the derivative of ρ with respect to (μ, μc)."""
    R_BC = dynamics.R_BC[0]
    part = np.empty((3, 5))
    part[:, 0] = dynamics.p_BK[0]
    part[:, 1], part[:, 2:] = R_BC @ dynamics.s[0] / dynamics.mass, R_BC / dynamics.mass
    return part


def _propagate_covariance(P: NDArray, where: slice, M: NDArray, growth: float) -> None:
    """Propagate P in place: the errors `where` become M (3, 28) times all errors, plus noise."""
    rows = M @ P
    block = rows @ M.T
    P[where] = rows
    P[:, where] = rows.T
    P[where, where] = (block + block.T) / 2 + growth * _EYE


def _well_positive(J: NDArray, reference: NDArray) -> bool:
    """Return whether J is at least a third of the known bodies' inertia in every direction."""
    try:
        np.linalg.cholesky(J - reference / 3)
    except np.linalg.LinAlgError:
        return False
    return True


def _cross(a: NDArray, b: NDArray) -> NDArray:
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
