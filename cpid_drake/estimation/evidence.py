"""Does a log have momentum, and does it change? The evidence of a fit with and without it.

Only these can be exactly zero; all other errors are always unknowns. A fit with all candidates free
is a Gaussian. Without a candidate, it is that Gaussian conditioned on zero: no second fit. The
evidence ∫ L(x) p(x) dx of a set F of free candidates, with x ~ N(0, (a σ)²) for each, is in
information form

    ½ bᵀA⁻¹b − ½ log det A − Σ log a,     A = H_FF + a⁻²,

H and b the information of the samples about the candidates in units of σ. Each candidate has the
size a among `SIZES` that its own evidence prefers, at the price of log(len(SIZES)): a vague prior
would hide what is small. Every set has its probability, and the target is the average over all
sets: what the samples cannot distinguish widens its interval.

Sources: MacKay 2003, Information Theory, Inference, and Learning Algorithms, ch. 28; Hoeting et al.
1999, Bayesian Model Averaging.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from cpid_drake.array import Array
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.gaussian import Gaussian, indices_of
from cpid_drake.estimation.unknowns import MOMENTUM, Model

SIZES = 10.0 ** np.arange(1, -7, -1)
"""Sizes of an error that are compared, in units of its σ."""

NAMED = 0.9
"""Probability from which a candidate is said to act."""

MOST_CANDIDATES = 12
"""Number of candidates of which all sets are compared; each has the largest evidence beside those
before it."""

UNLIKELY = 0.02
"""Odds of a candidate beside those before it, below which no more are compared."""

MOMENTUM_ODDS, CHANGE_ODDS, WRONG_ODDS = 1 / 10, 1 / 40, 1 / 100
"""Odds before the samples: that a log has a momentum that is not stated, that momentum changes
at the end of one block, and that a momentum is not as given. A size that the samples do not
determine would otherwise look as likely as none."""

POSSIBLE = 0.3
"""Odds of a change beside no other, from which all sets are compared."""

_NEGLIGIBLE = 1e-6  # probability of a set that does not count in the average


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Which candidates act.

    Attributes:
        probability: of each candidate to act.
        best: the most probable set.
        gaussian: average of the kept unknowns over all sets, with the differences between them.
        values: (k,) of each candidate in the best set, in its own units.
        covariance: (k, k) theirs.
        sizes: of each candidate beside those before it, as shares of its σ; of those that were
            compared.

    """

    probability: dict[str, float]
    best: tuple[str, ...]
    gaussian: Gaussian
    values: dict[str, Array]
    covariance: dict[str, Array]
    sizes: dict[str, float]

    @property
    def sigma(self) -> dict[str, Array]:
        """(k,) σ of `values`."""
        return {name: np.sqrt(np.diag(each)) for name, each in self.covariance.items()}

    @property
    def named(self) -> tuple[str, ...]:
        """The candidates that act with a probability of `NAMED` or more."""
        return tuple(name for name, p in self.probability.items() if p >= NAMED)


def compare(
    gaussian: Gaussian,
    candidates: Mapping[str, Array],
    kept: Sequence[str],
    odds: Mapping[str, float] | None = None,
) -> ModelComparison:
    """Compare all sets of candidates.

    Args:
        gaussian: of all unknowns themselves (not of deviations), the candidates' priors
            N(0, σ²) included.
        candidates: σ of each candidate's entries.
        kept: the unknowns that are averaged; all others are marginalized.
        odds: of candidates before the samples; default: one of all candidates acts.

    """
    probabilities = dict.fromkeys(candidates, 1 / max(len(candidates), 1)) | dict(odds or {})
    return _Sets(gaussian, candidates, kept).comparison(
        {name: float(np.log(value)) for name, value in probabilities.items()}
    )


