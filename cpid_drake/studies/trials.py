"""Monte Carlo trials of one scenario: the truth, the draws and the estimates."""

import os
import signal
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.base_motion import BaseTrajectory, propagate_base
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.sensitivity import BodyUncertainty, perturbed
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError
from cpid_drake.identification.fit_estimator import cramer_rao_bound
from cpid_drake.identification.identify import identify
from cpid_drake.identification.result import Identification, MomentumChanges
from cpid_drake.scenario.schema import Scenario, SpacecraftConfig
from cpid_drake.sensing.measurements import Measurements, ideal_measurements
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True, eq=False)
class Case:
    """Inputs of a trial; they can be sent to another process.

    Attributes:
        spacecraft: the nominal spacecraft, which the estimators use.
        truth: the target.
        motion: the motion of the joints.
        duration: duration of the motion [s].
        momentum_W: (6,) total momentum [L; P] about W's origin.
        momentum: the total momentum that the estimators use.
        firing: time [s] and (6,) momentum of a thruster's firing, or None.
        known_bodies: uncertainty of the nominal spacecraft; None if it is exact.
        suite: the sensors.
        estimators: their names.
        seed: seed of the study.

    """

    spacecraft: SpacecraftConfig
    truth: InertialParameters
    motion: JointMotion
    duration: float
    momentum_W: NDArray[np.float64]
    momentum: TotalMomentum
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
        covariance: (10, 10) that the estimator reports.
        feasible: whether the estimated spatial inertia is physically consistent.
        problem: the reason of a failure; empty without one.
        momentum_changes: changes of momentum that an online estimator detected.

    """

    parameters: NDArray[np.float64] = field(default_factory=lambda: np.full(10, np.nan))
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.full((10, 10), np.nan))
    feasible: bool = True
    problem: str = ""
    momentum_changes: MomentumChanges | None = None


def make_case(
    scenario: Scenario,
    spacecraft: Spacecraft,
    truth: InertialParameters,
    suite: SensorSuite,
    estimators: tuple[str, ...],
    seed: int,
) -> Case:
    """Return the case of a scenario with these sensors and estimators."""
    momentum = np.asarray(scenario.simulation.momentum_W, dtype=float)
    motion = scenario.make_joint_motion(spacecraft)
    true_momentum = _true_momentum(momentum, truth, motion, spacecraft.tree)
    unknown = bool(momentum.any() or scenario.identification.unknown_momentum)
    if scenario.accuracy.momentum_known:
        given = true_momentum
    else:
        given = TotalMomentum.unknown() if unknown else TotalMomentum.zero()
    firing = scenario.accuracy.firing
    return Case(
        spacecraft=scenario.spacecraft,
        truth=truth,
        motion=motion,
        duration=scenario.simulation.duration,
        momentum_W=momentum,
        momentum=given,
        firing=None if firing is None else (firing.time, np.asarray(firing.momentum_W)),
        known_bodies=scenario.body_uncertainty(),
        suite=suite,
        estimators=estimators,
        seed=seed,
    )


# -- truth ----------------------------------------------------------------------------------------


def ideal_samples(case: Case, tree: KinematicTree, joint_names: tuple[str, ...]) -> Measurements:
    """Return the ideal samples of the sensors, without noise, on a spacecraft of this tree."""

    def motion(times: NDArray[np.float64]) -> Telemetry:
        return base_trajectory(case, tree, times).to_telemetry(joint_names, times, case.motion)

    return ideal_measurements(case.suite, joint_names, motion, case.duration)


def base_trajectory(case: Case, tree: KinematicTree, times: NDArray[np.float64]) -> BaseTrajectory:
    """Return the true motion of the base at times (N,) [s], with the thruster firing if any."""
    phi = case.truth.to_standard_vector()

    def propagate(
        times: NDArray[np.float64], momentum_W: NDArray[np.float64], **start: NDArray[np.float64]
    ) -> BaseTrajectory:
        return propagate_base(
            tree, case.motion, phi, times, momentum_W=momentum_W, max_step=0.02, **start
        )

    if case.firing is None or case.firing[0] >= times[-1]:
        return propagate(times, case.momentum_W)
    at, added = case.firing
    first = propagate(np.append(times[times < at], at), case.momentum_W)
    pose = {"quaternion_WB": first.quaternion_WB[-1], "p_WB": first.p_WB[-1]}
    second = propagate(np.append(at, times[times > at]), case.momentum_W + added, **pose)
    skip = 0 if (times == at).any() else 1
    return BaseTrajectory(
        **{
            name: np.concatenate([values[:-1], getattr(second, name)[skip:]])
            for name, values in vars(first).items()
        }
    )


def _true_momentum(
    momentum_W: NDArray[np.float64],
    truth: InertialParameters,
    motion: JointMotion,
    tree: KinematicTree,
) -> TotalMomentum:
    """Return the true momentum, where the base coincides with W at the start."""
    psi = relative_parameterization(tree.mass).from_parameters(truth.to_vector())
    start = motion.evaluate(np.zeros(1))
    p_WScm = relative_dynamics(tree, start[:, 0], start[:, 1]).com(psi)[0]
    return TotalMomentum.known_about_origin(momentum_W, p_WScm, tree.mass + truth.mass)


def bound_of(case: Case, spacecraft: Spacecraft, ideal: Measurements) -> NDArray[np.float64]:
    """Return the Cramér-Rao bound (10,) on the σ of the parameters, without a thruster firing."""
    quiet = replace(case, firing=None)
    true = _true_momentum(case.momentum_W, case.truth, case.motion, spacecraft.tree)
    if case.firing is not None:
        ideal = ideal_samples(quiet, spacecraft.tree, spacecraft.joint_names)
    psi = relative_parameterization(spacecraft.mass).from_parameters(case.truth.to_vector())
    covariance = cramer_rao_bound(
        spacecraft.tree,
        psi,
        ideal,
        case.suite,
        momentum=TotalMomentum.unknown(true) if case.momentum.is_unknown else true,
        known_bodies=case.known_bodies,
    )
    return np.sqrt(np.diag(covariance))


# -- trials ---------------------------------------------------------------------------------------


def run_trials(
    case: Case, ideal: Measurements, trials: int, jobs: int
) -> Iterable[dict[str, Outcome]]:
    """Yield the outcomes of every trial by estimator, from `jobs` processes."""
    if jobs == 1:
        _prepare(case, ideal)
        yield from map(_trial, range(trials))
        return
    with (
        _one_thread_each(),
        ProcessPoolExecutor(jobs, get_context("spawn"), _prepare_process, (case, ideal)) as pool,
    ):
        yield from pool.map(_trial, range(trials))


@contextmanager
def _one_thread_each() -> Iterator[None]:
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


def _prepare(case: Case, ideal: Measurements) -> None:
    """Prepare the inputs that all trials of this process share."""
    global _process
    _process = case, case.spacecraft.make(), ideal


def _prepare_process(case: Case, ideal: Measurements) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process handles an interrupt
    _prepare(case, ideal)


def _trial(number: int) -> dict[str, Outcome]:
    """Return the estimates of one draw of the noise (and of the spacecraft), by estimator."""
    assert _process is not None
    case, spacecraft, ideal = _process
    sequence = np.random.SeedSequence(case.seed, spawn_key=(number,))
    noise_seed, body_seed = sequence.generate_state(2)
    if case.known_bodies is not None:
        tree = perturbed(spacecraft.tree, case.known_bodies, np.random.default_rng(body_seed))
        ideal = ideal_samples(case, tree, spacecraft.joint_names)
    measurements = add_noise(case.suite, ideal, int(noise_seed))
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
            outcomes[name] = _outcome(found)
        except InputError as error:
            outcomes[name] = Outcome(problem=str(error))
    return outcomes


def _outcome(result: Identification) -> Outcome:
    if not result.converged:
        return Outcome(problem=f"{result.estimator} did not converge")
    if not result.is_observable:
        return Outcome(problem=result.explain())
    try:
        feasible = result.feasible().is_feasible()
        result.spatial_inertia()
    except (InputError, np.linalg.LinAlgError):
        feasible = False
    return Outcome(result.parameters, result.covariance, feasible, "", result.momentum_changes)
