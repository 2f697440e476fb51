"""Fisher information about a target from a joint motion, for many joint motions at once.

The measurement model is that of the fits: the effects and sensors of `estimation.likelihood`, with
all constant errors that the suite declares and the uncertainty of the known bodies. It is evaluated
at the nodes of a coarse grid. There every sensor of the base has one sample, whose σ gives the same
information per second as the sensor's own samples. Errors of the encoders, dropouts and the gravity
gradient are left out. `fitted.cramer_rao_bound` contains them; it takes a hundred times as long.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.likelihood.constant_effects import constant_effect
from cpid_drake.estimation.likelihood.effects import (
    Effect,
    GyroBias,
    MotionChange,
    bodies_effect,
    momentum_effect,
    start_effect,
    target_effect,
)
from cpid_drake.estimation.likelihood.model import gyro_biases
from cpid_drake.estimation.likelihood.motion import TrajectoryState
from cpid_drake.estimation.likelihood.sensors import model_classes
from cpid_drake.estimation.roll import bias_sigma
from cpid_drake.estimation.sweep import START
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.logs.log import Measurements, Samples
from cpid_drake.planning.motion_batch import MotionBatch
from cpid_drake.sensors.sensors import SENSORS, Gyro
from cpid_drake.sensors.suite import SensorSuite

REMEMBERED = 8
"""Number of the last batches of motions that are kept, for the criterion and all constraints."""

NODE_RATE = 5.0
"""Nodes per second; motions of up to 0.8 Hz are resolved [Hz]."""


class InformationModel:
    """The information that the sensors of a spacecraft give about a target in a joint motion.

    Args:
        tree: the known spacecraft.
        suite: its sensors.
        duration: of the joint motions [s].
        momentum: the total momentum, marked as unknown if it is estimated; default: zero.
        known_bodies: uncertainty of the known bodies; None if they are exact.
        node_rate: nodes per second [Hz].

    Attributes:
        times: (N,) the nodes [s].
        fit: the unknowns of the fit, with their priors.
        size: number of unknowns n.
        psi: columns of ψ among them.

    """

    def __init__(
        self,
        tree: KinematicTree,
        suite: SensorSuite,
        duration: float,
        *,
        momentum: TotalMomentum | None = None,
        known_bodies: BodyUncertainty | None = None,
        node_rate: float = NODE_RATE,
    ) -> None:
        self.known_bodies = known_bodies
        self.times = np.linspace(0.0, duration, max(int(np.ceil(duration * node_rate)), 4) + 1)
        self.momentum = momentum or TotalMomentum.zero()
        self.suite = _thinned(suite, duration, len(self.times))
        self.fit = Model(tree, self.suite, known_bodies)
        self.tree, self.joint_count = self.fit.tree, self.fit.joint_count
        self._constants = self.fit.constants
        self._recent: dict[tuple[str, tuple[int, ...], bytes], MotionBatch] = {}
        still = np.zeros((len(self.times), 1, 2, self.joint_count))
        effects = self._effects(self.motions(still))
        ends = np.cumsum([0, *(effect.size for effect in effects)]).tolist()
        self.size = ends[-1]
        self.psi = next(slice(a, a + 10) for a, e in zip(ends, effects) if e.name == PSI)
        self.prior_information = self._prior_information()

    def motions(self, samples: NDArray[np.float64]) -> MotionBatch:
        """Return the known bodies' part of B joint motions, which does not depend on the target.

        The criterion and all constraints ask for the same motions; the last ones are remembered.

        Args:
            samples: (N, B, 2, J) positions and rates at the nodes, real or complex.

        """
        key = samples.dtype.char, samples.shape, samples.tobytes()
        if key not in self._recent:
            while len(self._recent) >= REMEMBERED:
                del self._recent[next(iter(self._recent))]
            self._recent[key] = MotionBatch(self.tree, self.times, samples, self._constants)
        return self._recent[key]

    def jacobian(self, motions: MotionBatch, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives (B, m, n) of all samples in units of σ, at a target's ψ (10,).

        Raises:
            InputError: the system's inertia is not positive definite for this target.

        """
        effects = self._effects(motions)
        trajectory = motions.trajectory(self.state(psi))
        U, n, dtype = len(motions.nodes), self.size, trajectory.w.dtype
        change = MotionChange(
            *np.zeros((3, U, 3, n), dtype), *np.zeros((4, 3, n)), *np.zeros((2, n))
        )  # the start and the external forces do not depend on the joint motion
        ends = np.cumsum([0] + [effect.size for effect in effects]).tolist()
        columns = {e.name: slice(a, a + e.size) for e, a in zip(effects, ends)}
        for effect in effects:
            effect.change_motion(trajectory, change.columns(columns[effect.name]))
        xi, change.w[:] = motions.pose_change(trajectory, change.w, change.attitude)
        parts = []
        samples = self._samples(motions)
        biases = {e.name: e for e in effects if isinstance(e, GyroBias)}
        for name, kind in model_classes(samples).items():
            bias = biases.get(f"bias of {name}")
            sensor = kind(name, samples[name], self.suite, motions, slice(0, U), bias)
            rows = np.array(sensor.jacobian(trajectory, change, xi))
            for constant, by in sensor.by_constants(trajectory).items():
                rows[:, :, columns[constant]] += by * self._constants.errors[constant].sigma
            for effect in effects:
                effect.change_reading(name, motions.nodes, rows[:, :, columns[effect.name]])
            white = sensor.whitened(rows).reshape(len(self.times), motions.count, -1, n)
            parts.append(np.swapaxes(white, 0, 1).reshape(motions.count, -1, n))
        return np.concatenate(parts, axis=1)

    def information(self, jacobian: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the information (B, n, n) of a Jacobian (B, m, n), with that of the prior."""
        return np.swapaxes(jacobian, 1, 2) @ jacobian + self.prior_information

    def _effects(self, motions: MotionBatch) -> list[Effect]:
        """Return all effects."""
        biases = gyro_biases(self.suite, 0.0, self.times[-1]).values()
        constants = [constant_effect(motions, name) for name in motions.constants.errors]
        effects: list[Effect] = [start_effect(), *biases, *constants]
        if self.momentum.is_unknown:
            effects.append(momentum_effect())
        effects.append(target_effect(motions))
        if self.known_bodies is not None:
            effects.append(bodies_effect(motions, self.known_bodies))
        return effects

    def state(self, psi: NDArray[np.float64]) -> TrajectoryState:
        """Return the nominal values of all unknowns for a target's ψ (10,)."""
        gyros = sum(2 if g.bias_growth else 1 for g in self.fit.gyros)
        return TrajectoryState(
            psi,
            Rotation.identity(),
            np.zeros(3),
            self.momentum.v_WScm_W,
            self.momentum.L_WScm_W,
            np.zeros((gyros, 3)),
            np.zeros(self._constants.size),
        )

    def _samples(self, motions: MotionBatch) -> Measurements:
        """Return samples of all sensors at the nodes; their values have no effect."""
        names = tuple(f"joint {k}" for k in range(self.joint_count))
        zeros = np.zeros((len(motions.nodes), 4))
        present = self.suite.present()
        return Measurements(names, {name: Samples(motions.nodes, zeros) for name in present})

    def _prior_information(self) -> NDArray[np.float64]:
        """Return (n, n): the fit's prior of all unknowns."""
        result = np.zeros((self.size, self.size))
        start = 0
        still = np.zeros((len(self.times), 1, 2, self.joint_count))
        sigmas = {unknown.name: unknown.sigma for unknown in self.fit.table}
        sigmas["start"] = np.repeat([START["attitude"], START["p_Wcm"]], 3)
        biases = iter(bias_sigma(self.fit))
        psi = next(unknown.mean for unknown in self.fit.table if unknown.name == PSI)
        state = self.state(psi)
        for effect in self._effects(self.motions(still)):
            here = slice(start, start + effect.size)
            if isinstance(effect, GyroBias):
                result[here, here][:3, :3] = np.eye(3) / next(biases) ** 2
                rows, _ = effect.links(state)
                result[here, here] += rows.T @ rows
            else:
                result[here, here] = np.diag(sigmas[effect.name] ** -2.0)
            start += effect.size
        return result


def inverse(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the covariance (B, n, n) of all unknowns, from their information."""
    scale = 1 / np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    scaled = np.linalg.inv(scale[:, :, None] * information * scale[:, None])
    return np.asarray(scale[:, :, None] * (scaled + np.swapaxes(scaled, 1, 2)) / 2 * scale[:, None])


def _thinned(suite: SensorSuite, duration: float, nodes: int) -> SensorSuite:
    """Return a suite without orbit that gives the same information with one sample at each node."""
    factors = {
        name: float(np.sqrt(nodes / (duration * errors.rate + 1)))
        for name, errors in suite.present().items()
        if SENSORS[name].quantity.width is not None
    }
    suite = replace(suite)
    for name in factors:
        errors = suite[name]
        if isinstance(errors, Gyro):
            setattr(suite, name, replace(errors, integrates=False))
    if suite.disturbances is not None:
        suite.disturbances = replace(suite.disturbances, orbit=None)
    return suite.noisier(factors)
