"""Accuracy of the estimators: Monte Carlo trials of one scenario with noisy sensors.

The true motion follows from conservation of momentum (`base_motion`, which agrees with the full
simulation to 1e-8). Every trial draws new sensor noise and, where the spacecraft is uncertain, a
new spacecraft. The estimators get the samples and the nominal spacecraft only.
"""

import os
import signal
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, chi2

from cpid_drake.dynamics.base_motion import BaseTrajectory, propagate_base
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.sensitivity import BodyUncertainty, perturbed
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.identification.identification import Identification, row_family
from cpid_drake.identification.sensor_identification import (
    ESTIMATORS,
    consider_covariance,
    cramer_rao_bound,
    fit_measurements,
    identification_of_filter,
    identification_of_fit,
    identify_smoothed,
    online_estimator,
)
from cpid_drake.scenario.schema import Scenario, SpacecraftConfig
from cpid_drake.sensing.measurements import Measurements, ideal_measurements
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.presets import load_sensors
from cpid_drake.sensing.screening import screen
from cpid_drake.sensing.smoothing import smooth
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

Z95 = 1.959964
"""Half-width of a 95 % interval, in σ."""


@dataclass(frozen=True, eq=False)
class Case:
    """Inputs of a trial; they can be sent to another process.

    Attributes:
        spacecraft: the nominal one, which the estimators use.
        truth: the target.
        motion: of the joints.
        duration: [s].
        momentum_W: (6,) total momentum [L; P] about W's origin.
        unknown_momentum: whether it is to be estimated, or else taken as zero or as told.
        momentum_told: whether the estimators are told it.
        firing: time [s] and (6,) momentum of a thruster's firing, or None.
        known_bodies: uncertainty of the nominal spacecraft; None if it is exact.
        suite: the sensors.
        estimators: their names.
        seed: of the study.

    """

    spacecraft: SpacecraftConfig
    truth: InertialParameters
    motion: JointMotion
    duration: float
    momentum_W: NDArray[np.float64]
    unknown_momentum: bool
    momentum_told: bool
    firing: tuple[float, NDArray[np.float64]] | None
    known_bodies: BodyUncertainty | None
    suite: SensorSuite
    estimators: tuple[str, ...]
    seed: int