@dataclass(frozen=True, eq=False)
class Question:
    """The alternatives of a comparison.

    Attributes:
        candidates: σ of the momenta that may be zero.
        given: values of unknowns that the caller has given.

    """

    candidates: dict[str, Array]
    given: dict[str, Array]

    @classmethod
    def of(cls, model: Model, logs: Collection[str], momentum: TotalMomentum | None) -> "Question":
        """Return the question about the momenta of some logs.

        Args:
            model: with a σ of the momentum.
            logs: names of the logs.
            momentum: the total momentum; None to compare zero with an unknown one.

        """
        unknown = model.unknown(MOMENTUM)
        keys = [unknown.key(name) for name in logs]
        if momentum is None:
            return cls(dict.fromkeys(keys, unknown.sigma), {})
        value = np.concatenate([momentum.L_WScm_W, momentum.v_WScm_W])
        return cls({}, {} if momentum.is_unknown else dict.fromkeys(keys, value))

    def without_contradicted(
        self, gaussian: Gaussian, values: Mapping[str, Array], model: Model
    ) -> "Question":
        """Return the question without those of the given momenta that the samples contradict.

        Args:
            gaussian: of all unknowns about their values.
            values: of the unknowns.
            model: with the σ of a momentum that is not given.

        """
        given = self.given
        if not given:
            return self
        own = gaussian.marginal(given)
        apart = np.concatenate([given[name] - values[name] for name in own.places])
        if 0.5 * (own.cost(apart) - own.least_cost) + np.log(WRONG_ODDS) < 0:
            return self  # no evidence is larger than the ratio of likelihoods
        about = np.concatenate([values[n] - given.get(n, 0.0) for n in gaussian.places])
        candidates = dict.fromkeys(given, model.unknown(MOMENTUM).sigma)
        kept = [name for name in gaussian.places if name not in candidates]
        odds = dict.fromkeys(candidates, WRONG_ODDS)
        likely = compare(gaussian.moved(-about), candidates, kept, odds).probability
        return replace(self, given={n: v for n, v in given.items() if likely[n] < NAMED})

    def answer(
        self,
        gaussian: Gaussian,
        values: Mapping[str, Array],
        further: Mapping[str, Array] | None = None,
    ) -> ModelComparison:
        """Compare all sets of candidates.

        Args:
            gaussian: of all unknowns about their values.
            values: of the unknowns.
            further: changes of momentum with their σ, which are candidates too.

        """
        x = np.concatenate([values[name] for name in gaussian.places])
        given = {name: value for name, value in self.given.items() if name in values}
        conditioned = gaussian.moved(-x).condition(given)
        changes = dict(further or {})
        sigma = self.candidates | changes
        kept = [name for name in conditioned.places if name not in sigma]
        odds = dict.fromkeys(self.candidates, MOMENTUM_ODDS) | dict.fromkeys(changes, CHANGE_ODDS)
        return compare(conditioned, sigma, kept, odds)

    def held(self, values: Mapping[str, Array], best: Collection[str]) -> dict[str, Array]:
        """Return the momenta that are held if the best candidates act, less their values."""
        zero = {name: np.zeros(1) for name in self.candidates if name not in best}
        return {name: value - values[name] for name, value in (zero | self.given).items()}


