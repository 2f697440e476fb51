"""Motions to compare a plan with, and what a fit really finds from noisy logs of a motion."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.joint_motion import HalfCosine, JointMotion
from cpid_drake.dynamics.parameterizations import SCALE_LENGTH, parameter_scale
from cpid_drake.dynamics.sensitivity import perturbed
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.identify import identify
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.planning.planner import Planner
from cpid_drake.planning.prediction import MotionSetting


def reference_motions(planner: Planner) -> Iterator[tuple[str, JointMotion]]:
    """Yield the scenario's motion and motions of the planner's family, by name.

    All but the scenario's motion and a half cosine move the joints as much as the limits allow. If
    not even a small motion keeps them, the name says so.
    """
    family, own = planner.family, planner.own_motion
    yield "scenario's motion", own
    if not isinstance(own, HalfCosine) and (family.start != family.end).any():
        yield "half cosine", HalfCosine(family.start, family.end, family.duration)
    rng = np.random.default_rng(planner.options.seed)
    t, T = family.times, family.duration
    first = 1 / T
    phase = 2 * np.pi * (first * t + (family.frequency - first) * t**2 / (2 * T))
    shifts = rng.uniform(0.0, 2 * np.pi, len(family.moving))
    drawn = {
        "best of 1,000 random": planner.ranked(1000)[0],
        "multi-axis chirp": family.fitted(np.sin(phase[:, None] + shifts)),
        "random binary, smoothed": rng.choice([-1.0, 1.0], family.shape),
    }
    for name, parameters in drawn.items():
        full = parameters / family.usage(parameters)
        plan = planner.consider(full)
        if plan is None:  # the transfer itself leaves no room
            yield f"{name}, beyond limits", family.make(full)
        else:
            yield name, plan.motion


def trial_errors(
    setting: MotionSetting,
    motion: JointMotion,
    parameters: NDArray[np.float64],
    trials: int,
    seed: int,
) -> Iterator[NDArray[np.float64]]:
    """Yield the errors (10,) of the fit, in units of the scale, in trials with drawn errors.

    The noise of all sensors is drawn, and the known bodies if they are uncertain. The errors are
    NaN where the fit finds no target.

    Args:
        setting: spacecraft and sensors.
        motion: of the joints.
        parameters: (10,) π of the target.
        trials: their number.
        seed: determines the draws.

    """
    craft, bodies, ideal = setting.spacecraft, setting.known_bodies, None
    scale = parameter_scale(parameters, SCALE_LENGTH)
    momentum = TotalMomentum.unknown() if setting.is_unknown else TotalMomentum.zero()
    for number in range(trials):
        sequence = np.random.SeedSequence(seed, spawn_key=(number,))
        noise_seed, body_seed = sequence.generate_state(2).tolist()
        if ideal is None or bodies is not None:
            rng = np.random.default_rng(body_seed)
            tree = None if bodies is None else perturbed(craft.tree, bodies, rng)
            ideal = setting.ideal(motion, parameters, tree)
        log = add_noise(setting.suite, ideal, noise_seed)
        try:
            found = identify(
                craft, log, sensors=setting.suite, momentum=momentum, known_bodies=bodies
            )
        except InputError:
            yield np.full(10, np.nan)
            continue
        yield (found.parameters - parameters) / scale
