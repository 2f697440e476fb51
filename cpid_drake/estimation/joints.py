"""The joints' motion by their own sensors: smoothing splines with a white-noise prior on jerk.

The spline of a joint is quintic and continues from block to block with position, rate and
acceleration. With encoder samples q at times t, the rows of its coefficients c are

    B(t) c = q / (σ f)    samples, with a noise factor f of the declared σ
    P c = 0 / s           |P c|² = ∫ jerk² dt: the jerk is white noise of size s

so the jerk's prior bridges missing samples with the uncertainty that they leave. For each number of
pieces, s and f have the largest marginal likelihood (evidence) of all blocks together; each block
counts with a start of its own, which makes the evidence a sum. With λ = s²/f² and
M = BᵀB + PᵀP/λ, one eigenvalue problem of a block's design serves every λ and every joint.

Sources: Wahba 1990, Spline Models for Observational Data, ch. 1 and 4; Demmler and Reinsch 1975.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cholesky, eigh, solve_triangular

from cpid_drake.estimation.faults import Block
from cpid_drake.estimation.likelihood.joint_motion import KICK, ORDER, _basis
from cpid_drake.estimation.likelihood.rounding import RoundedSamples, whitening
from cpid_drake.sensing.sensors import JOINT_POSITIONS, JOINT_RATES, sensors_of
from cpid_drake.sensing.splines import DerivativeSamples
from cpid_drake.sensing.suite import SensorSuite

PIECES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Numbers of pieces that a block of the usual length may need."""

FINER = 2
"""The gyro feels errors of the splines that encoders do not: so many times as many pieces."""

FAR = 4.0
"""A sample that is off by r > `FAR` σ has the weight FAR/r (Huber 1964)."""

DECLARED = 30.0
"""The declared σ of a sensor counts as much as so many samples."""

_LEGENDRE = np.polynomial.legendre.leggauss(3)  # exact for the square of a quadratic
_GRID = np.arange(-14.0, 16.0, 3.0)  # of log λ: jerk noise of 1e-3 to 1e3 rad/s³·√s
_RIDGE = 1e-2  # of the penalty, for the factorization: any λ has the same evidence with another one
_WORTH = 2.0  # change of −2 log(evidence) for which more pieces are used
_PATIENCE = 2  # numbers of pieces without gain after which no more are tried
_REWEIGHTINGS = 6


@dataclass(frozen=True, eq=False)
class Smoothness:
    """How smooth the joints of a log are, and how noisy their sensors.

    Attributes:
        rate: pieces of the splines in a second.
        jerk: (J,) size s of the jerk's white noise [rad/s³·√s or m/s³·√s].
        noise: (J,) factor f of the sensors' declared σ.

    """

    rate: float
    jerk: NDArray[np.float64]
    noise: NDArray[np.float64]

    def pieces(self, length: float) -> int:
        """Return the number of pieces in a block of this length [s]."""
        return max(1, round(self.rate * length))


