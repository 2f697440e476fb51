"""How smooth the joints of a log are, and how noisy their sensors: by the evidence of all blocks.

The spline of a joint in a block is quintic. With encoder samples q at times t, the rows of its
coefficients c are

    B(t) c = q / (σ f)    samples, with a noise factor f of the declared σ
    P c = 0 / s           |P c|² = ∫ jerk² dt: the jerk is white noise of size s

so the jerk's prior bridges missing samples with the uncertainty that they leave. For each number of
pieces, s and f have the largest marginal likelihood (evidence) of all blocks together; each block
counts with a start of its own, which makes the evidence a sum. With λ = s²/f², ν = `DECLARED` and
M = BᵀB + PᵀP/λ for n samples and K coefficients,

    −2 log(evidence) = (ν + n − 3) log(ν + S) + log det M + (K − 3) log λ − log det PᵀP

with the penalized χ² S; one eigenvalue problem of a block's design serves every λ and every joint.

Sources: Wahba 1990, Spline Models for Observational Data, ch. 1 and 4; Demmler and Reinsch 1975.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, eigh, solve_triangular

from cpid_drake.estimation.block import Block
from cpid_drake.estimation.likelihood.joint_motion import ORDER, spline_basis
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.sensors import JOINT_POSITIONS, JOINT_RATES, sensors_of
from cpid_drake.sensors.suite import SensorSuite

PIECES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Numbers of pieces that a block of the usual length may need."""

FINER = 2
"""The gyro feels errors of the splines that encoders do not: so many times as many pieces."""

FAR = 4.0
"""A sample that is off by r > `FAR` σ has the weight FAR/r (Huber 1964)."""

DECLARED = 10.0
"""The declared σ of a sensor counts as much as so many samples."""

_OPEN = 1e-6  # information about the start of a log: none
_LEGENDRE = np.polynomial.legendre.leggauss(3)  # exact for the square of a quadratic
_GRID = np.arange(-29.0, 16.0, 3.0)  # of log λ: jerk noise of 1e-6 to 1e3 rad/s³·√s
_RIDGE = 1e-2  # of the penalty, for the factorization: any λ has the same evidence with another one
_WORTH = 6.0  # of −2 log(evidence) for a rougher motion: strong evidence (Kass and Raftery 1995)
_PATIENCE = 2  # numbers of pieces without gain after which no more are tried
_REWEIGHTINGS = 6
_SAME = 0.05  # change of a weight that does not matter

_Values = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Smoothness:
    """How smooth the joints of a log are, and how noisy their sensors.

    Attributes:
        rate: pieces of the splines in a second.
        jerk: (J,) size s of the jerk's white noise [rad/s³·√s or m/s³·√s].
        noise: (J,) factor f of the sensors' declared σ; 1 if they are better than declared.

    """

    rate: float
    jerk: NDArray[np.float64]
    noise: NDArray[np.float64]

    def pieces(self, length: float) -> int:
        """Return the number of pieces in a block of this length [s]."""
        return max(1, round(self.rate * length))


def smoothness_of(
    blocks: Sequence[Block], suite: SensorSuite
) -> tuple[Smoothness, list[NDArray[np.float64]]]:
    """Return the smoothness with the largest evidence, and the weights (N, J) of every block.

    Args:
        blocks: successive blocks of one log.
        suite: the sensors' errors.

    """
    samples = [JointSamples.of(block, suite) for block in blocks]
    usual = float(np.median([block.length for block in blocks]))
    weights = [np.ones(each.values.shape) for each in samples]
    for _ in range(_REWEIGHTINGS):  # outliers look like a rough motion or like noise, until known
        pieces = _best_pieces(samples, usual, weights)
        evidence = _Evidence(samples, pieces / usual, weights)
        u, noise = evidence.best(evidence.chained())
        before, weights = weights, evidence.weights_of(u, noise)
        change = max(np.abs(a - b).max(initial=0.0) for a, b in zip(before, weights, strict=True))
        if change < _SAME:
            break
    jerk = np.exp(u / 2) * noise
    return Smoothness(FINER * pieces / usual, jerk, np.maximum(noise, 1.0)), before


