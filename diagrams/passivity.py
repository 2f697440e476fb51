#!/usr/bin/env python3
"""Adaptive control finds the target while the arms move; then they move and the base is still.

First, `PassivityController` drives the joints along the motion of the scenario exciting_motion. It
starts without any target, measures no acceleration and no force, and learns from its tracking
error and, in the composite form, from momentum. Then both arms move in the null space of the
coupling that follows from a recursive estimate of the target, so that the base rests while it is
identified. Meshcat shows and records both.
"""

import argparse

import numpy as np
from pydrake.geometry import StartMeshcat
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput
from pydrake.visualization import AddDefaultVisualization
from techniques.forgetting import reactionless_motion
from techniques.passivity_controller import PassivityController
from techniques.rows import worst_error

import cpid_drake as cpid


def adapt(spacecraft, target, motion, duration, is_composite, meshcat):
    """Simulate adaptive control; return times [s] and the parameters found (N, 10)."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    spacecraft.add_to(plant, target, scene_graph=scene_graph)
    state = plant.get_state_output_port()
    desired_motion = builder.AddSystem(cpid.JointTrajectory(motion).source()).get_output_port()

    # From here on nothing has a model of the target.
    controller = PassivityController(spacecraft, is_composite=is_composite).connected(
        builder,
        state=state,
        desired_motion=desired_motion,
        generalized_force=plant.get_applied_generalized_force_input_port(),
    )
    log = LogVectorOutput(controller.GetOutputPort("parameters"), builder, publish_period=0.1)
    AddDefaultVisualization(builder, meshcat)
    simulator = Simulator(builder.Build())
    config = SimulatorConfig(
        integration_scheme="runge_kutta2", max_step_size=0.01, use_error_control=False
    )
    ApplySimulatorConfig(config, simulator)
    root_context = simulator.get_mutable_context()
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    plant.SetPositionsAndVelocities(plant_context, spacecraft.initial_state(target, motion))
    meshcat.StartRecording()
    simulator.AdvanceTo(duration)
    cpid.keep_scene("adaptive.html", meshcat)
    found = log.FindLog(root_context)
    return found.sample_times(), found.data().T


def show(spacecraft, target, found, rate, meshcat, wait):
    """Show a motion of joints and base in Meshcat, and record it."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    spacecraft.add_to(plant, target, scene_graph=scene_graph)
    AddDefaultVisualization(builder, meshcat)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    columns = spacecraft.state_columns
    meshcat.StartRecording()
    for k, (q, quaternion) in enumerate(zip(found.q, found.quaternion_WB)):
        context.SetTime(k / rate)
        state = np.zeros(plant.num_multibody_states())
        state[columns["quaternion_WB"]], state[columns["q"]] = quaternion, q
        plant.SetPositionsAndVelocities(plant_context, state)
        diagram.ForcedPublish(context)
    cpid.keep_scene("still_base.html", meshcat, wait=wait)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=10.0, help="of adaptive control [s]")
    parser.add_argument("--direct", action="store_true", help="without momentum: Slotine and Li's")
    parser.add_argument("--wait", action="store_true", help="keep the live page until Enter")
    args = parser.parse_args()
    if not 1.0 <= args.duration <= 10.0:
        parser.exit(2, f"{parser.prog}: error: --duration must be from 1 to 10 s\n")
    scenario = cpid.load_scenario(cpid.shipped_scenario("exciting_motion"))
    spacecraft, target = scenario.spacecraft.make(), scenario.target_truth()
    motion, meshcat, truth = (
        scenario.make_joint_motion(spacecraft),
        StartMeshcat(),
        target.to_vector(),
    )
    meshcat.SetCameraPose([4.0, -3.3, 2.2], [0.6, 0.0, -0.2])
    run = adapt(spacecraft, target, motion, args.duration, not args.direct, meshcat)
    print("adaptive control: largest error of the parameters")
    for time, parameters in zip(*run):
        if time in (0.2, 0.5, 1.0, 2.0, 5.0, args.duration):
            print(f"  {time:4.1f} s {worst_error(parameters, truth):10.1e}")

    joints, q = range(len(spacecraft.joint_names)), motion.evaluate(0.0)[0]
    for is_free, word in ((True, "freely"), (False, "without rotation of the base")):
        found = reactionless_motion(
            spacecraft, target, joints, q, noise=(3e-6, 3e-5), duration=10.0, is_free=is_free
        )
        error, rotation = worst_error(found.parameters, truth), np.degrees(found.base_rotation)
        print(f"both arms, {word}: base rotates by {rotation:.3f}°, error {error:.1e}")
    show(spacecraft, target, found, 50.0, meshcat, args.wait)


if __name__ == "__main__":
    main()
