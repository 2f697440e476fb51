#!/usr/bin/env python3
"""Identify a caught target online from sensors: `identify.py` with another identifier."""

import sys

import numpy as np
from pydrake.geometry import StartMeshcat
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial
from pydrake.visualization import AddDefaultVisualization

import cpid_drake as cpid

model = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"  # or your file
spacecraft = cpid.Spacecraft(model, base="bus", capture_frame="capture_point")
tank = cpid.InertialParameters(60.0, [0.5, 0.05, -0.1], np.diag([6, 9, 8]))  # only in the plant
guess = cpid.InertialParameters(100.0, np.zeros(3), 10.0 * np.eye(3))  # of the controller
start = np.array([0.2, 0.3, 1.0, 0.0, -0.6, 0.0, -0.3, -1.5, 2.4, 0.0, -0.9, 0.0])  # [rad]
end = np.array([-0.8, -1.2, 0.7, 1.8, 0.8, -1.0, -1.5, -1.3, 0.6, -1.0, 0.5, 1.0])
path = PiecewisePolynomial.CubicHermite([0, 10], np.column_stack([start, end]), np.zeros((12, 2)))

builder = DiagramBuilder()
plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
spacecraft.add_to(plant, tank, scene_graph=scene_graph)  # in zero gravity
plant.SetDefaultPositions([1, 0, 0, 0, 0, 0, 0, *start])  # attitude, position, joints: at rest
state, force = plant.get_state_output_port(), plant.get_applied_generalized_force_input_port()
desired = builder.AddSystem(TrajectorySource(path, output_derivative_order=2)).get_output_port()
suite = cpid.load_sensors("flight", unstated="exact")
sensors = cpid.SpacecraftSensors.AddToBuilder(builder, spacecraft, state=state, suite=suite)
samples = sensors.sample_ports()
identifier = cpid.SensorIdentifier.AddToBuilder(builder, spacecraft, **samples, suite=suite)
ports = {"state": state, **identifier.estimate_ports()}
joints = {"desired_motion": desired, "generalized_force": force, "target": guess}
cpid.JointController.AddToBuilder(builder, spacecraft, **ports, **joints)
state_log, meshcat = LogVectorOutput(state, builder, publish_period=0.1), StartMeshcat()
AddDefaultVisualization(builder, meshcat)
scene = cpid.SceneVisualizer.AddToBuilder(builder, spacecraft, **ports, meshcat=meshcat, truth=tank)
simulator = Simulator(builder.Build())
ApplySimulatorConfig(SimulatorConfig(accuracy=1e-8, max_step_size=0.05), simulator)
meshcat.StartRecording()
row = "{:6}" + 10 * "{:z9.4f}"
print(row.replace("z9.4f", ">9").format("", *cpid.PARAMETER_NAMES))
print(row.format("truth", *tank.to_vector()))
for time in range(1, 11):
    simulator.AdvanceTo(time)
    found = identifier.identification(simulator.get_context())
    print(row.format(f"{time} s", *found.parameters), *found.failures)
scene.keep("scene.html", wait="--wait" in sys.argv)
