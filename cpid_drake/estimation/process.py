"""Noise of a sensor: white, and a first-order Gauss-Markov process that goes on over blocks.

The noise of a channel is n(t) = s(t) + e. e is white with the variance v₀, in units of the declared
one, and s has the covariance v exp(−|t − t'|/τ). It is Markov: with the value s₀ at the start of a
block and s₁ at its end (or at the start of the next block, if a gap is between them) as unknowns,
nothing else is shared by blocks. At the stamps t₁ … t_M, however uneven they are,

    ε_i = n_i − φ_i n_{i−1},    φ_i = exp(−(t_i − t_{i−1})/τ),    q_i = v (1 − φ_i²)

with n₀ = s₀ and n_{M+1} = s₁ has the covariance A = Q + B D Bᵀ, which is tridiagonal: B is the
bidiagonal matrix above without its columns of s₀ and s₁, and D are the variances of e. With its
Cholesky factor C, which is bidiagonal, C⁻¹ε is white: O(M) for M samples. The last of these M + 1
rows is what is known of s₁ without a later sample.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from cpid_drake.array import Array

_LEAST = 1e-6  # time between two stamps [s]
_LEAST_WEIGHT = 1e-5  # beside slow noise: rounding errors of larger variances hide those of others


@dataclass(frozen=True)
class Process:
    """The noise of a sensor.

    Attributes:
        white: variance of white noise, in units of the declared one.
        slow: variance of the Gauss-Markov process, in the same unit; zero without one.
        tau: its time [s].
        channels: number of entries of a sample.

    """

    white: float = 1.0
    slow: float = 0.0
    tau: float = 1.0
    channels: int = 3

    @property
    def size(self) -> int:
        """Number of its unknowns at an edge of a block."""
        return self.channels if self.slow else 0

    @property
    def total(self) -> float:
        """Variance of all noise."""
        return self.white + self.slow

    @property
    def coordinates(self) -> Array:
        """Coordinates in which the evidence of a process is nearly quadratic.

        They are x with √(white − least) = sinh(x)/2, which is log at large noise and linear in the
        σ where there may be no more, and the logs of slow/τ and τ, if there is slow noise. slow/τ,
        the intensity of what is slow, is known better than both.
        """
        white = np.arcsinh(2 * np.sqrt(max(self.white - LEAST_WHITE, 1e-4)))
        if not self.slow:
            return np.array([white])
        return np.array([white, np.log(self.slow / self.tau), np.log(self.tau)])

    def with_coordinates(self, coordinates: Array) -> "Process":
        """Return the process with other `coordinates`."""
        x, *slow = coordinates.tolist()
        white = LEAST_WHITE + np.sinh(x) ** 2 / 4
        if not slow:
            return replace(self, white=white)
        # slow = (slow/τ) τ
        return replace(self, white=white, slow=np.exp(sum(slow)), tau=np.exp(slow[1]))

    @property
    def white_slope(self) -> float:
        """Derivative of the white variance by its coordinate."""
        return float(np.sinh(2 * self.coordinates[0]) / 4)

    @property
    def white_bend(self) -> float:
        """Second derivative of the white variance by its coordinate."""
        return float(np.cosh(2 * self.coordinates[0]) / 2)

    def within(self, length: float) -> float:
        """Return the variance of all noise in a time [s]; what is slower looks constant in it."""
        return self.white - self.slow * float(np.expm1(-length / self.tau))


DECLARED = Process()
"""The noise that a sensor declares."""

EXACT = 0.5
"""Residuals below this share of the declared σ are errors of the model, and tell no noise."""

LEAST_WHITE = 0.03
"""Variance of white noise that each sensor has, in units of the declared one.

