"""Accuracy of the estimators: Monte Carlo trials of one scenario with noisy sensors.

The true motion follows from conservation of momentum (`propagation`, which agrees with the full
simulation to 1e-8). Every trial draws new sensor noise and, where the spacecraft is uncertain, a
new spacecraft. The estimators get the samples and the nominal spacecraft only.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, parameter_scale
from cpid_drake.errors import InputError
from cpid_drake.identification.estimators import methods
from cpid_drake.input_files.validation import nulls
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.studies.statistics import Accuracy, statistics_of
from cpid_drake.studies.trials import bound_of, ideal_samples, make_case, run_trials


@dataclass(frozen=True, eq=False)
class AccuracyStudy:
    """The result of `run_accuracy`: statistics by preset and estimator, and what was run."""

    results: tuple[Accuracy, ...]
    scale: NDArray[np.float64]
    seed: int
    trials: int
    notes: tuple[str, ...]


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
        trials: number of trials for each preset.
        presets: names or files of sensor suites.
        estimators: some of `cpid_drake.identification.estimators.methods`; default: all.
        seed: determines all random numbers.
        jobs: number of processes.
        progress: called with the preset, the number of finished trials and the number of all
            trials.

    Raises:
        InputError: no such estimator or sensors, or a number that is not positive.

    """
    config = scenario.accuracy
    trials = config.trials if trials is None else trials
    seed = config.seed if seed is None else seed
    presets = tuple(presets) or tuple(config.presets)
    estimators = tuple(dict.fromkeys(estimators)) or methods()
    for name in estimators:
        if name not in methods():
            raise InputError(f"no estimator '{name}'; choose from {', '.join(methods())}")
    for name, value in (("trials", trials), ("jobs", jobs)):
        if value < 1:
            raise InputError(f"{name} must be at least 1, not {value}")
    if seed < 0:
        raise InputError(f"seed must be >= 0, not {seed}")
    suites = {preset: load_sensors(preset) for preset in presets}
    truth = scenario.target_truth()
    spacecraft = scenario.spacecraft.make()
    results = []
    for preset, suite in suites.items():
        case = make_case(scenario, spacecraft, truth, suite, estimators, seed)
        ideal = ideal_samples(case, spacecraft.tree, spacecraft.joint_names)
        bound = bound_of(case, spacecraft, ideal)
        outcomes = []
        for outcome in run_trials(case, ideal, trials, jobs):
            outcomes.append(outcome)
            progress(preset, len(outcomes), trials)
        results += [
            statistics_of(case, preset, name, bound, [outcome[name] for outcome in outcomes])
            for name in estimators
        ]
    return AccuracyStudy(
        tuple(results),
        parameter_scale(truth.to_vector(), SCALE_LENGTH),
        seed,
        trials,
        _notes(scenario, results),
    )


def _notes(scenario: Scenario, results: list[Accuracy]) -> tuple[str, ...]:
    """Return remarks that a reader of the table needs."""
    notes = []
    if scenario.accuracy.firing is not None:
        notes.append(
            "The bound is that of the same case without the thruster's firing, which only the "
            "recursive fit and the trajectory fit detect."
        )
    if scenario.simulation.burns and not scenario.simulation.burns_logged:
        notes.append(
            "The bound is that of the same case without burns, which are not logged: the recursive "
            "fit and the trajectory fit have to detect them."
        )
    if scenario.simulation.burns:
        notes.append("Least squares assumes a constant momentum, which the burns change.")
    if scenario.body_uncertainty() is not None:
        notes.append(
            "The spacecraft is uncertain: the bound is that of an estimator that takes it as exact."
        )
    failures = {result.estimator: result.problem for result in results if result.failed}
    notes += [f"{name}: {problem}" for name, problem in failures.items()]
    return tuple(notes)


def summarize(study: AccuracyStudy, wall_seconds: float) -> dict:
    """Return the study as plain numbers for `summary.json`; missing values are None."""
    results = []
    for r in study.results:
        results.append(
            {
                "preset": r.preset,
                "estimator": r.estimator,
                "trials": r.trials,
                "bias": nulls(r.bias),
                "bias_halfwidth95": nulls(r.bias_halfwidth),
                "rmse": nulls(r.rmse),
                "crlb": nulls(r.crlb),
                "rmse_over_crlb": nulls(r.ratio),
                "rmse_over_crlb_interval95": nulls(r.ratio_interval),
                "nees_mean": nulls(r.nees_mean),
                "nees_band95": nulls(r.nees_band),
                "coverage95": nulls(r.coverage),
                "coverage95_interval95": nulls(r.coverage_interval),
                "coverage95_all": nulls(r.coverage_all),
                "within_one_percent": nulls(r.within_one_percent),
                "infeasible": r.infeasible,
                "failed": r.failed,
                "problem": r.problem,
            }
        )
        if r.detected is not None:
            share, delay = r.detected
            results[-1]["momentum_change"] = {"share": share, "largest_delay": nulls(delay)}
    return {
        "seed": study.seed,
        "trials": study.trials,
        "scale": nulls(study.scale),
        "notes": list(study.notes),
        "results": results,
        "wall_seconds": wall_seconds,
    }
