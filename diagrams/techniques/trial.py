"""A motion and what all sensors measure of it, with the rates and forces that techniques share."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cpid_drake import BodyUncertainty, Log, Motion, SensorSuite, Spacecraft
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.outboard import Outboard
from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    parameter_scale,
    relative_parameterization,
)
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.dynamics.sensitivity import perturbed
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.smoothing import smooth
from cpid_drake.logs.log import sample_times
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.simulation.scenario import SpacecraftConfig
from cpid_drake.simulation.trials import Case, base_trajectory, bound_of, ideal_samples, seeds_of
from techniques.force_sensors import RATE
from techniques.newton_euler import newton_euler_regressor

Array = NDArray[np.float64]

LEFT_OUT = 0.1
"""Time at both ends of a motion of which no rows are made [s]: half cosines start and end with a
step of the acceleration, which no spline follows."""

STEP = 1e-4
"""Half the interval of central differences of motion [s]: their error is 1e-8."""

_STREAM = 100  # random streams that no sensor of a suite has


class Rates:
    """Motion of C and of the spacecraft's bodies with its rates in W, at N instants, all in C.

    Args:
        tree: the spacecraft's bodies.
        around: motion (3 N) at t − `STEP`, t and t + `STEP`.

    Attributes:
        motion: the motion of base and joints at t.
        s, s_ddot: (N, 3) from the spacecraft's centre of mass K to C's origin, and its second
            derivative.
        w, alpha: (N, 3) angular velocity and acceleration of C.
        a: (N, 3) acceleration of C's origin.
        a_B: (N, 3) acceleration of the base's origin.
        K_rate: (N, 3) rate of the spacecraft's angular momentum about K.
        momentum_rate: (N, 6) [L̇ + v × P; Ṗ], with L about C's origin, which moves.
        R_CB: (N, 3, 3) attitude of B in C.

    """

    def __init__(self, tree: KinematicTree, around: Motion) -> None:
        self.tree, self.around, self.motion = tree, around, around.select(slice(1, None, 3))
        m = momentum_samples(tree, around)
        s = m.motion.p_WC - m.p_WKcm
        rate_of_s, L_K = m.motion.v_WC - m.P / m.mass, m.L + np.cross(s, m.P)
        self._R_WC = m.motion.R_WC[1::3]
        moving = (rate_of_s, m.motion.w_WC, m.motion.v_WC, L_K, m.L, m.P, around.v_WB)
        rates = _rates(np.stack(moving, axis=1)) @ self._R_WC  # row vectors: Rᵀ v
        self.s_ddot = rates[:, 0]
        self.alpha = rates[:, 1]
        self.a = rates[:, 2]
        self.K_rate = rates[:, 3]
        L_rate, P_rate = rates[:, 4], rates[:, 5]
        self.a_B = rates[:, 6]
        v, w, P, _ = np.swapaxes(m.in_C[1::3], 0, 1)
        self.w = w
        self.s = rotate(np.swapaxes(self._R_WC, 1, 2), s[1::3])
        self.momentum_rate = np.hstack([L_rate + np.cross(v, P), P_rate])
        self.R_CB = np.swapaxes(self._R_WC, 1, 2) @ self.motion.R_WB

    @cached_property
    def wrench(self) -> Array:
        """Y (N, 6, 10) with Y ψ the wrench [n; f] of the arm on the target about C's origin."""
        return newton_euler_regressor(self.s_ddot, self.alpha, self.w)

    @cached_property
    def efforts(self) -> tuple[Array, Array]:
        """A (N, J, 10) and b (N, J) of the joints' efforts A ψ + b.

        With K at rest, a joint's effort balances the rate of momentum of the bodies that it carries
        (b; see `Outboard.efforts`), the wrench on the target, and the force of a_WK = −f/m_k.
        """
        tree, around, middle = self.tree.lumped, self.around, slice(1, None, 3)
        known = BodyDynamics.at(tree, around.q, around.qdot)
        w = rotate(np.swapaxes(around.R_WB, 1, 2), around.w_WB)
        moving = (around.q, around.qdot, w, -(np.cross(w, known.p_BK) + known.v_BK))
        momentum = np.swapaxes(Outboard.at(tree, *moving).momentum, 0, 1)
        outboard, bodies = Outboard.at(tree, *(each[middle] for each in moving)), tree.jointed
        S = np.stack([outboard.joint_screw(k) for k in bodies], axis=1)
        shifts = np.concatenate([np.zeros((3, 3)), np.eye(3)], axis=1)
        inertia = np.stack(
            [outboard.momentum_by(bodies, np.broadcast_to(e, (1, 1, 6))) for e in shifts], axis=-1
        )
        R_BC, p_BC = known.R_BC[middle], (known.p_BK + rotate(known.R_BC, known.s))[middle]
        n, f = R_BC @ self.wrench[:, :3], R_BC @ self.wrench[:, 3:]
        wrench = np.concatenate([n + skew(p_BC) @ f, f], axis=1)
        chain, k = [], tree.capture_body
        while k > 0:
            chain.append(k)
            k = tree.bodies[k].parent
        loads = np.isin(bodies, chain)[:, None, None] * wrench[:, None]
        loads = loads - np.moveaxis(inertia, 0, 1) @ f[:, None] / tree.mass
        order = np.argsort([tree.bodies[k].joint for k in bodies])
        A = np.einsum("nji,njik->njk", S, loads)[:, order]
        return A, outboard.efforts(np.swapaxes(_rates(momentum), 0, 1))