def _best_pieces(
    samples: Sequence["JointSamples"], usual: float, weights: list[NDArray[np.float64]]
) -> int:
    """Return the number of pieces in a block of the usual length [s] that has most evidence."""
    best, least, in_vain = PIECES[0], np.inf, 0
    count = float(np.median([len(each.values) for each in samples]))
    for pieces in (n for n in PIECES if n == 1 or n <= count / 2):  # samples show no more
        evidence = _Evidence(samples, pieces / usual, weights)
        value = float(evidence.values(evidence.best(evidence.values)[0][:, None]).sum())
        if value < least - _WORTH:
            best, least, in_vain = pieces, value, 0
        else:
            in_vain += 1
        if in_vain == _PATIENCE:
            break
    return best


@dataclass(frozen=True, eq=False)
class JointSamples:
    """The samples of the joints' sensors in one block.

    Attributes:
        start, end: [s].
        parts: of each sensor: samples, derivative and σ.
        values: (N, J) all samples in units of σ.

    """

    start: float
    end: float
    parts: list[tuple[Samples, int, float]]
    values: NDArray[np.float64]

    @classmethod
    def of(cls, block: Block, suite: SensorSuite) -> "JointSamples":
        """Return the samples in a block of the sensors in a suite."""
        parts = [
            (block.samples[sensor.name], derivative, float(suite.sigmas(sensor.name)[0]))
            for derivative, quantity in enumerate((JOINT_POSITIONS, JOINT_RATES))
            for sensor in sensors_of(quantity)
            if sensor.name in suite.present() and len(block.samples[sensor.name])
        ]
        values = [samples.value / sigma for samples, _, sigma in parts]
        nothing = np.empty((0, len(block.samples.joint_names)))
        return cls(block.start, block.end, parts, np.concatenate([nothing, *values]))

    def key(self) -> tuple[object, ...]:
        """Return what the design depends on."""
        times = [(np.round(s.time - self.start, 9).tobytes(), d, x) for s, d, x in self.parts]
        return round(self.end - self.start, 9), *times

    def design(self, pieces: int) -> NDArray[np.float64]:
        """Return A (N, K) of the samples in units of σ."""
        times = [(np.empty(0), 0, 1.0), *((s.time, d, sigma) for s, d, sigma in self.parts)]
        return np.concatenate(
            [spline_basis(self.start, self.end, pieces, t, d) / sigma for t, d, sigma in times]
        )

    def penalty(self, pieces: int) -> NDArray[np.float64]:
        """Return P (3 pieces, K): |P c|² is the integral of the squared jerk."""
        edges = np.linspace(self.start, self.end, pieces + 1)
        x, weights = _LEGENDRE
        half = (self.end - self.start) / pieces / 2
        at = ((edges[:-1] + edges[1:])[:, None] / 2 + half * x).ravel()
        root = np.sqrt(np.tile(weights * half, pieces))
        return np.asarray(root[:, None] * spline_basis(self.start, self.end, pieces, at, 3))

    def log_volume(self, pieces: int) -> float:
        """Return log det(PᵀP) on the coefficients that have a jerk, in any basis of the splines.

        Position, rate and acceleration at the middle stand for the parabolas, which have none.
        """
        middle = np.array([(self.start + self.end) / 2])
        free = [spline_basis(self.start, self.end, pieces, middle, d) for d in range(ORDER)]
        rows = np.concatenate([*free, self.penalty(pieces)])
        return float(2 * np.sum(np.log(np.abs(np.diag(np.linalg.qr(rows, mode="r"))))))


