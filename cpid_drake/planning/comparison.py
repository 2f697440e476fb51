"""Motions to compare a plan with."""

from collections.abc import Iterator

import numpy as np

from cpid_drake.dynamics.joint_motion import HalfCosine, JointMotion
from cpid_drake.planning.planner import Planner


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
