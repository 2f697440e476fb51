"""Errors of rounded samples are not white: how those of one joint's samples are correlated.

The error of a rounded sample depends on where the value is within a step of the resolution. If the
joint's zero lies anywhere between two steps, the errors of two samples that are d steps apart have
the correlation

    6 B₂(frac(d)) = Σ_m 6/(π m)² cos(2π m d),   B₂(x) = x² − x + 1/6.

The errors are equal at rest and nearly equal where the joint moves by almost a whole number of
steps from sample to sample. White noise before rounding multiplies the terms by exp(−(2π m σ)²), σ
in steps. Source: Widrow and Kollár 2008, Quantization Noise, ch. 9 and 20.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

HARMONICS = 6
"""Number of terms of the correlation; the others count as white noise."""

SMALLEST = 0.6
"""Smallest variance of a combination of errors, as a share of that of white noise. Smaller ones are
those of a position that is known to a small share of a step."""


@dataclass(frozen=True, eq=False)
class RoundedSamples:
    """Samples of J joints with the sum of white noise and rounding errors.

    Attributes:
        Q: (N, K) combinations of the N errors of a joint, in units of σ.
        value: (N, J) samples [rad, m, rad/s or m/s].
        smooth: (N, J) the values without errors, as far as they are known.
        sigma: of white noise and rounding together.
        step: of the resolution; 0 without rounding.

    """

    Q: NDArray[np.float64]
    value: NDArray[np.float64]
    smooth: NDArray[np.float64]
    sigma: float
    step: float

    @property
    def rounded_share(self) -> float:
        """Variance of the rounding errors as a share of the whole."""
        return self.step**2 / 12 / self.sigma**2

    def covariance(self) -> NDArray[np.float64]:
        """Return the covariance (J, K, K) of Qᵀ e for the errors e of each joint."""
        J, K = self.value.shape[1], self.Q.shape[1]
        if not self.step:
            return np.broadcast_to(self.Q.T @ self.Q, (J, K, K))
        m = np.arange(1, HARMONICS + 1)
        noise = max(1 - self.rounded_share, 0.0) * (self.sigma / self.step) ** 2
        share = 6 / (np.pi * m) ** 2 * np.exp(-((2 * np.pi * m) ** 2) * noise) * self.rounded_share
        phase = 2 * np.pi * m[:, None, None] * (self.smooth / self.step)
        waves = np.sqrt(share)[:, None, None] * np.stack([np.cos(phase), np.sin(phase)])
        parts = np.einsum("nk,pmnj->jkpm", self.Q, waves, optimize=True).reshape(J, K, -1)
        white = (1 - share.sum()) * (self.Q.T @ self.Q)
        return np.asarray(white + parts @ np.swapaxes(parts, 1, 2))

    def smallest(self) -> NDArray[np.float64]:
        """Return (J,) the smallest variance of a combination of errors with unit coefficients.

        A joint that moves by less than a step has equal errors, whatever its motion. If N samples
        contain n such steps, N / (n + 1) of them have the same error.
        """
        if not self.step:
            return np.ones(self.value.shape[1])
        steps = np.abs(np.diff(self.value, axis=0)).sum(axis=0) / self.step
        repeated = np.maximum(len(self.value) / (steps + 1), SMALLEST)
        return np.asarray(1 + self.rounded_share * (repeated - 1))


def whitening(samples: list[RoundedSamples]) -> NDArray[np.float64]:
    """Return W (J, K, K): W Qᵀ e has unit covariance, where Q (M, K) of all samples has Qᵀ Q = 1.

    Args:
        samples: of each sensor, with its rows of Q.

    """
    covariance = sum(each.covariance() for each in samples)
    smallest = np.max([each.smallest() for each in samples], axis=0)
    variances, axes = np.linalg.eigh(covariance)
    variances = np.maximum(variances, smallest[:, None])
    return np.asarray(np.swapaxes(axes, 1, 2) / np.sqrt(variances)[:, :, None])
