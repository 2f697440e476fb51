#!/usr/bin/env python3
"""Identify a captured target online: motion, controller, plant, sensors, identifier, Meshcat."""

import numpy as np
from pydrake.geometry import StartMeshcat
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput
from pydrake.visualization import AddDefaultVisualization

import cpid_drake as cpid

# The spacecraft is known. Only the plant knows the target, here a tank of 60 kg.
model = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"  # or your file
spacecraft = cpid.Spacecraft(model, base="bus", capture_frame="capture_point")
tank = cpid.InertialParameters(60.0, [0.5, 0.05, -0.1], np.diag([6.0, 9.0, 8.0]))
guess = cpid.InertialParameters(100.0, np.zeros(3), 10.0 * np.eye(3))  # of the controller
start = np.array([0.2, 0.3, 1.0, 0.0, -0.6, 0.0, -0.3, -1.5, 2.4, 0.0, -0.9, 0.0])  # [rad]
end = np.array([-0.8, -1.2, 0.7, 1.8, 0.8, -1.0, -1.5, -1.3, 0.6, -1.0, 0.5, 1.0])
motion = cpid.HalfCosine(start, end, duration=10.0)
suite = cpid.load_sensors("flight")

builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
spacecraft.add_to(plant, tank, scene_graph=scene_graph)
state, force = plant.get_state_output_port(), plant.get_applied_generalized_force_input_port()
desired = builder.AddSystem(cpid.JointMotionSource(motion)).get_output_port()
cpid.JointController.AddToBuilder(
    builder, spacecraft, state=state, desired_motion=desired, generalized_force=force, target=guess
)
sensors = cpid.SpacecraftSensors.AddToBuilder(builder, spacecraft, state=state, suite=suite)
samples = sensors.sample_ports()
identifier = cpid.SensorIdentifier.AddToBuilder(builder, spacecraft, **samples, suite=suite)
state_log = LogVectorOutput(state, builder, publish_period=0.1)
meshcat = StartMeshcat()
AddDefaultVisualization(builder, meshcat)
estimate = {name: identifier.GetOutputPort(name) for name in ("covariance", "spatial_inertia")}
cpid.SceneVisualizer.AddToBuilder(builder, spacecraft, state=state, **estimate, meshcat=meshcat)

simulator = Simulator(builder.Build())
ApplySimulatorConfig(SimulatorConfig(accuracy=1e-8, max_step_size=0.05), simulator)
root_context = simulator.get_mutable_context()
plant_context = plant.GetMyMutableContextFromRoot(root_context)
plant.SetPositionsAndVelocities(plant_context, spacecraft.initial_state(tank, motion))
meshcat.StartRecording()
simulator.AdvanceTo(motion.duration)
meshcat.PublishRecording()
found = identifier.Finish(root_context)
for row in zip(cpid.PARAMETER_NAMES, found.parameters, tank.to_vector(), strict=True):
    print("{:3}{:9.4f}   truth {:8.4f}".format(*row))
