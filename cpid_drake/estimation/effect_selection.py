"""Which constant errors explain the samples: marginal likelihoods of all subsets from one fit.

A fit with all errors free is, near its solution, a normal distribution of the errors c (in units of
their prior σ) and of the target ψ. A model with fewer errors is this distribution at c = 0 for the
others, so its marginal likelihood needs no further fit (Laplace's method; the Savage-Dickey density
ratio, Dickey 1971). It prefers few errors: one that explains nothing costs log(prior σ / σ).
Several logs of one target have the target and the errors of the sensors in common; an external
force belongs to one log.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.block_state import BlockState, solution
from cpid_drake.estimation.blocks import BlockSolver
from cpid_drake.estimation.combination import SourceRows
from cpid_drake.estimation.likelihood.constants import ConstantError


@dataclass(frozen=True, eq=False)
class LogFit:
    """The fit of one log with some errors free.

    Attributes:
        solver: the solver of the blocks.
        known: what is known at the end of a pass near the solution.
        misfit: χ² per degree of freedom: larger noise than given makes all errors less certain.
        name: the log's name; empty for the only log.

    """

    solver: BlockSolver
    known: BlockState
    misfit: float = 1.0
    name: str = ""

    def likelihood_about(
        self, x: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the information (n, n) and the gradient (n,) of the log likelihood about x.

        Args:
            x: (n,) the log's errors in units of their σ, and ψ.

        """
        k, n = self.solver.constants.size, len(x)
        R, z = self.known.root[-n:, -n:], self.known.rest[-n:]
        nominal = np.concatenate([self.known.nominal.constants, self.known.nominal.psi])
        prior = np.append(np.ones(k), np.zeros(10))
        gradient = R.T @ (z + R @ (nominal - x)) + prior * x
        return (R.T @ R - np.diag(prior)) / self.misfit, gradient / self.misfit


@dataclass(frozen=True, eq=False)
class Unknown:
    """An error of the sensors, or an external force in one log.

    Attributes:
        error: the error.
        log: name of the log of a force; empty for an error that all logs have in common.
        place: its places in the vector of all errors.

    """

    error: ConstantError
    log: str
    place: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Submodel:
    """The estimate with some of the errors free, and all other candidates zero.

    Attributes:
        free: names of the free candidates.
        log_likelihood: logarithm of the marginal likelihood, plus a constant.
        psi: (10,) the target.
        covariance: (10, 10) its covariance.
        constants: (k,) the errors in units of their σ.
        sigma: (k,) their σ, in the same units; zero for those that are not free.

    """

    free: tuple[str, ...]
    log_likelihood: float
    psi: NDArray[np.float64]
    covariance: NDArray[np.float64]
    constants: NDArray[np.float64]
    sigma: NDArray[np.float64]


