"""The target's unknowns ψ: the physically consistent ones, and their prior.

With P(ψ) the pseudo-inertia (4, 4) of the target, P₀ that of a plausible solid and κ = `WIDENED`,

    X(ψ) = L₀⁻¹ (P + κP₀) L₀⁻ᵀ,     (1 + κ) P₀ = L₀L₀ᵀ,

is positive definite in a cone that is slightly wider than that of the rigid bodies, because noise
puts estimates of flat bodies beyond it. The entries of log X, ten coordinates ξ₀ in which 1 means a
factor of e, are N(0, σ²) before the first sample, with σ = `LOG_SIZE`.

Sources: Lee and Park 2018 (the metric); Rucker and Wensing 2022 (κ = 0).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import (
    standard_to_pseudo_inertia,
    standard_to_relative,
)
from cpid_drake.estimation.gaussian import Gaussian

WIDENED = 0.1
"""κ: by so many plausible solids the cone is wider than that of the rigid bodies."""

LOG_SIZE = 3.0
"""σ of the target's log-sizes before the first sample: a factor of 20."""

_ROW, _COLUMN = np.triu_indices(4)
_BASIS = np.zeros((10, 4, 4))  # of symmetric matrices, orthonormal
for _k, (_i, _j) in enumerate(zip(_ROW, _COLUMN, strict=True)):
    _BASIS[_k, _i, _j] = _BASIS[_k, _j, _i] = 1.0 if _i == _j else np.sqrt(0.5)


