"""What a motion is planned for: the largest σ of the target's parameters, within limits.

The target is unknown when its motion is planned. A motion is as good as it is for the least
favourable of plausible targets: the one whose σ exceeds most what other motions reach for it.
Without these weights, a light target, which no motion determines well, would decide alone.
Parameters are compared in units of their scale: the mass, a length for the centre of mass, and the
trace of the inertia; see `parameterizations.parameter_scale`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    TENSOR_ORDER,
    parameter_scale,
    parameters_to_standard,
    relative_parameterization,
)
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.unknowns import Model
from cpid_drake.planning.base_motion import PlannedBaseMotion, known_instants, smooth_peak
from cpid_drake.planning.information import covariance
from cpid_drake.planning.motion_family import MotionFamily

DIFFERENCE_STEP = 1e-6
"""Step of the differences in a motion's parameters [rad or m]: σ changes by 1e-6 of itself, and
rounding by 1e-11."""


@dataclass(frozen=True, eq=False)
class Objective:
    """The criterion of a family's motions for plausible targets, and what they need.

    Attributes:
        model: the spacecraft model with its sensors.
        momentum: the total momentum, marked as unknown if it is estimated.
        family: the motions.
        times: (N,) nodes that resolve them [s].
        targets: (T, 10) π of the plausible targets, at least one.
        information: (10, 10) what is known about π before the motion.
        demanding: (D, 10) π of the targets for which the limits hold, usually heavy ones.
        limits: the finite limits of the base's motion, by the names in `PlannedBaseMotion.lengths`.
        efforts: (J,) largest joint efforts; infinite where there is no limit [N·m or N].
        weights: (T,) of the σ of each target beside those of the others; default: one.

    """

    model: Model
    momentum: TotalMomentum
    family: MotionFamily
    times: Array
    targets: Array
    information: Array
    demanding: Array
    limits: dict[str, float]
    efforts: Array
    weights: Array = field(default_factory=lambda: np.ones(1))

    def sigmas(self, parameters: Array) -> Array:
        """Return σ (B, T, d) for T targets in B motions (B, F, K), times the targets' weights.

        The d parameters are those on which the motion depends; σ are in units of the scale.
        """
        instants = known_instants(self.model.tree, self.family.samples(parameters, self.times))
        form, sigmas = relative_parameterization(self.model.tree.mass), []
        for target in self.targets:
            psi = form.from_parameters(target)
            jacobian = form.jacobian(psi)
            motion = PlannedBaseMotion.of(self.times, instants, self.momentum, psi)
            prior = jacobian.T @ self.information @ jacobian
            of_target = jacobian @ covariance(self.model, motion, prior) @ jacobian.T
            sigma = np.sqrt(np.diagonal(of_target, axis1=1, axis2=2))
            scale = parameter_scale(target, SCALE_LENGTH)
            sigmas.append((sigma / scale)[:, self._determined])
        return np.stack(sigmas, axis=1) * self.weights[:, None]

    def shares(self, samples: Array) -> Array:
        """Return the largest shares (B, D, Q) of the Q limits that B motions need.

        The D targets are the demanding ones. The peaks over time are smooth functions.

        Args:
            samples: (N, B, 2, J) positions and rates of the joints at the nodes.

        """
        instants, of_axes = known_instants(self.model.tree, samples), []
        form = relative_parameterization(self.model.tree.mass)
        for target in self.demanding:
            psi = form.from_parameters(target)
            motion = PlannedBaseMotion.of(self.times, instants, self.momentum, psi)
            lengths = motion.lengths()
            shares = [lengths[name] / limit for name, limit in self.limits.items()]
            if np.isfinite(self.efforts).any():
                phi = parameters_to_standard(target)
                efforts = np.abs(motion.efforts(self.model.tree, samples, phi)) / self.efforts
                shares += [*np.moveaxis(efforts[..., np.isfinite(self.efforts)], -1, 0)]
            of_axes.append([smooth_peak(share) for share in shares])
        count = len(self.limits) + np.count_nonzero(np.isfinite(self.efforts))
        return np.moveaxis(np.reshape(of_axes, (len(of_axes), count, samples.shape[1])), -1, 0)

    def weighted(self, largest: Array) -> "Objective":
        """Return the objective in which all targets count alike.

        The weight of a target is one over the least σ that any motion reaches for it, in units of
        the geometric mean of these least σ.

        Args:
            largest: (B, T) the largest of `sigmas` for each target in many motions.

        """
        least = largest.min(axis=0) / self.weights
        weights = np.exp(np.log(least).mean()) / least
        return replace(self, weights=weights)

    def values(self, parameters: Array) -> Array:
        """Return log σ of all targets and the shares of all limits minus one (B, T d + D Q)."""
        count, samples = len(parameters), self.family.samples(parameters, self.times)
        parts = np.log(self.sigmas(parameters)), self.shares(samples) - 1
        return np.concatenate([part.reshape(count, -1) for part in parts], axis=1)

    def evaluate(self, parameters: Array) -> tuple[Array, Array]:
        """Return `values` (m,) of one motion (F, K) and their derivatives (m, F K)."""
        steps = DIFFERENCE_STEP * np.eye(parameters.size).reshape(-1, *parameters.shape)
        values = self.values(np.concatenate([parameters[None], parameters + steps]))
        return values[0], (values[1:] - values[0]).T / DIFFERENCE_STEP

    @property
    def _determined(self) -> NDArray[np.intp]:
        """Places in π of the parameters on which the motion depends."""
        return np.concatenate([np.arange(4), 4 + TENSOR_ORDER])[self.model.tree.unknowns]
