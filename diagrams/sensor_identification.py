#!/usr/bin/env python3
"""Identify from noisy sensors, each at its own rate, and watch the estimate and its σ converge.

joint motion -> joint controller -> plant (zero gravity) -> sensors -> identifier.
Spacecraft, target and joint motion are those of the shipped scenario exciting_motion.yaml.
"""

import argparse

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from cpid_drake import (
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    InputError,
    JointController,
    JointMotionSource,
    SensorIdentifier,
    SpacecraftSensors,
    load_scenario,
    load_sensors,
    shipped_scenario,
)

SHOWN = [0, 1, 4]  # m, c_x and Ixx while it runs; all ten at the end


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensors", default="flight", help="sensor preset or YAML file")
    parser.add_argument("--seed", type=int, default=1, help="of the sensors' errors")
    args = parser.parse_args()
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    spacecraft, target = scenario.spacecraft.make(), scenario.target_truth()
    motion = scenario.make_joint_motion(spacecraft)

    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
    spacecraft.add_to(plant, target)
    state = plant.get_state_output_port()

    source = builder.AddSystem(JointMotionSource(motion))
    JointController.AddToBuilder(
        builder,
        spacecraft,
        state=state,
        desired_motion=source.get_output_port(),
        generalized_force=plant.get_applied_generalized_force_input_port(),
        target=target,
    )

    try:
        suite = load_sensors(args.sensors)
        sensors = SpacecraftSensors.AddToBuilder(
            builder, spacecraft, state=state, suite=suite, seed=args.seed
        )
        identifier = SensorIdentifier.AddToBuilder(
            builder, spacecraft, samples=sensors.sample_ports(), suite=suite
        )
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")
    diagram = builder.Build()

    simulator = Simulator(diagram)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    root_context = simulator.get_mutable_context()
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    plant.SetPositionsAndVelocities(plant_context, spacecraft.initial_state(target, motion))
    context = identifier.GetMyMutableContextFromRoot(root_context)

    print("time [s]  samples            m [kg]             c_x [m]         Ixx [kg·m²]")
    for time in np.arange(0.5, motion.duration, 1.0):  # the identifier solves blocks of a second
        simulator.AdvanceTo(time)
        result = identifier.identification(context)
        sigma = np.sqrt(np.diag(result.covariance))
        columns = (f"{result.parameters[k]:10.5f} ± {sigma[k]:<7.2g}" for k in SHOWN)
        print(f"{time:8.2f} {result.sample_count:8d}", *columns)
    simulator.AdvanceTo(motion.duration)
    simulator.AdvancePendingEvents()  # the sensors' last samples
    result = identifier.Finish(root_context)
    print(f"\n{result.explain()}")
    print(f"{'':12}{'estimate':>12}{'std. deviation':>18}{'truth':>12}")
    sigma = np.sqrt(np.diag(result.covariance))
    rows = zip(PARAMETER_NAMES, PARAMETER_UNITS, result.parameters, sigma, target.to_vector())
    for name, unit, estimate, deviation, truth in rows:
        print(f"{f'{name} [{unit}]':12}{estimate:12.5f}{deviation:18.1e}{truth:12.5f}")


if __name__ == "__main__":
    main()
