"""Noise of a sensor: white, and a first-order Gauss-Markov process that goes on over blocks.

The noise of a channel is n(t) = s(t) + e. e is white with the variance v₀, in units of the declared
one, and s has the covariance v exp(−|t − t'|/τ). It is Markov: with the value s₀ at the start of a
block and s₁ at its end (or at the start of the next block, if a gap is between them) as unknowns,
nothing else is shared by blocks. At the stamps t₁ … t_M, however uneven they are,

    z_i = (n_i − φ_i n_{i−1}) / √q_i,    φ_i = exp(−(t_i − t_{i−1})/τ),    q_i = v (1 − φ_i²)

with n₀ = s₀ and n_{M+1} = s₁ has the covariance 1 + B D Bᵀ, which is tridiagonal: B is the
bidiagonal matrix above without its columns of s₀ and s₁, and D are the variances of e. With its
Cholesky factor C, which is bidiagonal, C⁻¹z is white: O(M) for M samples. The last of these M + 1
rows is what is known of s₁ without a later sample.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from cpid_drake.array import Array

_LEAST = 1e-6  # time between two stamps [s]


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

    def within(self, length: float) -> float:
        """Return the variance of all noise in a time [s]; what is slower looks constant in it."""
        return self.white - self.slow * float(np.expm1(-length / self.tau))


DECLARED = Process()
"""The noise that a sensor declares."""

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

    @property
    def extra(self) -> int:
        """Number of rows beside those of samples: one, if an end of the block is linked."""
        return 1 if self.process.slow else 0

    @cached_property
    def _factors(self) -> tuple[Array, Array, Array, float]:
        """φ and 1/√q (M + 1,), the band (2, M + 1) of C, and the log of the determinant."""
        noise, M = self.process, len(self.times)
        dt = np.maximum(np.diff(self.times, prepend=self.start, append=self.end), _LEAST)
        phi, q = np.exp(-dt / noise.tau), -noise.slow * np.expm1(-2 * dt / noise.tau)
        D = np.zeros(M + 2)  # of s₀, the samples and s₁
        D[1:-1] = noise.white / self.weights**2
        band = np.zeros((2, M + 1))
        band[0] = 1 + (D[1:] + phi**2 * D[:-1]) / q
        band[1, :-1] = -phi[1:] * D[1:-1] / np.sqrt(q[1:] * q[:-1])
        C, info = lapack.dpbtrf(band, lower=1)
        if info:
            raise np.linalg.LinAlgError("noise")
        return phi, 1 / np.sqrt(q), C, float(2 * np.sum(np.log(C[0])) + np.sum(np.log(q)))

    @property
    def volume(self) -> float:
        """The log of the determinant of the covariance, of one channel."""
        if not self.process.slow:
            variances = self.process.white / self.weights**2
            return float(np.sum(np.log(variances)))
        return self._factors[-1]

    def __call__(self, values: Array) -> Array:
        """Return white values (M or M + 1, ...) of those (M, ...) in units of the declared σ."""
        flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
        if not self.process.slow:
            white = (self.weights / np.sqrt(self.process.white))[:, None] * flat
            return np.asarray(white.reshape(values.shape))
        phi, root, C, _ = self._factors
        z = np.zeros((len(flat) + 1, flat.shape[1]), order="F")
        z[:-1] = flat
        z[1:] -= phi[1:, None] * flat
        z *= root[:, None]
        white = lapack.dtbtrs(C, z, uplo="L")[0] if z.size else z
        return np.asarray(white.reshape(-1, *values.shape[1:]))

    def transposed(self, values: Array) -> Array:
        """Return what the transpose of the rows of samples makes of values (M, ...)."""
        flat = values.reshape(len(values), int(np.prod(values.shape[1:])))
        if not self.process.slow:
            return self(values)
        phi, root, C, _ = self._factors
        z = np.zeros((len(flat) + 1, flat.shape[1]), order="F")
        z[:-1] = flat
        z = lapack.dtbtrs(C, z, uplo="L", trans="T")[0] * root[:, None] if z.size else z
        return np.asarray((z[:-1] - phi[1:, None] * z[1:]).reshape(values.shape))

    @cached_property
    def edges(self) -> Array:
        """What s₀ and s₁ add to the white values: (M + 1, 2)."""
        phi, root, C, _ = self._factors
        z = np.zeros((len(root), 2), order="F")
        z[0, 0], z[-1, 1] = -phi[0] * root[0], root[-1]
        return np.asarray(lapack.dtbtrs(C, z, uplo="L")[0])

    def of(self, rest: Array, start: Array, end: Array) -> Array:
        """Return white residuals (M or M + 1, d) of (M, d), with s at both edges (d,)."""
        white = self(rest)
        if self.process.slow:
            white = white + self.edges @ np.stack([start, end])
        return white


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
        ends = (self.times[0] - far, self.times[-1] + far) if len(self.times) else (0.0, far)
        return Innovations(self.times, *ends, np.ones(len(self.times)), self.process)

    def __call__(self, values: Array) -> Array:
        """Return white values (M, ...)."""
        return self._own(values)[: len(self.times)]

    def transposed(self, values: Array) -> Array:
        """Return what the transpose of this makes of values (M, ...)."""
        return self._own.transposed(values)

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


def added(*blocks: Mapping[str, Array]) -> dict[str, Array]:
    """Return the sums of what several blocks show, by name."""
    total = dict[str, Array]()
    for block in blocks:
        total |= {name: total.get(name, 0.0) + sums for name, sums in block.items()}
    return total
