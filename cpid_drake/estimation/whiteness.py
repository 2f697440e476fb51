"""Whiteness of residuals: a correct model leaves residuals that are not correlated in time."""

from dataclasses import dataclass, field

import numpy as np
from scipy.fft import next_fast_len

from cpid_drake.array import Array

NEGLIGIBLE = 0.5
"""Size of a mean of residuals, in units of that of the assumed noise, below which their correlation
is ignored."""

MOST_CORRELATED = 0.7
"""Correlation of residuals from sample to sample above which a check fails."""

LAGS = 600
"""Longest distance of two residuals whose correlation counts, in samples."""

BAND = 3.3
"""Band of white residuals in σ. A report tests several sensors, so the band is a wide one."""


@dataclass(frozen=True)
class Whiteness:
    """Correlation of residuals from sample to sample.

    Attributes:
        lag_one: correlation of neighbours, −1 to 1; for white residuals within ± `band`.
        band: 3.3 σ of `lag_one`: 99.9 % of white residuals are within it; 1 of too few samples.
        correlation_time: number of samples that together have the information of one independent
            sample; 1 if white.
        count: number of samples.
        rms: size of the residuals, in their unit.

    """

    lag_one: float
    band: float
    correlation_time: float
    count: int
    rms: float = 1.0

    @property
    def is_white(self) -> bool:
        """Whether the correlation is small: one of 0.1, which changes σ by a tenth, is ignored."""
        return bool(abs(self.lag_one) <= max(self.band, 0.1))

    @property
    def fails(self) -> bool:
        """Whether residuals in σ are so correlated that they are no noise.

        What is correlated over T samples weighs as much in their mean as white noise of √T the
        size: small residuals fail, too, if they are slow enough.
        """
        size = self.rms * np.sqrt(self.correlation_time)
        return bool(self.lag_one > MOST_CORRELATED and size >= NEGLIGIBLE)


@dataclass(frozen=True, eq=False)
class LagSums:
    """Sums over residuals that are added block by block: their whiteness in constant memory.

    Their mean is zero.

    Attributes:
        products: (`LAGS` + 1, channels) sums of products of residuals that are 0, 1, 2, … samples
            apart.
        pairs: (`LAGS` + 1,) their numbers, of all channels together.
        last: (n, channels) the last residuals, `LAGS` at most.

    """

    products: Array = field(default_factory=lambda: np.zeros((LAGS + 1, 1)))
    pairs: Array = field(default_factory=lambda: np.zeros(LAGS + 1))
    last: Array = field(default_factory=lambda: np.zeros((0, 1)))

    def added(self, residuals: Array) -> "LagSums":
        """Return the sums after adding successive residuals (N, channels).

        Outliers of each channel are reduced to 9 of its medians: 6 σ of normal residuals.
        """
        N, channels = residuals.shape
        usual = np.median(np.abs(residuals), axis=0) if N else np.zeros(channels)
        most = np.where(usual > 0, 9 * usual, np.inf)
        rest = np.clip(residuals, -most, most)
        before = len(self.last)
        whole, lags = np.concatenate([self.last, rest]) if before else rest, np.arange(LAGS + 1)
        # Σ_i x_i x_{i − lag} over the new x_i, with earlier ones: a product of spectra, longer by
        # what must not wrap around.
        length = next_fast_len(N + LAGS, real=True)
        of_rest = np.fft.rfft(rest, length, axis=0)
        by_whole = of_rest.conj() * (np.fft.rfft(whole, length, axis=0) if before else of_rest)
        products = np.fft.irfft(by_whole, length, axis=0)[before - lags]
        pairs = channels * np.clip(len(whole) - lags, 0, N)
        return LagSums(self.products + products, self.pairs + pairs, whole[-LAGS:])

    @property
    def correlation(self) -> Array:
        """The autocorrelation at 0, 1, 2, … samples, up to where half as many pairs are left."""
        squares = self.products[0]
        if not squares.any():
            return np.zeros(0)
        reached = int(np.sum(self.pairs >= self.pairs[0] / 2))
        # ρ_lag: mean of all channels, whatever their size, of Σ x_i x_{i − lag} / Σ x_i²
        each = self.products[:reached, squares > 0] / squares[squares > 0]
        means = np.mean(each, axis=1) * self.pairs[0] / self.pairs[:reached]
        return np.asarray(np.clip(means, -1.0, 1.0))

    @property
    def whiteness(self) -> Whiteness:
        """The whiteness of all residuals so far."""
        rho, count = self.correlation, round(self.pairs[0] / self.last.shape[1])
        if count < 4 or len(rho) < 2:
            return Whiteness(0.0, 1.0, 1.0, count, 0.0)
        pairs = self.pairs * np.mean(self.products[0] > 0)  # of channels that are not zero
        time = correlation_time(rho, pairs[0])
        rms = float(np.sqrt(np.sum(self.products[0]) / pairs[0]))
        return Whiteness(float(rho[1]), float(BAND / np.sqrt(pairs[1])), time, count, rms)


def correlation_time(rho: Array, count: float) -> float:
    """Return 1 + 2 Σ ρ_k from the autocorrelation at 0, 1, 2, … samples of so many entries.

    The sum is up to where pairs of ρ turn negative (Geyer 1992, "Practical Markov Chain Monte
    Carlo", initial positive sequence), less two of its σ if residuals are white.
    """
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    end = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    beyond = 2 * float(pairs[:end].sum()) - 2
    return 1 + max(beyond - 4 * float(np.sqrt(2 * end / count)), 0.0)
