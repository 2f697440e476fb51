"""Whiteness of residuals: a correct model leaves residuals that are not correlated in time."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NEGLIGIBLE = 0.5
"""Size of residuals, in units of the assumed noise, below which their correlation is ignored."""

MOST_CORRELATED = 0.7
"""Correlation of residuals from sample to sample above which a check fails."""

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
    def is_negligible(self) -> bool:
        """Whether residuals in σ are so small that their correlation does not matter."""
        return self.rms < NEGLIGIBLE

    @property
    def fails(self) -> bool:
        """Whether residuals in σ are so correlated that they are no noise."""
        return self.lag_one > MOST_CORRELATED and not self.is_negligible


def least_white(tests: Iterable[Whiteness]) -> Whiteness | None:
    """Return the test that is farthest from white, of those that matter; None without tests."""

    def distance(test: Whiteness) -> tuple[bool, float]:
        return not test.is_negligible, abs(test.lag_one) / max(test.band, 0.1)

    return max(tests, key=distance, default=None)


def whiteness(residuals: NDArray[np.float64]) -> Whiteness:
    """Return the whiteness of residuals (N, channels) at N successive instants.

    All channels are scaled to the same size. The correlation time is 1 + 2 Σ ρ_k up to where pairs
    of ρ turn negative (Geyer 1992, "Practical Markov Chain Monte Carlo", initial positive
    sequence).
    """
    count = len(residuals)
    rho, channels = autocorrelation(residuals) if count else (np.zeros(0), 0)
    if count < 4 or not channels:
        return Whiteness(0.0, 1.0, 1.0, count, 0.0)
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    end = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    time = 2 * float(pairs[:end].sum()) - 1
    band, rms = BAND / np.sqrt(count * channels), np.sqrt(np.mean(residuals**2))
    return Whiteness(float(rho[1]), float(band), max(time, 1.0), count, float(rms))


def autocorrelation(residuals: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Return the autocorrelation of residuals (N, channels) at lags 0, 1, ... N/2 samples.

    It is the mean over all channels that are not constant; the second result is their number.
    """
    residuals = residuals - residuals.mean(axis=0)
    size = np.sqrt(np.mean(residuals**2, axis=0))
    scaled = residuals[:, size > 0] / size[size > 0]
    count, channels = scaled.shape
    if not channels:
        return np.zeros(count // 2), 0
    spectrum = np.abs(np.fft.rfft(scaled, 2 * count, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum, axis=0)[: count // 2].sum(axis=1)
    return covariance / covariance[:1], channels


@dataclass(frozen=True)
class LagSums:
    """Sums over residuals that are added block by block: the whiteness in constant memory.

    The mean is taken as zero, and the correlation is that of the first-order process with the same
    correlation of neighbours.

    Attributes:
        count: number of samples.
        channels: number of entries of a sample.
        square: sum of squares.
        pairs: number of pairs of neighbours.
        product: sum of their products.

    """

    count: int = 0
    channels: int = 0
    square: float = 0.0
    pairs: int = 0
    product: float = 0.0

    def added(self, residuals: NDArray[np.float64]) -> "LagSums":
        """Return the sums after adding successive residuals (N, channels).

        Outliers are reduced to six times the usual size.
        """
        usual = float(np.median(np.abs(residuals))) if len(residuals) else 0.0
        limit = 6 * max(1.0, 1.5 * usual)
        rest = np.clip(residuals, -limit, limit)
        return LagSums(
            self.count + len(rest),
            rest.shape[1],
            self.square + float(np.sum(rest**2)),
            self.pairs + max(len(rest) - 1, 0),
            self.product + float(np.sum(rest[1:] * rest[:-1])),
        )

    @property
    def whiteness(self) -> Whiteness:
        """The whiteness of all residuals so far."""
        if self.pairs < 4 or self.square == 0:
            return Whiteness(0.0, 1.0, 1.0, self.count, 0.0)
        lag_one = float(np.clip(self.product / self.pairs * self.count / self.square, -1, 1))
        band = BAND / np.sqrt(self.pairs * self.channels)
        time = min((1 + lag_one) / max(1 - lag_one, 1e-9), self.count)
        rms = np.sqrt(self.square / self.count / self.channels)
        return Whiteness(lag_one, float(band), max(time, 1.0), self.count, float(rms))
