"""Results of techniques that have a motion, a training or a simulation of their own."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, STANDARD, parameter_scale
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.techniques import network, one_joint
from cpid_drake.studies.techniques.adaptive import Adaptation, simulate_adaptation
from cpid_drake.studies.techniques.forgetting import reactionless_motion
from cpid_drake.studies.techniques.rows import worst_error
from cpid_drake.studies.trials import Case

Array = NDArray[np.float64]

_TURN = Rotation.from_euler("xyz", [0.7, -0.4, 1.1]).as_matrix()

GENERIC = InertialParameters(
    100.0,
    np.array([0.43, 0.12, -0.08]),
    _TURN @ np.diag([20.0, 30.0, 14.0]) @ _TURN.T,
)
"""A target without the symmetry of the paper's, which flatters the planar relations."""

FREE_NOISE = (3e-6, 3e-5)
"""σ of a sample of gyro and joint rates in the reactionless motion [rad/s]: those of `flight` after
the filter of the recursion."""

FREE_SEEDS = 4
"""Draws of the reactionless motions: their errors differ from each other by a factor of ten."""

TESTED = 1000
"""Targets that test a network."""


@dataclass(frozen=True, eq=False)
class Extra:
    """A result of a technique with a motion or a training of its own: numbers by name."""

    name: str
    numbers: Mapping[str, float]
    run: Adaptation | None = None


ADAPTIVE = {"Slotine-Li": (False, 30.0), "composite": (True, 10.0)}
"""Whether adaptive control is composite, and how long it runs [s]."""


def names_of(motions: Iterable[str], is_fast: bool) -> tuple[str, ...]:
    """Return the names of the results for these motions, the longest first."""
    simple = ("planar", *(f"reactionless {which}" for which in ("one arm", "both arms", "free")))
    if is_fast:
        return simple
    long = (f"{kind} {motion}" for kind in ("network", *ADAPTIVE) for motion in motions)
    return (*long, *simple)


def extra(name: str, cases: Mapping[str, Case], steps: int) -> Extra:
    """Return the result of a name.

    Args:
        name: one of `names_of`.
        cases: by motion. Planar relations use the spacecraft of the first, and reactionless motions
            the posture at the start of the last.
        steps: batches of the network's training.

    """
    first = next(iter(cases.values()))
    spacecraft, target = first.spacecraft.make(), first.truth
    kind, _, what = name.partition(" ")
    if kind == "planar":
        return Extra(name, dict(_planar(spacecraft, {"paper": target, "generic": GENERIC})))
    if kind == "reactionless":
        *_, last = cases.values()
        return Extra(name, _reactionless(spacecraft, target, last, what))
    case = cases[what]
    if kind == "network":
        return Extra(name, _network(spacecraft, case, steps))
    is_composite, duration = ADAPTIVE[kind]
    run = simulate_adaptation(spacecraft, target, case.motion, duration, is_composite=is_composite)
    numbers = {
        f"error after {time:g} s": float(run.error[round(10 * time)])
        for time in (1.0, 10.0, 20.0, 30.0)
        if time <= duration
    }
    numbers["tracking"] = float(run.tracking.max())
    return Extra(name, numbers, run)


def _planar(
    spacecraft: Spacecraft, targets: Mapping[str, InertialParameters]
) -> Iterator[tuple[str, float]]:
    """Yield errors of the planar relations with exact data, and the number of parameters."""
    motions = {"three axes": one_joint.best_moves(spacecraft)}
    motions["six axes"] = one_joint.six_axes(spacecraft)
    for label, target in targets.items():
        truth = target.to_vector()
        scale = parameter_scale(truth, SCALE_LENGTH)
        for axes, motion in motions.items():
            runs = one_joint.planar_runs(spacecraft, target, motion)
            found, known = one_joint.planar_solution(spacecraft, runs)
            relative = np.abs(found - truth) / scale
            yield f"{label}, {axes}", float(np.nanmax(relative))
            yield f"{label}, {axes}, mass", float(relative[0])
            yield f"{label}, {axes}, known", float(known)


def _reactionless(
    spacecraft: Spacecraft, target: InertialParameters, case: Case, what: str
) -> dict[str, float]:
    joints = range(len(spacecraft.joint_names))
    arm = [j for j in joints if j in one_joint.arm_joints(spacecraft)]
    errors, turns = [], []
    for seed in range(FREE_SEEDS):
        found = reactionless_motion(
            spacecraft,
            target,
            list(joints) if what == "both arms" else arm,
            case.motion.evaluate(0.0)[0],
            noise=FREE_NOISE,
            seed=seed,
            is_free=what == "free",
        )
        errors.append(worst_error(found.parameters, target.to_vector()))
        turns.append(found.turn)
    return {
        "error": float(np.sqrt(np.mean(np.square(errors)))),
        "turn": float(np.degrees(max(turns))),
    }


def _network(spacecraft: Spacecraft, case: Case, steps: int) -> dict[str, float]:
    start = perf_counter()
    assert case.suite.gyro is not None
    trained = network.train(spacecraft, case.motion, case.suite.gyro, case.duration, steps=steps)
    seconds, rng = perf_counter() - start, np.random.default_rng(case.seed)
    sigma = case.suite.gyro.sigma / np.sqrt(case.suite.gyro.rate * network.BIN)

    def errors(phi: Array, shift: float) -> Array:
        w = network.responses(spacecraft, case.motion, phi, case.duration, shift)
        found = trained.parameters(w + sigma * rng.standard_normal(w.shape))
        return np.array([worst_error(*each) for each in zip(found, STANDARD.to_parameters(phi))])

    phi = network.training_targets(TESTED, rng)
    heavy = InertialParameters(600.0, np.zeros(3), 100.0 * np.eye(3)).to_standard_vector()
    w = network.responses(spacecraft, case.motion, heavy[None], case.duration)
    inside = errors(phi, 0.0)
    return {
        "median error": float(np.median(inside)),
        "95 % below": float(np.quantile(inside, 0.95)),
        "median error, joints 0.02 rad elsewhere": float(np.median(errors(phi, 0.02))),
        "mass told of 600 kg": float(trained.parameters(w)[0, 0]),
        "seconds of training": seconds,
    }
