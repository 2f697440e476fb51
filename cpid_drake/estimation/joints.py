"""The joints' motion by their own sensors: smoothing splines that continue from block to block.

Position, rate and acceleration continue at the ends of blocks; the spline of a block is quintic.
With samples q at times t, the rows of all its coefficients c are

    B(t) c = q / (σ f)    samples, with a noise factor f of the declared σ; a rounded value that
                          is repeated counts once
    P c = 0 / s           |P c|² = ∫ jerk² dt: the jerk is white noise of size s

so the jerk's prior bridges missing samples with the uncertainty that they leave. The number of
pieces, s and f have the largest marginal likelihood (evidence). With λ = s²/f², ν = `DECLARED` and
the banded M = BᵀB + PᵀP/λ, for n samples and K coefficients of the whole log,

    −2 log(evidence) = (ν + n − d) log(ν + S) + log det M + (K − d) log λ − log det PᵀP

with d = 3 for each part of the log that has no gap inside, the penalized χ² S, and det PᵀP that on
the coefficients that have a jerk.

Sources: Wahba 1990, Spline Models for Observational Data, ch. 1 and 4.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.joint_samples import JointSamples, Smoothness, once_weights
from cpid_drake.estimation.least_squares import loss_weight
from cpid_drake.estimation.likelihood.joint_motion import DEGREE, ORDER, JointPart
from cpid_drake.estimation.process import DECLARED_COUNT as DECLARED
from cpid_drake.estimation.process import Process
from cpid_drake.files.errors import InputError
from cpid_drake.sensors.suite import SensorSuite

FINER = 2
"""The gyro feels errors of the splines that encoders do not: so many times as many pieces."""

_GRID = np.arange(-29.0, 16.0, 3.0)  # of log λ: jerk noise of 1e-6 to 1e3 rad/s³·√s
_WIDTH = DEGREE + 2 * ORDER - 1  # of the bands: functions at both ends are sums of neighbours
_WORTH = 6.0  # of −2 log(evidence) for a rougher motion: strong evidence (Kass and Raftery 1995)
_FAST = 16.0  # pieces in a second, which follow 5 Hz: with too few, a fast motion looks like noise
_REWEIGHTINGS = 6  # at most; outliers look like a rough motion or like noise until they are known
_TOGETHER = 4096  # rows of the banded matrices that are factorized in one call
_SAME = 0.05  # change of a weight that does not matter
_SHAPES = 9, 7  # of τ and of ratios
_FIRST = (1, 2), (3, 2), (5, 2)  # shapes that are tried first
_PRICE = 12.0  # of −2 log(evidence): of noise that is not white


def smooth_joints(
    blocks: Sequence[Block], suite: SensorSuite
) -> tuple[Smoothness, list[JointPart]]:
    """Return the smoothness of a log's joints, and their smoothed motion in successive blocks.

    Args:
        blocks: successive blocks of one log.
        suite: the sensors' errors.

    Raises:
        InputError: the samples are too few.

    """
    samples = [JointSamples(block, suite) for block in blocks]
    once = once_weights(samples)
    processes: dict[str, Process] = {}
    weights = once
    try:
        for _ in range(_REWEIGHTINGS):
            samples = [each.with_processes(processes) for each in samples]
            rate = FINER * _best_rate(samples, weights, once)
            splines = _Splines(samples, rate, weights, once)
            u, noise = splines.best()
            loss = splines.weights(u, noise)
            before, weights = weights, [w * o for w, o in zip(loss, once, strict=True)]
            pairs = zip(before, weights, strict=True)
            is_same = max(np.abs(a - b).max(initial=0.0) for a, b in pairs) < _SAME
            if not is_same:
                continue
            smoothness = Smoothness(splines.rate, np.exp(u / 2) * noise, noise)
            old, processes = processes, _processes(splines, u, processes)
            if old == processes:
                break
        noise = np.maximum(noise, 1.0)
        c, jerk = splines.solved(u), np.exp(u / 2) * noise
    except np.linalg.LinAlgError as error:
        raise InputError("encoders: too few samples to show how the joints move") from error
    smoothness = Smoothness(splines.rate, jerk, noise, processes)
    parts = [
        each.part(smoothness, w).about(c[place])
        for each, w, place in zip(samples, before, splines.places, strict=True)
    ]
    return smoothness, parts


def continued(part: JointPart, before: Array) -> JointPart:
    """Return the part that continues what is at the end of the block before, (ORDER, J)."""
    c = part.coefficients.copy()
    c[:ORDER] = before
    for own, rest, A in zip(c.T, part.about(c).rest, part.rows, strict=True):
        own[ORDER:] += np.linalg.lstsq(A[:, ORDER:], rest, rcond=1e-12)[0]
    return part.about(c)


def _processes(
    splines: "_Splines", u: Array, now: Mapping[str, Process]
) -> dict[str, Process]:
    """Return the shapes of the noise, of variance 1, of the joints' sensors without steps.

    They have the largest evidence of a grid of τ and of ratios of slow and white variances, if it
    is much larger than that of white noise: shapes are tried from one to its neighbours.
    """
    found = dict(now)
    times = splines.times
    for name, t in times.items():
        step, known = float(np.median(np.diff(t))) if len(t) > 2 else 1.0, {}

        def cost(at: tuple[int, int] | None) -> float:
            if at not in known:
                shapes = {n: p for n, p in found.items() if n != name}
                if at is not None:
                    shapes[name] = _shape(step, *at)
                price = 0.0 if at is None else _PRICE
                known[at] = splines.of(shapes).least_about(u) + price
            return known[at]

        places = {_shape(step, i, j): (i, j) for i in range(_SHAPES[0]) for j in range(_SHAPES[1])}
        best = places.get(found.get(name, Process()))
        tried = [None, *_FIRST] if best is None else [None, best]
        best = min(tried, key=cost)
        while best is not None:
            i, j = best
            near = [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]
            near = [at for at in near if 0 <= at[0] < _SHAPES[0] and 0 <= at[1] < _SHAPES[1]]
            better = min([best, *near], key=cost)
            if better == best:
                break
            best = better
        found.pop(name, None)
        if best is not None:
            found[name] = _shape(step, *best)
    return found


def _shape(step: float, i: int, j: int) -> Process:
    """Return one of the shapes: τ from a step on, and slow noise of 0.1 to 100 of the white."""
    ratio = 0.1 * 10 ** (j / 2)
    return Process(1 / (1 + ratio), ratio / (1 + ratio), step * 2.0**i, 1)


class _Splines:
    """The splines of a log for any jerk; joints with the same weights share their algebra.

    Everything is about a first fit, so that no digits of the sum of squares are lost.

    Args:
        samples: of successive blocks.
        rate: pieces in a second.
        weights: (N, J) of every block.
        once: (N, J) the weights without outliers; see `once_weights`.

    Attributes:
        places: of the blocks' coefficients among those of the log; neighbours share `ORDER`, if no
            gap is between them.

    """

    def __init__(
        self, samples: Sequence[JointSamples], rate: float, weights: list[Array], once: list[Array]
    ) -> None:
        self.rate, self._weights, self._samples, self._once = rate, weights, samples, once
        pieces = [each.pieces(rate) for each in samples]
        begins = [a.end < b.start for a, b in pairwise(samples)]  # behind a gap
        self._free, J = ORDER * (1 + sum(begins)), weights[0].shape[1]
        ends = np.cumsum([n + DEGREE - ORDER for n in pieces])
        ends += ORDER * np.cumsum([1, *begins])
        self.places = [slice(b - n - DEGREE, b) for b, n in zip(ends.tolist(), pieces)]
        self.size = self.places[-1].stop
        self._A = [each.design(n) for each, n in zip(samples, pieces, strict=True)]
        self._P = [each.penalty(n) for each, n in zip(samples, pieces, strict=True)]
        is_white = all(each.is_white for each in samples)
        self._width = _WIDTH if is_white else max(X.shape[1] for X in self._A)
        self._PP, groups = self._banded(self._P), defaultdict(list)
        for j in range(J):
            groups[b"".join(w[:, j].tobytes() for w in weights)].append(j)
        self._group, bands = np.zeros(J, dtype=int), list[Array]()
        for joints in groups.values():
            parts = zip(samples, weights, self._A, strict=True)
            weighted = [each.white(w[:, joints[:1]] * A) for each, w, A in parts]
            self._group[joints] = len(bands)
            bands.append(self._banded(weighted))
        self._AA = np.reshape(bands, (-1, self.size, self._width))  # a platform may have no joints
        self._c, self._left = np.zeros((self.size, J)), [each.values for each in samples]
        self._expand()
        first = self.solved(np.zeros(J))
        self._left, self._c = self._residuals(first), first
        self._expand()
        # Without the state at its end, the jerk determines each block by itself.
        own = [np.diag(np.linalg.qr(P[:, :-ORDER], mode="r")) for P in self._P]
        volume = 2 * np.sum(np.log(np.abs(np.concatenate(own))))
        volume -= sum(each.volume for each in samples)
        self._constant = -volume - 2 * np.sum(np.log(np.concatenate(weights)), axis=0)
        samples_once = np.sum(np.concatenate(once) ** 2, axis=0)
        self._freedom = DECLARED + np.maximum(samples_once - self._free, 0.0)

    def _expand(self) -> None:
        """Compute sums of squares and their gradients at `_c`."""
        parts = zip(self._samples, self._weights, self._left, strict=True)
        left = [each.white(w * r) for each, w, r in parts]
        jerk = [P @ self._c[place] for P, place in zip(self._P, self.places, strict=True)]
        self._left2, self._jerk2 = (
            np.asarray(sum(np.sum(r**2, axis=0) for r in each)) for each in (left, jerk)
        )
        self._by_left, self._by_jerk = np.zeros((2, *self._c.shape))
        for k, place in enumerate(self.places):
            back = self._samples[k].transposed(left[k])
            self._by_left[place] += self._A[k].T @ (self._weights[k] * back)
            self._by_jerk[place] += self._P[k].T @ jerk[k]

    def _residuals(self, c: Array) -> list[Array]:
        """Return what coefficients (K, J) more leave of the samples of each block."""
        blocks = zip(self._left, self._A, self.places, strict=True)
        return [left - A @ (c - self._c)[place] for left, A, place in blocks]

    def _banded(self, rows: list[Array]) -> Array:
        """Return the sum of XᵀX over the rows X of all blocks, as the transpose of LAPACK's."""
        band = np.zeros((self.size, self._width))
        for X, place in zip(rows, self.places, strict=True):
            i, j = _band(X.shape[1], self._width)
            band[place.start + j, self._width - 1 + i - j] += (X.T @ X)[i, j]
        return band

    def _roots(self, group: NDArray[np.intp], q: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the Cholesky factors of AA + q PᵀP, banded, side by side; and which of them exist.

        One that does not exist is 1.
        """
        M, good = self._AA[group] + q[:, None, None] * self._PP, np.ones(len(q), dtype=bool)
        while failed := (found := lapack.dpbtrf(M.reshape(-1, self._width).T))[1]:
            good[(failed - 1) // self.size] = False
            M[~good] = np.arange(self._width) == self._width - 1
        return found[0], good

    @property
    def times(self) -> dict[str, Array]:
        """Times of the samples of sensors without steps [s], by name."""
        names = {name for each in self._samples for name in each.times}
        nothing = np.empty(0)
        return {n: np.concatenate([s.times.get(n, nothing) for s in self._samples]) for n in names}

    def of(self, processes: Mapping[str, Process]) -> "_Splines":
        """Return the splines with other noise."""
        samples = [each.with_processes(processes) for each in self._samples]
        return _Splines(samples, self.rate, self._weights, self._once)

    def least_about(self, u: Array) -> float:
        """Return the least −2 log(evidence) of all joints near u = log λ (J,) or smoother."""
        near = u[:, None] + 3.0 * np.arange(-4, 2)
        return float(self.values(near).min(axis=1, initial=np.inf).sum())

    def values(self, u: Array) -> Array:
        """Return −2 log(evidence) (J, G) at u = log λ (J, G)."""
        S, volume = self._squares(u)
        volume = volume + (self.size - self._free) * u + self._constant[:, None]
        return np.asarray(self._freedom[:, None] * np.log(DECLARED + S) + volume)

    def _squares(self, u: Array) -> tuple[Array, Array]:
        """Return penalized χ² and log det M (J, G) at u = log λ (J, G)."""
        S, log_det = np.empty((2, u.size))
        pairs = [np.repeat(self._group, u.shape[1]), u.ravel()]
        (group, value), which = np.unique(pairs, axis=1, return_inverse=True)
        order = np.argsort(which, kind="stable")
        count = 1 + _TOGETHER // self.size
        for first in range(0, len(value), count):
            some = slice(first, first + count)
            at = order[slice(*np.searchsorted(which[order], [some.start, some.stop]))]
            q, k, j = np.exp(-value[some]), which[at] - first, at // u.shape[1]
            roots, good = self._roots(group[some].astype(int), q)
            place = np.arange(len(k)) - np.searchsorted(k, k)
            by = self._by_left.T[j] - q[k, None] * self._by_jerk.T[j]
            right = np.zeros((place.max() + 1, len(q), self.size))
            right[place, k] = by
            solved = lapack.dpbtrs(roots, right.reshape(len(right), -1).T)[0].T
            fall = np.einsum("nk,nk->n", by, solved.reshape(right.shape)[place, k])
            squares = np.maximum(self._left2[j] + q[k] * self._jerk2[j] - fall, 0.0)
            S[at] = np.where(good[k], squares, np.inf)
            log_det[at] = 2 * np.sum(np.log(roots[-1].reshape(len(q), -1)), axis=1)[k]
        return S.reshape(u.shape), log_det.reshape(u.shape)

    def solved(self, u: Array) -> Array:
        """Return all coefficients (K, J) at u = log λ (J,)."""
        q = np.exp(-u)
        roots, good = self._roots(self._group, q)
        if not good.all():
            raise np.linalg.LinAlgError("the samples do not determine so rough a motion")
        by = (self._by_left - q * self._by_jerk).T
        return np.asarray(self._c + lapack.dpbtrs(roots, by.ravel())[0].reshape(by.shape).T)

    def best(self) -> tuple[Array, Array]:
        """Return u = log λ (J,) and the noise factors (J,).

        The smoothest u of a grid that is not much worse than the best one; then parabolas.
        """
        values = self.values(np.broadcast_to(_GRID, (len(self._left2), len(_GRID))))
        u = _GRID[np.argmax(values < values.min(axis=1)[:, None] + _WORTH, axis=1)]
        for step in (0.75, 0.1):
            at = u[:, None] + step * np.arange(-4, 5)
            values = self.values(at)
            k = np.clip(np.argmin(values, axis=1), 1, 7)[:, None]
            a, b, c = (np.take_along_axis(values, k + i, 1)[:, 0] for i in (-1, 0, 1))
            with np.errstate(invalid="ignore"):  # beside a motion that is too rough for the samples
                shift = np.nan_to_num(0.5 * (a - c) / np.maximum(a - 2 * b + c, 1e-12))
            u = np.take_along_axis(at, k, 1)[:, 0] + step * np.clip(shift, -1, 1)
        return u, np.sqrt((DECLARED + self._squares(u[:, None])[0][:, 0]) / self._freedom)

    def weights(self, u: Array, noise: Array) -> list[Array]:
        """Return the weights (N, J) of every block that the residuals show."""
        left = self._residuals(self.solved(u))
        return [loss_weight(r / noise) for r in left]


@lru_cache(maxsize=64)
def _band(size: int, width: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the entries of the upper band of a matrix."""
    i, j = np.triu_indices(size)
    inside = j - i < width
    return i[inside], j[inside]


def _best_rate(samples: Sequence[JointSamples], weights: list[Array], once: list[Array]) -> float:
    """Return the pieces in a second with the most evidence, or less if it is about as much.

    More than `_FAST` are tried as long as they have more.
    """
    usual = float(np.median([each.end - each.start for each in samples]))
    best, least, pieces = 1 / usual, np.inf, 1
    most = float(np.median([len(each.values) for each in samples])) / 2  # samples show no more
    while pieces == 1 or pieces <= most:
        splines = _Splines(samples, pieces / usual, weights, once)
        grid = np.broadcast_to(_GRID, (weights[0].shape[1], len(_GRID)))
        value = float(splines.values(grid).min(axis=1).sum())
        if value < least - _WORTH:
            best, least = splines.rate, value
        elif splines.rate >= _FAST:
            break
        pieces *= 2
    return best
