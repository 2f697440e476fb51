"""Does a log have momentum, and does it change? The evidence of a fit with and without it.

Only these can be exactly zero, or as the caller says; all other errors are always unknowns. A fit
with all candidates free is a Gaussian. Without a candidate, it is that Gaussian conditioned on
zero: no second fit. Beside others that act, a candidate x ~ N(0, (a σ)²) has the evidence

    log ∫ L(x) p(x) dx − log L(0) = ½ bᵀ(H + a⁻²)⁻¹b − ½ log det(a²H + 1),

H and b the information of the samples about it in units of σ. Its size a is the one among `SIZES`
that this evidence prefers, at the price of log(len(SIZES)): a vague prior would hide what is small.

All that may act are taken in one after the other; then each is kept or left out by its evidence
beside the others, until none is to be changed. Each adds its doubt to the target: one that may act
or not widens its interval.

Sources: MacKay 2003, Information Theory, Inference, and Learning Algorithms, ch. 28; Hoeting et al.
1999, Bayesian Model Averaging.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import expit

from cpid_drake.array import Array
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.gaussian import Gaussian, indices_of
from cpid_drake.estimation.unknowns import MOMENTUM, Model

SIZES = 10.0 ** np.arange(1, -7, -1)
"""Sizes of an error that are compared, in units of its σ."""

NAMED = 0.9
"""Probability from which a candidate is said to act."""

MOST_CANDIDATES = 12
"""Most candidates that are compared: each has the largest evidence beside those before it."""

UNLIKELY = 0.02
"""Odds of a candidate beside those before it, below which no more are compared."""

MOMENTUM_ODDS, UNEXPECTED_ODDS = 1 / 10, 1 / 40
"""Odds before the samples: that a log has a momentum that is not stated; and that momentum changes
at the end of one block, or is not as given. A size that the samples do not determine would
otherwise look as likely as none."""

POSSIBLE = 0.3
"""Odds of a change beside no other, from which changes are compared."""

_NEGLIGIBLE = 1e-6  # probability of a doubt that does not count


@dataclass(frozen=True, eq=False)
class ModelComparison:
    """Which candidates act.

    Attributes:
        probability: of each candidate to act.
        best: the most probable set.
        gaussian: of the kept unknowns: of the best set, with the doubts about it.
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
    def named(self) -> tuple[str, ...]:
        """The candidates that act with a probability of `NAMED` or more."""
        return tuple(name for name, p in self.probability.items() if p >= NAMED)


def compare(
    gaussian: Gaussian,
    candidates: Mapping[str, Array],
    kept: Sequence[str],
    odds: Mapping[str, float],
    doubted: Collection[str] | None = None,
) -> ModelComparison:
    """Compare sets of candidates.

    Args:
        gaussian: of all unknowns themselves (not of deviations), the candidates' priors
            N(0, σ²) included.
        candidates: σ of each candidate's entries.
        kept: the unknowns whose distribution is returned; all others are marginalized.
        odds: of candidates before the samples.
        doubted: candidates whose doubts count in this distribution; default: all.

    """
    log_odds = {name: float(np.log(value)) for name, value in odds.items()}
    problem = _Candidates(gaussian, candidates, kept, log_odds)
    return problem.comparison(candidates if doubted is None else doubted)


