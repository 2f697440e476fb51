"""Whiteness of residuals: a correct model leaves residuals that are not correlated in time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Whiteness:
    """Correlation of residuals from sample to sample.

    Attributes:
        lag_one: correlation of neighbours, −1 to 1; for white residuals within ± `band`.
        band: two σ of `lag_one` for white residuals.
        correlation_time: number of samples that together have the information of one independent
            sample; 1 if white.
        count: number of samples.

    """

    lag_one: float
    band: float
    correlation_time: float
    count: int

    @property
    def is_white(self) -> bool:
        """Whether the correlation is small: one of 0.1, which changes σ by a tenth, is ignored."""
        return bool(abs(self.lag_one) <= max(self.band, 0.1))


def whiteness(residuals: NDArray[np.float64]) -> Whiteness:
    """Return the whiteness of residuals (N, channels) at N successive instants.

    All channels are scaled to the same size. The correlation time is 1 + 2 Σ ρ_k up to where pairs
    of ρ turn negative (Geyer 1992, "Practical Markov Chain Monte Carlo", initial positive
    sequence).
    """
    rho, channels = autocorrelation(residuals)
    count = len(residuals)
    if count < 4 or not channels:
        return Whiteness(0.0, np.inf, 1.0, count)
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    end = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    time = 2 * float(pairs[:end].sum()) - 1
    return Whiteness(float(rho[1]), float(2 / np.sqrt(count * channels)), max(time, 1.0), count)


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