class _Sets:
    """The information about the kept unknowns k and the candidates c, in units of σ.

    The candidates' own priors are taken out. What remains is H_cc and b_c with k eliminated, and
    the k for given c.
    """

    def __init__(
        self, gaussian: Gaussian, candidates: Mapping[str, Array], kept: Sequence[str]
    ) -> None:
        self.names = [name for name in gaussian.places if name in candidates]
        both = gaussian.marginal([*kept, *self.names])
        self.kept_sizes = {name: both.sizes[name] for name in kept}
        n = len(indices_of(both.places, kept))
        sigma = np.concatenate([np.empty(0), *(candidates[name] for name in self.names)])
        scale = np.concatenate([1 / np.linalg.norm(both.R[:, :n], axis=0), sigma])
        R = both.R * scale
        self.sigma, self.kept_scale = sigma, scale[:n]
        T, z = R[:n, :n], both.z[:n]  # k given c: T k = z − G c
        self.by_c = solve_triangular(T, R[:n, n:])
        self.at_zero = solve_triangular(T, z)
        inverse = solve_triangular(T, np.eye(n))
        self.covariance_k = inverse @ inverse.T
        C = R[n:, n:]
        self.H, self.b = C.T @ C - np.eye(len(sigma)), C.T @ both.z[n:]
        self.places = {name: indices_of(both.places, [name]) - n for name in self.names}
        self.size: dict[str, float] = {}

    def evidence(
        self, free: Sequence[str], size: Mapping[str, float]
    ) -> tuple[float, NDArray[np.intp], Array]:
        """Return the log evidence of a set against none, its entries, and A's Cholesky factor."""
        index = np.concatenate([np.empty(0, np.intp), *(self.places[name] for name in free)])
        a = np.concatenate([np.empty(0), *(np.full(len(self.places[n]), size[n]) for n in free)])
        A = self.H[np.ix_(index, index)] + np.diag(a**-2)
        d = 1 / np.sqrt(np.diag(A))
        L = cholesky(A * d * d[:, None], lower=True)
        y = solve_triangular(L, d * self.b[index], lower=True)
        log_det = 2 * float(np.sum(np.log(np.diag(L)) - np.log(d)))
        price = float(np.sum(np.log(a))) + len(free) * np.log(len(SIZES))
        return 0.5 * float(y @ y) - 0.5 * log_det - price, index, L / d[:, None]

    def _evidence_of_sets(self, names: Sequence[str]) -> Array:
        """Return the log evidence (2ⁿ,) of all sets of n names; bit k of a set's number is name k.

        One name after the other is left out of all sets so far, or eliminated from them.
        """
        _, index, L = self.evidence(names, self.size)
        A = L @ L.T
        d = 1 / np.sqrt(np.diag(A))
        left = np.column_stack([A * d * d[:, None], d * self.b[index]])[None]
        values = np.zeros(1)
        for name in names:
            m = len(self.places[name])
            root = np.linalg.cholesky(left[:, :m, :m])
            by = np.linalg.solve(root, left[:, :m, m:])
            rest, across = left[:, m:, m:], np.swapaxes(by[..., :-1], -1, -2)
            log_det = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
            log_det -= np.sum(np.log(d[:m]))
            price = m * np.log(self.size[name]) + np.log(len(SIZES))
            gain = 0.5 * np.sum(by[..., -1] ** 2, axis=1) - log_det - price
            values = np.concatenate([values, values + gain])
            left, d = np.concatenate([rest, rest - across @ by]), d[m:]
        return values

    def comparison(self, odds: Mapping[str, float]) -> ModelComparison:
        """Return the comparison for the logs of all candidates' odds."""
        some = list[str]()
        while len(some) < MOST_CANDIDATES and (others := [n for n in self.names if n not in some]):
            gains = self._gains(others, some)
            name = max(gains, key=lambda each: gains[each].max() + odds[each])
            if gains[name].max() + odds[name] < np.log(UNLIKELY):
                break
            self.size[name] = float(SIZES[np.argmax(gains[name])])
            some.append(name)
        wide = {name: self._mean_size(name, [n for n in some if n != name]) for name in some}
        values = self._evidence_of_sets(some)
        sets = [
            [name for k, name in enumerate(some) if bits >> k & 1] for bits in range(len(values))
        ]
        values += [sum(odds[name] for name in free) for free in sets]
        first = int(np.argmax(values))
        weights = np.exp(values - values[first])
        weights /= weights.sum()
        free = sets[first]
        n, nearby = len(self.at_zero), self.kept(*self.evidence(free, self.size)[1:])[0]
        _, index, L = self.evidence(free, wide)
        mean, square, probability = np.zeros(n), np.zeros((n, n)), dict.fromkeys(self.names, 0.0)
        for weight, each in zip(weights, sets, strict=True):
            for name in each:
                probability[name] += float(weight)
            if weight > _NEGLIGIBLE:
                k, P = self.kept(*self.evidence(each, wide)[1:])
                k = k - nearby
                mean, square = mean + weight * k, square + weight * (P + np.outer(k, k))
        scale = self.kept_scale
        x = self.sigma[index] * cho_solve((L, True), self.b[index])
        inverse = solve_triangular(L, np.diag(self.sigma[index]), lower=True)
        of_free = inverse.T @ inverse
        ends = np.cumsum([0, *(len(self.places[name]) for name in free)]).tolist()
        parts = dict(zip(free, map(slice, ends[:-1], ends[1:]), strict=True))
        covariance = square - np.outer(mean, mean)
        own = np.sqrt(np.diag(covariance))
        root = cholesky(covariance / own / own[:, None], lower=True)
        whiten = solve_triangular(root, np.diag(1 / own / scale), lower=True)
        average = np.column_stack([whiten, whiten @ ((nearby + mean) * scale)])
        return ModelComparison(
            probability,
            tuple(free),
            Gaussian.of_rows(self.kept_sizes, average),
            {name: x[part] for name, part in parts.items()},
            {name: of_free[part, part] for name, part in parts.items()},
            self.size,
        )

    def _mean_size(self, name: str, others: Sequence[str]) -> float:
        """Return the root of the mean square of a candidate's size, by the evidence of each.

        Entries that no sample shows are as large as the others: few do not show how large.
        """
        gains = self._gains([name], others)[name]
        weights = np.exp(gains - gains.max())
        return float(np.sqrt(weights @ SIZES**2 / weights.sum()))

    def _gains(self, names: Sequence[str], free: Sequence[str]) -> dict[str, Array]:
        """Return the evidence for each candidate beside free ones, for each of `SIZES`."""
        _, index, L = self.evidence(free, self.size)
        by_free = solve_triangular(L, np.column_stack([self.H[index], self.b[index]]), lower=True)
        gains = {}
        for name in names:
            own = self.places[name]
            H = self.H[np.ix_(own, own)] - by_free[:, own].T @ by_free[:, own]
            gains[name] = _gain(H, self.b[own] - by_free[:, own].T @ by_free[:, -1])
        return gains

    def kept(self, index: NDArray[np.intp], L: Array) -> tuple[Array, Array]:
        """Return mean and covariance of the kept unknowns for one set."""
        G = self.by_c[:, index]
        mean = self.at_zero - G @ cho_solve((L, True), self.b[index])
        half = solve_triangular(L, G.T, lower=True)
        return mean, self.covariance_k + half.T @ half