@dataclass(frozen=True, eq=False)
class Question:
    """The alternatives of a comparison: the momentum of logs is as supposed, or not.

    Attributes:
        sigma: σ of these momenta if they are not.
        supposed: their values: zero, or as given.
        is_given: whether the caller has given them.

    """

    sigma: Mapping[str, Array] = field(default_factory=dict)
    supposed: Mapping[str, Array] = field(default_factory=dict)
    is_given: bool = False

    @classmethod
    def of(cls, model: Model, logs: Collection[str], momentum: TotalMomentum | None) -> "Question":
        """Return the question about the momentum of some logs.

        Args:
            model: with a σ of the momentum.
            logs: names of the logs.
            momentum: the total momentum; None to compare zero with an unknown one.

        """
        if momentum is not None and momentum.is_unknown:
            return cls(is_given=True)
        supposed = momentum or TotalMomentum.zero()
        value = np.concatenate([supposed.L_WScm_W, supposed.v_WScm_W])
        unknown = model.unknown(MOMENTUM)
        keys = [unknown.key(name) for name in logs]
        is_given = momentum is not None
        return cls(dict.fromkeys(keys, unknown.sigma), dict.fromkeys(keys, value), is_given)

    def answer(
        self,
        gaussian: Gaussian,
        values: Mapping[str, Array],
        further: Mapping[str, Array] | None = None,
    ) -> ModelComparison:
        """Compare sets of candidates, and return their Gaussian about the values, too.

        What is given is left only if another momentum is more probable; before, there is no doubt.

        Args:
            gaussian: of all unknowns about their values.
            values: of the unknowns.
            further: changes of momentum with their σ, which are candidates too.

        """
        changes, own = dict(further or {}), [n for n in self.sigma if n in gaussian.places]
        apart = [values[name] - self.supposed.get(name, 0.0) for name in gaussian.places]
        sigma = {name: self.sigma[name] for name in own} | changes
        kept = [name for name in gaussian.places if name not in sigma]
        odds = dict.fromkeys(own, UNEXPECTED_ODDS if self.is_given else MOMENTUM_ODDS)
        odds |= dict.fromkeys(changes, UNEXPECTED_ODDS)
        doubted = {*changes, *([] if self.is_given else own)}
        compared = compare(gaussian.minus(-np.concatenate(apart)), sigma, kept, odds, doubted)
        of_best = {n: x + self.supposed.get(n, 0.0) for n, x in compared.values.items()}
        now = [values[name] for name in compared.gaussian.places]
        about = compared.gaussian.minus(np.concatenate(now))
        return replace(compared, gaussian=about, values=of_best)

    def held(self, values: Mapping[str, Array], best: Collection[str]) -> dict[str, Array]:
        """Return the momenta that are held if the best candidates act, less their values."""
        held = {name: each for name, each in self.supposed.items() if name not in best}
        return {name: each - values[name] for name, each in held.items()}


