"""Adaptive joint control of a free base by passivity (Slotine and Li)."""

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    EventStatus,
    State,
    ValueProducer,
)

from cpid_drake import InertialParameters, InputError, Spacecraft
from cpid_drake.dynamics.parameterizations import STANDARD, parameter_scale
from cpid_drake.systems.ports import SpacecraftSystem
from techniques.newton_euler import ReferenceDynamics, momentum_regressor, skew_consistent_regressor

Array = NDArray[np.float64]

NOMINAL = InertialParameters(50.0, np.zeros(3), 5.0 * np.eye(3))
"""The target of the damping, so that it never becomes small with a light wrist alone."""

START_SIGMA = 1e3
"""σ of the start value in the momentum recursion, in units of each parameter's scale."""


class PassivityController(SpacecraftSystem):
    """Drives the joints along a motion and adapts the target's parameters while they move.

    No acceleration and no force is measured. With v = (V_WB in B, q̇), the reference
    q̇_r = q̇_d − Λ (q − q_d) and s = v − v_r,

        τ = (M̂ v̇_r + Ĉ v_r)_J − K_J s_J,   (M̂ v̇_r + Ĉ v_r)_B = K_B s_B,   φ̂' = −Γ Y_rᵀ s_C.

    The base has no actuator, so its reference velocity V_Br is a state that obeys the estimated
    equation of the base; this keeps all equations linear in φ. With the skew-consistent Ĉ the
    energy ½ sᵀ M s + ½ φ̃ᵀ Γ⁻¹ φ̃ decreases as −sᵀ K s, whatever the target is: the joints follow,
    and φ̂ converges if the motion excites all parameters. The damping is K_J = k M_JJ of a nominal
    target without the base's share and K_B = 2 M_BB of the spacecraft alone.

    The *composite* form (Slotine and Li 1989) also learns from momentum: Γ = γ P with P of a
    recursive least-squares estimate on the standard rows, which is updated every period.

    .. pydrake_system::

        name: PassivityController
        input_ports:
        - state
        - desired_motion
        output_ports:
        - generalized_force
        - parameters

    - `state`: x = [q; v] of the plant.
    - `desired_motion` (3 J): q_d, q̇_d, q̈_d of the J joints, see `JointTrajectory`.
    - `generalized_force`: for the plant's applied-generalized-force port; zero on the base.
    - `parameters` (10): the estimate; see `parameterizations.PARAMETER_NAMES`.

    The continuous state is φ̂ (10) and V_Br (6); the discrete state of the composite form is P
    (100). V_Br starts at zero: start at rest, or with the base's twist small.

    Args:
        spacecraft: the spacecraft to be controlled.
        adaptation: γ.
        stiffness: Λ [1/s].
        damping: k [1/s].
        is_composite: whether to learn from momentum, which must be zero.
        period: time between two updates of P [s].

    Raises:
        InputError: a gain or the period is not positive.

    Source: Slotine and Li 1987, "On the adaptive control of robot manipulators"; 1989, "Composite
    adaptive control of robot manipulators".

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        *,
        adaptation: float = 1.0,
        stiffness: float = 3.0,
        damping: float = 10.0,
        is_composite: bool = False,
        period: float = 0.01,
    ) -> None:
        super().__init__()
        self.set_name("passivity_controller")
        gains = {"adaptation": adaptation, "stiffness": stiffness, "damping": damping}
        for name, value in {**gains, "period": period}.items():
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"passivity controller: {name} must be > 0, not {value:g}")
        self._spacecraft, self._tree = spacecraft, spacecraft.tree.lumped
        self._stiffness, self._damping, self._adaptation = stiffness, damping, adaptation
        self._nominal = NOMINAL.to_standard_vector()
        plant, J = spacecraft.plant, len(spacecraft.joint_names)
        self._place = spacecraft.state_columns["qdot"] - plant.num_positions()
        scale = parameter_scale(NOMINAL.to_vector())
        scale = np.concatenate([[2 * scale[0]], np.full(3, scale[0]), np.full(6, scale[0])])
        self._scale = scale
        self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareVectorInputPort("desired_motion", 3 * J)
        self.DeclareContinuousState(16)
        if is_composite:
            self._P_index = self.DeclareDiscreteState(np.diag((START_SIGMA * scale) ** 2).ravel())
            self.DeclarePeriodicUnrestrictedUpdateEvent(
                period_sec=period, offset_sec=0.0, update=self._learn_from_momentum
            )
        self._is_composite = is_composite
        result = Value(BasicVector(J + 16))  # the joint efforts and the rates of the state
        self._control = self.DeclareCacheEntry(
            "control", ValueProducer(allocate=result.Clone, calc=self._calc_control)
        )
        self.DeclareVectorOutputPort(
            name="generalized_force",
            size=plant.num_velocities(),
            calc=self._calc_generalized_force,
            prerequisites_of_calc={self._control.ticket()},
        )
        self.DeclareVectorOutputPort(
            name="parameters",
            size=10,
            calc=self._calc_parameters,
            prerequisites_of_calc={self.all_state_ticket()},
        )

    def _velocities(self, context: Context) -> tuple[Array, Array]:
        """Return joint positions (J,) and velocities v (6 + J,) with the base's twist in B."""
        state = self.GetInputPort("state").Eval(context)
        motion = self._spacecraft.to_motion(context.get_time(), state)
        R_BW = motion.R_WB[0].T
        twist = R_BW @ motion.w_WB[0], R_BW @ motion.v_WB[0]
        return motion.q[0], np.concatenate([*twist, motion.qdot[0]])

    def _calc_control(self, context: Context, result: AbstractValue) -> None:
        q, v = self._velocities(context)
        state = context.get_continuous_state_vector().CopyToVector()
        phi, V_Br = state[:10], state[10:]
        q_d, qdot_d, qddot_d = self.GetInputPort("desired_motion").Eval(context).reshape(3, -1)
        v_r = np.concatenate([V_Br, qdot_d - self._stiffness * (q - q_d)])
        rate_J = qddot_d - self._stiffness * (v[6:] - qdot_d)
        s = v - v_r
        known = ReferenceDynamics.at(self._tree, q, v, v_r)
        M, Cv = known.with_target(phi, v, v_r)
        wanted = 2 * known.M[:6, :6] @ s[:6] - Cv[:6] - M[:6, 6:] @ rate_J
        rate = np.concatenate([np.linalg.solve(M[:6, :6], wanted), rate_J])
        nominal = known.with_target(self._nominal, v, v_r)[0]
        share = nominal[6:, :6] @ np.linalg.solve(nominal[:6, :6], nominal[:6, 6:])
        effort = (M @ rate + Cv)[6:] - self._damping * (nominal[6:, 6:] - share) @ s[6:]
        J_C = known.J_C
        A_r = J_C @ rate + known.bias_C
        Y_r = skew_consistent_regressor(A_r, J_C @ v_r, J_C @ v)
        gain = np.diag(self._scale**2)
        if self._is_composite:
            gain = context.get_discrete_state(self._P_index).value().reshape(10, 10)
        adapted = -self._adaptation * gain @ Y_r.T @ (J_C @ s)
        result.get_mutable_value().SetFromVector(np.concatenate([effort, adapted, rate[:6]]))

    def _control_of(self, context: Context) -> Array:
        return np.asarray(self._control.Eval(context).CopyToVector())

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Set the rates of φ̂ and V_Br."""
        derivatives.get_mutable_vector().SetFromVector(self._control_of(context)[-16:])

    def _calc_generalized_force(self, context: Context, output: BasicVector) -> None:
        force = np.zeros(output.size())
        force[self._place] = self._control_of(context)[:-16]
        output.SetFromVector(force)

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        phi = context.get_continuous_state_vector().CopyToVector()[:10]
        is_known = phi[0] > 0
        output.SetFromVector(STANDARD.to_parameters(phi) if is_known else np.full(10, np.nan))

    def _learn_from_momentum(self, context: Context, state: State) -> EventStatus:
        """Update φ̂ and P by the rows J_Cᵀ Y_mom(V_C) φ = −(M_k v)_B of zero momentum about Bo."""
        q, v = self._velocities(context)
        known = ReferenceDynamics.at(self._tree, q, v, v)
        A = known.J_C[:, :6].T @ momentum_regressor(known.J_C @ v)
        b = -known.M[:6] @ v
        P = context.get_discrete_state(self._P_index).value().reshape(10, 10)
        vector = state.get_mutable_continuous_state().get_mutable_vector()
        values = vector.CopyToVector()
        PA = P @ A.T
        gain = np.linalg.solve(A @ PA + np.eye(6), PA.T).T
        values[:10] += gain @ (b - A @ values[:10])
        P = P - gain @ PA.T
        vector.SetFromVector(values)
        state.get_mutable_discrete_state(self._P_index).set_value(((P + P.T) / 2).ravel())
        return EventStatus.Succeeded()
