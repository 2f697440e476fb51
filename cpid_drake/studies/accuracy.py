"""Accuracy of the estimators: Monte Carlo trials of one scenario with noisy sensors.

The true motion follows from conservation of momentum. Every trial draws new sensor noise and, where
the spacecraft is uncertain, a new spacecraft. The estimators get the samples and the nominal
spacecraft only.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, parameter_scale
from cpid_drake.errors import InputError
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.identification.estimators import methods
from cpid_drake.identification.identify import identify
from cpid_drake.input_files.validation import nulls
from cpid_drake.logs.log import Log
from cpid_drake.processes import shared_work
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.trials import Case, bound_of, draw, ideal_samples, make_case


@dataclass(frozen=True, eq=False)
class Outcome:
    """One estimator's result in one trial; NaN where it failed, with the reason in `problem`.

    `parameters` (10,) and `covariance` (10, 10) are what the estimator reports.
    """

    parameters: NDArray[np.float64] = field(default_factory=lambda: np.full(10, np.nan))
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.full((10, 10), np.nan))
    problem: str = ""


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Statistics of one estimator over the trials of one sensor suite; arrays are (10,) each.

    Attributes:
        preset, estimator: names of the suite and of the estimator.
        trials: number of trials; `failed` of them gave no estimate.
        problem: the reason of the first failure.
        bias: mean error.
        rmse: root mean square error.
        crlb: Cramér-Rao bound on the root mean square error.
        nees: mean normalized error squared, 10 for a consistent estimator.
        nees_band: the interval that contains that mean with 95 % probability if the estimator is
            consistent.
        coverage: share of trials whose 95 % interval contains the truth.

    """

    preset: str
    estimator: str
    trials: int
    failed: int
    problem: str
    bias: NDArray[np.float64]
    rmse: NDArray[np.float64]
    crlb: NDArray[np.float64]
    nees: float
    nees_band: tuple[float, float]
    coverage: NDArray[np.float64]

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Rmse / crlb."""
        return self.rmse / self.crlb


@dataclass(frozen=True, eq=False)
class AccuracyStudy:
    """The result of `run_accuracy`: statistics by suite and estimator, and what was run."""

    results: tuple[Accuracy, ...]
    scale: NDArray[np.float64]
    seed: int
    trials: int


def run_accuracy(
    scenario: Scenario,
    *,
    trials: int | None = None,
    presets: Iterable[str] = (),
    estimators: Iterable[str] = (),
    seed: int | None = None,
    jobs: int = 1,
    progress: Callable[[str, int, int], None] = lambda preset, done, total: None,
) -> AccuracyStudy:
    """Run the trials of a scenario.

    Args:
        scenario: spacecraft, target, motion, momentum; its `accuracy` section gives the defaults.
        trials: number of trials for each suite.
        presets: names or files of sensor suites.
        estimators: some of `cpid_drake.identification.estimators.methods`; default: all.
        seed: determines all random numbers.
        jobs: number of processes.
        progress: called with the suite, the number of finished trials and the number of all trials.

    Raises:
        InputError: no such estimator or sensors, or a number that is not positive.

    """
    config = scenario.accuracy
    trials = config.trials if trials is None else trials
    seed = config.seed if seed is None else seed
    estimators = tuple(dict.fromkeys(estimators)) or methods()
    for name in estimators:
        if name not in methods():
            raise InputError(f"no estimator '{name}'; choose from {', '.join(methods())}")
    for name, value, least in (("trials", trials, 1), ("jobs", jobs, 1), ("seed", seed, 0)):
        if value < least:
            raise InputError(f"{name} must be at least {least}, not {value}")
    suites = {preset: load_sensors(preset) for preset in tuple(presets) or config.presets}
    truth, spacecraft = scenario.target_truth(), scenario.spacecraft.make()
    results = []
    for preset, suite in suites.items():
        case = make_case(scenario, spacecraft, truth, suite, estimators, seed)
        ideal = ideal_samples(case, spacecraft.tree, spacecraft.joint_names)
        bound = bound_of(case, spacecraft, ideal)
        outcomes = []
        for outcome in shared_work(_trials_of, (case, ideal), range(trials), jobs):
            outcomes.append(outcome)
            progress(preset, len(outcomes), trials)
        results += [
            statistics_of(case, preset, name, bound, [outcome[name] for outcome in outcomes])
            for name in estimators
        ]
    scale = parameter_scale(truth.to_vector(), SCALE_LENGTH)
    return AccuracyStudy(tuple(results), scale, seed, trials)


def _trials_of(inputs: tuple[Case, Log]) -> Callable[[int], dict[str, Outcome]]:
    """Return the function that does the trial of a number."""
    case, ideal = inputs
    return partial(_trial, case, case.spacecraft.make(), ideal)


def _trial(case: Case, spacecraft: Spacecraft, ideal: Log, number: int) -> dict[str, Outcome]:
    """Return the estimates of one draw of the noise (and of the spacecraft), by estimator."""
    measurements = draw(case, spacecraft, ideal, number)
    outcomes: dict[str, Outcome] = {}
    for name in case.estimators:
        try:
            found = identify(
                spacecraft,
                measurements,
                estimator=name,
                sensors=case.suite,
                momentum=case.momentum,
                known_bodies=case.known_bodies,
            )
        except InputError as error:
            outcomes[name] = Outcome(problem=str(error))
            continue
        if not found.converged:
            outcomes[name] = Outcome(problem="did not converge")
        elif not found.is_observable:
            outcomes[name] = Outcome(problem=found.explain())
        else:
            outcomes[name] = Outcome(found.parameters, found.covariance)
    return outcomes


def statistics_of(
    case: Case, preset: str, estimator: str, bound: NDArray[np.float64], outcomes: Sequence[Outcome]
) -> Accuracy:
    """Return the statistics of one estimator over its outcomes.

    Args:
        case: inputs of the trials.
        preset: name of the sensors.
        estimator: name of the estimator.
        bound: (10,) Cramér-Rao bound on the standard deviations.
        outcomes: one per trial.

    """
    good = [outcome for outcome in outcomes if not outcome.problem]
    problem = next((outcome.problem for outcome in outcomes if outcome.problem), "")
    shown = good or [Outcome()]  # without any, all statistics are NaN
    errors = np.array([outcome.parameters for outcome in shown]) - case.truth.to_vector()
    sigmas = np.array([np.sqrt(np.diag(outcome.covariance)) for outcome in shown])
    inside = np.where(np.isfinite(errors), np.abs(errors) <= quantile_95() * sigmas, np.nan)
    freedom = 10 * len(shown)
    low, high = (chdtri(freedom, p) / len(shown) for p in (0.975, 0.025))
    return Accuracy(
        preset=preset,
        estimator=estimator,
        trials=len(outcomes),
        failed=len(outcomes) - len(good),
        problem=problem,
        bias=errors.mean(axis=0),
        rmse=np.sqrt(np.mean(errors**2, axis=0)),
        crlb=bound,
        nees=float(np.mean([_nees(e, s, each) for e, s, each in zip(errors, sigmas, shown)])),
        nees_band=(float(low), float(high)),
        coverage=inside.mean(axis=0),
    )


def _nees(error: NDArray[np.float64], sigma: NDArray[np.float64], outcome: Outcome) -> float:
    """Return the normalized error squared; NaN for a failure."""
    if outcome.problem or not np.isfinite(error).all():
        return np.nan
    unit = outcome.covariance / sigma / sigma[:, None]
    return float(error / sigma @ np.linalg.lstsq(unit, error / sigma, rcond=None)[0])


def summarize(study: AccuracyStudy, wall_seconds: float) -> dict:
    """Return the study as plain numbers for `summary.json`; missing values are None."""
    results = [
        {
            key: nulls(value) if isinstance(value, (float, tuple, np.ndarray)) else value
            for key, value in {**vars(result), "rmse_over_crlb": result.ratio}.items()
        }
        for result in study.results
    ]
    return {
        "seed": study.seed,
        "trials": study.trials,
        "scale": nulls(study.scale),
        "results": results,
        "wall_seconds": wall_seconds,
    }
