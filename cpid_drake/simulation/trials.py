"""The truth of Monte Carlo trials, of many at once, and the draws of their samples."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import (
    SCALE_LENGTH,
    parameter_scale,
    relative_parameterization,
)
from cpid_drake.dynamics.propagation import BaseTrajectory, Wrench, propagate
from cpid_drake.dynamics.sensitivity import perturbed
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.cramer_rao import cramer_rao_bound
from cpid_drake.files.errors import InputError
from cpid_drake.identification.identify import identify
from cpid_drake.logs.log import THRUST, Log, ideal_log
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.simulated_disturbance import SimulatedDisturbance
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.simulation.burns import Burn, log_of_burns
from cpid_drake.simulation.scenario import Scenario
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True, eq=False)
class Case:
    """Inputs of a trial; they can be sent to another process.

    Attributes:
        truth: the target.
        motion: the motion of the joints.
        duration: duration of the motion [s].
        momentum_W: (6,) total momentum [L; P] about W's origin.
        momentum: the total momentum that the estimators use.
        known_bodies: uncertainty of the nominal spacecraft; None if it is exact.
        suite: the sensors.
        seed: seed of the study.
        torque_W, acceleration_W: (3,) constant disturbance, see `SimulatedDisturbance`; None for a
            random one in every trial, of the size that `suite` gives.
        burns: burns of thrusters that are fixed on the base.
        logs_thrust: whether the samples contain their log.

    """

    truth: InertialParameters
    motion: JointMotion
    duration: float
    momentum_W: Array
    momentum: TotalMomentum
    known_bodies: BodyUncertainty | None
    suite: SensorSuite
    seed: int
    torque_W: Array | None = None
    acceleration_W: Array | None = None
    burns: tuple[Burn, ...] = ()
    logs_thrust: bool = True

    def disturbance(self, seed: int | None = None) -> SimulatedDisturbance:
        """Return the disturbance of a trial with this seed; None for the constant one alone."""
        return SimulatedDisturbance(
            None if seed is None else self.suite.disturbances,
            seed or 0,
            torque_W=self.torque_W,
            acceleration_W=self.acceleration_W,
        )

    def total_momentum(self, tree: KinematicTree) -> TotalMomentum:
        """Return the true momentum about the system's centre of mass, unknown if `momentum` is."""
        q = self.motion.evaluate(0.0)[0]
        true = TotalMomentum.with_base_at_origin(tree, self.truth, q, self.momentum_W)
        return TotalMomentum.unknown(true) if self.momentum.is_unknown else true


def make_case(
    scenario: Scenario,
    spacecraft: Spacecraft,
    truth: InertialParameters,
    suite: SensorSuite,
    seed: int,
) -> Case:
    """Return the case of a scenario with these sensors."""
    momentum = np.asarray(scenario.simulation.momentum_W, dtype=float)
    motion = scenario.make_joint_motion(spacecraft)
    unknown = bool(momentum.any() or scenario.identification.momentum == "unknown")
    return Case(
        truth=truth,
        motion=motion,
        duration=scenario.simulation.duration,
        momentum_W=momentum,
        momentum=TotalMomentum.unknown() if unknown else TotalMomentum.zero(),
        known_bodies=scenario.body_uncertainty(),
        suite=suite,
        seed=seed,
        torque_W=scenario.simulation.disturbance.torque_W,
        acceleration_W=scenario.simulation.disturbance.acceleration_W,
        burns=tuple(scenario.simulation.burns),
        logs_thrust=scenario.simulation.burns_logged,
    )


def ideal_samples(
    case: Case,
    tree: KinematicTree,
    joint_names: tuple[str, ...],
    disturbance: SimulatedDisturbance | None = None,
) -> Log:
    """Return the ideal samples of the sensors, without noise, on a spacecraft of this tree.

    The other arguments are those of `base_trajectory`.
    """
    return ideal_logs([case], tree, joint_names, [disturbance or case.disturbance()])[0]


def ideal_logs(
    cases: Sequence[Case],
    tree: KinematicTree,
    joint_names: tuple[str, ...],
    disturbances: Sequence[SimulatedDisturbance],
) -> list[Log]:
    """Return the ideal samples of cases that differ as those of `base_trajectories` may."""
    motions, logs = list[Motion](), []
    for number, case in enumerate(cases):

        def motion(times: Array, number: int = number) -> Motion:
            if not motions:  # the times are those of all cases
                motions.extend(motions_of(cases, tree, joint_names, times, disturbances))
            return motions[number]

        ideal = ideal_log(case.suite, joint_names, motion, case.duration)
        if case.burns and case.logs_thrust:
            samples = {**ideal.samples, THRUST: log_of_burns(case.burns)}
            ideal = Log(joint_names, samples, motion=ideal.motion)
        logs.append(ideal)
    return logs


def base_trajectory(
    case: Case, tree: KinematicTree, times: Array, disturbance: SimulatedDisturbance | None = None
) -> BaseTrajectory:
    """Return the true motion of the base, with the burns of thrusters and a disturbance.

    Args:
        case: the target, the motion of the joints, the momentum and the burns.
        tree: the spacecraft; its base frame B coincides with W at the first time.
        times: (N,) increasing instants [s].
        disturbance: external forces and torques; default: the constant ones of the case.

    """
    motions = base_trajectories([case], tree, times, [disturbance or case.disturbance()])
    return BaseTrajectory(**{name: values[0] for name, values in vars(motions).items()})