@dataclass(frozen=True, eq=False)
class Outcome:
    """One estimator's result in one trial; parameters are NaN where it failed.

    Attributes:
        parameters: (10,) estimate.
        covariance: (10, 10) as the estimator reports it.
        feasible: whether the estimated spatial inertia is physically consistent.
        problem: why it failed; empty if it did not.
        momentum_changes: times at which the filter detected a change of momentum, only the last.

    """

    parameters: NDArray[np.float64] = field(default_factory=lambda: np.full(10, np.nan))
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.full((10, 10), np.nan))
    feasible: bool = True
    problem: str = ""
    momentum_changes: tuple[int, float] | None = None


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Statistics of one estimator over the trials of one preset; arrays are (10,) each.

    Attributes:
        preset, estimator: their names.
        trials: number of trials; `failed` of them gave no estimate.
        problem: why the first of those failed.
        bias, bias_halfwidth: mean error and half its 95 % interval.
        rmse: root mean square error.
        crlb: Cramér-Rao bound on it.
        ratio_interval: (2, 10) 95 % interval of rmse / crlb.
        nees_mean: mean normalized error squared, 10 for a consistent estimator.
        nees_band: where that mean lies with 95 % probability if it is consistent.
        coverage: share of trials whose 95 % interval contains the truth.
        coverage_interval: (2, 10) 95 % interval of that share.
        coverage_all: the same share over all ten parameters.
        within_one_percent: share of trials with an error below 1 % (of m, 0.5 m, trace of I).
        infeasible: number of trials whose spatial inertia is not physically consistent.
        detected: of the filter: share of trials in which it detected the change of momentum,
            largest delay [s].

    """

    preset: str
    estimator: str
    trials: int
    failed: int
    problem: str
    bias: NDArray[np.float64]
    bias_halfwidth: NDArray[np.float64]
    rmse: NDArray[np.float64]
    crlb: NDArray[np.float64]
    ratio_interval: NDArray[np.float64]
    nees_mean: float
    nees_band: tuple[float, float]
    coverage: NDArray[np.float64]
    coverage_interval: NDArray[np.float64]
    coverage_all: float
    within_one_percent: NDArray[np.float64]
    infeasible: int
    detected: tuple[float, float] | None

    @property
    def ratio(self) -> NDArray[np.float64]:
        """Rmse / crlb."""
        return self.rmse / self.crlb


@dataclass(frozen=True, eq=False)
class AccuracyStudy:
    """The result of `run_accuracy`: statistics by preset and estimator, and what was run."""

    results: tuple[Accuracy, ...]
    scale: NDArray[np.float64]
    seed: int
    trials: int
    notes: tuple[str, ...]


def parameter_scale(truth: InertialParameters) -> NDArray[np.float64]:
    """Return the scale (10,) of the errors: m, 0.5 m for c, the trace of I."""
    trace = np.trace(truth.I_TTcm_C)
    return np.concatenate([[truth.mass], 3 * [0.5], 6 * [trace]])


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
        estimators: names of `ESTIMATORS`; default: all.
        seed: determines all random numbers.
        jobs: number of processes.
        progress: called with the preset, the trials done and their number.

    Raises:
        InputError: no such estimator or sensors, or a number that is not positive.

    """
    config = scenario.accuracy
    trials = config.trials if trials is None else trials
    seed = config.seed if seed is None else seed
    presets = tuple(presets) or tuple(config.presets)
    estimators = tuple(estimators) or ESTIMATORS
    for name in estimators:
        if name not in ESTIMATORS:
            raise InputError(f"no estimator '{name}'; choose from {', '.join(ESTIMATORS)}")
    for name, value in (("trials", trials), ("jobs", jobs)):
        if value < 1:
            raise InputError(f"{name} must be at least 1, not {value}")
    if seed < 0:
        raise InputError(f"seed must be >= 0, not {seed}")
    suites = {preset: load_sensors(preset) for preset in presets}
    truth = scenario.target_truth()
    spacecraft = scenario.make_spacecraft()
    results = []
    for preset, suite in suites.items():
        case = _case(scenario, spacecraft, truth, suite, estimators, seed)
        perfect = _perfect(case, spacecraft.tree, spacecraft.joint_names)
        bound = _bound(case, spacecraft, perfect)
        outcomes = []
        for outcome in _run_trials(case, perfect, trials, jobs):
            outcomes.append(outcome)
            progress(preset, len(outcomes), trials)
        results += [
            _statistics(case, preset, name, bound, [outcome[name] for outcome in outcomes])
            for name in estimators
        ]
    return AccuracyStudy(
        tuple(results), parameter_scale(truth), seed, trials, _notes(scenario, results)
    )


def _case(
    scenario: Scenario,
    spacecraft: Spacecraft,
    truth: InertialParameters,
    suite: SensorSuite,
    estimators: tuple[str, ...],
    seed: int,
) -> Case:
    momentum = np.asarray(scenario.simulation.momentum_W, dtype=float)
    told = scenario.accuracy.momentum_known
    firing = scenario.accuracy.firing
    return Case(
        spacecraft=scenario.spacecraft,
        truth=truth,
        motion=scenario.make_joint_motion(spacecraft),
        duration=scenario.simulation.duration,
        momentum_W=momentum,
        unknown_momentum=bool(momentum.any() or scenario.identification.unknown_momentum)
        and not told,
        momentum_told=told,
        firing=None if firing is None else (firing.time, np.asarray(firing.momentum_W)),
        known_bodies=scenario.body_uncertainty(),
        suite=suite,
        estimators=estimators,
        seed=seed,
    )


# -- truth ----------------------------------------------------------------------------------------


