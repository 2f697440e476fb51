#!/usr/bin/env python3
"""Use the estimate in the joint controller while the arms move: the tracking error vanishes.

The controller starts with a model of the spacecraft alone. As soon as all ten parameters are
identified to 5 % and the checks pass, the controller uses the estimate; its feedback gains do not
change. The feedback
reads the exact state; the sensors are for the identifier. Spacecraft, target and joint motion are
those of the scenario exciting_motion, whose motion is made twice.
"""

import argparse

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

import cpid_drake as cpid
from cpid_drake.files.figures import new_figure
from cpid_drake.report.page import Report, Section

NONE, EXACT = "none", "exact"
"""No estimate in the controller; an estimate from the exact state. Others are sensor suites."""


class Repeated:
    """A joint motion that is made several times, one after the other."""

    def __init__(self, motion, count):
        self.motion, self.duration = motion, count * motion.duration

    def evaluate(self, time):  # noqa: D102
        return self.motion.evaluate(np.mod(time, self.motion.duration))

    def breaks(self):  # noqa: D102
        starts = np.arange(0.0, self.duration, self.motion.duration)
        return np.unique(starts[:, None] + self.motion.breaks())


def simulate(scenario, source, seed):
    """Return times [s], largest errors of the joints [rad], and masses in the controller [kg]."""
    spacecraft, target = scenario.spacecraft.make(), scenario.target_truth()
    motion = Repeated(scenario.make_joint_motion(spacecraft), 2)
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
    spacecraft.add_to(plant, target)
    state = plant.get_state_output_port()
    desired_motion = builder.AddSystem(cpid.JointTrajectory(motion).source()).get_output_port()

    # From here on nothing has a model of the target.
    if source in (NONE, EXACT):
        identifier = cpid.MomentumIdentifier.AddToBuilder(
            builder, spacecraft, state=state, period=0.5, offset=0.5
        )
    else:
        suite = cpid.load_sensors(source, unstated="exact")
        sensors = cpid.SpacecraftSensors.AddToBuilder(
            builder, spacecraft, state=state, suite=suite, seed=seed
        )
        identifier = cpid.SensorIdentifier.AddToBuilder(
            builder, spacecraft, **sensors.sample_ports(), suite=suite
        )
    estimate = {} if source == NONE else identifier.estimate_ports()
    controller = cpid.JointController.AddToBuilder(
        builder,
        spacecraft,
        state=state,
        desired_motion=desired_motion,
        generalized_force=plant.get_applied_generalized_force_input_port(),
        **estimate,
    )
    states = LogVectorOutput(state, builder, publish_period=0.05)
    models = LogVectorOutput(controller.GetOutputPort("model_target"), builder, 0.05)

    simulator = Simulator(builder.Build())
    config = SimulatorConfig(integration_scheme="runge_kutta5", max_step_size=0.05, accuracy=1e-10)
    ApplySimulatorConfig(config, simulator)
    root_context = simulator.get_mutable_context()
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    plant.SetPositionsAndVelocities(plant_context, spacecraft.initial_state(target, motion))
    simulator.AdvanceTo(motion.duration)
    print(f"{source}: {identifier.Finish(root_context).explain()}")
    log = states.FindLog(root_context)
    q = log.data()[spacecraft.state_columns["q"]].T
    error = np.abs(q - motion.evaluate(log.sample_times())[:, 0]).max(axis=1)
    return log.sample_times(), error, models.FindLog(root_context).data()[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensors", default="flight", help="a sensor preset or a file")
    parser.add_argument("--seed", type=int, default=1, help="of the sensors' errors")
    parser.add_argument("--figure", metavar="FILE", help="draw the tracking errors as an HTML page")
    args = parser.parse_args()
    scenario = cpid.load_scenario(cpid.shipped_scenario("exciting_motion"))
    try:
        runs = {name: simulate(scenario, name, args.seed) for name in (NONE, EXACT, args.sensors)}
    except cpid.InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")
    print(f"\n{'largest tracking error [rad]':32}{'before':>10}{'after':>10}{'ratio':>10}")
    for name, (time, error, mass) in runs.items():
        known, second = mass > 0, time >= time[-1] / 2
        before, after = error[~known].max(), error[second].max()
        text = f"{name}, used from {time[known][0]:.2f} s" if known.any() else name
        print(f"{text:32}{before:10.1e}{after:10.1e}{before / after:10.1e}")
    print("before: until the controller first uses the estimate; after: in the second motion")
    if args.figure:
        title = "Largest tracking error of the joints"
        figure = new_figure(title, "time [s]", "rad", height=400)
        for name, (time, error, _) in runs.items():
            figure.add_scatter(x=time, y=error, name=f"estimate from: {name}")
        figure.update_yaxes(type="log", exponentformat="power")
        Report("Adaptive control", "", [Section("Errors", figures=[figure], columns=1)]).write(
            args.figure
        )


if __name__ == "__main__":
    main()
