"""Recursive least squares with forgetting, and motion of the arms that does not rotate the base.

The rows are the relative ones in B at zero momentum, Y(ω_WB) ψ = −(I_K ω_WB + h_K), which need
neither attitude nor position. Old samples are forgotten with the factor λ per sample:

    K = P Aᵀ (A P Aᵀ + λ)⁻¹,   ψ ← ψ + K (b − A ψ),   P ← (P − K A P)/λ.

The *reactionless* motion moves the joints in the null space of the estimated coupling,
q̇ = (1 − H⁺ H) z with H(ψ̂, q) q̇ the angular momentum of a base at rest. Source: Nguyen-Huynh and
Sharf 2013, "Adaptive reactionless motion and parameter identification in postcapture of space
debris".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from cpid_drake import InertialParameters, InputError, Spacecraft
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.parameterizations import parameter_scale, relative_parameterization
from cpid_drake.dynamics.rotations import rotate
from techniques.trial import Trial

Array = NDArray[np.float64]

WINDOW, DEGREE = 21, 4
"""Samples and degree of the polynomials that give rates at the window's centre, a tenth of a second
late at 100 Hz. Encoders and gyro get the same filter, so that all belong to one instant."""

START_SIGMA = 3e4
"""σ of the start value in units of a target's size, for rows with errors of unit size instead of
3e-5 N·m·s. Less would count; more would let the noise of the first samples lead astray."""

CUT_OFF = 1e-6
"""Singular values of H below this share of the largest count as zero."""


class ForgettingLeastSquares:
    """The recursion for a spacecraft of a known mass [kg], with a factor λ per sample.

    It starts at zero, with a σ of the size of a target of a tenth of this mass.
    """

    def __init__(self, known_mass: float, forgetting: float = 1.0) -> None:
        self.form, mass = relative_parameterization(known_mass), known_mass / 10
        scale = parameter_scale(np.array([mass, 0, 0, 0, *3 * [mass / 10], 0, 0, 0]))
        scale[1:4] *= mass
        self.psi, self.P = np.zeros(10), np.diag((START_SIGMA * scale) ** 2)
        self._forgetting = forgetting

    def update(self, A: Array, b: Array) -> None:
        """Use rows (r, 10) and (r,) of one sample."""
        PA = self.P @ A.T
        gain = np.linalg.solve(A @ PA + self._forgetting * np.eye(len(b)), PA.T).T
        self.psi = self.psi + gain @ (b - A @ self.psi)
        P = (self.P - gain @ PA.T) / self._forgetting
        self.P = (P + P.T) / 2

    @property
    def parameters(self) -> Array:
        """(10,) the estimate."""
        return np.asarray(self.form.to_parameters(self.psi))


def rows_of(known: BodyDynamics, w_B: Array) -> tuple[Array, Array]:
    """Return A (N, 3, 10) and b (N, 3) at angular velocities of the base (N, 3), in B."""
    return known.regressor(w_B), -(rotate(known.I_K, w_B) + known.h_K)


def forgetting_estimate(trial: Trial, memory: float = np.inf) -> Array:
    """Return the last parameters (10,) of the recursion on causally filtered gyro and encoders.

    Args:
        trial: the samples; the gyro and the encoders must have the same times.
        memory: time after which a sample has lost the weight 1 − 1/e [s].

    Raises:
        InputError: the gyro and the encoders have different times, or the gyro measures a mean.

    """
    gyro, encoders = trial.log.gyro, trial.log.encoders
    if trial.suite.gyro is None or trial.suite.gyro.integrates:
        raise InputError("recursive least squares needs a gyro that measures rates, not their mean")
    if not np.array_equal(gyro.time, encoders.time):
        raise InputError("recursive least squares needs a gyro and encoders of the same rate")
    period = float(np.median(np.diff(gyro.time)))

    def filtered(values: Array, derivative: int = 0) -> Array:
        found = savgol_filter(values, WINDOW, DEGREE, derivative, delta=period, axis=0)
        return np.asarray(found[WINDOW // 2 : -(WINDOW // 2)])

    known = BodyDynamics.at(
        trial.spacecraft.tree.lumped, filtered(encoders.value), filtered(encoders.value, 1)
    )
    recursion = ForgettingLeastSquares(trial.spacecraft.mass, float(np.exp(-period / memory)))
    for A, b in zip(*rows_of(known, filtered(gyro.value))):
        recursion.update(A, b)
    return recursion.parameters


@dataclass(frozen=True, eq=False)
class Reactionless:
    """A motion in the null space of the estimated coupling.

    Attributes:
        parameters: (10,) the estimate at its end.
        base_rotation: largest angle by which the base rotated [rad].
        q: (N, J) joint positions.
        quaternion_WB: (N, 4) attitude of the base.

    """

    parameters: Array
    base_rotation: float
    q: Array
    quaternion_WB: Array


def reactionless_motion(
    spacecraft: Spacecraft,
    target: InertialParameters,
    joints: Sequence[int],
    q: Array,
    *,
    noise: tuple[float, float] = (0.0, 0.0),
    seed: int = 1,
    duration: float = 10.0,
    rate: float = 50.0,
    is_free: bool = False,
) -> Reactionless:
    """Simulate an adaptive reactionless motion at velocity level, and identify from it.

    The wanted rates z are two sines for each of the joints, with half of the rate limits; rates
    rise in the first second, and all are smaller if one exceeds its limit. Position limits are
    not looked at.

    Args:
        spacecraft: the spacecraft model.
        target: the true target, which only the base's motion has.
        joints: the joints that may move.
        q: (J,) joint positions at the start.
        noise: σ of a sample of the gyro and of the joint rates [rad/s].
        seed: of the noise.
        duration: [s].
        rate: samples per second.
        is_free: whether the joints make the same sines without regard to the base.

    """
    tree, rng, joints = spacecraft.tree.lumped, np.random.default_rng(seed), list(joints)
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, (2, len(joints)))
    frequencies = np.random.default_rng(2).uniform(0.1, 0.4, (2, len(joints)))
    recursion = ForgettingLeastSquares(spacecraft.mass)
    psi = recursion.form.from_parameters(target.to_vector())
    attitude, poses = Rotation.identity(), []
    limit, units = spacecraft.limits.rates[joints], np.eye(len(q))[joints]
    for time in np.arange(int(duration * rate)) / rate:
        sines = np.sin(2 * np.pi * frequencies * time + phases).sum(axis=0)
        z = min(time, 1.0) * 0.5 * limit * sines
        if not is_free:
            at_units = BodyDynamics.at(tree, np.tile(q, (len(joints), 1)), units)
            H = at_units.momentum_at_rest(recursion.psi).T
            z = z - np.linalg.pinv(H, rcond=CUT_OFF) @ (H @ z)
        z = z / max(np.max(np.abs(z) / limit), 1.0)  # all alike: they remain in the null space
        qdot = z @ units
        measured = qdot + noise[1] * rng.standard_normal(len(q)) * units.any(axis=0)
        both = BodyDynamics.at(tree, np.tile(q, (2, 1)), np.stack([qdot, measured]))
        w_B = both.part(slice(0, 1)).base_twist(psi)[0]
        A, b = rows_of(both.part(slice(1, 2)), w_B + noise[0] * rng.standard_normal(3))
        recursion.update(A[0], b[0])
        q, attitude = q + qdot / rate, attitude * Rotation.from_rotvec(w_B[0] / rate)
        poses.append((q, attitude.as_quat(scalar_first=True), attitude.magnitude()))
    path, attitudes, turns = (np.array(each) for each in zip(*poses))
    return Reactionless(recursion.parameters, float(turns.max()), path, attitudes)
