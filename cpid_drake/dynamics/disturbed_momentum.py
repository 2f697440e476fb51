"""Total momentum of spacecraft and target under external forces and torques.

With constant acceleration a of the system's centre of mass Scm, constant torque τ about it, and a
constant wrench (moment M about W's origin, force F), all in W, Newton's and Euler's laws read

    P' = m a + F,    p' = P / m,    L' = τ + M + p × m a,

where p is the position of Scm and [L; P] is the momentum about W's origin. Their solution is a
cubic polynomial of time, independent of how the bodies move.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.rotations import cross
from cpid_drake.dynamics.tree import KinematicTree


@dataclass(frozen=True, eq=False)
class SystemMomentum:
    """Total momentum and centre of mass of spacecraft and target at one instant.

    Attributes:
        momentum_W: (6,) total momentum [L; P] about W's origin, in W [N·m·s, N·s].
        p_WScm: (3,) centre of mass of the system, in W [m].
        mass: mass of the system [kg].

    """

    momentum_W: NDArray[np.float64]
    p_WScm: NDArray[np.float64]
    mass: float

    @classmethod
    def with_base_at_origin(
        cls,
        tree: KinematicTree,
        target: InertialParameters,
        q: NDArray[np.float64],
        momentum_W: ArrayLike,
    ) -> "SystemMomentum":
        """Return the momentum of a system whose base frame B coincides with W.

        Args:
            tree: the spacecraft.
            target: the target.
            q: (J,) joint positions [rad or m].
            momentum_W: (6,) total momentum [L; P] about W's origin, in W [N·m·s, N·s].

        """
        psi = relative_parameterization(tree.mass).from_parameters(target.to_vector())
        p_WScm = relative_dynamics(tree, q[None], np.zeros((1, q.size))).com(psi)[0]
        return cls(np.asarray(momentum_W, dtype=float), p_WScm, tree.mass + target.mass)

    def after(
        self, time: float, disturbance_W: NDArray[np.float64], wrench_W: NDArray[np.float64]
    ) -> "SystemMomentum":
        """Return the momentum after a time with constant disturbance and wrench.

        Args:
            time: [s].
            disturbance_W: (6,) torque about Scm and acceleration of Scm, in W [N·m, m/s²].
            wrench_W: (6,) moment about W's origin and force, in W [N·m, N].

        """
        torque, acceleration = disturbance_W[:3], disturbance_W[3:]
        force = self.mass * acceleration
        P, push = self.momentum_W[3:], force + wrench_W[3:]
        path = self.p_WScm * time + (P / 2 + push * time / 6) * time**2 / self.mass  # integral of p
        rate = np.concatenate([torque + wrench_W[:3], push])
        momentum_W = self.momentum_W + rate * time
        momentum_W[:3] += cross(path, force)
        p_WScm = self.p_WScm + (P + push * time / 2) * time / self.mass
        return SystemMomentum(momentum_W, p_WScm, self.mass)
