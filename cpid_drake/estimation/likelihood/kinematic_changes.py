"""Derivatives of the kinematics by joints, bodies and compliances, of many blocks in few calls."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.array import Array
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.outboard import Outboard
from cpid_drake.dynamics.parameterizations import parameters_to_standard, relative_parameterization
from cpid_drake.dynamics.rotations import cross
from cpid_drake.dynamics.sensitivity import (
    MotionSensitivity,
    screw_sensitivity,
    uncertain_sensitivity,
)
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.likelihood.motion_model import BaseMotion, Trajectory
from cpid_drake.estimation.likelihood.uniform_spline import spline_slopes

TOGETHER = 32
"""So many blocks have their kinematics computed in one call."""


def inertia_changes(
    trajectory: Trajectory, nodes: NDArray[np.intp], acceleration: Array
) -> dict[str, Array]:
    """Return the derivatives (M, 3, n) of J α by ψ, the joints' errors and the bodies'.

    Args:
        trajectory: of the base.
        nodes: (M,) nodes at which the inertia J is that of spacecraft and target.
        acceleration: (M, 3) the angular accelerations α, in B.

    """
    motion, psi = trajectory.motion, trajectory.state.psi
    grid = motion.grid.part(nodes)
    by = {"psi": grid.inertia_regressor(acceleration)}
    errors_of_q = motion.joint_errors.by_errors(motion.nodes[nodes])
    if not errors_of_q and motion.known_bodies is None:
        return by
    q = motion.joint_motion(motion.nodes[nodes])[:, 0]
    turning = acceleration, -cross(acceleration, grid.com(psi))
    outboard = Outboard.at(_with_target(motion.tree, psi, grid), q, 0 * q, *turning)
    J = -grid.inertia(psi)
    if errors_of_q:
        each = screw_sensitivity(outboard, psi, grid, *outboard.joint_screws)[0].w
        by_q = J @ outboard.by_joint(each)
        by |= {name: by_q * of_q[:, None] for name, of_q in errors_of_q.items()}
    if motion.known_bodies is not None:
        bodies = motion.known_bodies, motion.body_errors
        by["bodies"] = J @ uncertain_sensitivity(outboard, psi, grid, *bodies).w
    return by


def relate(motions: Sequence[BaseMotion], psi: Array) -> None:
    """Compute the spacecraft's dynamics of motions of one spacecraft and target in few calls.

    Raises:
        InputError: see `BodyDynamics.mobility`.

    """
    for first in range(0, len(motions), TOGETHER):
        some = motions[first : first + TOGETHER]
        samples = np.concatenate([motion.joint_motion(motion.times) for motion in some])
        dynamics, end = BodyDynamics.at(some[0].tree, samples[:, 0], samples[:, 1]), 0
        inverse, h = dynamics.mobility(psi), dynamics.momentum_at_rest(psi)
        for motion in some:
            start, end = end, end + len(motion.times)
            motion.dynamics = dynamics.part(slice(start, end))
            motion.free = psi, inverse[start:end], h[start:end]


def with_changes(trajectories: Sequence[Trajectory]) -> Iterator[Trajectory]:
    """Yield trajectories of one spacecraft and target with `Trajectory.by`, in few calls."""
    for k in range(0, len(trajectories), TOGETHER):
        some = trajectories[k : k + TOGETHER]
        for trajectory, by in zip(some, _changes(some), strict=True):
            yield replace(trajectory, by=by)


def _changes(trajectories: Sequence[Trajectory]) -> list[dict[str, MotionSensitivity]]:
    """Return the derivatives by "q" and "qdot" and, if not exact, "compliance" and "bodies".

    The compliances are those of the joints, then of the grasp about and along C's axes. A joint
    yields by −(compliance) τ, with the effort τ of a rigid arm, and the target against C by that
    times moment and force of a rigid grasp. This holds if the arm's modes are much faster than the
    motion, and if external forces on arm and target are small.
    """
    outboard, dynamics = _relative_to_base(trajectories)
    motion, psi = trajectories[0].motion, trajectories[0].state.psi
    joints, yields = motion.joints.coefficients.shape[1], motion.constants.acting["compliance"]
    which, S = outboard.joint_screws
    if yields:
        which, S = which + outboard.grasp_screws[0], np.dstack([S, outboard.grasp_screws[1]])
    moved = screw_sensitivity(outboard, psi, dynamics, which, S)
    q, qdot = (mapped(outboard.by_joint, by) for by in moved)
    parts = {"q": q, "qdot": qdot}
    if yields:
        # q = −C τ and q' = −C τ'
        loads = outboard.loads(which, S, _rate(outboard.momentum, trajectories))
        loads = outboard.by_joint(loads)
        rates = _rate(loads, trajectories)[:, None]
        parts = {name: mapped(lambda value: value[..., :joints], by) for name, by in parts.items()}
        parts["compliance"] = mapped(lambda *by: -(by[0] * loads[:, None] + by[1] * rates), q, qdot)
    if motion.known_bodies is not None:
        bodies = motion.known_bodies, motion.body_errors
        parts["bodies"] = uncertain_sensitivity(outboard, psi, dynamics, *bodies)
    ends = np.cumsum([len(trajectory.w) for trajectory in trajectories])[:-1]
    split = (mapped(lambda value: np.split(value, ends), by) for by in parts.values())
    each = zip(*[zip(*vars(by).values(), strict=True) for by in split], strict=True)
    return [
        {name: MotionSensitivity(*by) for name, by in zip(parts, one, strict=True)} for one in each
    ]


def mapped(function: Callable[..., Any], *parts: MotionSensitivity) -> MotionSensitivity:
    """Return a function of each array of derivatives."""
    return MotionSensitivity(*map(function, *map(dict.values, map(vars, parts))))


def _rate(values: Array, trajectories: Sequence[Trajectory]) -> Array:
    """Return the rates of values (..., U, n) at all instants of all motions."""
    rates, end = list[Array](), 0
    for motion in (trajectory.motion for trajectory in trajectories):
        start, end = end, end + len(motion.times)
        D = spline_slopes(motion.nodes, motion.times)
        rates.append(D @ values[..., start : start + D.shape[1], :])
    return np.concatenate(rates, axis=-2)


def _relative_to_base(trajectories: Sequence[Trajectory]) -> tuple[Outboard, BodyDynamics]:
    """Return all motions of the bodies and the target, and of the bodies, seen from the base.

    A target with rotors carries their momentum.
    """
    motions = [trajectory.motion for trajectory in trajectories]
    psi, tree = trajectories[0].state.psi, motions[0].tree
    dynamics = BodyDynamics.concatenate([motion.dynamics for motion in motions])
    joints = np.concatenate([motion.joint_motion(motion.times) for motion in motions])
    w = np.concatenate([trajectory.w for trajectory in trajectories])
    v = -(cross(w, dynamics.com(psi)) + dynamics.com_rate(psi))
    with_target = _with_target(tree, psi, dynamics)
    outboard = Outboard.at(with_target, joints[:, 0], joints[:, 1], w, v)
    constants = motions[0].constants
    if constants.acting["rotors_C"]:
        spin = constants.sum(trajectories[0].state.constants, "", "rotors_C", 3)
        momentum = outboard.momentum.copy()
        momentum[outboard.inboard_of_target, :, :3] += dynamics.R_BC @ spin
        outboard = replace(outboard, momentum=momentum)
    return outboard, dynamics


def _with_target(tree: KinematicTree, psi: Array, dynamics: BodyDynamics) -> KinematicTree:
    """Return the spacecraft with a target."""
    parameters = relative_parameterization(dynamics.mass).to_parameters(psi)
    return tree.with_target(parameters_to_standard(parameters))