@dataclass(frozen=True, eq=False)
class TargetCone:
    """The targets of a spacecraft that are rigid bodies, and some a little beyond.

    Attributes:
        solid: (10,) ψ of a plausible solid.
        mass: nominal mass of the spacecraft [kg].

    """

    solid: Array
    mass: float

    @cached_property
    def _added(self) -> Array:
        """κP₀ (4, 4)."""
        return WIDENED * self._pseudo_inertia(self.solid)

    @cached_property
    def _inverse_root(self) -> Array:
        """L₀⁻¹ (4, 4), with L₀L₀ᵀ = (1 + κ)P₀."""
        root = np.linalg.cholesky(self._pseudo_inertia(self.solid) + self._added)
        return np.asarray(np.linalg.inv(root))

    def _pseudo_inertia(self, psi: Array) -> Array:
        return standard_to_pseudo_inertia(_of_relative(psi, self.mass))

    def contains(self, psi: Array) -> bool:
        """Return whether ψ (10,) is inside of the cone."""
        if not (np.isfinite(psi).all() and psi[0] < self.mass):
            return False
        sizes = np.linalg.eigvalsh(self._relative(psi))
        return bool(sizes[0] > _FLATTEST * max(1.0, float(sizes[-1])))

    def log_size(self, psi: Array) -> tuple[Array, Array]:
        """Return the coordinates ξ₀ (10,) of ψ about the plausible solid, and ∂ξ₀/∂ψ (10, 10)."""
        sizes, axes = np.linalg.eigh(self._relative(psi))
        by_standard = _by_standard(_of_relative(psi, self.mass), self.mass)
        into = axes.T @ self._inverse_root
        moved = standard_to_pseudo_inertia(np.asarray(np.linalg.inv(by_standard)).T)
        changes = _slopes(sizes, np.log(sizes), 1 / sizes) * (into @ moved @ into.T)
        by = np.tensordot(axes @ changes @ axes.T, _BASIS, axes=([1, 2], [1, 2])).T
        return np.tensordot(_BASIS, (axes * np.log(sizes)) @ axes.T, axes=2), by

    def prior(self, name: str, psi: Array) -> Gaussian:
        """Return what is known of a target before the first sample, about ψ (10,).

        It is linear about ψ, or about a body near it if ψ is outside of the cone.
        """
        # ξ₀(ψ₀) + ∂ξ₀/∂ψ (ψ − ψ₀) ~ N(0, σ²)
        inside = self._inside(psi, 0.5)
        xi, by = self.log_size(inside)
        return Gaussian.of_rows(
            {name: 10}, np.column_stack([by, by @ (inside - psi) - xi]) / LOG_SIZE
        )

    def _relative(self, psi: Array) -> Array:
        """Return X (4, 4)."""
        P = self._pseudo_inertia(psi) + self._added
        return np.asarray(self._inverse_root @ P @ self._inverse_root.T)

    def most_probable(
        self, gaussian: Gaussian, sigma: float = LOG_SIZE, noise: float = 1.0
    ) -> Array:
        """Return the ψ (10,) inside of the cone with the least |R ψ − z|²/noise² + |ξ₀(ψ)/σ|².

        This is infinite at the cone's boundary, along which steps would creep, and may have several
        minima. So the search begins on the way from the solid to what the rows alone say, as far
        as this is inside; and the rows are no more precise at first than this ψ shows, then step by
        step (a homotopy; Nocedal and Wright 2006, ch. 11.3), a path that stays away from the
        boundary.

        Args:
            gaussian: of ψ itself.
            sigma: of the log-sizes.
            noise: factor by which the rows are less precise.

        """
        psi = self._inside(self.solid + gaussian.minus(self.solid).solve(), _SHORTER)
        now, change = _misfit(gaussian, psi), np.inf
        # Once ψ stays where it is, rows of any precision leave it there.
        while now > noise and change > _SAME:
            before, psi = psi, self._settled(gaussian, psi, now, sigma)
            change = float(np.abs(self.log_size(psi)[0] - self.log_size(before)[0]).max())
            now /= _FINER
        return self._settled(gaussian, psi, noise, sigma)

    def start(self, gaussian: Gaussian) -> Array:
        """Return the most probable ψ (10,) with log-sizes N(0, 1) about the plausible solid.

        The rows are as precise as the body that explains them best leaves them.

        Args:
            gaussian: of ψ itself.

        """
        noise = 1.0
        while True:
            psi = self.most_probable(gaussian, 1.0, noise)
            misfit = _misfit(gaussian, psi)
            if not misfit > 1.05 * noise:
                return psi
            noise = misfit

    def _inside(self, psi: Array, share: float) -> Array:
        """Return ψ (10,), its step from the solid shortened again and again until it is inside.

        Raises an error if ψ is not finite. Any other step becomes so short that it is lost in the
        digits of the solid, which is inside.
        """
        if not np.isfinite(psi).all():
            raise np.linalg.LinAlgError("the target that they show is not finite")
        step = psi - self.solid
        while not self.contains(self.solid + step):
            step = share * step
        return np.asarray(self.solid + step)

    def _settled(self, gaussian: Gaussian, psi: Array, noise: float, sigma: float) -> Array:
        """Return the most probable ψ if the rows are less precise by a factor, from a ψ near it."""
        R, z = gaussian.R / noise, gaussian.z / noise

        def rows(psi: Array) -> tuple[Array, Array]:
            xi, by = self.log_size(psi)
            return np.vstack([R, by / sigma]), np.append(R @ psi - z, xi / sigma)

        # Gauss-Newton: A δψ = −r
        A, rest = rows(psi)
        for _ in range(_MOST_STEPS):
            step, share, fall = np.linalg.lstsq(A, -rest)[0], 1.0, -1.0
            while not fall > 0 and share > _LEAST_SHARE:
                tried, share = psi + share * step, share / 2
                if self.contains(tried):
                    ahead, left = rows(tried)
                    fall = float(rest @ rest - left @ left)
            if not fall > 0:
                break
            psi, A, rest = tried, ahead, left
            if fall < max(_SETTLED, _ROUNDING * float(rest @ rest)):
                break
        return psi


