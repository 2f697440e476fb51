"""The demands of a scenario that the spacecraft's joints, motors and bodies cannot meet."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.scenario.simulation import Simulation
from cpid_drake.spacecraft.clearance import Clearance
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics

LARGEST_MOVE = 0.01
"""Distances are computed whenever a joint has moved by this much [rad or m]."""

MOST_POSES = 5000
"""Largest number of poses in which distances are computed."""

ROUNDING = 1e-9
"""Relative excess over a limit that is ignored."""


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
    `FreeFloatingDynamics`; the base moves so that the total momentum is constant.

    Args:
        simulation: the scenario's simulation; it need not have been run.

    """
    motion, spacecraft = simulation.joint_motion, simulation.spacecraft
    duration = simulation.scenario.simulation.duration
    times = np.append(motion.instants(), duration)
    times = np.unique(times[times <= duration])
    q, qdot, qddot = np.moveaxis(motion.evaluate(times), -2, 0)
    momentum_W = simulation.scenario.simulation.momentum_W
    try:
        with np.errstate(over="raise", invalid="raise"):
            base = spacecraft.predicted_motion(simulation.truth, motion, times, momentum_W)
    except FloatingPointError:
        return LimitCheck((), "", ("limits (the motion of the base is not finite)",))
    states = spacecraft.to_states(base)
    rigid = spacecraft.make_simulation_plant(simulation.truth)
    dynamics = FreeFloatingDynamics(spacecraft, rigid)
    efforts = dynamics.joint_efforts(rigid.CreateDefaultContext(), states, qddot)
    exceeded = _joints_beyond(simulation, times, q, qdot, efforts)
    overlaps, closest, unchecked = _distances(simulation, times, q)
    without = [
        name
        for name, limit in zip(spacecraft.joint_names, spacecraft.limits.efforts, strict=True)
        if np.isinf(limit)
    ]
    if without:
        unchecked.append(f"efforts of {_listed(without)} (no limit in the model)")
    return LimitCheck((*exceeded, *overlaps), closest, tuple(unchecked))


def _joints_beyond(
    simulation: Simulation,
    times: NDArray[np.float64],
    q: NDArray[np.float64],
    qdot: NDArray[np.float64],
    efforts: NDArray[np.float64],
) -> list[str]:
    """Return a sentence for each joint and limit that is exceeded; arrays are (N,) and (N, J)."""
    spacecraft, limits = simulation.spacecraft, simulation.spacecraft.limits
    sliding = {body.joint for body in spacecraft.tree.bodies if body.prismatic}
    found = []
    for k, joint in enumerate(spacecraft.joint_names):
        length, force = ("m", "N") if k in sliding else ("rad", "N·m")
        low, high = limits.lowest[k], limits.highest[k]
        excess = np.maximum(q[:, k] - high, low - q[:, k])
        n = int(excess.argmax())
        if excess[n] > ROUNDING * max(1.0, abs(q[n, k])):
            found.append(
                f"{joint} is at {q[n, k]:.3g} {length} at {times[n]:.3g} s, its limits are "
                f"{low:.3g} and {high:.3g} {length}"
            )
        n = int(np.abs(qdot[:, k]).argmax())
        if _exceeds(abs(qdot[n, k]), limits.rates[k]):
            found.append(
                f"{joint} moves at {abs(qdot[n, k]):.3g} {length}/s at {times[n]:.3g} s, its "
                f"limit is {limits.rates[k]:.3g} {length}/s"
            )
        n = int(np.abs(efforts[:, k]).argmax())
        if _exceeds(abs(efforts[n, k]), limits.efforts[k]):
            found.append(
                f"{joint} needs {abs(efforts[n, k]):.3g} {force} at {times[n]:.3g} s, its motor "
                f"gives {limits.efforts[k]:.3g} {force}"
            )
    return found


def _exceeds(value: float, limit: float) -> bool:
    return bool(value > limit + ROUNDING * abs(limit))


def _distances(
    simulation: Simulation, times: NDArray[np.float64], q: NDArray[np.float64]
) -> tuple[list[str], str, list[str]]:
    """Return sentences about overlaps, the smallest distance, and what is not checked."""
    spacecraft = simulation.spacecraft
    arms = [k for k in range(q.shape[1]) if not spacecraft.tree.is_rotor(k)]
    moved = np.cumsum(np.abs(np.diff(q[:, arms], axis=0, prepend=q[:1, arms])).max(axis=1))
    count = int(min(moved[-1] / LARGEST_MOVE, MOST_POSES - 2)) + 2
    instants = np.interp(np.linspace(0.0, moved[-1], count), moved, times)
    try:
        clearance = Clearance(spacecraft, simulation.truth, simulation.scenario.target.visual_model)
        approaches = clearance.approaches(simulation.joint_motion.evaluate(instants)[:, 0])
    except InputError as error:
        return [], "", [f"distances ({error})"]
    unchecked = []
    if clearance.shapeless:
        unchecked.append(f"distances of {_listed(clearance.shapeless)} (no collision geometry)")
    overlaps, closest = [], ""
    for each in approaches:
        length, time = f"{abs(each.distance):.2g} m", f"{instants[each.sample]:.3g} s"
        if each.distance < 0:
            overlaps.append(f"{' and '.join(each.bodies)} overlap by {length} at {time}")
        else:
            closest = f"{length} between {' and '.join(each.bodies)} at {time}"
    return overlaps, closest, unchecked


def _listed(names: Sequence[str]) -> str:
    """Return the first names of a list and the number of the others."""
    more = f" and {len(names) - 4} more" if len(names) > 5 else ""
    return ", ".join(names if not more else names[:4]) + more
