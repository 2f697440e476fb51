"""The demands of a scenario that the spacecraft's joints, motors and bodies cannot meet."""

from dataclasses import dataclass

import numpy as np

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError, listed
from cpid_drake.simulation.simulation import Simulation
from cpid_drake.spacecraft.clearance import Clearance
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics
from cpid_drake.spacecraft.spacecraft import Spacecraft

LARGEST_MOVE = 0.01
"""Distances are computed whenever a joint has moved by this much [rad or m]."""

MOST_POSES = 5000
"""Largest number of poses in which distances are computed."""


@dataclass(frozen=True)
class LimitCheck:
    """The result of `check_limits`, in words.

    Attributes:
        exceeded: one sentence for each limit of a joint that is exceeded, and for each pair of
            bodies that overlap.
        closest: the smallest distance between bodies that are not neighbours, and its time; empty
            if bodies overlap or if the distance is not known.
        unchecked: what was not checked, and why; one phrase each.

    """

    exceeded: tuple[str, ...]
    closest: str
    unchecked: tuple[str, ...]


def check_limits(simulation: Simulation) -> LimitCheck:
    """Compare a scenario's joint motion with the limits of the spacecraft's model.

    The simulation has no limits: it moves the joints as prescribed. The check computes the efforts
    along the prescribed motion by inverse dynamics with the true target, see
    `FreeFloatingDynamics`; the base moves so that the total momentum is constant. The simulation
    need not have been run.
    """
    motion, spacecraft = simulation.joint_motion, simulation.spacecraft
    config = simulation.scenario.simulation
    times = np.append(motion.instants(), config.duration)
    times = np.unique(times[times <= config.duration])
    q, qdot, qddot = np.moveaxis(motion.evaluate(times), -2, 0)
    try:
        with np.errstate(over="raise", invalid="raise"):
            base = spacecraft.predicted_motion(simulation.truth, motion, times, config.momentum_W)
    except FloatingPointError:
        return LimitCheck((), "", ("limits (the motion of the base is not finite)",))
    rigid = spacecraft.make_simulation_plant(simulation.truth)
    efforts = FreeFloatingDynamics(spacecraft, rigid).joint_efforts(
        rigid.CreateDefaultContext(), spacecraft.to_states(base), qddot
    )
    exceeded = _joints_beyond(spacecraft, times, q, qdot, efforts)
    overlaps, closest, unchecked = _distances(simulation, times, q)
    limits = zip(spacecraft.joint_names, spacecraft.limits.efforts, strict=True)
    if without := [name for name, limit in limits if np.isinf(limit)]:
        unchecked.append(f"efforts of {listed(without)} (no limit in the model)")
    return LimitCheck((*exceeded, *overlaps), closest, tuple(unchecked))


def _joints_beyond(
    spacecraft: Spacecraft, times: Array, q: Array, qdot: Array, efforts: Array
) -> list[str]:
    """Return a sentence for each joint and limit that is exceeded; arrays are (N,) and (N, J)."""
    limits, beyond = spacecraft.limits, []
    sliding = spacecraft.tree.sliding
    for k, joint in enumerate(spacecraft.joint_names):
        length, force = ("m", "N") if k in sliding else ("rad", "N·m")
        low, high, rate, effort = (
            each[k] for each in (limits.lowest, limits.highest, limits.rates, limits.efforts)
        )
        speeds, needs = np.abs(qdot[:, k]), np.abs(efforts[:, k])
        for values, excess, verb, unit, limit in (
            (
                q[:, k],
                np.maximum(q[:, k] - high, low - q[:, k]),
                "is at",
                length,
                f"its limits are {low:.3g} and {high:.3g}",
            ),
            (speeds, speeds - rate, "moves at", f"{length}/s", f"its limit is {rate:.3g}"),
            (needs, needs - effort, "needs", force, f"its motor gives {effort:.3g}"),
        ):
            n = int(excess.argmax())
            if excess[n] > 1e-9 * max(1.0, abs(values[n])):  # not by rounding
                value = f"{values[n]:.3g} {unit} at {times[n]:.3g} s"
                beyond.append(f"{joint} {verb} {value}, {limit} {unit}")
    return beyond


def _distances(simulation: Simulation, times: Array, q: Array) -> tuple[list[str], str, list[str]]:
    """Return sentences about overlaps, the smallest distance, and what is not checked."""
    spacecraft = simulation.spacecraft
    arms = [k for k in range(q.shape[1]) if not spacecraft.tree.is_rotor(k)]
    steps = np.abs(np.diff(q[:, arms], axis=0, prepend=q[:1, arms]))
    moved = np.cumsum(steps.max(axis=1, initial=0.0))  # a craft may have wheels only
    count = int(min(moved[-1] / LARGEST_MOVE, MOST_POSES - 2)) + 2
    instants = np.interp(np.linspace(0.0, moved[-1], count), moved, times)
    try:
        clearance = Clearance(spacecraft, simulation.truth, simulation.scenario.target.visual_model)
        approaches = clearance.approaches(simulation.joint_motion.evaluate(instants)[:, 0])
    except InputError as error:
        return [], "", [f"distances ({error})"]
    unchecked, overlaps, closest = list[str](), list[str](), ""
    if clearance.shapeless:
        unchecked.append(f"distances of {listed(clearance.shapeless)} (no collision geometry)")
    for each in approaches:
        length, time = f"{abs(each.distance):.2g} m", f"{instants[each.sample]:.3g} s"
        if each.distance < 0:
            overlaps.append(f"{' and '.join(each.bodies)} overlap by {length} at {time}")
        else:
            closest = f"{length} between {' and '.join(each.bodies)} at {time}"
    return overlaps, closest, unchecked
