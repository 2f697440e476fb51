"""What a motion is planned for: criteria of the covariance of the target, and their gradients.

A planner does not know the target. It knows plausible targets, and a motion is as good as it is for
the least favourable of them: the one whose σ exceeds most what other motions reach for it. Without
these weights, a light target, which no motion determines well, would decide alone. Parameters are
compared in units of their scale: the mass, a length for the centre of mass, and the trace of the
inertia; see `parameterizations.parameter_scale`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    parameter_scale,
    relative_parameterization,
)
from cpid_drake.errors import InputError, choose_from
from cpid_drake.planning.families import MotionFamily
from cpid_drake.planning.information import InformationModel, inverse

STEP = 1e-20
"""Imaginary step of the parameters of a motion."""

DIRECTIONS = 24
"""Number of parameters whose derivatives are computed at once."""

# A component of a criterion is ½ log of a mean variance. It is a function of the covariance (d, d)
# in units of the scale, with derivatives as weighted combinations v: (value, weights, v).
Component = tuple[float, NDArray[np.float64], NDArray[np.float64]]


def _worst(covariance: NDArray[np.float64]) -> list[Component]:
    variances = np.diag(covariance)
    one = np.eye(len(covariance))
    return [
        (float(np.log(v) / 2), np.array([0.5 / v]), one[k : k + 1]) for k, v in enumerate(variances)
    ]


def _a_optimal(covariance: NDArray[np.float64]) -> list[Component]:
    d, trace = len(covariance), np.trace(covariance)
    return [(float(np.log(trace / d) / 2), np.full(d, 0.5 / trace), np.eye(d))]


def _d_optimal(covariance: NDArray[np.float64]) -> list[Component]:
    d = len(covariance)
    values, axes = np.linalg.eigh(covariance)
    return [(float(np.log(values).sum() / (2 * d)), 0.5 / d / values, axes.T)]


def _e_optimal(covariance: NDArray[np.float64]) -> list[Component]:
    values, axes = np.linalg.eigh(covariance)
    return [(float(np.log(values[-1]) / 2), np.array([0.5 / values[-1]]), axes.T[-1:])]


CRITERIA: dict[str, Callable[[NDArray[np.float64]], list[Component]]] = {
    "worst": _worst,
    "A": _a_optimal,
    "D": _d_optimal,
    "E": _e_optimal,
}
"""The criteria by name: largest σ, mean variance, volume of the ellipsoid, its longest axis."""


def check_criterion(name: str) -> None:
    """Refuse an unknown criterion.

    Raises:
        InputError: there is no such criterion.

    """
    if name not in CRITERIA:
        raise InputError(f"no criterion '{name}'; {choose_from(name, list(CRITERIA))}")


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
        criterion: name of one of `CRITERIA`.

    """

    model: InformationModel
    family: MotionFamily
    targets: tuple[PlausibleTarget, ...]
    criterion: str = "worst"

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
        logs = [
            [max(part[0] for part in self._components(target, one)) for one in of_target]
            for target, of_target in zip(self.targets, covariances, strict=True)
        ]
        return np.asarray(np.exp(logs))

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
        """Return the components (C,) for (F, K); the criterion is exp of the largest."""
        covariances = self.covariances(self.samples(parameters[None]))[:, 0]
        each = zip(self.targets, covariances, strict=True)
        return np.array([part[0] for one in each for part in self._components(*one)])

    def evaluate(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the components (C,) for (F, K) and their gradients (C, F K).

        The gradients are exact up to rounding.
        """
        motions, psi = self.model.motions(self.samples(parameters[None])), self.model.psi
        values, gradients, by_jacobian = [], [], []
        for target in self.targets:
            H = self.model.jacobian(motions, self.psi(target))
            by_psi, _, covariance = self._covariance(target, H)
            parts = self._components(target, by_psi @ covariance[0, psi, psi] @ by_psi.T)
            for value, weights, v in parts:
                y = v @ by_psi @ covariance[0, psi]
                # −Σ w yᵀ (dHᵀ H + Hᵀ dH) y = ⟨dH, −2 H Σ w y yᵀ⟩
                values.append(value)
                by_jacobian.append(-2 * H[0] @ (y.T * weights) @ y)
        each = len(values) // len(self.targets)
        stacked = np.reshape(by_jacobian, (len(self.targets), each, -1))
        for chunk, step in self.steps(parameters):
            motions = self.model.motions(self.samples(chunk))
            slopes = []
            for target, G in zip(self.targets, stacked, strict=True):
                dH = self.model.jacobian(motions, self.psi(target)).imag / step
                slopes.append(G @ dH.reshape(len(dH), -1).T)
            gradients.append(np.concatenate(slopes))
        return np.array(values), np.concatenate(gradients, axis=1)

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

    def _components(
        self, target: PlausibleTarget, covariance: NDArray[np.float64]
    ) -> list[Component]:
        """Return the components of a target with a covariance (d, d), weighted."""
        found = CRITERIA[self.criterion](covariance)
        return [(value + float(np.log(target.weight)), w, v) for value, w, v in found]

    def _covariance(
        self, target: PlausibleTarget, H: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return ∂π/∂ψ in units of the scale (d, 10), the scale (10,) and the covariance."""
        jacobian = relative_parameterization(self.model.tree.mass).jacobian(self.psi(target))
        scale = parameter_scale(target.parameters, SCALE_LENGTH)
        F, psi = self.model.information(H), self.model.psi
        F[:, psi, psi] += jacobian.T @ target.information @ jacobian
        return (jacobian / scale[:, None])[self.model.tree.unknowns], scale, inverse(F)