Errors of the model may be as large; noise without it would weigh differences of neighbours only.
"""

DECLARED_COUNT = 10.0
"""The declared σ of a sensor counts as much as so many samples."""


@dataclass(frozen=True, eq=False)
class Innovations:
    """Makes the samples of a sensor in one block white.

    Attributes:
        times: (M,) of its samples [s].
        start, end: times of the two edges [s].
        weights: (M,) of its samples.
        process: its noise.

    """

    times: Array
    start: float
    end: float
    weights: Array
    process: Process

    def is_same(self, other: "Innovations") -> bool:
        """Return whether another one does the same."""
        return self.process == other.process and np.array_equal(self.weights, other.weights)

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """φ (M + 1,), and D (M + 2,) of s₀, the samples and s₁."""
        dt = np.maximum(np.diff(self.times, prepend=self.start, append=self.end), _LEAST)
        D = np.zeros(len(self.times) + 2)
        D[1:-1] = self.process.white / np.maximum(self.weights, _LEAST_WEIGHT) ** 2
        return np.exp(-dt / self.process.tau), D

    @cached_property
    def _root(self) -> Array:
        """The band (2, M + 1) of C."""
        phi, D = self._steps
        # Aᵢᵢ = qᵢ + Dᵢ + φᵢ² Dᵢ₋₁ and Aᵢ₊₁,ᵢ = −φᵢ₊₁ Dᵢ
        band = np.zeros((2, len(phi)))
        band[0] = self.process.slow * (1 - phi**2) + D[1:] + phi**2 * D[:-1]
        band[1, :-1] = -phi[1:] * D[1:-1]
        C, info = lapack.dpbtrf(band, lower=1)
        if info:
            raise np.linalg.LinAlgError("noise")
        return np.asarray(C)

    @property
    def volume(self) -> float:
        """The log of the determinant of the covariance, of one channel."""
        if not self.process.slow:
            variances = self.process.white / self.weights**2
            return float(np.sum(np.log(variances)))
        return float(2 * np.sum(np.log(self._root[0])))

    def __call__(self, values: Array) -> Array:
        """Return white values (M or M + 1, ...) of those (M, ...) in units of the declared σ."""
        flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
        if not self.process.slow:
            white = (self.weights / np.sqrt(self.process.white))[:, None] * flat
            return np.asarray(white.reshape(values.shape))
        # C⁻¹ε, εᵢ = nᵢ − φᵢ nᵢ₋₁, with no s₀ and s₁
        z = np.zeros((len(flat) + 1, flat.shape[1]), order="F")
        z[:-1] = flat
        z[1:] -= self._steps[0][1:, None] * flat
        white = lapack.dtbtrs(self._root, z, uplo="L")[0] if z.size else z
        return np.asarray(white.reshape(-1, *values.shape[1:]))

    @cached_property
    def edges(self) -> Array:
        """What s₀ and s₁ add to the white values: (M + 1, 2)."""
        phi = self._steps[0]
        # ε₁ has −φ₁ s₀, and the last one s₁
        z = np.zeros((len(phi), 2), order="F")
        z[0, 0], z[-1, 1] = -phi[0], 1.0
        return np.asarray(lapack.dtbtrs(self._root, z, uplo="L")[0])

    def of(self, rest: Array, start: Array, end: Array) -> Array:
        """Return white residuals (M or M + 1, d) of (M, d), with s at both edges (d,)."""
        white = self(rest)
        if self.process.slow:
            white = white + self.edges @ np.stack([start, end])
        return white

    def slopes(self, noise: Array, slow: Array) -> Array:
        """Return the derivatives of χ² of white values, and of the volume, by coordinates.

        See `Process.coordinates`. With v = A⁻¹ε, those of εᵀA⁻¹ε + log det A are

            tr((A⁻¹ − vvᵀ) dA) + 2 vᵀdε.

        Args:
            noise: (M, d, c) samples of d channels, of which the squares are summed over c.
            slow: (2, d, c) s₀ and s₁.

        """
        M, d = noise.shape[:2]
        by_white = self.process.white_slope / self.process.white  # d log(white)/dx
        if not self.process.slow:
            return by_white * np.array([M * d - float(np.sum(self(noise) ** 2))])
        phi, D = self._steps
        n = np.concatenate([slow[:1], noise, slow[1:]]).reshape(M + 2, -1)
        # v = A⁻¹ε
        v = lapack.dpbtrs(self._root, n[1:] - phi[:, None] * n[:-1], lower=1)[0]
        inverse = lapack.dpbtrs(self._root, np.eye(M + 1), lower=1)[0]
        P = d * np.diag(inverse) - np.einsum("ik,ik->i", v, v)
        across = d * np.diag(inverse, 1) - np.einsum("ik,ik->i", v[1:], v[:-1])

        def change(by_D: Array, by_q: Array, by_phi: Array) -> float:
            # dA, and dε = −dφ n of the value before
            diagonal = by_q + by_D[1:] + phi**2 * by_D[:-1] + 2 * phi * by_phi * D[:-1]
            beside = -by_phi[1:] * D[1:-1] - phi[1:] * by_D[1:-1]
            return float(P @ diagonal + 2 * across @ beside - 2 * by_phi @ lag)

        lag = np.einsum("ik,ik->i", v, n[:-1])
        by_phi = -phi * np.log(np.maximum(phi, 1e-300))  # by log τ
        v_slow = self.process.slow
        q, none = v_slow * (1 - phi**2), np.zeros(len(phi))
        by_tau = change(0 * D, q - 2 * v_slow * phi * by_phi, by_phi)
        return np.array([change(by_white * D, none, none), change(0 * D, q, none), by_tau])


@dataclass(frozen=True, eq=False)
class Alone:
    """Makes a series of samples white whose slow noise is stationary: it has no edges.

    Attributes:
        times: (M,) of its samples [s].
        process: its noise.

    """

    times: Array
    process: Process = DECLARED

    @cached_property
    def _own(self) -> Innovations:
        far = 40 * self.process.tau  # s is stationary before the first sample
        start, end = (self.times[0] - far, self.times[-1] + far) if len(self.times) else (0.0, far)
        return Innovations(self.times, start, end, np.ones(len(self.times)), self.process)

    def __call__(self, values: Array) -> Array:
        """Return white values (M, ...)."""
        return self._own(values)[: len(self.times)]

    @property
    def volume(self) -> float:
        """The log of the determinant of the covariance, of one channel."""
        slow = self.process.slow  # the variance of what is behind the last sample
        return self._own.volume - (float(np.log(slow)) if slow else 0.0)


def proxy(times: Array, rest: Array, process: Process) -> float:
    """Return −2 log(likelihood) of a series of residuals (N, d).

    The unknowns of the fit are taken as exact: it only says where to look.
    """
    own = Alone(times, process)
    return float(np.sum(own(rest) ** 2) + rest.shape[1] * own.volume)