@dataclass(frozen=True, eq=False)
class JointPart:
    """The joints' motion in one block, and what their own sensors tell about it.

    Attributes:
        start, end: [s].
        pieces: number of polynomials.
        coefficients: (K, J) present values c; the first and the last `ORDER` are the scaled
            derivatives at both ends.
        rows, target: (J, K, K), (J, K) with rows c = target and unit noise: samples and jerk.
        is_kicked: whether the thrust changes at the start, and the accelerations with it.

    """

    start: float
    end: float
    pieces: int
    coefficients: NDArray[np.float64]
    rows: NDArray[np.float64]
    target: NDArray[np.float64]
    is_kicked: bool = False

    @property
    def size(self) -> int:
        """Number of coefficients K of each joint."""
        return len(self.coefficients)

    @property
    def rest(self) -> NDArray[np.float64]:
        """(J, K) right-hand side of the rows for errors of the present coefficients."""
        return np.asarray(self.target - np.einsum("jrk,kj->jr", self.rows, self.coefficients))

    def basis(self, times: ArrayLike, derivative: int = 0) -> NDArray[np.float64]:
        """Return the derivatives (M, K) of a joint's position (or rate, …) w.r.t. coefficients."""
        return _basis(self.start, self.end, self.pieces, np.asarray(times), derivative)

    def evaluate(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions and rates (M, 2, J) at times (M,)."""
        return np.stack([self.basis(times, d) @ self.coefficients for d in range(2)], axis=1)

    def moved(self, step: NDArray[np.float64]) -> "JointPart":
        """Return the part after a step (J K,) of all coefficients, joint after joint."""
        J = self.coefficients.shape[1]
        return replace(self, coefficients=self.coefficients + step.reshape(J, -1).T)


def smooth_joints(
    blocks: Sequence[Block], suite: SensorSuite
) -> tuple[Smoothness, list[JointPart]]:
    """Return the smoothness with the largest evidence, and the smoothed motion of all blocks.

    Args:
        blocks: successive blocks of one log.
        suite: the sensors' errors.

    """
    samples = [_Samples.of(block, suite) for block in blocks]
    usual = float(np.median([block.length for block in blocks]))
    best, least, tried_in_vain = PIECES[0], np.inf, 0
    for pieces in PIECES:
        evidence = _Evidence(samples, pieces / usual)
        value = float(evidence.values(evidence.best()[:, None]).sum())
        if value < least - _WORTH:
            best, least, tried_in_vain = pieces, value, 0
        else:
            tried_in_vain += 1
        if tried_in_vain == _PATIENCE:
            break
    found = _Evidence(samples, FINER * best / usual)
    smoothness, weights = found.robust()
    parts = [joint_part(block, suite, smoothness, each) for block, each in zip(blocks, weights)]
    return smoothness, smoothed(parts)


def joint_part(
    block: Block,
    suite: SensorSuite,
    smoothness: Smoothness,
    weights: NDArray[np.float64] | None = None,
) -> JointPart:
    """Return a block's own information about its joints, about a motion that fits it alone.

    Errors of rounded samples are not white; see `rounding`.

    Args:
        block: the samples.
        suite: the sensors' errors.
        smoothness: of the log.
        weights: (N, J) weights of the samples; default: 1.

    """
    samples, pieces = _Samples.of(block, suite), smoothness.pieces(block.length)
    P, A, y = samples.penalty(pieces), samples.design(pieces), samples.values
    (N, J), K = y.shape, A.shape[1]
    w = np.ones((N, J)) if weights is None else weights
    jerk = np.column_stack([P, np.zeros(len(P))]) / smoothness.jerk[:, None, None]
    data = np.dstack([w.T[..., None] * A, (w * y).T])

    def rows_of(data: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        T = triangles(np.concatenate([jerk, data / smoothness.noise[:, None, None]], axis=1))
        return T[:, :K, :K], T[:, :K, K]

    rows, target = rows_of(data)
    c = np.stack([np.linalg.lstsq(R, b, rcond=1e-12)[0] for R, b in zip(rows, target)], axis=1)
    plain = (w == 1).all(axis=0)
    if N >= K and samples.is_rounded and plain.any():
        Q, R = np.linalg.qr(A)
        both = np.dstack([np.broadcast_to(R, (J, K, K)), (Q.T @ y).T])
        white = np.zeros_like(data)
        white[:, :K] = samples.whitening(Q, A @ c) @ both
        rows, target = rows_of(np.where(plain[:, None, None], white, data))
    return JointPart(block.start, block.end, pieces, c, rows, target, block.is_kicked)


def smoothed(parts: Sequence[JointPart]) -> list[JointPart]:
    """Return successive parts about the motion that fits all of them together."""
    J = parts[0].coefficients.shape[1]
    carried, factors = np.zeros((J, ORDER, ORDER + 1)), []
    for part in parts:
        if part.is_kicked:
            carried = opened(carried)
        factors.append(triangles(joined(carried, part)))
        carried = factors[-1][:, part.size - ORDER : part.size, part.size - ORDER :]
    end = np.stack([np.linalg.lstsq(T[:, :-1], T[:, -1], rcond=1e-12)[0] for T in carried])
    result = []
    for k in reversed(range(len(parts))):
        part, T = parts[k], factors[k]
        n = part.size - ORDER
        right = T[:, :n, -1] - np.einsum("jnk,jk->jn", T[:, :n, n:-1], end)
        inner = [np.linalg.lstsq(R, b, rcond=1e-12)[0] for R, b in zip(T[:, :n, :n], right)]
        c = np.concatenate([np.array(inner).reshape(J, n), end], axis=1).T
        result.append(replace(part, coefficients=c))
        end = c[:ORDER].T
        if part.is_kicked and k:
            # Position and rate continue; the acceleration before the change is that of before.
            end = _before_change(factors[k - 1], parts[k - 1].size, end)
    return result[::-1]


def joined(carried: NDArray[np.float64], part: JointPart) -> NDArray[np.float64]:
    """Return rows (J, ORDER + K, K + 1) of what is known at the start, and of a part's own."""
    J, K = carried.shape[0], part.size
    first = np.zeros((J, ORDER, K + 1))
    first[:, :, :ORDER], first[:, :, K] = carried[:, :, :ORDER], carried[:, :, ORDER]
    return np.concatenate([first, np.dstack([part.rows, part.target])], axis=1)


def opened(carried: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what is known (J, ORDER, ORDER + 1) after a kick: the accelerations have changed."""
    J = len(carried)
    rows = np.zeros((J, ORDER + 1, ORDER + 2))
    rows[:, 0, 0] = 1 / KICK
    rows[:, 1:, 0], rows[:, 1:, 1:] = -carried[:, :, ORDER - 1], carried
    return triangles(rows)[:, 1 : ORDER + 1, 1:]


def _before_change(
    T: NDArray[np.float64], size: int, end: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the end (J, ORDER) of a block whose next one has another acceleration."""
    known = T[:, size - ORDER : size, size - ORDER :]
    result = end.copy()
    for j, rows in enumerate(known):
        left = rows[:, -1] - rows[:, : ORDER - 1] @ end[j, : ORDER - 1] - rows[:, -2] * end[j, -1]
        column = rows[:, ORDER - 1]
        result[j, -1] += (column @ left) / (column @ column + KICK**-2)
    return result


def triangles(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the upper triangles (J, n, n) of rows (J, M, n)."""
    J, M, n = rows.shape
    if n > M:
        rows = np.concatenate([rows, np.zeros((J, n - M, n))], axis=1)
    return np.asarray(np.linalg.qr(rows, mode="r"))


@dataclass(frozen=True, eq=False)
class _Samples:
    """The samples of the joints' sensors in one block: samples, derivative, σ and resolution."""

    start: float
    end: float
    parts: list[tuple[DerivativeSamples, float]]
    count: int

    @classmethod
    def of(cls, block: Block, suite: SensorSuite) -> "_Samples":
        parts = []
        for derivative, quantity in enumerate((JOINT_POSITIONS, JOINT_RATES)):
            for name in [sensor.name for sensor in sensors_of(quantity)]:
                if name in suite.present() and len(block.samples[name]):
                    one = (block.samples[name], derivative, float(suite.sigmas(name)[0]))
                    parts.append((one, suite.step(name)))
        return cls(block.start, block.end, parts, len(block.samples.joint_names))

    @property
    def values(self) -> NDArray[np.float64]:
        """(N, J) in units of σ."""
        values = [samples.value / sigma for (samples, _, sigma), _ in self.parts]
        return np.concatenate([np.empty((0, self.count)), *values])

    @property
    def is_rounded(self) -> bool:
        return any(step for _, step in self.parts)

    def key(self) -> tuple[object, ...]:
        """Return what the design depends on."""
        times = [
            (np.round(s.time - self.start, 9).tobytes(), d, sigma)
            for (s, d, sigma), _ in self.parts
        ]
        return round(self.end - self.start, 9), *times

    def design(self, pieces: int) -> NDArray[np.float64]:
        """Return A (N, K) of the samples in units of σ."""
        parts = [
            _basis(self.start, self.end, pieces, s.time, d) / sigma
            for (s, d, sigma), _ in self.parts
        ]
        K = _basis(self.start, self.end, pieces, np.empty(0), 0).shape[1]
        return np.concatenate([np.empty((0, K)), *parts])

    def penalty(self, pieces: int) -> NDArray[np.float64]:
        """Return P (3 pieces, K): |P c|² is the integral of the squared jerk."""
        edges = np.linspace(self.start, self.end, pieces + 1)
        x, weights = _LEGENDRE
        half = (self.end - self.start) / pieces / 2
        at = ((edges[:-1] + edges[1:])[:, None] / 2 + half * x).ravel()
        root = np.sqrt(np.tile(weights * half, pieces))
        return np.asarray(root[:, None] * _basis(self.start, self.end, pieces, at, 3))

    def whitening(self, Q: NDArray[np.float64], smooth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return W (J, K, K) that whitens Qᵀ e of rounded samples; `smooth` (N, J) without e."""
        ends = np.cumsum([len(s) for (s, _, _), _ in self.parts])[:-1]
        rounded = [
            RoundedSamples(q, s.value, sigma * value, sigma, step)
            for ((s, _, sigma), step), q, value in zip(
                self.parts, np.split(Q, ends), np.split(smooth, ends), strict=True
            )
        ]
        return whitening(rounded)


class _Design:
    """Splines of one design, for all λ: in the basis in which samples and jerk are diagonal.

    With t > 0, BᵀB + t PᵀP = L Lᵀ and L⁻¹PᵀP L⁻ᵀ = V diag(s) Vᵀ:
    BᵀB + PᵀP/λ = L V (1 + (1/λ − t) s) Vᵀ Lᵀ. Everything is about a first fit, so that no digits of
    the sum of squares are lost.

    Args:
        A, P: rows of the samples and of the jerk.
        y: (N, C) samples of C splines in units of σ.

    Raises:
        numpy.linalg.LinAlgError: the samples do not determine the splines.

    """

    def __init__(
        self, A: NDArray[np.float64], P: NDArray[np.float64], y: NDArray[np.float64]
    ) -> None:
        self.size = A.shape[1]
        AA, PP = A.T @ A, P.T @ P
        self.t = _RIDGE * float(np.trace(AA) / np.trace(PP))
        L = cholesky(AA + self.t * PP, lower=True)
        X = solve_triangular(L, P.T, lower=True)
        s, V = eigh(X @ X.T)
        self.s = np.clip(s, 0.0, 1 / self.t)
        self.W = solve_triangular(L, V, lower=True, trans=1)  # c = c0 + W d
        self.log_det = 2 * float(np.sum(np.log(np.diag(L))))
        self.c0 = self.W @ (self.W.T @ (A.T @ y))
        left, jerk = y - A @ self.c0, P @ self.c0
        self.left2, self.jerk2 = np.sum(left**2, axis=0), np.sum(jerk**2, axis=0)
        self.by_left, self.by_jerk = self.W.T @ (A.T @ left), self.W.T @ (P.T @ jerk)

    def squares(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the penalized sums of squares, and log det M + (K − 3) u, at u = log λ (C, G)."""
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

    def __init__(self, samples: Sequence[_Samples], rate: float) -> None:
        self.samples, self.J = samples, samples[0].count
        self.pieces = [max(1, round(rate * (each.end - each.start))) for each in samples]
        self.weights = [np.ones(each.values.shape) for each in samples]
        groups = defaultdict(list)
        for k, each in enumerate(samples):
            groups[each.key()].append(k)
        self.designs: list[tuple[_Design, NDArray[np.intp], NDArray[np.intp]]] = []
        self.rate = rate
        for group in groups.values():
            self._add(group, np.arange(self.J))

    def _add(self, group: list[int], joints: NDArray[np.intp]) -> None:
        """Add the evidence of some joints in blocks of one design, with their present weights."""
        first = group[0]
        w = self.weights[first][:, joints[0]]
        A, P = self._design(first), self.samples[first].penalty(self.pieces[first])
        y = np.hstack([self.samples[k].values[:, joints] for k in group])
        try:
            design = _Design(w[:, None] * A, P, w[:, None] * y)
        except np.linalg.LinAlgError:  # too few samples say nothing about smoothness
            return
        blocks = np.repeat(group, len(joints))
        self.designs.append((design, blocks, np.tile(joints, len(group))))

    def _design(self, k: int) -> NDArray[np.float64]:
        """Return the rows of the samples of a block."""
        return self.samples[k].design(self.pieces[k])

    def _sums(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return sums of squares (J, G), their freedom (J, 1) and volume (J, G) at u (J, G)."""
        S, volume, count = np.zeros(u.shape), np.zeros(u.shape), np.zeros((len(u), 1))
        for design, blocks, joints in self.designs:
            each, log_det = design.squares(u[joints])
            np.add.at(S, joints, each)
            np.add.at(volume, joints, log_det)
            samples = [[len(self.weights[k]) - ORDER] for k in blocks]
            np.add.at(count, joints, np.array(samples, float))
        return S, count, volume

    def values(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return −2 log(evidence) (J, G) at u = log λ (J, G), up to a constant."""
        S, count, volume = self._sums(u)
        freedom = DECLARED + count
        return np.asarray(freedom * np.log((DECLARED + S) / freedom) + volume)

    def best(self) -> NDArray[np.float64]:
        """Return u = log λ (J,) of the largest evidence: a grid, then twice a parabola."""
        values = self.values(np.broadcast_to(_GRID, (self.J, len(_GRID))))
        u = _GRID[np.argmin(values, axis=1)]
        for step in (0.75, 0.1):
            at = u[:, None] + step * np.arange(-4, 5)
            values = self.values(at)
            k = np.clip(np.argmin(values, axis=1), 1, 7)[:, None]
            a, b, c = (np.take_along_axis(values, k + i, 1)[:, 0] for i in (-1, 0, 1))
            shift = np.clip(0.5 * (a - c) / np.maximum(a - 2 * b + c, 1e-12), -1, 1)
            u = np.take_along_axis(at, k, 1)[:, 0] + step * shift
        return np.asarray(u)

    def robust(self) -> tuple[Smoothness, list[NDArray[np.float64]]]:
        """Return the best smoothness, with samples that are far off weighted less, and weights."""
        for _ in range(_REWEIGHTINGS):
            u = self.best()
            S, count, _ = self._sums(u[:, None])
            noise = np.sqrt((DECLARED + S) / (DECLARED + count))[:, 0]
            if not self._reweight(u, noise):
                break
        return Smoothness(self.rate, np.exp(u / 2) * noise, noise), self.weights

    def _reweight(self, u: NDArray[np.float64], noise: NDArray[np.float64]) -> bool:
        """Weight the samples by their residuals; return whether a weight changed."""
        changed: list[tuple[int, int]] = []
        kept = []
        for design, blocks, joints in self.designs:
            c, same = design.coefficients(u[joints]), np.ones(len(blocks), bool)
            for k in np.unique(blocks):
                own = np.flatnonzero(blocks == k)
                j = joints[own]
                left = self.samples[k].values[:, j] - self._design(k) @ c[:, own]
                new = np.minimum(1.0, FAR / np.maximum(np.abs(left) / noise[j], 1e-9))
                same[own] = np.abs(new - self.weights[k][:, j]).max(axis=0) < 0.05
                self.weights[k][:, j] = np.where(same[own], self.weights[k][:, j], new)
                changed += [(int(k), int(each)) for each in j[~same[own]]]
            if same.all():
                kept.append((design, blocks, joints))
            else:
                for k in np.unique(blocks[same]):
                    changed += [(int(k), int(j)) for j in joints[same & (blocks == k)]]
        self.designs = kept
        for k, j in changed:
            self._add([k], np.array([j]))
        return bool(changed)
