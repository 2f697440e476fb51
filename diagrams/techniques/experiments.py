"""Techniques with a motion, a training or a simulation of their own: numbers by name."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from paper.study import peak_relative_error
from paper.values import PAPER_TABLE_1

from cpid_drake import HalfCosine, InertialParameters, Motion
from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, STANDARD, parameter_scale
from cpid_drake.dynamics.propagation import propagate
from techniques import network, one_joint
from techniques.adaptive import simulate_adaptation
from techniques.forgetting import reactionless_motion
from techniques.rows import worst_error
from techniques.trial import Truth

Array = NDArray[np.float64]
Numbers = dict[str, float]

FREE_NOISE = (3e-6, 3e-5)
"""σ of a sample of gyro and joint rates in the reactionless motion [rad/s]: those of `flight` after
the filter of the recursion."""

FREE_SEEDS = 4
"""Draws of the reactionless motions: their errors differ from each other by a factor of ten."""

ARMS = ("one arm at rest", "both arms at rest", "one arm free")
"""Which arms move, and whether so that the base is at rest."""

TESTED = 1000
"""Targets that test a network."""


def planar(truth: Truth) -> Numbers:
    """Return errors of the planar relations with exact data, and the number of parameters."""
    target, numbers = truth.case.truth.to_vector(), Numbers()
    for label, order in (("three", (2, 1, 0)), ("six", (2, 1, 0, 2, 1, 2))):
        runs = one_joint.best_moves(truth.spacecraft, order)
        found, known = one_joint.planar_solution(
            truth.spacecraft, one_joint.planar_runs(truth.spacecraft, truth.case.truth, runs)
        )
        errors = np.abs(found - target) / parameter_scale(target, SCALE_LENGTH)
        numbers[f"error, {label} axes"] = float(np.nanmax(errors))
        numbers[f"parameters, {label} axes"] = float(known)
    return numbers


def reactionless(arms: str, truth: Truth) -> Numbers:
    """Return the RMS error and the largest rotation of the base, from the start of the motion."""
    everything = range(len(truth.spacecraft.joint_names))
    joints = everything if "both" in arms else sorted(one_joint.arm_joints(truth.spacecraft))
    runs = [
        reactionless_motion(
            truth.spacecraft,
            truth.case.truth,
            joints,
            truth.case.motion.evaluate(0.0)[0],
            noise=FREE_NOISE,
            seed=draw,
            is_free="free" in arms,
        )
        for draw in range(FREE_SEEDS)
    ]
    errors = [worst_error(run.parameters, truth.case.truth.to_vector()) for run in runs]
    rotation, error = max(run.base_rotation for run in runs), np.sqrt(np.mean(np.square(errors)))
    return {"error": float(error), "rotation [°]": float(np.degrees(rotation))}


def adaptive(is_composite: bool, truth: Truth) -> Numbers:
    """Return errors of the parameters over time, and the largest of the joints."""
    times = (1, 10) if is_composite else (10, 20, 30)
    found, tracking = simulate_adaptation(
        truth.spacecraft, truth.case.truth, truth.case.motion, times[-1], is_composite=is_composite
    )
    target = truth.case.truth.to_vector()
    errors = {f"error after {t} s": worst_error(found[10 * t], target) for t in times}
    return errors | {"tracking [rad]": float(tracking.max())}


def network_errors(truth: Truth) -> Numbers:
    """Return errors of a network for targets in its range, for other joints, for a heavy target."""
    gyro, rng = truth.case.suite.gyro, np.random.default_rng(truth.case.seed)
    assert gyro is not None
    trained = network.train(truth.spacecraft, truth.case.motion, gyro, truth.case.duration)
    sigma = gyro.sigma / np.sqrt(gyro.rate * network.BIN)

    def answers(phi: Array, shift: float = 0.0) -> Array:
        w = network.responses(truth.spacecraft, truth.case.motion, phi, truth.case.duration, shift)
        return trained.parameters(w + sigma * rng.standard_normal(w.shape))

    def errors(shift: float) -> Array:
        return np.array([worst_error(*each) for each in zip(answers(phi, shift), target)])

    phi = network.training_targets(TESTED, rng)
    target = STANDARD.to_parameters(phi)
    heavy = InertialParameters(600.0, np.zeros(3), 100.0 * np.eye(3)).to_standard_vector()
    inside = errors(0.0)
    return {
        "median error": float(np.median(inside)),
        "95 % below": float(np.quantile(inside, 0.95)),
        "median error, joints 0.02 rad elsewhere": float(np.median(errors(0.02))),
        "mass found of 600 kg": float(answers(heavy[None])[0, 0]),
    }


def some_joints(truth: Truth) -> Numbers:
    """Return the bound of momentum if only some joints move from the start of a motion to its end.

    It is NaN if they do not determine all ten. There are no numbers if the motion ends where it
    starts.
    """
    arm, numbers = np.array(one_joint.arm_joints(truth.spacecraft)), Numbers()
    start, end = truth.case.motion.evaluate(np.array([0.0, truth.case.duration]))[:, 0]
    half, joints = len(arm) // 2, np.arange(len(start))
    for label, chosen in {
        "capture arm": arm,
        "its outer half": arm[:half],
        "its inner half": arm[half:],
        "other joints": np.setdiff1d(joints, arm),
    }.items():
        if not np.allclose(start, end):
            moved = start + np.isin(joints, chosen) * (end - start)
            case = replace(truth.case, motion=HalfCosine(start, moved, truth.case.duration))
            numbers[f"bound, {label}"] = replace(truth, case=case).bound()
    return numbers


def resimulated(truth: Truth) -> Numbers:
    """Return the errors of the motion with the parameters that Ning et al. 2016 print (Fig. 7)."""
    times, tree = np.linspace(0.0, truth.case.duration, 101), truth.spacecraft.tree

    def base(target: InertialParameters) -> Motion:
        found = propagate(tree, truth.case.motion, target.to_standard_vector(), times)
        return found.to_motion(truth.spacecraft.joint_names, times, truth.case.motion)

    true, other = base(truth.case.truth), base(PAPER_TABLE_1)
    return {
        "attitude": peak_relative_error(other.euler_321 - true.euler_321, true.euler_321),
        "position": peak_relative_error(other.p_WB - true.p_WB, true.p_WB),
    }
