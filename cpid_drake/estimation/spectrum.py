"""The spectrum of each sensor's noise, as blocks show it: white noise, and slow noise.

Noise of a sensor has the covariance σ² (v₀ δ + Σ v_τ exp(−|t − t'|/τ)): white, and Gauss-Markov
processes with the times `TAUS`; σ is declared, v is the spectrum. The cosine transform of M samples
has nearly independent entries of the variances S (M,), so samples are whitened by dividing it by
√S. Slow noise begins anew with a block.

A block alone shows the noise: its start, its joints and its forces are solved for, whatever they
are, so that neither a wrong target nor a change of the momentum looks like noise. With orthonormal
rows Q of these unknowns, G = QQᵀ and h = diag G, the squares of the transform are expected to be

    (1 − 2h) S/S₀ + G² (S/S₀) + (h − G² 1)

for a spectrum S, if S₀ was assumed; the last term is the noise of other sensors. Both are summed in
bands of a factor of 2, all that is kept of a block. The noise is as declared unless that is
improbable, and white unless that is improbable: few samples tell little. Else a grid of slow parts
is weighed by its likelihood. The declared σ counts as `DECLARED` samples of what is seen of the
noise, and as many of the whole, if that is larger. What is missing of it is white: noise that is
slower than a block, too, leaves residuals that are too small.

Sources: Whittle 1953 (likelihood of a spectrum); Patterson and Thompson 1971 (likelihood of
residuals).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import dct, idct
from scipy.linalg import toeplitz

from cpid_drake.array import Array
from cpid_drake.estimation.least_squares import IMPROBABLE

DECLARED = 10.0
"""The declared σ of a sensor counts as much as so many samples."""

TAUS = 0.03 * 2.0 ** np.arange(8)
"""Times of slow noise [s]; what is slower than a block looks constant in it."""

RATIOS = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0])
"""Variances of slow noise that are compared, in units of that of the white noise."""

WHITE: Array = np.eye(1 + len(TAUS))[0]
"""The spectrum (1 + taus,) of declared noise."""

Spectra = Mapping[str, Array]
"""Spectra (1 + taus,) of sensors, or sums over their residuals, by name."""

_FORMS = np.array([WHITE, *(WHITE + q * part for part in np.eye(len(WHITE))[1:] for q in RATIOS)])
_WHOLE = _FORMS.sum(axis=1)
_ODDS = np.array([1.0, 1.0, *np.full(len(_FORMS) - 1, 1 / (len(_FORMS) - 1))])  # declared, white
_LEAST = 0.05  # of squares that unknowns leave: below, these are errors of the model
_BANDS = 20  # of frequencies n/(2 block): n = 0, 1–2, 3–6, ...
_POWER, _OTHERS, _FREE, _SQUARES, _OWN = range(5)  # columns of sums; the last are of each part
_ITERATIONS = 8


@dataclass(frozen=True, eq=False)
class Whitening:
    """Makes the samples of a sensor in one block white.

    Attributes:
        weights: (M,) of its samples.
        parts: (M, 1 + taus) variances of the transform of each part of the noise.
        spectrum: (1 + taus,) their sizes.

    """

    weights: Array
    parts: Array
    spectrum: Array

    @classmethod
    def of(cls, times: Array, spectrum: Array, weights: Array) -> "Whitening":
        """Return that of samples (M,) at some times [s], which are taken as evenly spread."""
        M = len(times)
        step = float(times[-1] - times[0]) / (M - 1) if M > 1 else 1.0
        return cls(weights, _parts(M, f"{step:.3g}"), spectrum)

    @property
    def is_white(self) -> bool:
        """Whether no noise is slow."""
        return not self.spectrum[1:].any()

    @property
    def power(self) -> Array:
        """The variances (M,) of the transformed noise."""
        return np.asarray(self.parts @ self.spectrum)

    def is_same(self, other: "Whitening") -> bool:
        """Return whether another one does the same."""
        is_same = np.array_equal(self.spectrum, other.spectrum)
        return is_same and np.array_equal(self.weights, other.weights)

    def __call__(self, values: Array) -> Array:
        """Return whitened values (M, ...) in units of the declared σ."""
        weighted = (values.T * self.weights).T
        if self.is_white:
            return np.asarray(weighted / np.sqrt(self.spectrum[0]))
        transform = dct(weighted, axis=0, norm="ortho").T / np.sqrt(self.power)
        return np.asarray(idct(transform.T, axis=0, norm="ortho"))

    def undone(self, values: Array) -> Array:
        """Return the values (M, ...) of whitened ones."""
        if self.is_white:
            weighted = values * np.sqrt(self.spectrum[0])
        else:
            transform = dct(values, axis=0, norm="ortho").T * np.sqrt(self.power)
            weighted = idct(transform.T, axis=0, norm="ortho")
        return np.asarray((weighted.T / self.weights).T)

    def sums(self, Q: Array, rest: Array) -> Array:
        """Return what a block shows of the noise, (bands, 5 + taus).

        Args:
            Q: (M, d, g) rows of an orthonormal base of what its unknowns change, whitened.
            rest: (M, d) whitened residuals.

        """
        M, d, g = Q.shape
        rows = np.swapaxes(dct(Q, axis=0, norm="ortho"), 0, 1).reshape(d * M, g)
        h = np.sum(rows**2, axis=1).reshape(d, M)
        G2 = np.sum(((rows @ rows.T) ** 2).reshape(d, M, d, M), axis=(0, 2))
        ratio, lost = self.parts / self.power[:, None], np.sum(h, axis=0)
        own = (d - 2 * lost)[:, None] * ratio + G2 @ ratio
        near = self.weights == np.max(self.weights)  # what is far off says nothing about the noise
        expected = lost - np.sum(G2, axis=1), d - lost, np.sum((1 - h) ** 2, axis=0), own
        power = np.sum(dct((rest.T * near).T, axis=0, norm="ortho") ** 2, axis=1)
        found = np.zeros((_BANDS, _OWN + len(WHITE)))
        band = np.log2(np.arange(M) + 1).astype(int)
        np.add.at(found, band, np.column_stack([power, np.mean(near) * np.column_stack(expected)]))
        return found


@lru_cache(maxsize=512)
def _parts(count: int, step: str) -> Array:
    """Return the variances (M, 1 + taus) of the transform of each part of the noise."""
    later = float(step) * np.arange(count)
    parts = [np.ones(count)]
    for tau in TAUS if count else ():
        half = dct(toeplitz(np.exp(-later / tau)), axis=0, norm="ortho")
        parts.append(np.diag(dct(half, axis=1, norm="ortho")))
    return np.stack(parts, axis=1) if count else np.ones((0, len(WHITE)))


def spectrum_of(sums: Array) -> Array:
    """Return the spectrum (1 + taus,) that sums over blocks show; see `Whitening.sums`."""
    free, squares = sums[:, _FREE], sums[:, _SQUARES]
    seen = squares > _LEAST * np.maximum(free, _LEAST)
    sums, free, squares = sums[seen], free[seen], squares[seen]
    if not len(free):
        return WHITE
    nu, power, others = free**2 / squares, sums[:, _POWER], sums[:, _OTHERS]
    own = _FORMS @ sums[:, _OWN:].T
    level = own @ nu / nu.sum()  # of what is seen
    v = np.full(len(_FORMS), max(power.sum() / max(free.sum(), 1.0), 1e-12))
    for _ in range(_ITERATIONS):
        expected = v[:, None] * own + others
        w = nu * v[:, None] * own / expected
        up, down = np.sum(w * power / expected, axis=1), np.sum(w, axis=1)
        v *= np.sqrt((DECLARED / (v * level) + up) / (DECLARED + down))
    own, level, whole, v = (np.append(each[:1], each, axis=0) for each in (own, level, _WHOLE, v))
    v[0] = 1.0  # as declared
    expected = v[:, None] * own + others
    deviance = np.sum(nu * (np.log(expected) + power / expected), axis=1)
    for size in (v * level, np.maximum(v * whole, 1.0)):
        deviance += DECLARED * (np.log(size) + 1 / size)
    p = _ODDS * np.exp(-0.5 * (deviance - deviance.min()))
    found = v[1] * WHITE
    if p[0] > IMPROBABLE * p.sum():
        found = WHITE
    elif p[1] < IMPROBABLE * p.sum():
        found = (p * v)[2:] @ _FORMS[1:] / p[2:].sum()
    return np.asarray(found + max(0.0, 1 - found.sum()) * WHITE)


def slow_part(spectrum: Array) -> tuple[float, float]:
    """Return the share of slow noise in its variance, or the declared one, and its time [s]."""
    slow = float(np.sum(spectrum[1:]))
    return slow / max(float(np.sum(spectrum)), 1.0), float(spectrum[1:] @ TAUS) / max(slow, 1e-300)


def added(*blocks: Spectra) -> Spectra:
    """Return the sums of what several blocks show."""
    total = dict[str, Array]()
    for block in blocks:
        total |= {name: total.get(name, 0.0) + sums for name, sums in block.items()}
    return total


def are_near(some: Spectra, others: Spectra, share: float) -> bool:
    """Return whether spectra by sensor differ by less than a share of their σ."""
    for name in {*some, *others}:
        before, after = some.get(name, WHITE), others.get(name, WHITE)
        if np.max(np.abs(np.sqrt(after) - np.sqrt(before))) > share * np.sqrt(np.sum(after)):
            return False
    return True
