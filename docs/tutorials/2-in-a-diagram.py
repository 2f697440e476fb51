# %% [markdown]
# # 2. The identifier in a Diagram
#
# This tutorial puts the identification into a Drake Diagram. The plant moves its arms, and the
# identifier reads the plant's state. Then sensors with noise replace the exact state, and another
# identifier reads their samples. `diagrams/identify.py` is the same Diagram with Meshcat.

# %%
import matplotlib.pyplot as plt
import numpy as np
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

import cpid_drake as cpid

# %% [markdown]
# ## The inputs
#
# You provide a model of the spacecraft *without* its target, and the name of the frame that holds
# it. The tank is the true target: only the plant has it. The controller begins with a guess.

# %%
model = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"
spacecraft = cpid.Spacecraft(model, base="bus", capture_frame="capture_point")
tank = cpid.InertialParameters(60.0, [0.5, 0.05, -0.1], np.diag([6, 9, 8]))
guess = cpid.InertialParameters(100.0, np.zeros(3), 10.0 * np.eye(3))
start = np.array([0.2, 0.3, 1.0, 0.0, -0.6, 0.0, -0.3, -1.5, 2.4, 0.0, -0.9, 0.0])  # [rad]
end = np.array([-0.8, -1.2, 0.7, 1.8, 0.8, -1.0, -1.5, -1.3, 0.6, -1.0, 0.5, 1.0])
path = PiecewisePolynomial.CubicHermite([0, 10], np.column_stack([start, end]), np.zeros((12, 2)))

# %% [markdown]
# ## The Diagram
#
# Each system has a method `AddToBuilder`, which adds and connects it. Its arguments are the ports
# that the system reads.


# %%
def build(add_identifier):
    """Return a simulator of the plant, its identifier, and the log of the estimate."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    spacecraft.add_to(plant, tank, scene_graph=scene_graph)  # in zero gravity
    plant.SetDefaultPositions([1, 0, 0, 0, 0, 0, 0, *start])  # attitude, position, joints
    state = plant.get_state_output_port()
    desired = builder.AddSystem(TrajectorySource(path, output_derivative_order=2))
    identifier = add_identifier(builder, state)
    cpid.JointController.AddToBuilder(
        builder,
        spacecraft,
        state=state,
        desired_motion=desired.get_output_port(),
        generalized_force=plant.get_applied_generalized_force_input_port(),
        target=guess,
        **identifier.estimate_ports(),
    )
    log = LogVectorOutput(identifier.GetOutputPort("parameters"), builder, publish_period=0.5)
    simulator = Simulator(builder.Build())
    ApplySimulatorConfig(SimulatorConfig(accuracy=1e-8, max_step_size=0.05), simulator)
    return simulator, identifier, log


# %% [markdown]
# ![The systems of the Diagram and their connections](../../diagrams/pictures/identify.png)
#
# ## With the exact state
#
# `MomentumIdentifier` takes ten samples a second and adds their six rows of Eq. 18. An entry of its
# port `parameters` is NaN until the motion determines it. After the third sample all ten are there.
# From the fourth on it checks that momentum is conserved: a discrete plant would fail.

# %%
simulator, identifier, log = build(
    lambda builder, state: cpid.MomentumIdentifier.AddToBuilder(
        builder, spacecraft, state=state, rows="eq18"
    )
)
simulator.AdvanceTo(10.0)
exact = identifier.Finish(simulator.get_mutable_context())
print(exact)

assert exact.passed
assert np.abs(exact.parameters - tank.to_vector()).max() < 1e-6
seen = log.FindLog(simulator.get_context())
known = np.isfinite(seen.data()).all(axis=0)
assert seen.sample_times()[known][0] == 0.5

# %% [markdown]
# ## With real sensors
#
# `SpacecraftSensors` samples the state as a star tracker, a gyro, encoders and a camera would.
# `SensorIdentifier` knows their noise. It solves a block of samples each second. `unstated="exact"`
# says that the sensors have no other errors than those that their file states.

# %%
suite = cpid.load_sensors("flight", unstated="exact")


def add_sensors_and_identifier(builder, state):
    """Add the sensors, and the identifier that reads them."""
    sensors = cpid.SpacecraftSensors.AddToBuilder(builder, spacecraft, state=state, suite=suite)
    return cpid.SensorIdentifier.AddToBuilder(
        builder, spacecraft, **sensors.sample_ports(), suite=suite
    )


simulator, identifier, log = build(add_sensors_and_identifier)
simulator.AdvanceTo(10.0)
found = identifier.Finish(simulator.get_mutable_context())
print(found)

sigma = np.sqrt(np.diag(found.covariance))
assert found.passed
assert (np.abs(found.parameters - tank.to_vector()) < 4 * sigma).all()

# %% [markdown]
# The estimate of the mass over time: it is known to a percent before the motion is over.

# %%
seen = log.FindLog(simulator.get_context())
figure, axis = plt.subplots(figsize=(7, 3), layout="constrained")
axis.axhline(tank.mass, color="C1", label="true mass")
axis.plot(seen.sample_times(), seen.data()[0], "o-", label="estimate")
axis.set(xlabel="time [s]", ylabel="mass [kg]", ylim=(57, 63))
axis.legend()
plt.show()

# %% [markdown]
# In a notebook, `found.plot(truth=tank)` draws each parameter with its interval and the true value.