class EffectSelection:
    """The joint estimate of errors and target, and the submodels that follow from it.

    Args:
        logs: the fits of the logs of one target with all candidates free.
        candidates: names of the errors that may be zero; all others are always free.

    Attributes:
        unknowns: the errors by name; the name of a force includes that of its log, if it has one.

    """

    def __init__(self, logs: Sequence[LogFit], candidates: Iterable[str] = ()) -> None:
        self.unknowns: dict[str, Unknown] = {}
        self._of_logs = [self._places_of(log) for log in logs]
        self._size = k = sum(each.error.size for each in self.unknowns.values())
        names = set(candidates)
        self._places = {
            name: each.place for name, each in self.unknowns.items() if each.error.name in names
        }
        about = np.concatenate([np.zeros(k), logs[0].known.nominal.psi])
        prior = np.append(np.ones(k), np.zeros(10))
        self._information, gradient = np.diag(prior), -prior * about
        for log, places in zip(logs, self._of_logs):
            among = np.append(places, k + np.arange(10))
            information, change = log.likelihood_about(about[among])
            self._information[np.ix_(among, among)] += information
            gradient[among] += change
        self._mean = about + np.linalg.solve(self._information, gradient)
        self._covariance = np.linalg.inv(self._information)

    @property
    def candidates(self) -> list[str]:
        """Names of the unknowns that may be zero."""
        return list(self._places)

    def _places_of(self, log: LogFit) -> NDArray[np.intp]:
        """Return the places of a log's errors, which are added to the unknowns if they are new."""
        places = [np.empty(0, dtype=int)]
        for error in log.solver.constants.errors.values():
            own = "" if error.sensor else log.name
            name = f"{error.name} of {own}" if own else error.name
            first = sum(each.error.size for each in self.unknowns.values())
            new = Unknown(error, own, first + np.arange(error.size))
            places.append(self.unknowns.setdefault(name, new).place)
        return np.concatenate(places)

    def of_log(self, number: int, constants: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the errors of one log among the errors of all logs."""
        return constants[self._of_logs[number]]

    @property
    def root(self) -> NDArray[np.float64]:
        """(n, n) upper triangle R of the information RᵀR about all errors and ψ."""
        return np.asarray(np.linalg.cholesky(self._information).T)

    @property
    def target_rows(self) -> SourceRows:
        """What all logs tell about ψ, whatever the errors are."""
        R = self.root[-10:, -10:]
        return SourceRows(R, R @ self._mean[-10:])

    def estimate_about(
        self, psi: NDArray[np.float64], plausible: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return all errors and ψ (10,), which differs from a given one in what is well known.

        Args:
            psi: (10,) the given one.
            plausible: (10,) plausible sizes of ψ.

        """
        R, about = self.root, np.concatenate([np.zeros(self._size), psi])
        found = about + solution(R, R @ (self._mean - about), plausible)
        return found[: self._size], found[self._size :]

    def submodel(self, free: Iterable[str]) -> Submodel:
        """Return the estimate with these candidates free."""
        free = tuple(free)
        held = [self._places[name] for name in self._places if name not in free]
        zero = np.concatenate([np.empty(0, dtype=int), *held])
        rest = np.setdiff1d(np.arange(len(self._mean)), zero)
        gain = np.linalg.solve(self._covariance[np.ix_(zero, zero)], self._mean[zero])
        mean = self._mean - self._covariance[:, zero] @ gain
        mean[zero] = 0.0
        information = self._information[np.ix_(rest, rest)]
        covariance = np.linalg.inv(information)
        sigma = np.zeros(len(mean))
        sigma[rest] = np.sqrt(np.diag(covariance))
        likelihood = float(-0.5 * (self._mean[zero] @ gain + np.linalg.slogdet(information)[1]))
        k = self._size
        return Submodel(free, likelihood, mean[k:], covariance[-10:, -10:], mean[:k], sigma[:k])

    def best(self, least_gain: float) -> Submodel:
        """Return the submodel that explains the samples best.

        Candidates are added one by one while the logarithm of the marginal likelihood grows by at
        least `least_gain`; after each one, those that have become superfluous are removed.
        """
        found = self.submodel(())
        while True:
            others = [name for name in self._places if name not in found.free]
            larger = [self.submodel((*found.free, name)) for name in others]
            best = max(larger, key=lambda each: each.log_likelihood, default=found)
            if best.log_likelihood < found.log_likelihood + least_gain:
                return found
            found = best
            for name in found.free:
                less = self.submodel(other for other in found.free if other != name)
                if less.log_likelihood > found.log_likelihood - least_gain:
                    found = less


@dataclass(frozen=True, eq=False)
class ModelAverage:
    """What submodels that may be true do to the estimate of another one.

    Attributes:
        probabilities: probability of each submodel, by the names of its free errors.
        spread: (10, 10) what to add to the covariance of the target, about the estimate of the
            submodel that was taken for true.

    """

    probabilities: dict[tuple[str, ...], float]
    spread: NDArray[np.float64]


def model_average(
    assumed: Submodel, others: Iterable[Submodel], odds: float, least: float
) -> ModelAverage:
    """Return what the uncertainty of the model adds to the covariance of the target.

    The target is distributed as in one of the submodels, whose probabilities follow from their
    marginal likelihoods. The second moment about the assumed estimate is that of this mixture.
    Source: Hoeting, Madigan, Raftery and Volinsky 1999, "Bayesian model averaging: a tutorial".

    Args:
        assumed: the submodel whose estimate is used.
        others: the submodels that may be true instead.
        odds: of each of them against the assumed one, before the first sample.
        least: probability from which a submodel counts.

    """
    others = list(others)
    logs = np.array([each.log_likelihood - assumed.log_likelihood for each in others])
    weights = np.append(np.log(odds) + logs, 0.0)
    shares = np.exp(weights - weights.max())
    shares /= shares.sum()
    found, spread = {}, np.zeros((10, 10))
    for other, share in zip(others, shares[:-1]):
        if share >= least:
            found[other.free] = float(share)
            change = other.psi - assumed.psi
            wider = other.covariance - assumed.covariance
            spread += share * (wider + np.outer(change, change))
    return ModelAverage(found, spread)
