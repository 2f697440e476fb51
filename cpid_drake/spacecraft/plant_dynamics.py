"""Dynamics of the known bodies relative to the base at one configuration, computed by Drake.

This is faster for a single sample than `relative_motion.relative_dynamics`, which is faster for
many samples.
"""

import threading

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import JacobianWrtVariable

from cpid_drake.dynamics.relative_motion import RelativeDynamics
from cpid_drake.dynamics.rotations import skew
from cpid_drake.spacecraft.spacecraft import Spacecraft


class PlantRelativeDynamics(threading.local):
    """Computes `RelativeDynamics` at one configuration, for one or more vectors of joint rates.

    One instance serves any number of threads: each thread has a context of its own.

    Args:
        spacecraft: the known spacecraft; its plant is not changed.

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
        """Return the dynamics for positions q (J,) [rad or m] and rates qdot (N, J) [1/s].

        Arrays that do not depend on the rates have one row instead of N.
        """
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
        # The equations of `RelativeDynamics.from_known`, from the blocks of Drake's mass matrix.
        mass, R_BC = self._spacecraft.mass, X_BC.rotation().matrix()
        p_BK = np.array([M[2, self._base[4]], M[0, self._base[5]], M[1, self._base[3]]]) / mass
        shift = skew(p_BK)
        momentum = qdot @ M[:, self._joints].T
        v_BK = momentum[:, 3:] / mass
        V_BC = qdot @ J_BC.T
        one = np.ones((len(qdot), 1))
        return RelativeDynamics(
            mass=mass,
            I_K=(M[:3, self._base[:3]] + mass * shift @ shift)[None],
            h_K=momentum[:, :3] - momentum[:, 3:] @ shift.T,
            p_BK=p_BK[None],
            v_BK=v_BK,
            R_BC=R_BC[None],
            w_BC=V_BC[:, :3],
            s=one * ((X_BC.translation() - p_BK) @ R_BC),
            sdot=V_BC[:, 3:] - v_BK @ R_BC,
        )
