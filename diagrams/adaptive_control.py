#!/usr/bin/env python3
"""Use the estimate in the joint controller while the arms move: the tracking error vanishes.

joint motion -> adaptive joint controller -> plant (zero gravity) -> sensors -> identifier, and the
estimate back to the controller. The controller starts with a model of the spacecraft alone, or with
a guess of the target. As soon as the identifier knows all ten parameters to 5 %, the controller
uses the estimate. Its feedback gains do not change, and its feedback reads the exact state: the
sensors are for the identifier. Spacecraft, target and joint motion are those of the shipped
scenario exciting_motion.yaml; the motion is made twice.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from cpid_drake import (
    InertialParameters,
    InputError,
    JointController,
    JointMotion,
    JointMotionSource,
    MomentumIdentifier,
    Scenario,
    SceneVisualizer,
    SensorIdentifier,
    SpacecraftSensors,
    load_scenario,
    load_sensors,
    shipped_scenario,
)
from cpid_drake.report.style import COLORS, label_axes, saved_figure
from cpid_drake.systems.scene_visualizer import extent_of, prepare_meshcat

LOG_PERIOD = 0.05  # [s]
NOTHING, EXACT = "none", "exact"  # the choices of --sensors that are not sensor suites


@dataclass
class Repeated:
    """A joint motion that is made several times, one after the other."""

    motion: JointMotion
    count: int

    @property
    def duration(self) -> float:
        """Duration of all repetitions [s]."""
        return self.count * self.motion.duration

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        return self.motion.evaluate(np.mod(time, self.motion.duration))


@dataclass
class Run:
    """Times [s], largest error of the joints [rad], mass of the target in the controller [kg]."""

    time: NDArray[np.float64]
    error: NDArray[np.float64]
    mass: NDArray[np.float64]
    explanation: str

    @property
    def first_use(self) -> float:
        """The time at which the controller first uses the estimate [s]; NaN for never."""
        changed = self.mass != self.mass[0]
        return self.time[changed][0] if changed.any() else np.nan


def simulate(
    scenario: Scenario,
    source: str,
    guess: InertialParameters | None,
    seed: int,
    meshcat: Meshcat | None = None,
    rate: float = 0.0,
) -> Run:
    """Make the motion twice, with estimates from the exact state, from sensors, or none."""
    spacecraft, target = scenario.spacecraft.make(), scenario.target_truth()
    motion = Repeated(scenario.make_joint_motion(spacecraft), 2)

    builder = DiagramBuilder()
    plant = MultibodyPlant(time_step=0.0)
    scene_graph = None
    if meshcat is None:
        builder.AddSystem(plant)
    else:
        _, scene_graph = AddMultibodyPlantSceneGraph(builder, plant)
    look = scenario.target.visual_model
    spacecraft.add_to(plant, target, scene_graph=scene_graph, target_visual_model=look)
    state = plant.get_state_output_port()
    desired_motion = builder.AddSystem(JointMotionSource(motion)).get_output_port()
    force = plant.get_applied_generalized_force_input_port()

    # From here on nothing knows the target.
    if source in (NOTHING, EXACT):
        identifier = MomentumIdentifier.AddToBuilder(
            builder, spacecraft, state=state, rows="standard", period=0.5, offset=0.5
        )
    else:
        suite = load_sensors(source)
        sensors = SpacecraftSensors.AddToBuilder(
            builder, spacecraft, state=state, suite=suite, seed=seed
        )
        identifier = SensorIdentifier.AddToBuilder(
            builder, spacecraft, samples=sensors.sample_ports(), suite=suite
        )
    estimate = {name: identifier.GetOutputPort(name) for name in ("covariance", "spatial_inertia")}
    ports = {"state": state, "desired_motion": desired_motion, "generalized_force": force}
    used = None
    if source == NOTHING:
        JointController.AddToBuilder(builder, spacecraft, **ports, target=guess)
    else:
        controller = JointController.AddToBuilder(
            builder, spacecraft, **ports, **estimate, target=guess
        )
        used = LogVectorOutput(controller.GetOutputPort("model_target"), builder, LOG_PERIOD)

    states = LogVectorOutput(state, builder, LOG_PERIOD)
    if meshcat is not None:
        times = np.linspace(0.0, motion.duration / 2, 50)
        extent = extent_of(spacecraft, spacecraft.predicted_motion(target, motion, times), target)
        prepare_meshcat(meshcat, extent)
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
        SceneVisualizer.AddToBuilder(
            builder,
            spacecraft,
            state=state,
            **estimate,
            meshcat=meshcat,
            extent=extent,
            truth=target,
        )
    simulator = Simulator(builder.Build())
    ResetIntegratorFromFlags(simulator, "runge_kutta5", 0.05)
    simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    simulator.set_target_realtime_rate(rate)
    root_context = simulator.get_mutable_context()
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    plant.SetPositionsAndVelocities(plant_context, spacecraft.initial_state(target, motion))
    simulator.AdvanceTo(motion.duration)

    log = states.FindLog(root_context)
    q = log.data()[spacecraft.joint_state_columns[0]].T
    q_d = motion.evaluate(log.sample_times())[:, 0]
    mass = np.full(len(q), guess.mass if guess else 0.0)
    if used is not None:
        mass = used.FindLog(root_context).data()[0]
    found = identifier.identification(identifier.GetMyContextFromRoot(root_context))
    return Run(
        log.sample_times(),
        np.abs(q - q_d).max(axis=1),
        mass,
        found.explain(),
    )


def draw(runs: dict[str, Run], truth: float, path: Path) -> None:
    """Draw the joint errors and the error of the mass in the controller's model."""
    with saved_figure(path, 7.5, 5.0) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        for (name, run), color in zip(runs.items(), COLORS, strict=False):
            above.semilogy(run.time, run.error, color=color, label=name)
            below.semilogy(run.time, np.abs(run.mass - truth) / truth, color=color)
            for axes in (above, below):
                axes.axvline(run.first_use, color=color, linestyle=":", linewidth=1.0)
        above.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(runs))
        label_axes(above, "Largest tracking error of the joints", "", "rad")
        label_axes(below, "Relative error of the target's mass in the controller", "time [s]", "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--sensors",
        nargs="+",
        default=[EXACT, "flight"],
        help="what the identifier reads: 'exact' for the exact state, a sensor preset or a file",
    )
    parser.add_argument("--guess", type=float, metavar="KG", help="of the target: a sphere of 1 m")
    parser.add_argument("--seed", type=int, default=1, help="of the sensors' errors")
    parser.add_argument("--figure", metavar="FILE", help="draw the tracking errors as a PNG file")
    parser.add_argument("--live", action="store_true", help="show the last run in Meshcat")
    parser.add_argument("--html", metavar="FILE", help="write a replay of the last run")
    args = parser.parse_args()
    for path in (args.figure, args.html):
        if path is not None and (Path(path).is_dir() or not Path(path).parent.is_dir()):
            parser.exit(2, f"{parser.prog}: error: {path}: not a file in a folder\n")
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    meshcat = Meshcat() if args.live or args.html else None
    if args.live:
        print(f"Open {meshcat.web_url()}", flush=True)
    sphere = None
    if args.guess is not None:
        if not 0 < args.guess < 1e6:
            parser.exit(2, f"{parser.prog}: error: --guess must be a mass > 0 in kg\n")
        sphere = InertialParameters(args.guess, np.zeros(3), 0.1 * args.guess * np.eye(3))
    initial = "initial model"
    names = {NOTHING: initial, EXACT: "exact state"}
    runs: dict[str, Run] = {}
    try:
        for source in args.sensors:
            if source != EXACT:
                load_sensors(source)
        for source in (NOTHING, *args.sensors):
            shown = meshcat if source == args.sensors[-1] else None
            if shown is not None:
                meshcat.StartRecording()
            rate = 1.0 if shown and args.live else 0.0
            run = simulate(scenario, source, sphere, args.seed, shown, rate)
            runs[names.get(source, f"{source} sensors")] = run
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")

    print(f"{'largest tracking error [rad]':32}{'before':>10}{'after':>10}{'ratio':>10}")
    second = runs[initial].time >= runs[initial].time[-1] / 2
    for name, run in runs.items():
        known = run.time > run.first_use
        before, after = run.error[~known].max(), run.error[second].max()
        if known.any():
            text = f"{name}, used from {run.first_use:.2f} s"
            print(f"{text:32}{before:10.1e}{after:10.1e}{before / after:10.1e}")
        else:
            print(f"{f'{name}, always':32}{before:10.1e}{after:10.1e}")
    print("before: until the controller first uses the estimate; after: in the second motion")
    for name, run in list(runs.items())[1:]:
        print(f"{name}: {run.explanation}")
    if args.figure:
        draw(runs, scenario.target.mass, Path(args.figure))
    if meshcat is not None:
        meshcat.StopRecording()
        meshcat.PublishRecording()
    if args.html:
        Path(args.html).write_text(meshcat.StaticHtml(), encoding="utf-8")
    if args.live:
        print("The recording plays in the browser; press Stop (Escape) there to end.", flush=True)
        meshcat.AddButton("Stop", "Escape")
        while meshcat.GetButtonClicks("Stop") == 0:
            time.sleep(0.2)


if __name__ == "__main__":
    main()