def _rates(values: Array) -> Array:
    """Return the central differences (N, ...) of values (3 N, ...)."""
    return np.asarray((values[2::3] - values[::3]) / (2 * STEP))


@dataclass(frozen=True, eq=False)
class Measured:
    """Samples of a sensor of forces: exact values (N, k), and draws of its errors of unit size."""

    exact: Array
    noise: Array
    zero: Array
    calibration: Array

    @classmethod
    def of(cls, exact: Array, seed: int | None, stream: int) -> "Measured":
        """Return samples whose errors a seed determines, or without errors."""
        k = exact.shape[1]
        if seed is None:
            return cls(exact, np.zeros(exact.shape), np.zeros(k), np.zeros((6, 6)))
        key = np.random.SeedSequence(seed, spawn_key=(_STREAM + stream,))
        draw = np.random.default_rng(key).standard_normal
        return cls(exact, draw(exact.shape), draw((k,)), draw((6, 6)))

    def by(self, noise: Array | float, zero: Array | float, K: Array | float = 0.0) -> Array:
        """Return the samples (N, k) of a sensor with these σ; K (6, 6) of its calibration."""
        value = self.exact + noise * self.noise + zero * self.zero
        return value + self.exact @ (K * self.calibration).T if np.any(K) else value


@dataclass(frozen=True, eq=False)
class Trial:
    """All that a technique may use: the nominal spacecraft and what the sensors measured.

    Attributes:
        spacecraft: the spacecraft model.
        suite: the errors of the sensors of the base and of the joints.
        log: their samples.
        rates: the smoothed motion, at the instants of rows; the base's position is zero if it is
            not measured.
        known_bodies: uncertainty of the spacecraft's bodies; None if it is exact.
        acceleration: of the base's origin, in B (N, 3), at these instants.
        efforts: of the joints (N, J).
        wrench: of the arm on the target about C's origin, in C (N, 6).
        covariance: (N, n, n) of the smoothed motion, see `smoothing.smooth`; None if it is exact.

    """

    spacecraft: Spacecraft
    suite: SensorSuite
    log: Log
    rates: Rates
    known_bodies: BodyUncertainty | None
    acceleration: Measured
    efforts: Measured
    wrench: Measured
    covariance: Array | None = None


@dataclass(frozen=True, eq=False)
class Truth:
    """What a spacecraft with a target does, at zero momentum, and what all sensors see of it.

    It is sent to other processes before it is used.
    """

    config: SpacecraftConfig
    case: Case

    @cached_property
    def spacecraft(self) -> Spacecraft:
        """The nominal spacecraft."""
        return self.config.make()

    def trial(self, number: int) -> Trial:
        """Return one draw of all errors and, where the spacecraft is uncertain, of its bodies.

        Every technique gets the same numbers: those of the seed and the trial's number.
        """
        suite, bodies = self.case.suite, self.case.known_bodies
        noise, body_seed = seeds_of(self.case.seed, number)
        ideal, rates = self.exact
        if bodies is not None:
            rng = np.random.default_rng(body_seed)
            ideal, rates = self._observed(perturbed(self.spacecraft.tree, bodies, rng))
        log, has_position = add_noise(suite, ideal, noise), suite.position is not None
        motion, covariance = smooth(log, suite, rates.around.time, with_position=has_position)
        trial = self._trial(log, rates, Rates(self.spacecraft.tree, motion), noise)
        return replace(trial, covariance=covariance[1::3])

    def exact_trial(self) -> Trial:
        """Return the trial without any errors; the rates are those of the true motion."""
        ideal, rates = self.exact
        return self._trial(ideal, rates, rates, None)

    @cached_property
    def exact(self) -> tuple[Log, Rates]:
        """Ideal samples and true rates of the nominal spacecraft."""
        return self._observed(self.spacecraft.tree)

    def bound(self) -> float:
        """Return the Cramér-Rao bound of momentum on the worst error of ten parameters.

        NaN if the motion does not determine all of them.
        """
        scale = parameter_scale(self.case.truth.to_vector(), SCALE_LENGTH)
        return float((bound_of(self.case, self.spacecraft) / scale).max())

    def _observed(self, tree: KinematicTree) -> tuple[Log, Rates]:
        names, case = self.spacecraft.joint_names, self.case
        times = sample_times(RATE, case.duration)
        kept = (times >= LEFT_OUT - 1e-9) & (times <= case.duration - LEFT_OUT + 1e-9)
        around = (times[kept][:, None] + STEP * np.array([-1.0, 0.0, 1.0])).ravel()
        base = base_trajectory(case, tree, np.append(0.0, around))
        near = base.to_motion(names, np.append(0.0, around), case.motion).select(slice(1, None))
        return ideal_samples(case, tree, names), Rates(tree, near)

    def _trial(self, log: Log, true: Rates, rates: Rates, seed: int | None) -> Trial:
        tree, (A, b) = true.tree, true.efforts
        psi = relative_parameterization(tree.mass).from_parameters(self.case.truth.to_vector())
        a_B = rotate(np.swapaxes(true.R_CB, 1, 2), true.a_B)
        exact = (a_B, A @ psi + b, true.wrench @ psi)
        acceleration, efforts, wrench = (Measured.of(v, seed, k) for k, v in enumerate(exact))
        case = self.case
        return Trial(
            self.spacecraft,
            case.suite,
            log,
            rates,
            case.known_bodies,
            acceleration,
            efforts,
            wrench,
        )
