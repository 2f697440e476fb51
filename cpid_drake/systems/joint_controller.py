"""Computed torque for a tree of joints on a free base, with a fixed or an identified target."""

from typing import Self

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    EventStatus,
    InputPort,
    OutputPort,
    State,
    ValueProducer,
)

from cpid_drake.array import as_slice
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.free_floating import FreeFloatingDynamics
from cpid_drake.spacecraft.spacecraft import Connect, Spacecraft
from cpid_drake.systems.ports import SpacecraftSystem

_PLACEHOLDER = InertialParameters(1.0, np.zeros(3), np.eye(3))


class JointController(SpacecraftSystem):
    """Drives the joints of a spacecraft along a motion; the base floats freely.

    This is computed torque with a model of spacecraft and target: `FreeFloatingDynamics` gives the
    efforts that accelerate the joints by a_J = q̈_d + 2ζω (q̇_d − q̇) + ω² (q_d − q). These efforts
    act between the links, so they conserve momentum whatever the model is.

    With the true target in the model the joints follow the desired motion exactly, also against
    forces from outside if it reads them. Without any target the torques at the wrist are far too
    small for the load. A guess of half or twice the true mass suffices, because feedback corrects
    the rest. A controller that reads an identifier's
    estimate replaces the target of its model as soon as all ten parameters are known with the
    required tolerance, and whenever the identifier's checks pass; else it keeps its model. It looks
    at the estimate every 0.1 s.

    .. pydrake_system::

        name: JointController
        input_ports:
        - state
        - desired_motion
        - covariance
        - spatial_inertia
        - checks_passed
        - spatial_forces
        output_ports:
        - generalized_force
        - model_target

    - `state`: x = [q; v] of the plant.
    - `desired_motion` (3 J): q_d, q̇_d, q̈_d of the J joints, as from Drake's
      `TrajectorySource` with `output_derivative_order=2` and from `JointTrajectory.source`.
    - `covariance` (100), `spatial_inertia` and `checks_passed` (1), if `reads_estimate`: outputs of
      an identifier; the first two are NaN while unknown.
    - `spatial_forces`, if `knows_forces`: all forces from outside, as those of `ExternalForces`.
    - `generalized_force`: for the plant's applied-generalized-force port; zero on the base.
    - `model_target` (10): the target of the model as `parameterizations.PARAMETER_NAMES`; zero if
      the model is the spacecraft alone.

    The state is the spatial inertia of the model's target about C's origin, in C.

    Args:
        spacecraft: the spacecraft to be controlled.
        target: the model's target, at the start if the estimate is read; default: none.
        connect: joins C and the target in the model, see `Spacecraft.add_to`. If the simulated
            plant has a compliant wrist, the model must have it too.
        plant: the plant that is driven, if it has more coordinates than the model, such as those of
            sprung masses.
        natural_frequency: ω of the joint errors [rad/s].
        damping_ratio: ζ of the joint errors.
        reads_estimate: whether the target of the model follows an identifier's estimate, which then
            has three ports here.
        knows_forces: whether it reads the forces from outside, against which the joints then hold
            their motion.
        tolerance: the largest σ of an estimate that is used, relative to the scale of each
            parameter (see `parameterizations.parameter_scale`).

    Raises:
        InputError: a gain or the tolerance is not positive, or the target is not a rigid body; and,
            when an effort is computed, the model has a compliant wrist and no target.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        *,
        target: InertialParameters | None = None,
        connect: Connect = MultibodyPlant.WeldFrames,
        plant: MultibodyPlant | None = None,
        natural_frequency: float = 10.0,
        damping_ratio: float = 1.0,
        reads_estimate: bool = False,
        knows_forces: bool = False,
        tolerance: float = 0.05,
    ) -> None:
        super().__init__()
        self.set_name("joint_controller")
        for name, value in (
            ("natural_frequency", natural_frequency),
            ("damping_ratio", damping_ratio),
            ("tolerance", tolerance),
        ):
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"joint controller: {name} must be > 0, not {value:g}")
        model = MultibodyPlant(time_step=0.0)
        self._target = spacecraft.add_to(model, target or _PLACEHOLDER, connect=connect)
        self._dynamics = FreeFloatingDynamics(spacecraft, model)
        plant = plant or model
        names = plant.GetStateNames()
        state = np.array([names.index(name) for name in model.GetStateNames()])
        self._model_columns = as_slice(state)
        self._driven = as_slice(state[model.num_positions() :] - plant.num_positions())
        self._gains = np.array([natural_frequency**2, 2 * damping_ratio * natural_frequency])
        self._tolerance = tolerance
        columns = spacecraft.columns_in(plant)
        self._joint_columns, self._coupling = columns[spacecraft.joint_columns], spacecraft.coupling

        self._state_port = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self._desired_port = self.DeclareVectorInputPort(
            "desired_motion", 3 * len(spacecraft.joint_names)
        )
        start = target.to_spatial_inertia() if target else SpatialInertia.Zero()
        self._target_index = self.DeclareAbstractState(Value(start))
        # Any call may overwrite the state of this context; its target is that of the model.
        self._model_context = self.DeclareCacheEntry(
            "model_context",
            ValueProducer(
                allocate=lambda: AbstractValue.Make(model.CreateDefaultContext()),
                calc=self._set_target,
            ),
            {self.xa_ticket()},
        )
        if reads_estimate:
            self.DeclareVectorInputPort("covariance", 100)
            self.DeclareAbstractInputPort("spatial_inertia", Value(SpatialInertia.NaN()))
            self.DeclareVectorInputPort("checks_passed", 1)
            self.DeclarePeriodicUnrestrictedUpdateEvent(
                period_sec=0.1, offset_sec=0.0, update=self._read_estimate
            )
        self._forces_port = None
        if knows_forces:
            none = Value([ExternallyAppliedSpatialForce()])
            self._forces_port = self.DeclareAbstractInputPort("spatial_forces", none)
        self.DeclareVectorOutputPort(
            name="generalized_force",
            size=plant.num_velocities(),
            calc=self._calc_generalized_force,
            prerequisites_of_calc={self.all_input_ports_ticket(), self.xa_ticket()},
        )
        self.DeclareVectorOutputPort(
            name="model_target",
            size=10,
            calc=self._calc_model_target,
            prerequisites_of_calc={self.xa_ticket()},
        )

    @classmethod
    def AddToBuilder(
        cls,
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        state: OutputPort,
        desired_motion: OutputPort,
        generalized_force: InputPort | None = None,
        covariance: OutputPort | None = None,
        spatial_inertia: OutputPort | None = None,
        checks_passed: OutputPort | None = None,
        spatial_forces: OutputPort | None = None,
        target: InertialParameters | None = None,
        connect: Connect = MultibodyPlant.WeldFrames,
        plant: MultibodyPlant | None = None,
        natural_frequency: float = 10.0,
        damping_ratio: float = 1.0,
        tolerance: float = 0.05,
    ) -> Self:
        """Add a controller to a diagram and connect it; for the options see the class.

        The estimate is read if its three ports are given, and forces from outside if theirs is.

        Raises:
            InputError: some but not all ports of an estimate are given, or a port has another size.

        """
        estimate = (covariance, spatial_inertia, checks_passed)
        controller = cls(
            spacecraft,
            target=target,
            connect=connect,
            plant=plant,
            natural_frequency=natural_frequency,
            damping_ratio=damping_ratio,
            reads_estimate=any(port is not None for port in estimate),
            knows_forces=spatial_forces is not None,
            tolerance=tolerance,
        )
        return controller.connected(
            builder,
            state=state,
            desired_motion=desired_motion,
            generalized_force=generalized_force,
            covariance=covariance,
            spatial_inertia=spatial_inertia,
            checks_passed=checks_passed,
            spatial_forces=spatial_forces,
        )

    def _model_inertia(self, context: Context) -> SpatialInertia:
        return context.get_abstract_state(self._target_index).get_value()

    def _set_target(self, context: Context, model: AbstractValue) -> None:
        inertia = self._model_inertia(context)
        self._target.SetSpatialInertiaInBodyFrame(model.get_mutable_value(), inertia)

    def _calc_generalized_force(self, context: Context, output: BasicVector) -> None:
        state = self._state_port.Eval(context)
        coupling, given = self._coupling, self._desired_port.Eval(context).reshape(3, -1)
        desired = np.stack([coupling.positions(given[0]), *coupling.rates(given[1:])])
        # a_J = q̈_d + ω² (q_d − q) + 2ζω (q̇_d − q̇)
        a_J = desired[2] + self._gains @ (desired[:2] - state[self._joint_columns])
        model = self._model_context.Eval(context)
        self._dynamics.plant.SetPositionsAndVelocities(model, state[self._model_columns])
        outside = () if self._forces_port is None else self._forces_port.Eval(context)
        force = np.zeros(output.size())
        force[self._driven] = self._dynamics.generalized_force(model, a_J, outside)
        output.SetFromVector(force)

    def _calc_model_target(self, context: Context, output: BasicVector) -> None:
        inertia = self._model_inertia(context)
        is_known = inertia.get_mass() > 0
        output.SetFromVector(
            InertialParameters.from_spatial_inertia(inertia).to_vector() if is_known else [0.0] * 10
        )

    def _read_estimate(self, context: Context, state: State) -> EventStatus:
        estimate = self.GetInputPort("spatial_inertia").Eval(context)
        covariance = self.GetInputPort("covariance").Eval(context).reshape(10, 10)
        if estimate.IsNaN():
            return EventStatus.DidNothing()
        parameters = InertialParameters.from_spatial_inertia(estimate).to_vector()
        sigma = np.sqrt(np.diag(covariance))  # NaN where it is not known
        if not np.all(sigma <= self._tolerance * parameter_scale(parameters)):
            return EventStatus.DidNothing()
        if not self.GetInputPort("checks_passed").Eval(context)[0]:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._target_index).set_value(estimate)
        return EventStatus.Succeeded()
