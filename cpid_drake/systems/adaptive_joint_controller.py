"""Computed torque with a model of the target that an identifier corrects while the joints move."""

from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    EventStatus,
    InputPort,
    OutputPort,
    State,
)

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.joint_controller import ComputedTorque
from cpid_drake.systems.ports import add_connected

_NOTHING = SpatialInertia(0.0, np.zeros(3), UnitInertia(0.0, 0.0, 0.0), skip_validity_check=True)
_PLACEHOLDER = InertialParameters(1.0, np.zeros(3), np.eye(3))


class AdaptiveJointController(ComputedTorque):
    """A `JointController` that takes its model of the target from an identifier.

    The model starts with a guess of the target, or with the spacecraft alone. In every period the
    controller reads the identifier's estimate. It replaces the target of its model if all ten
    parameters are known with the required tolerance; otherwise it keeps the target that it has.
    The feedback gains do not change.

    .. pydrake_system::

        name: AdaptiveJointController
        input_ports:
        - state
        - desired_motion
        - covariance
        - spatial_inertia
        output_ports:
        - generalized_force
        - model_target

    - `state`, `desired_motion`, `generalized_force`: as those of `JointController`.
    - `covariance` (100) and `spatial_inertia`: outputs of an identifier, NaN while unknown.
    - `model_target` (10): the target of the model as `parameterizations.PARAMETER_NAMES`; zero if
      the model is the spacecraft alone.

    The state is the spatial inertia of the model's target about C's origin, in C.

    Args:
        spacecraft: the spacecraft to be controlled.
        guess: the target of the model at the start; default: none.
        tolerance: the largest σ that is accepted, relative to the scale of each parameter (see
            `parameterizations.parameter_scale`).
        period: time between two readings of the estimate [s].
        gains: `natural_frequency` and `damping_ratio` of `JointController`.

    Raises:
        InputError: a tolerance, period or gain is not positive, or the guess is not a rigid body.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        *,
        guess: InertialParameters | None = None,
        tolerance: float = 0.05,
        period: float = 0.1,
        **gains: float,
    ) -> None:
        if not (np.isfinite([tolerance, period]).all() and min(tolerance, period) > 0):
            raise InputError(
                f"tolerance and period must be > 0: tolerance {tolerance:g}, period {period:g}"
            )
        plant = MultibodyPlant(time_step=0.0)
        self._target = spacecraft.add_to(plant, guess or _PLACEHOLDER)
        super().__init__(spacecraft, plant, **gains)
        self.set_name("adaptive_joint_controller")
        self._tolerance = tolerance
        self.DeclareVectorInputPort("covariance", 100)
        self.DeclareAbstractInputPort("spatial_inertia", Value(SpatialInertia.NaN()))
        start = guess.to_spatial_inertia() if guess else _NOTHING
        self._model_index = self.DeclareAbstractState(Value(start))
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._update_model
        )
        self.DeclareVectorOutputPort(
            name="model_target",
            size=10,
            calc=self._calc_model_target,
            prerequisites_of_calc={self.xa_ticket()},
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        state: OutputPort,
        desired_motion: OutputPort,
        covariance: OutputPort,
        spatial_inertia: OutputPort,
        generalized_force: InputPort,
        **options: Any,
    ) -> "AdaptiveJointController":
        """Add a controller and connect its inputs and the output `generalized_force`.

        Args:
            builder: the diagram's builder.
            spacecraft: the spacecraft to be controlled.
            state: x = [q; v], usually `MultibodyPlant.get_state_output_port()`.
            desired_motion: usually the output of a `JointMotionSource`.
            covariance: an identifier's output of this name.
            spatial_inertia: an identifier's output of this name.
            generalized_force: the input to drive, usually
                `MultibodyPlant.get_applied_generalized_force_input_port()`.
            options: further arguments of the constructor.

        Raises:
            InputError: a port has the wrong size for this spacecraft; also the errors of the
                constructor.

        """
        ports = {
            "state": state,
            "desired_motion": desired_motion,
            "covariance": covariance,
            "spatial_inertia": spatial_inertia,
        }
        system = add_connected(builder, AdaptiveJointController(spacecraft, **options), ports)
        builder.Connect(system.GetOutputPort("generalized_force"), generalized_force)
        return system

    def _model_context(self, context: Context) -> Context:
        """Return a context of the model with the target of this system's state."""
        model = super()._model_context(context)
        self._target.SetSpatialInertiaInBodyFrame(model, self._model_inertia(context))
        return model

    def _model_inertia(self, context: Context) -> SpatialInertia:
        return context.get_abstract_state(self._model_index).get_value()

    def _update_model(self, context: Context, state: State) -> EventStatus:
        estimate = self.GetInputPort("spatial_inertia").Eval(context)
        covariance = self.GetInputPort("covariance").Eval(context).reshape(10, 10)
        if estimate.IsNaN():
            return EventStatus.DidNothing()
        parameters = InertialParameters.from_spatial_inertia(estimate).to_vector()
        sigma = np.sqrt(np.diag(covariance))  # NaN where it is not known
        if not np.all(sigma <= self._tolerance * parameter_scale(parameters)):
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._model_index).set_value(estimate)
        return EventStatus.Succeeded()

    def _calc_model_target(self, context: Context, output: BasicVector) -> None:
        inertia = self._model_inertia(context)
        known = inertia.get_mass() > 0
        parameters = InertialParameters.from_spatial_inertia(inertia) if known else None
        output.SetFromVector(parameters.to_vector() if parameters else np.zeros(10))