def base_trajectories(
    cases: Sequence[Case],
    tree: KinematicTree,
    times: Array,
    disturbances: Sequence[SimulatedDisturbance],
) -> BaseTrajectory:
    """Return the true motion of the base in T cases, each with its disturbance, as (T, N, ...).

    The cases may differ in target, momentum and disturbance only; of all else, the first counts.
    """
    case = cases[0]
    phi = np.array([each.truth.to_standard_vector() for each in cases])
    thrust, orbit = log_of_burns(case.burns), case.suite.orbit
    changes = {t for each in disturbances for t in each.changes(times[0], times[-1])}
    is_free = orbit is None and not case.burns and all(each.is_zero for each in disturbances)

    def acting(time: float) -> Wrench:
        return Wrench([each.at(time) for each in disturbances], thrust.held_at(time), orbit)

    return propagate(
        tree,
        case.motion,
        phi,
        times,
        momentum_W=[each.momentum_W for each in cases],
        wrench=None if is_free else acting,
        edges=[*changes, *thrust.time],
    )


def motions_of(
    cases: Sequence[Case],
    tree: KinematicTree,
    joint_names: tuple[str, ...],
    times: Array,
    disturbances: Sequence[SimulatedDisturbance] | None = None,
) -> list[Motion]:
    """Return the motion of such cases; default: with their constant disturbances alone."""
    constant = [each.disturbance() for each in cases]
    base = base_trajectories(cases, tree, times, disturbances or constant)
    return base.to_motions(joint_names, times, cases[0].motion)


def bound_of(case: Case, spacecraft: Spacecraft) -> Array:
    """Return the Cramér-Rao bound (10,) on the σ of the parameters, without unlogged burns."""
    logged = case if case.logs_thrust else replace(case, burns=())
    ideal = ideal_samples(logged, spacecraft.tree, spacecraft.joint_names)
    psi = relative_parameterization(spacecraft.mass).from_parameters(case.truth.to_vector())
    covariance = cramer_rao_bound(
        spacecraft.tree,
        psi,
        ideal,
        case.suite,
        momentum=case.total_momentum(spacecraft.tree),
        known_bodies=case.known_bodies,
    )
    return np.sqrt(np.diag(covariance))


def draw(case: Case, spacecraft: Spacecraft, number: int) -> Log:
    """Return the samples of one trial of the nominal spacecraft; see `draws`."""
    return draws([case], spacecraft.tree, spacecraft.joint_names, [number])[0]


def draws(
    cases: Sequence[Case],
    tree: KinematicTree,
    joint_names: tuple[str, ...],
    numbers: Sequence[int],
) -> list[Log]:
    """Return the samples of trials: draws of all errors, disturbances and uncertain bodies.

    Args:
        cases: inputs of the trials, which differ as those of `base_trajectories` may; the seed and
            a trial's number determine its draw.
        tree: the spacecraft around which the bodies are drawn.
        joint_names: its joints.
        numbers: the trials' numbers, from 0.

    """
    ideal = list[Log]()
    for together, own, disturbances in _together(cases, tree, numbers):
        ideal += ideal_logs(together, own, joint_names, disturbances)
    seeds = [seeds_of(case.seed, number)[0] for case, number in zip(cases, numbers)]
    return [add_noise(c.suite, log, seed) for c, log, seed in zip(cases, ideal, seeds)]


def true_motions(
    cases: Sequence[Case],
    tree: KinematicTree,
    joint_names: tuple[str, ...],
    numbers: Sequence[int],
    times: Array,
) -> list[Motion]:
    """Return the exact motion of trials at times (N,) [s]; the other arguments are `draws`'s."""
    motions = list[Motion]()
    for together, own, disturbances in _together(cases, tree, numbers):
        motions += motions_of(together, own, joint_names, times, disturbances)
    return motions


def _together(
    cases: Sequence[Case], tree: KinematicTree, numbers: Sequence[int]
) -> Iterator[tuple[Sequence[Case], KinematicTree, list[SimulatedDisturbance]]]:
    """Yield cases that can be propagated together, with their spacecraft and disturbances."""
    seeds = [seeds_of(case.seed, number) for case, number in zip(cases, numbers, strict=True)]
    disturbances = [case.disturbance(noise) for case, (noise, _) in zip(cases, seeds)]
    if cases[0].known_bodies is None:
        yield cases, tree, disturbances
        return
    for case, disturbance, (_, body_seed) in zip(cases, disturbances, seeds):
        assert case.known_bodies is not None
        own = perturbed(tree, case.known_bodies, np.random.default_rng(body_seed))
        yield [case], own, [disturbance]


def fit_errors(case: Case, spacecraft: Spacecraft, trials: int) -> Iterator[Array]:
    """Yield the errors (10,) of the default fit in trials, in units of the scale.

    They are NaN where the fit finds no target.
    """
    truth, bodies = case.truth.to_vector(), case.known_bodies
    for number in range(trials):
        log = draw(case, spacecraft, number)
        try:
            estimate = identify(
                spacecraft, log, sensors=case.suite, momentum=case.momentum, known_bodies=bodies
            )
        except InputError:
            yield np.full(10, np.nan)
            continue
        yield (estimate.parameters - truth) / parameter_scale(truth, SCALE_LENGTH)


def seeds_of(seed: int, number: int) -> tuple[int, int]:
    """Return the seeds of the noise and of the bodies in a trial of a study."""
    noise, bodies = np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(2)
    return int(noise), int(bodies)