def _perfect(case: Case, tree: KinematicTree, joint_names: tuple[str, ...]) -> Measurements:
    """Return the ideal samples of the sensors, without noise, on a spacecraft of this tree."""

    def motion(times: NDArray[np.float64]) -> Telemetry:
        return _base_trajectory(case, tree, times).to_telemetry(joint_names, times, case.motion)

    return ideal_measurements(case.suite, joint_names, motion, case.duration)


def _base_trajectory(case: Case, tree: KinematicTree, times: NDArray[np.float64]) -> BaseTrajectory:
    phi = case.truth.to_standard_vector()
    steps = {"max_step": 0.02}
    if case.firing is None or case.firing[0] >= times[-1]:
        return propagate_base(tree, case.motion, phi, times, momentum_W=case.momentum_W, **steps)
    at, added = case.firing
    before = times[times < at]
    first = propagate_base(
        tree, case.motion, phi, np.append(before, at), momentum_W=case.momentum_W, **steps
    )
    second = propagate_base(
        tree,
        case.motion,
        phi,
        np.append(at, times[times > at]),
        quaternion_WB=first.quaternion_WB[-1],
        p_WB=first.p_WB[-1],
        momentum_W=case.momentum_W + added,
        **steps,
    )
    skip = 0 if (times == at).any() else 1
    names = ("quaternion_WB", "p_WB", "w_WB", "v_WB")
    return BaseTrajectory(
        *(
            np.concatenate([getattr(first, name)[:-1], getattr(second, name)[skip:]])
            for name in names
        )
    )


