"""Inverse dynamics of a spacecraft whose base floats freely."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.framework import Context
from scipy.linalg import lapack

from cpid_drake.array import Array, as_slice
from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft


class FreeFloatingDynamics:
    """Computes the joint efforts that accelerate the joints while the base floats freely.

    The equations of motion are M v̇ + C = τ + τ_applied. B are the coordinates without actuators:
    those of the base, and of a compliant wrist. Their acceleration is
    a_B = M_BB⁻¹ (τ_applied,B − C_B − M_BJ a_J), and the acceleration a_J of the joints needs
    τ_J = M_JB a_B + M_JJ a_J + C_J − τ_applied,J. These efforts act between the links, so they
    conserve momentum.

    Args:
        spacecraft: the spacecraft.
        plant: a plant of the spacecraft, with or without a target. No actuator acts on coordinates
            that are not the spacecraft's, such as those of a compliant wrist.

    Attributes:
        plant: the plant.

    Raises:
        InputError: the plant does not have the spacecraft's joints.

    """

    def __init__(self, spacecraft: Spacecraft, plant: MultibodyPlant) -> None:
        self.plant = plant
        J = spacecraft.columns_in(plant)[spacecraft.joint_columns[1]] - plant.num_positions()
        self._coupling = spacecraft.coupling
        B = np.setdiff1d(np.arange(plant.num_velocities()), J)
        self._B, self._J = as_slice(B), as_slice(J)

    def generalized_force(
        self,
        context: Context,
        a_J: ArrayLike,
        outside: Sequence[ExternallyAppliedSpatialForce] = (),
    ) -> Array:
        """Return the generalized force (nv,) that gives the joints their acceleration.

        Args:
            context: a context of the plant with the state.
            a_J: (n,) accelerations of all joints of `Spacecraft.coupling` [rad/s² or m/s²].
            outside: forces from outside.

        Returns:
            The joint efforts [N·m or N] in the order of v; zero on the base.

        Raises:
            InputError: a body without mass moves on springs.

        """
        plant, B = self.plant, self._B
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        for force in outside:
            body, world = plant.get_body(force.body_index), plant.world_frame()
            p_W = body.EvalPoseInWorld(context).rotation() @ force.p_BoBq_B
            body.AddInForce(context, p_W, force.F_Bq_W, world, forces)
        # τ₀ = M [0; a_J] + C − τ_applied
        vdot = np.zeros(plant.num_velocities())
        vdot[self._J] = a_J
        effort = plant.CalcInverseDynamics(context, vdot, forces)
        # M_BB a_B = −τ₀_B,  τ = τ₀ + M [a_B; 0]
        M_B = plant.CalcMassMatrix(context)[:, B]
        _, minus_a_B, failed = lapack.dposv(M_B[B], effort[B])
        if failed:
            raise InputError(
                "the mass matrix of the coordinates without actuators is not positive definite: in "
                "a model with a compliant wrist the target must have a mass"
            )
        effort -= M_B @ minus_a_B
        effort[B] = 0.0
        return np.asarray(effort)

    def joint_efforts(self, context: Context, states: Array, a_J: Array) -> Array:
        """Return the joint efforts (N, J) [N·m or N] of a motion, in the spacecraft's joint order.

        Args:
            context: a context of the plant; its state is overwritten.
            states: (N, nx) states x = [q; v].
            a_J: (N, J) accelerations of the joints [rad/s² or m/s²].

        """
        efforts = np.zeros(np.shape(a_J))
        for k, (state, acceleration) in enumerate(zip(states, a_J, strict=True)):
            self.plant.SetPositionsAndVelocities(context, state)
            force = self.generalized_force(context, self._coupling.rates(acceleration))
            efforts[k] = self._coupling.efforts(force[self._J])
        return efforts
