"""The known bodies as seen from the base, one sample at a time, by Drake's kinematics.

The fast road online; `base_motion.known_dynamics` is the one for many samples at once.
"""

import threading

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import JacobianWrtVariable

from cpid_drake.base_motion import KnownDynamics
from cpid_drake.regressors import skew
from cpid_drake.relative_motion import RelativeDynamics
from cpid_drake.spacecraft import Spacecraft


class KnownBodies(threading.local):
    """Gives the known bodies' dynamics at one configuration, for one or for several rates.

    Args:
        spacecraft: the known spacecraft. Its plant is only read; every thread has its own context.

    """

    def __init__(self, spacecraft: Spacecraft) -> None:
        self._spacecraft, self._plant = spacecraft, spacecraft.plant
        self._context = self._plant.CreateDefaultContext()
        q, qdot = spacecraft.joint_state_columns
        self._q = q
        self._joints = qdot - self._plant.num_positions()
        base = spacecraft.base.floating_velocities_start_in_v()
        self._base = np.arange(base, base + 6)
        self._positions = np.zeros(self._plant.num_positions())
        self._positions[spacecraft.quaternion_columns[0]] = 1.0
        self._frame = spacecraft.base.body_frame()

    def __call__(self, q: NDArray[np.float64], qdot: NDArray[np.float64]) -> RelativeDynamics:
        """Return the dynamics (N instants) at positions q (J,) and rates qdot (N, J)."""
        plant, context = self._plant, self._context
        self._positions[self._q] = q
        plant.SetPositions(context, self._positions)
        M = plant.CalcMassMatrix(context)[self._base]
        X_BC = self._spacecraft.capture_frame.CalcPoseInWorld(context)
        J_BC = plant.CalcJacobianSpatialVelocity(
            context,
            JacobianWrtVariable.kV,
            self._spacecraft.capture_frame,
            np.zeros(3),
            self._frame,
            self._spacecraft.capture_frame,
        )[:, self._joints]
        R_CB = X_BC.rotation().matrix().T
        X = np.zeros((1, 6, 6))
        X[0, :3, :3] = X[0, 3:, 3:] = R_CB
        X[0, 3:, :3] = -R_CB @ skew(X_BC.translation())
        known = KnownDynamics(M[None, :, self._base], qdot @ M[:, self._joints].T, X, qdot @ J_BC.T)
        return RelativeDynamics.from_known(known, self._spacecraft.mass)