class _Design:
    """Splines of one design, for all λ: in the basis in which samples and jerk are diagonal.

    With t > 0, BᵀB + t PᵀP = L Lᵀ and L⁻¹PᵀP L⁻ᵀ = V diag(s) Vᵀ:
    BᵀB + PᵀP/λ = L V (1 + (1/λ − t) s) Vᵀ Lᵀ. Everything is about a first fit, so that no digits of
    the sum of squares are lost.

    Args:
        A, P: rows of the samples and of the jerk.
        y: (N, C) samples of C splines in units of σ.
        log_volume: that of the jerk's rows; see `JointSamples.log_volume`.

    Raises:
        numpy.linalg.LinAlgError: the samples do not determine the splines.

    """

    def __init__(
        self,
        A: NDArray[np.float64],
        P: NDArray[np.float64],
        y: NDArray[np.float64],
        log_volume: float,
    ) -> None:
        self.size = A.shape[1]
        AA, PP = A.T @ A, P.T @ P
        self.t = _RIDGE * float(np.trace(AA) / np.trace(PP))
        L = cholesky(AA + self.t * PP, lower=True)
        X = solve_triangular(L, P.T, lower=True)
        s, V = eigh(X @ X.T)
        self.s = np.clip(s, 0.0, 1 / self.t)
        self.W = solve_triangular(L, V, lower=True, trans=1)  # c = c0 + W d
        self.log_det = 2 * float(np.sum(np.log(np.diag(L)))) - log_volume
        self.c0 = self.W @ (self.W.T @ (A.T @ y))
        left, jerk = y - A @ self.c0, P @ self.c0
        self.left2, self.jerk2 = np.sum(left**2, axis=0), np.sum(jerk**2, axis=0)
        self.by_left, self.by_jerk = self.W.T @ (A.T @ left), self.W.T @ (P.T @ jerk)

    def squares(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return penalized χ², and log det M λ^(K − 3)/det PᵀP, at u = log λ (C, G)."""
        q = np.exp(-u)[..., None]
        size = 1 + (q - self.t) * self.s
        d = self.by_left.T[:, None] - q * self.by_jerk.T[:, None]
        S = self.left2[:, None] + q[..., 0] * self.jerk2[:, None] - np.sum(d * d / size, axis=2)
        volume = self.log_det + np.sum(np.log(size), axis=2) + (self.size - ORDER) * u
        return np.maximum(S, 0.0), volume

    def coefficients(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return c (K, C) at u = log λ (C,)."""
        q = np.exp(-u)
        size = 1 + (q - self.t) * self.s[:, None]
        return np.asarray(self.c0 + self.W @ ((self.by_left - q * self.by_jerk) / size))


class _Evidence:
    """The evidence of all blocks of a log, by joint; blocks of one design share their algebra."""

    def __init__(
        self, samples: Sequence[JointSamples], rate: float, weights: list[NDArray[np.float64]]
    ) -> None:
        self._samples, self._weights, self._J = samples, weights, weights[0].shape[1]
        self._pieces = [max(1, round(rate * (each.end - each.start))) for each in samples]
        groups = defaultdict(list)
        for k, (each, w) in enumerate(zip(samples, weights, strict=True)):
            key = each.key()
            for j in range(self._J):
                groups[key, w[:, j].tobytes()].append((k, j))
        self._designs: list[tuple[_Design, NDArray[np.intp], NDArray[np.intp]]] = []
        for group in groups.values():
            (k, joint), (blocks, joints) = group[0], np.array(group).T
            first, pieces, w = samples[k], self._pieces[k], weights[k][:, joint]
            y = np.stack([samples[k].values[:, j] for k, j in group], axis=1)
            A, P = w[:, None] * first.design(pieces), first.penalty(pieces)
            try:
                design = _Design(A, P, w[:, None] * y, first.log_volume(pieces))
            except np.linalg.LinAlgError:  # too few samples say nothing about smoothness
                continue
            self._designs.append((design, blocks, joints))

    def _sums(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return sums of squares (J, G), their freedom (J, 1) and volume (J, G) at u (J, G)."""
        S, volume, count = np.zeros(u.shape), np.zeros(u.shape), np.zeros((len(u), 1))
        for design, blocks, joints in self._designs:
            each, log_det = design.squares(u[joints])
            np.add.at(S, joints, each)
            np.add.at(volume, joints, log_det)
            samples = [[len(self._weights[k]) - ORDER] for k in blocks]
            np.add.at(count, joints, np.array(samples, float))
        return S, count, volume

    def values(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return −2 log(evidence) (J, G) at u = log λ (J, G), up to a constant."""
        S, count, volume = self._sums(u)
        freedom = DECLARED + count
        weights = sum(np.sum(np.log(each), axis=0) for each in self._weights)
        volume -= 2 * np.asarray(weights)[:, None]
        return np.asarray(freedom * np.log((DECLARED + S) / freedom) + volume)

    def chained(self) -> _Values:
        """Return the function `values` of blocks that continue from each other.

        Blocks of a slow motion show its jerk only together: each by itself is a parabola.
        """
        parts = []
        for each, pieces, w in zip(self._samples, self._pieces, self._weights, strict=True):
            A, P = each.design(pieces), each.penalty(pieces)
            rows = np.dstack([w.T[..., None] * A, (w * each.values).T])
            own = np.linalg.qr(np.pad(rows, ((0, 0), (0, A.shape[1] + 1), (0, 0))), mode="r")
            parts.append((np.asarray(np.linalg.qr(P, mode="r")), np.asarray(own), len(A)))

        def values(u: NDArray[np.float64]) -> NDArray[np.float64]:
            q = np.exp(-u / 2)[..., None, None]
            carried = np.zeros((*u.shape, ORDER, ORDER + 1))
            carried[..., range(ORDER), range(ORDER)] = _OPEN
            S, volume, count = np.zeros(u.shape), np.zeros(u.shape), -ORDER
            for P, own, n in parts:
                K = own.shape[-1] - 1
                m, inner = ORDER + len(P), K - ORDER
                rows = np.zeros((*u.shape, m + own.shape[1], K + 1))
                rows[..., :ORDER, :ORDER] = carried[..., :-1]
                rows[..., :ORDER, K] = carried[..., -1]
                rows[..., ORDER:m, :K], rows[..., m:, :] = q * P, own[:, None]
                T = np.asarray(np.linalg.qr(rows, mode="r"))
                size = np.log(np.abs(np.diagonal(T, axis1=-2, axis2=-1)[..., :K]))
                volume += 2 * np.sum(size[..., :inner], axis=-1) + inner * u
                S, count, carried = S + T[..., K, K] ** 2, count + n, T[..., inner:K, inner:]
            volume += 2 * np.sum(size[..., inner:], axis=-1)
            return np.asarray((DECLARED + count) * np.log(DECLARED + S) + volume)

        return values

    def best(self, values_at: _Values) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return u = log λ (J,) and the noise factors (J,).

        The smoothest u of a grid that is not much worse than the best one; then parabolas.

        Args:
            values_at: returns −2 log(evidence) (J, G) at u (J, G).

        """
        values = values_at(np.broadcast_to(_GRID, (self._J, len(_GRID))))
        u = _GRID[np.argmax(values < values.min(axis=1)[:, None] + _WORTH, axis=1)]
        for step in (0.75, 0.1):
            at = u[:, None] + step * np.arange(-4, 5)
            values = values_at(at)
            k = np.clip(np.argmin(values, axis=1), 1, 7)[:, None]
            a, b, c = (np.take_along_axis(values, k + i, 1)[:, 0] for i in (-1, 0, 1))
            shift = np.clip(0.5 * (a - c) / np.maximum(a - 2 * b + c, 1e-12), -1, 1)
            u = np.take_along_axis(at, k, 1)[:, 0] + step * shift
        S, count, _ = self._sums(u[:, None])
        return u, np.sqrt((DECLARED + S) / (DECLARED + count))[:, 0]

    def weights_of(
        self, u: NDArray[np.float64], noise: NDArray[np.float64]
    ) -> list[NDArray[np.float64]]:
        """Return the weights (N, J) of every block that the residuals show."""
        result = [w.copy() for w in self._weights]
        rows = [each.design(n) for each, n in zip(self._samples, self._pieces, strict=True)]
        for design, blocks, joints in self._designs:
            c = design.coefficients(u[joints])
            for n, (k, j) in enumerate(zip(blocks, joints, strict=True)):
                size = np.abs(self._samples[k].values[:, j] - rows[k] @ c[:, n]) / noise[j]
                result[k][:, j] = np.minimum(1.0, FAR / np.maximum(size, 1e-9))
        return result