def _gain(H: Array, b: Array) -> Array:
    """Return the evidence for a candidate, for each of `SIZES`, of samples that tell H and b of it.

    With H = V diag(h) Vᵀ it is ½ Σ (a Vᵀb)²/(1 + a² h) − ½ Σ log(1 + a² h) − log(len(SIZES)).
    """
    (h, V), a2 = np.linalg.eigh(H), SIZES[:, None] ** 2
    size = 1 + a2 * np.maximum(h, 0.0)
    gain = 0.5 * np.sum(a2 * (V.T @ b) ** 2 / size - np.log(size), axis=1)
    return np.asarray(gain - np.log(len(SIZES)))


def is_possible_change(gaussian: Gaussian, sigma: Array) -> bool:
    """Return whether one of some changes of momentum, beside no other, has odds of `POSSIBLE`.

    Args:
        gaussian: of the changes themselves, their priors N(0, σ²) included.
        sigma: (12,) of each.

    """
    R = gaussian.R * np.tile(sigma, len(gaussian.places))
    H, b = R.T @ R - np.eye(len(R)), R.T @ gaussian.z
    gains = [_gain(H[own, own], b[own]).max() for own in gaussian.places.values()]
    return bool(max(gains) + np.log(CHANGE_ODDS) > np.log(POSSIBLE))
