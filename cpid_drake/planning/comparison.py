"""Motions to compare a plan with, and what to expect of each."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.joint_motion import HalfCosine, JointMotion
from cpid_drake.planning.planner import Planner
from cpid_drake.planning.prediction import Prediction
from cpid_drake.simulation.trials import fit_errors


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


def predictions(
    planner: Planner,
    motions: Mapping[str, JointMotion],
    trials: int = 0,
    progress: Callable[[str], None] = lambda step: None,
) -> dict[str, Prediction]:
    """Return what is expected of motions with the first of the plausible targets.

    Args:
        planner: the planner of the scenario.
        motions: the motions, by name.
        trials: number of noisy logs that are simulated and identified for each motion.
        progress: called after every trial with a short description.

    """
    made = {}
    for name, motion in motions.items():
        case, errors = planner.case(motion, planner.targets[0]), []
        world = replace(case, suite=case.suite.exact())
        for number, error in enumerate(fit_errors(world, planner.spacecraft, trials), start=1):
            errors.append(error)
            progress(f"{name}: {number} of {trials} trials")
        made[name] = replace(
            planner.predict(motion, planner.targets[0]),
            usage=planner.usage(motion),
            errors=np.reshape(errors, (-1, 10)),
        )
    return made
