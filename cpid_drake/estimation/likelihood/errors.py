"""Effect of errors of the joint motion and of the known bodies on the predicted motion.

Each function returns the derivative of the motion with respect to such errors, each error in units
of its own σ.
"""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import parameters_to_standard, relative_parameterization
from cpid_drake.dynamics.sensitivity import (
    BodyUncertainty,
    MotionSensitivity,
    body_sensitivity,
    joint_sensitivity,
)
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.likelihood.motion import BaseMotion, Instants, Trajectory


def joint_errors(motion: BaseMotion, trajectory: Trajectory, at: Instants) -> MotionSensitivity:
    """Return the derivative w.r.t. the coefficients of the joints' splines, (M, 3, K J).

    The square root of the coefficients' covariance makes the n errors independent.
    """
    tree, telemetry = _relative_to_base(motion, trajectory, at)
    by_q, by_qdot = joint_sensitivity(tree, telemetry, trajectory.state.psi, at.dynamics)
    factor = np.linalg.cholesky(motion.joints.covariance)
    B, B_dot = motion.joints.basis(at.times) @ factor, motion.joints.basis(at.times, 1) @ factor

    def by_errors(q: NDArray[np.float64], qdot: NDArray[np.float64]) -> NDArray[np.float64]:
        both = q[..., None] * B[:, None, None, :] + qdot[..., None] * B_dot[:, None, None, :]
        return both.reshape(len(B), 3, -1)

    return MotionSensitivity(
        by_errors(by_q.w, by_qdot.w), by_errors(by_q.com, by_qdot.com), by_errors(by_q.v, by_qdot.v)
    )


def body_errors(
    motion: BaseMotion, trajectory: Trajectory, at: Instants, uncertainty: BodyUncertainty
) -> MotionSensitivity:
    """Return the derivative w.r.t. the known bodies' inertial parameters, (M, 3, 10 bodies)."""
    tree, telemetry = _relative_to_base(motion, trajectory, at)
    known, psi = len(motion.tree.bodies), trajectory.state.psi
    change = body_sensitivity(tree, telemetry, psi, at.dynamics, known)
    sigmas = np.tile(uncertainty.sigmas, known)
    return MotionSensitivity(change.w * sigmas, change.com * sigmas, change.v * sigmas)


def _relative_to_base(
    motion: BaseMotion, trajectory: Trajectory, at: Instants
) -> tuple[KinematicTree, Telemetry]:
    """Return the tree with the target attached, and the motion of both relative to the base."""
    psi = trajectory.state.psi
    phi = parameters_to_standard(relative_parameterization(at.dynamics.mass).to_parameters(psi))
    q, qdot, _ = np.moveaxis(motion.joints.evaluate(at.times), 1, 0)
    w, v = trajectory.spline(at.times), -at.com_velocity(trajectory)
    return motion.tree.with_target(phi), Telemetry.seen_from_base(q, qdot, w, v)