def _momentum_about_com(
    case: Case, tree: KinematicTree
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the true (L, v_Wcm) about the system's centre of mass, for a base that starts at W."""
    mass = tree.mass
    psi = relative_parameterization(mass).from_parameters(case.truth.to_vector())
    start = case.motion.evaluate(np.zeros(1))
    p_Wcm = relative_dynamics(tree, start[:, 0], start[:, 1]).com(psi)[0]
    L, P = case.momentum_W[:3], case.momentum_W[3:]
    return L - np.cross(p_Wcm, P), P / (mass + case.truth.mass)


def _bound(case: Case, spacecraft: Spacecraft, perfect: Measurements) -> NDArray[np.float64]:
    """Return the (10,) Cramér-Rao bound on each parameter's σ; of the case without a firing."""
    quiet = replace(case, firing=None)
    if case.firing is not None:
        perfect = _perfect(quiet, spacecraft.tree, spacecraft.joint_names)
    psi = relative_parameterization(spacecraft.mass).from_parameters(case.truth.to_vector())
    covariance = cramer_rao_bound(
        spacecraft.tree,
        psi,
        perfect,
        case.suite,
        momentum=_momentum_about_com(case, spacecraft.tree),
        unknown_momentum=case.unknown_momentum,
        known_bodies=case.known_bodies,
    )
    return np.sqrt(np.diag(covariance))


# -- trials ---------------------------------------------------------------------------------------


def _run_trials(
    case: Case, perfect: Measurements, trials: int, jobs: int
) -> Iterable[dict[str, Outcome]]:
    if jobs == 1:
        _prepare(case, perfect)
        yield from map(_trial, range(trials))
        return
    with (
        _one_thread_each(),
        ProcessPoolExecutor(jobs, get_context("spawn"), _prepare_process, (case, perfect)) as pool,
    ):
        yield from pool.map(_trial, range(trials))


@contextmanager
def _one_thread_each():
    """Limit linear algebra to one thread in new processes, which share the cores already."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


_process: tuple[Case, Spacecraft, Measurements] | None = None


def _prepare(case: Case, perfect: Measurements) -> None:
    """Initialize what all trials of this process share."""
    global _process
    config = case.spacecraft
    spacecraft = Spacecraft(
        config.model,
        base=config.base,
        capture_frame=config.capture_frame,
        packages=config.packages,
    )
    _process = case, spacecraft, perfect


def _prepare_process(case: Case, perfect: Measurements) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process handles an interruption
    _prepare(case, perfect)


def _trial(number: int) -> dict[str, Outcome]:
    """Return the estimate of every estimator from one draw of noise (and of the spacecraft)."""
    case, spacecraft, perfect = _process
    sequence = np.random.SeedSequence(case.seed, spawn_key=(number,))
    noise_seed, body_seed = sequence.generate_state(2)
    if case.known_bodies is not None:
        tree = perturbed(spacecraft.tree, case.known_bodies, np.random.default_rng(body_seed))
        perfect = _perfect(case, tree, spacecraft.joint_names)
    measurements, _ = screen(add_noise(case.suite, perfect, int(noise_seed)))
    outcomes: dict[str, Outcome] = {}
    smoothed = None
    for name in case.estimators:
        changes = None
        try:
            if name == "trajectory_fit":
                result = _fit(case, spacecraft, measurements)
            elif name == "momentum_filter":
                result, changes = _filter(case, spacecraft, measurements)
            else:
                family = row_family(name, case.unknown_momentum)
                smoothed = smoothed or smooth(measurements, case.suite)
                result = identify_smoothed(
                    spacecraft.tree,
                    smoothed,
                    family,
                    case.unknown_momentum,
                    _told(case, spacecraft),
                )
            outcomes[name] = _outcome(result, changes)
        except (InputError, np.linalg.LinAlgError) as error:
            outcomes[name] = Outcome(problem=str(error))
    return outcomes


def _told(
    case: Case, spacecraft: Spacecraft
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the momentum that the estimators are told, if any."""
    return _momentum_about_com(case, spacecraft.tree) if case.momentum_told else None


def _fit(case: Case, spacecraft: Spacecraft, measurements: Measurements) -> Identification:
    fit = fit_measurements(
        spacecraft.tree,
        measurements,
        case.suite,
        unknown_momentum=case.unknown_momentum,
        momentum=_told(case, spacecraft),
        known_bodies=case.known_bodies,
    )
    if not fit.converged:
        raise InputError("the trajectory fit did not converge")
    return identification_of_fit(fit)


def _filter(
    case: Case, spacecraft: Spacecraft, measurements: Measurements
) -> tuple[Identification, tuple[int, float]]:
    if case.momentum_told:
        raise InputError("the momentum filter cannot be told a momentum that is not zero")
    online = online_estimator(spacecraft, case.suite, unknown_momentum=case.unknown_momentum)
    state = online.run(measurements)
    changes = (state.filter.momentum_changes, state.filter.momentum_change_time)
    consider = None
    if case.known_bodies is not None:
        consider = consider_covariance(online, state, measurements, case.known_bodies)
    return identification_of_filter(online, state, consider), changes


def _outcome(result: Identification, changes: tuple[int, float] | None) -> Outcome:
    if not result.is_observable:
        return Outcome(problem=result.explain())
    try:
        feasible = result.feasible().is_feasible()
        result.spatial_inertia()
    except InputError:
        feasible = False
    return Outcome(result.parameters, result.covariance, feasible, "", changes)


# -- statistics -----------------------------------------------------------------------------------


def _statistics(
    case: Case, preset: str, estimator: str, bound: NDArray[np.float64], outcomes: list[Outcome]
) -> Accuracy:
    good = [outcome for outcome in outcomes if not outcome.problem]
    failed = len(outcomes) - len(good)
    problem = next((outcome.problem for outcome in outcomes if outcome.problem), "")
    if not good:
        nothing = np.full(10, np.nan)
        return Accuracy(
            preset, estimator, len(outcomes), failed, problem, nothing, nothing, nothing, bound,
            np.full((2, 10), np.nan), np.nan, (np.nan, np.nan), nothing, np.full((2, 10), np.nan),
            np.nan, nothing, 0, None,
        )  # fmt: skip
    n = len(good)
    errors = np.array([outcome.parameters for outcome in good]) - case.truth.to_vector()
    covariances = np.array([outcome.covariance for outcome in good])
    sigmas = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    rmse = np.sqrt(np.mean(errors**2, axis=0))
    draws = np.random.default_rng(case.seed).integers(n, size=(1000, n))
    resampled = np.sqrt(np.mean(errors[draws] ** 2, axis=1))
    nees = [_normalized_square(e, P) for e, P in zip(errors, covariances)]
    inside = np.abs(errors) <= Z95 * sigmas
    intervals = [
        binomtest(int(count), n).proportion_ci(0.95, method="wilson")
        for count in inside.sum(axis=0)
    ]
    small = np.abs(errors) <= 0.01 * parameter_scale(case.truth)
    return Accuracy(
        preset=preset,
        estimator=estimator,
        trials=len(outcomes),
        failed=failed,
        problem=problem,
        bias=errors.mean(axis=0),
        bias_halfwidth=Z95 * errors.std(axis=0, ddof=min(1, n - 1)) / np.sqrt(n),
        rmse=rmse,
        crlb=bound,
        ratio_interval=np.percentile(resampled, [2.5, 97.5], axis=0) / bound,
        nees_mean=float(np.mean(nees)),
        nees_band=tuple(chi2.ppf([0.025, 0.975], 10 * n) / n),
        coverage=inside.mean(axis=0),
        coverage_interval=np.array([[i.low, i.high] for i in intervals]).T,
        coverage_all=float(inside.mean()),
        within_one_percent=small.mean(axis=0),
        infeasible=sum(not outcome.feasible for outcome in good),
        detected=_detection(case, good),
    )


def _normalized_square(error: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    sigma = np.sqrt(np.diag(covariance))
    unit = covariance / sigma / sigma[:, None]
    return float(error / sigma @ np.linalg.lstsq(unit, error / sigma, rcond=None)[0])


def _detection(case: Case, outcomes: list[Outcome]) -> tuple[float, float] | None:
    """Return the share of trials in which the change was detected, and the largest delay [s]."""
    changes = [outcome.momentum_changes for outcome in outcomes]
    if any(change is None for change in changes):
        return None
    seen = [time for count, time in changes if count]
    delay = np.nan
    if seen and case.firing is not None:
        delay = max(time - case.firing[0] for time in seen)
    return len(seen) / len(changes), float(delay)


def _notes(scenario: Scenario, results: list[Accuracy]) -> tuple[str, ...]:
    """Return remarks that a reader of the table needs."""
    notes = []
    if scenario.accuracy.firing is not None:
        notes.append(
            "The bound is that of the same case without the thruster's firing, of which only the "
            "momentum filter takes notice."
        )
    if scenario.body_uncertainty() is not None:
        notes.append(
            "The spacecraft is uncertain: the bound is that of an estimator that takes it as known."
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
                "bias": _plain(r.bias),
                "bias_halfwidth95": _plain(r.bias_halfwidth),
                "rmse": _plain(r.rmse),
                "crlb": _plain(r.crlb),
                "rmse_over_crlb": _plain(r.ratio),
                "rmse_over_crlb_interval95": [_plain(end) for end in r.ratio_interval],
                "nees_mean": _plain(r.nees_mean),
                "nees_band95": [_plain(end) for end in r.nees_band],
                "coverage95": _plain(r.coverage),
                "coverage95_interval95": [_plain(end) for end in r.coverage_interval],
                "coverage95_all": _plain(r.coverage_all),
                "within_one_percent": _plain(r.within_one_percent),
                "infeasible": r.infeasible,
                "failed": r.failed,
                "problem": r.problem,
            }
        )
        if r.detected is not None:
            share, delay = r.detected
            results[-1]["momentum_change"] = {"share": share, "largest_delay": _plain(delay)}
    return {
        "seed": study.seed,
        "trials": study.trials,
        "scale": _plain(study.scale),
        "notes": list(study.notes),
        "results": results,
        "wall_seconds": wall_seconds,
    }


def _plain(value: NDArray[np.float64] | float) -> list | float | None:
    if np.ndim(value):
        return [_plain(entry) for entry in value]
    return float(value) if np.isfinite(value) else None