_FLATTEST = 1e-12  # what is flatter than that is rounding
_SHORTER = 0.95  # is a step that ends outside of the cone, again and again
_FINER = 3.0  # so much more precise are the rows at each step of a homotopy
_SAME = 1e-9  # change of log-sizes, of such a step
_MOST_STEPS, _LEAST_SHARE, _SETTLED = 200, 1e-9, 1e-6  # of such a step; the last in χ²
_ROUNDING = 1e-6  # share of a sum of squares


def _misfit(gaussian: Gaussian, psi: Array) -> float:
    """Return the RMS of the rows' residuals; raises an error if it is not finite."""
    misfit = float(np.sqrt(np.mean((gaussian.R @ psi - gaussian.z) ** 2)))
    if not np.isfinite(misfit):
        raise np.linalg.LinAlgError("the target that they show is not finite")
    return misfit


def _slopes(at: Array, values: Array, slopes: Array) -> Array:
    """Return the divided differences (n, n) of a function with its values and slopes (n,).

    In the axes of a symmetric A, the change of f(A) by E is these times E, entry by entry
    (Daleckii and Krein 1965).
    """
    differ = at[:, None] - at
    is_same = np.abs(differ) < 1e-6 * (np.abs(at[:, None]) + np.abs(at)) + 1e-12
    rises = (values[:, None] - values) / np.where(is_same, 1.0, differ)
    return np.where(is_same, (slopes[:, None] + slopes) / 2, rises)


_SHIFTS = np.zeros((6, 3, 3))  # entry by entry the matrices of P(h) = |h|²1 − hhᵀ
for _k, (_i, _j) in enumerate(zip(*np.triu_indices(3), strict=True)):
    _SHIFTS[_k] = (_i == _j) * np.eye(3)
    _SHIFTS[_k, [_i, _j], [_j, _i]] -= 0.5 * (1 + (_i == _j))


def psi_about(x: Array, nominal_mass: float, mass: float) -> tuple[Array, Array]:
    """Return ψ (10,) about a spacecraft of another mass, and its derivative (10, 10) by x.

    The coordinates x of a target are ψ about the *nominal* mass of the spacecraft, a fixed
    function of the target's (m, m c, J). With f = m_k/(m_k + m) and P(h) = |h|²1 − hhᵀ,

        ψ = (m f, f h, J − P(h)/(m_k + m)),

    and the same with the nominal mass for x. Nothing is singular at m = 0.

    Args:
        x: (10,) the target's coordinates.
        nominal_mass, mass: of the spacecraft's bodies, nominal and with their present errors [kg].

    """
    if mass == nominal_mass:
        return x, np.eye(10)
    phi = _of_relative(x, nominal_mass)
    x_phi, psi_phi = (_by_standard(phi, each) for each in (nominal_mass, mass))
    psi = standard_to_relative(phi, mass)
    return psi, np.asarray(np.linalg.solve(x_phi.T, psi_phi.T).T)


def _of_relative(psi: Array, mass: float) -> Array:
    """Return φ (10,) of ψ about a spacecraft of a mass: the inverse of `standard_to_relative`."""
    up = mass / (mass - psi[0])  # 1 + m / mass
    m, h = up * psi[0], up * psi[1:4]
    return np.concatenate([[m], h, psi[4:] + _SHIFTS @ h @ h / (mass + m)])


def _by_standard(phi: Array, mass: float) -> Array:
    """Return the derivative (10, 10) of ψ by φ = (m, m c, J), about a spacecraft of a mass."""
    h, total = phi[1:4], mass + phi[0]
    f, by = mass / total, np.eye(10)
    # ψ = (m f, f h, J − P(h)/(m_k + m)), ∂f/∂m = −f/(m_k + m)
    by[0, 0], by[1:4, 0], by[1:4, 1:4] = f**2, -f / total * h, f * np.eye(3)
    by[4:, 0] = _SHIFTS @ h @ h / total**2
    by[4:, 1:4] = -2 / total * (_SHIFTS @ h)
    return by