class _Candidates:
    """The information about the kept unknowns k and the candidates c, in units of σ.

    The candidates' own priors are taken out. What remains is H_cc and b_c with k eliminated, and
    the k for given c.
    """

    def __init__(
        self,
        gaussian: Gaussian,
        candidates: Mapping[str, Array],
        kept: Sequence[str],
        log_odds: Mapping[str, float],
    ) -> None:
        self.names = [name for name in gaussian.places if name in candidates]
        self.log_odds = log_odds
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
        # The information about c, and less its prior of a unit: H = CᵀC − 1, b = Cᵀz.
        self.H, self.b = C.T @ C - np.eye(len(sigma)), C.T @ both.z[n:]
        self.places = {name: indices_of(both.places, [name]) - n for name in self.names}
        self.size: dict[str, float] = {}

    def comparison(self, doubted: Collection[str]) -> ModelComparison:
        """Return the comparison, with the doubts about some of the candidates."""
        some = self._some()
        best, log_odds = self._best(some)
        # p of being otherwise than in the best set, beside which one candidate is in doubt.
        doubts = {n: float(expit(-each if n in best else each)) for n, each in log_odds.items()}
        probability = dict.fromkeys(self.names, 0.0)
        probability |= {name: 1 - p if name in best else p for name, p in doubts.items()}
        wide = {name: self._mean_size(name, [n for n in some if n != name]) for name in some}
        mean, covariance, x, of_best = self._with(best, wide)
        # Each doubt p moves k by δ: E[k] += p δ, Cov[k] += p (P − P_best)₊ + p (1 − p) δ δᵀ.
        moved, spread = np.zeros_like(mean), np.zeros_like(covariance)
        for name, p in doubts.items():
            if name not in doubted or p < _NEGLIGIBLE:
                continue
            other = [n for n in some if (n in best) != (n == name)]
            k, P, _, _ = self._with(other, wide)
            moved += p * (k - mean)
            spread += p * (1 - p) * np.outer(k - mean, k - mean)
            if name not in best:  # one that may be zero keeps its variance
                spread += p * (P - covariance)
        mean, covariance = mean + moved, covariance + spread
        own = np.sqrt(np.diag(covariance))
        root = cholesky(covariance / own / own[:, None], lower=True)
        whiten = solve_triangular(root, np.diag(1 / own / self.kept_scale), lower=True)
        average = np.column_stack([whiten, whiten @ (mean * self.kept_scale)])
        ends = np.cumsum([0, *(len(self.places[name]) for name in best)]).tolist()
        parts = dict(zip(best, map(slice, ends[:-1], ends[1:]), strict=True))
        return ModelComparison(
            probability,
            tuple(best),
            Gaussian.of_rows(self.kept_sizes, average),
            {name: x[part] for name, part in parts.items()},
            {name: of_best[part, part] for name, part in parts.items()},
            self.size,
        )

    def _some(self) -> list[str]:
        """Return the candidates that may act, and set the size of each beside those before it."""
        some = list[str]()
        while len(some) < MOST_CANDIDATES and (others := [n for n in self.names if n not in some]):
            gains = self._gains(others, some)
            name = max(gains, key=lambda each: gains[each].max() + self.log_odds[each])
            if gains[name].max() + self.log_odds[name] < np.log(UNLIKELY):
                break
            self.size[name] = float(SIZES[np.argmax(gains[name])])
            some.append(name)
        return some

    def _best(self, some: Sequence[str]) -> tuple[list[str], dict[str, float]]:
        """Return the set that one candidate more or less makes no better.

        And the log odds of each candidate beside the others of this set.
        """
        best = list(some)
        while True:
            log_odds = {}
            for name in some:
                [gains] = self._gains([name], [n for n in best if n != name]).values()
                at_size = gains[np.searchsorted(-SIZES, -self.size[name])]
                log_odds[name] = float(at_size) + self.log_odds[name]
            wrong = {name: each for name, each in log_odds.items() if (each > 0) != (name in best)}
            if not wrong:
                return best, log_odds
            flipped = max(wrong, key=lambda name: abs(wrong[name]))
            best = [n for n in some if (n in best) != (n == flipped)]

    def _mean_size(self, name: str, others: Sequence[str]) -> float:
        """Return the root of the mean square of a candidate's size, by the evidence of each.

        Entries that no sample shows are as large as the others: few do not show how large.
        """
        gains = self._gains([name], others)[name]
        weights = np.exp(gains - gains.max())
        return float(np.sqrt(weights @ SIZES**2 / weights.sum()))

    def _gains(self, names: Sequence[str], acting: Sequence[str]) -> dict[str, Array]:
        """Return the evidence for each candidate beside those that act, for each of `SIZES`."""
        index, L = self._factor(acting, self.size)
        by_acting = solve_triangular(L, np.column_stack([self.H[index], self.b[index]]), lower=True)
        gains = {}
        for name in names:
            own = self.places[name]
            H = self.H[np.ix_(own, own)] - by_acting[:, own].T @ by_acting[:, own]
            gains[name] = _gain(H, self.b[own] - by_acting[:, own].T @ by_acting[:, -1])
        return gains

    def _factor(
        self, acting: Sequence[str], size: Mapping[str, float]
    ) -> tuple[NDArray[np.intp], Array]:
        """Return the entries of candidates that act, and L with L Lᵀ = H + a⁻² of these."""
        index = np.concatenate([np.empty(0, np.intp), *(self.places[name] for name in acting)])
        a = np.concatenate([np.empty(0), *(np.full(len(self.places[n]), size[n]) for n in acting)])
        A = self.H[np.ix_(index, index)] + np.diag(a**-2)
        d = 1 / np.sqrt(np.diag(A))
        return index, cholesky(A * d * d[:, None], lower=True) / d[:, None]

    def _with(
        self, acting: Sequence[str], size: Mapping[str, float]
    ) -> tuple[Array, Array, Array, Array]:
        """Return mean and covariance of k, and those of the candidates that act."""
        index, L = self._factor(acting, size)
        G = self.by_c[:, index]
        c = cho_solve((L, True), self.b[index])
        half = solve_triangular(L, np.column_stack([G.T, np.diag(self.sigma[index])]), lower=True)
        of_k, of_c = half[:, : len(G)], half[:, len(G) :]
        # k = k₀ − G c, Cov[k] = P₀ + G (L Lᵀ)⁻¹ Gᵀ
        covariance = self.covariance_k + of_k.T @ of_k
        return self.at_zero - G @ c, covariance, self.sigma[index] * c, of_c.T @ of_c


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
    return bool(max(gains) + np.log(UNEXPECTED_ODDS) > np.log(POSSIBLE))
