"""What a motion is planned for: the largest σ of the target's parameters, and its gradients.

A planner does not know the target. It knows plausible targets, and a motion is as good as it is for
the least favourable of them: the one whose σ exceeds most what other motions reach for it. Without
these weights, a light target, which no motion determines well, would decide alone. Parameters are
compared in units of their scale: the mass, a length for the centre of mass, and the trace of the
inertia; see `parameterizations.parameter_scale`.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    parameter_scale,
    relative_parameterization,
)
from cpid_drake.planning.families import MotionFamily
from cpid_drake.planning.information import InformationModel, inverse

STEP = 1e-20
"""Imaginary step of the parameters of a motion."""

DIRECTIONS = 24
"""Number of parameters whose derivatives are computed at once."""


@dataclass(frozen=True, eq=False)
class PlausibleTarget:
    """A target that is possible as far as the planner knows.

    Attributes:
        parameters: (10,) π.
        information: (10, 10) what is known about π before the motion; default: nothing.
        weight: of its σ beside those of other targets.

    """

    parameters: NDArray[np.float64]
    information: NDArray[np.float64] = field(default_factory=lambda: np.zeros((10, 10)))
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class Objective:
    """The criterion of a motion of a family, for all plausible targets.

    Attributes:
        model: the information that sensors give.
        family: the motions.
        targets: the plausible targets, at least one.

    """

    model: InformationModel
    family: MotionFamily
    targets: tuple[PlausibleTarget, ...]

    def samples(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions and rates (N, B, 2, J) at the nodes, from parameters (B, F, K)."""
        times = self.model.times
        known = self.family.known(times)[:, None, :2]
        moved = np.einsum("ndf,bfk->nbdk", self.family.functions(times)[:, :2], parameters)
        samples = np.repeat(known, len(parameters), axis=1).astype(moved.dtype)
        samples[..., self.family.moving] += moved
        return samples

    def covariances(self, samples: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariances (T, B, d, d) for T targets, from positions and rates.

        The d parameters are those on which the motion depends; they are in units of their scale.

        Args:
            samples: (N, B, 2, J) as from `samples`.

        """
        motions, psi, found = self.model.motions(samples), self.model.psi, []
        for target in self.targets:
            by_psi, _, covariance = self._covariance(
                target, self.model.jacobian(motions, self.psi(target))
            )
            found.append(by_psi @ covariance[:, psi, psi] @ by_psi.T)
        return np.stack(found)

    def target_scores(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the criterion (T, B) of motions (B, F, K) for each of T targets, weighted."""
        covariances = self.covariances(self.samples(parameters))
        weights = np.array([target.weight for target in self.targets])
        largest = np.diagonal(covariances, axis1=-2, axis2=-1).max(axis=-1)
        return np.asarray(weights[:, None] * np.sqrt(largest))

    def scores(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the criterion (B,) of motions (B, F, K): a σ in units of the scale."""
        return np.asarray(self.target_scores(parameters).max(axis=0))

    def weighted(self, motions: list[NDArray[np.float64]]) -> "Objective":
        """Return the objective in which all targets count alike.

        The weight of a target is one over the least σ that any of these motions reaches for it, in
        units of the geometric mean of these least σ.

        Args:
            motions: parameters (B, F, K), one batch after the other.

        """
        plain = replace(self, targets=tuple(replace(one, weight=1.0) for one in self.targets))
        least = np.min([plain.target_scores(each).min(axis=1) for each in motions], axis=0)
        weights = np.exp(np.log(least).mean()) / least
        targets = zip(self.targets, weights.tolist(), strict=True)
        return replace(self, targets=tuple(replace(one, weight=w) for one, w in targets))

    def values(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return log σ (T d,) of all parameters and targets, weighted, for (F, K).

        The criterion is exp of the largest.
        """
        covariances = self.covariances(self.samples(parameters[None]))[:, 0]
        weights = np.array([target.weight for target in self.targets])
        variances = np.diagonal(covariances, axis1=-2, axis2=-1)
        return np.asarray(np.log(weights)[:, None] + np.log(variances) / 2).ravel()

    def evaluate(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return `values` (T d,) for (F, K) and their exact gradients (T d, F K)."""
        motions, psi = self.model.motions(self.samples(parameters[None])), self.model.psi
        values, gradients, by_jacobian = [], [], []
        for target in self.targets:
            H = self.model.jacobian(motions, self.psi(target))
            by_psi, _, covariance = self._covariance(target, H)
            variances = np.diag(by_psi @ covariance[0, psi, psi] @ by_psi.T)
            values.append(np.log(target.weight) + np.log(variances) / 2)
            # σ² = s C sᵀ and y = C sᵀ: dσ² = −yᵀ (dHᵀ H + Hᵀ dH) y = ⟨dH, −2 H y yᵀ⟩
            y = by_psi @ covariance[0, psi]
            by_jacobian.append(
                [-(H[0] @ np.outer(one, one)) / v for one, v in zip(y, variances, strict=True)]
            )
        stacked = np.reshape(by_jacobian, (len(self.targets), len(values[0]), -1))
        for chunk, step in self.steps(parameters):
            motions = self.model.motions(self.samples(chunk))
            slopes = []
            for target, G in zip(self.targets, stacked, strict=True):
                dH = self.model.jacobian(motions, self.psi(target)).imag / step
                slopes.append(G @ dH.reshape(len(dH), -1).T)
            gradients.append(np.concatenate(slopes))
        return np.concatenate(values), np.concatenate(gradients, axis=1)

    def steps(self, parameters: NDArray[np.float64]) -> list[tuple[NDArray[np.float64], float]]:
        """Return parameters (D, F, K) with an imaginary step of one parameter each, and the step.

        There are `DIRECTIONS` parameters in each entry of the list.
        """
        steps = 1j * STEP * np.eye(parameters.size).reshape(-1, *parameters.shape)
        complex_ones: NDArray[Any] = parameters + steps
        firsts = range(0, len(steps), DIRECTIONS)
        return [(complex_ones[k : k + DIRECTIONS], STEP) for k in firsts]

    def psi(self, target: PlausibleTarget) -> NDArray[np.float64]:
        """Return the relative unknowns ψ (10,) of a target."""
        return relative_parameterization(self.model.tree.mass).from_parameters(target.parameters)

    def _covariance(
        self, target: PlausibleTarget, H: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return ∂π/∂ψ in units of the scale (d, 10), the scale (10,) and the covariance."""
        jacobian = relative_parameterization(self.model.tree.mass).jacobian(self.psi(target))
        scale = parameter_scale(target.parameters, SCALE_LENGTH)
        F, psi = self.model.information(H), self.model.psi
        F[:, psi, psi] += jacobian.T @ target.information @ jacobian
        return (jacobian / scale[:, None])[self.model.tree.unknowns], scale, inverse(F)
