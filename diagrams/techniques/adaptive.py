"""Adaptive control of the simulated spacecraft: parameters and tracking errors over time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from cpid_drake import InertialParameters, JointMotion, JointTrajectory, Spacecraft
from techniques.passivity_controller import PassivityController

Array = NDArray[np.float64]

SIMULATOR = SimulatorConfig(
    integration_scheme="runge_kutta2", max_step_size=0.01, use_error_control=False
)
"""Steps of 10 ms: smaller ones change the errors of 1e-4 of the parameters, and no claim."""


@dataclass(frozen=True, eq=False)
class Repeated:
    """A joint motion, again and again; forth and back if it does not end at its start."""

    motion: JointMotion
    duration: float

    def evaluate(self, time: ArrayLike) -> Array:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        period, time = self.motion.duration, np.asarray(time, dtype=float)
        start, end = self.motion.evaluate(np.array([0.0, period]))[:, 0]
        if np.allclose(start, end, atol=1e-9):
            return self.motion.evaluate(np.mod(time, period))
        phase = np.mod(time, 2 * period)
        values = self.motion.evaluate(np.minimum(phase, 2 * period - phase))
        values[..., 1, :] *= np.where(phase > period, -1.0, 1.0)[..., None]
        return values

    def instants(self) -> Array:
        """Return the instants of the motion [s]."""
        return self.motion.instants()

    def breaks(self) -> Array:
        """Return those of all repetitions [s]."""
        starts = np.arange(0.0, self.duration, self.motion.duration)
        return np.unique(np.add.outer(starts, self.motion.breaks()))


def simulate_adaptation(
    spacecraft: Spacecraft,
    target: InertialParameters,
    motion: JointMotion,
    duration: float,
    *,
    is_composite: bool,
) -> tuple[Array, Array]:
    """Simulate Drake's plant with a `PassivityController`, which starts with no target at all.

    Returns:
        At steps of 0.1 s, the parameters (N, 10) and the largest error of the joints (N,) [rad].

    """
    motion = Repeated(motion, duration)
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
    spacecraft.add_to(plant, target)
    state = plant.get_state_output_port()
    controller = PassivityController(spacecraft, is_composite=is_composite).connected(
        builder,
        state=state,
        desired_motion=builder.AddSystem(JointTrajectory(motion).source()).get_output_port(),
        generalized_force=plant.get_applied_generalized_force_input_port(),
    )
    logs = [
        LogVectorOutput(port, builder, publish_period=0.1)
        for port in (controller.GetOutputPort("parameters"), state)
    ]
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(SIMULATOR, simulator)
    root_context = simulator.get_mutable_context()
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    plant.SetPositionsAndVelocities(plant_context, spacecraft.initial_state(target, motion))
    simulator.AdvanceTo(duration)
    parameters, states = (log.FindLog(root_context) for log in logs)
    q = states.data()[spacecraft.state_columns["q"]].T
    tracking = np.abs(q - motion.evaluate(states.sample_times())[:, 0]).max(axis=1)
    return parameters.data().T, tracking
