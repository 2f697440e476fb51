"""Joint efforts of a free-floating spacecraft with a target, for many joint motions at once.

No force acts on the system, so the force on all bodies outboard of a joint comes through the joint:
it is the rate of their momentum. With the joint's screw S and the momentum Π and the base's twist V
about B's origin, in B,

    τ = Sᵀ (dΠ/dt + V ×* Π)

(Featherstone 2008, ch. 2). Splines through the nodes give dΠ/dt.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cpid_drake.dynamics.kinematics import CaptureMotion
from cpid_drake.dynamics.outboard import Outboard, joined_bodies, joint_screw
from cpid_drake.dynamics.parameterizations import parameters_to_standard, vector_to_tensor
from cpid_drake.dynamics.rotations import cross, rotate
from cpid_drake.planning.motion_batch import MotionBatch
from cpid_drake.planning.objective import Objective, PlausibleTarget

SHARE = 0.85
"""Share of the largest effort that is imposed at the nodes: peaks between them are larger."""


@dataclass(frozen=True, eq=False)
class JointEfforts:
    """Efforts of some joints, for all plausible targets.

    Attributes:
        objective: the model of the base's motion.
        joints: (Q,) the joints whose efforts are limited.
        largest: (J,) largest efforts of all joints [N·m or N].

    """

    objective: Objective
    joints: NDArray[np.intp]
    largest: NDArray[np.float64]
    name: str = "torque"

    def values(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `constraints.Constraint`."""
        shares = self.shares(parameters[None])[..., 0].ravel()
        return np.concatenate([1 - shares, 1 + shares])

    def evaluate(
        self, parameters: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `constraints.Constraint`."""
        gradients = []
        for chunk, step in self.objective.steps(parameters):
            found = self.shares(chunk).imag / step
            gradients.append(found.reshape(-1, found.shape[-1]))
        gradient = np.concatenate(gradients, axis=1)
        return self.values(parameters), np.concatenate([-gradient, gradient])

    def demands(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the largest share (T, Q) of what is imposed, in motions (B, F, K)."""
        return np.asarray(np.abs(self.shares(parameters)).max(axis=(1, 3)))

    def shares(self, parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the efforts (T, N, Q, B) of B motions as shares of what is imposed."""
        model = self.objective.model
        motions = model.motions(self.objective.samples(parameters))
        q, qdot = np.moveaxis(motions.joints.evaluate(motions.nodes), 1, 0)
        known = Outboard.at(model.tree, q, qdot)
        screws = self._screws(known)
        found = [self._efforts(motions, known, screws, each) for each in self.objective.targets]
        return np.moveaxis(np.stack(found), -1, 2)

    def _screws(self, known: Outboard) -> dict[int, NDArray[np.float64]]:
        """Return the screws (N B, 6) of the limited joints by their outboard bodies."""
        places, bodies = known.tree.bodies, known.bodies
        of_joint = {places[k].joint: k for k in joined_bodies(known.tree)}
        limited = [of_joint[joint] for joint in self.joints.tolist()]
        return {k: joint_screw(places[k], bodies.R[k], bodies.r[k]) for k in limited}

    def _efforts(
        self,
        motions: MotionBatch,
        known: Outboard,
        screws: dict[int, NDArray[np.float64]],
        target: PlausibleTarget,
    ) -> NDArray[np.float64]:
        """Return the efforts (N, B, Q) as shares of what is imposed; `known` is without target."""
        model, psi = self.objective.model, self.objective.psi(target)
        trajectory, dynamics = motions.trajectory(model.state(psi)), motions.dynamics
        w = trajectory.w
        v = -(cross(w, dynamics.com(psi)) + dynamics.com_rate(psi))
        V = np.concatenate([w, v], axis=1)
        of_target = _target_momentum(known.capture, w, v, target.parameters)
        N, carrying = len(model.times), model.tree.carrying
        derivative = CubicSpline(model.times, np.eye(N))(model.times, 1)
        result = np.zeros((N, motions.count, self.joints.size), w.dtype)
        for place, (k, screw) in enumerate(screws.items()):
            momentum = known.momentum[k] + known.momentum_by([k], V[None])[0]
            if k in carrying:
                momentum = momentum + of_target
            rate = np.tensordot(derivative, momentum.reshape(N, -1), axes=1).reshape(-1, 6)
            L, P = momentum[:, :3], momentum[:, 3:]
            rate += np.concatenate([cross(w, L) + cross(v, P), cross(w, P)], axis=1)
            effort = np.sum(screw * rate, axis=1).reshape(N, -1)
            result[..., place] = effort / (SHARE * self.largest[self.joints[place]])
        return result


def _target_momentum(
    capture: CaptureMotion,
    w: NDArray[np.float64],
    v: NDArray[np.float64],
    parameters: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the target's momentum [L; P] (N, 6) about B's origin, in B.

    Args:
        capture: the motion of C seen from the base.
        w, v: (N, 3) velocities of the base, in B.
        parameters: (10,) π.

    """
    phi = parameters_to_standard(parameters)
    turning = w + capture.w_WC
    moving = v + cross(w, capture.p_WC) + capture.v_WC
    first = capture.R_WC @ phi[1:4]
    inertia = capture.R_WC @ vector_to_tensor(phi[4:]) @ np.swapaxes(capture.R_WC, -1, -2)
    P = phi[0] * moving + cross(turning, first)
    L = rotate(inertia, turning) + cross(first, moving) + cross(capture.p_WC, P)
    return np.concatenate([L, P], axis=1)
