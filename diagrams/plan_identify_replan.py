#!/usr/bin/env python3
"""Plan a motion, identify while it is made, and plan the next one, until the target is known.

planned motion -> joint controller -> plant (zero gravity) -> sensors -> identifier, and
the estimate back to the controller and to the planner. Nothing is known about the target at first:
the first motion is planned for a range of targets, and the controller has one of them as its model.
As long as the estimate is not as precise as asked, the next motion is planned with the estimate and
its covariance. Then the joints make the transfer of the scenario with the estimate in the
controller. The true target is drawn from the range; only the plant has it.
"""

import argparse
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from cpid_drake import (
    HalfCosine,
    InertialParameters,
    InputError,
    JointController,
    JointMotion,
    JointTrajectory,
    Scenario,
    SensorIdentifier,
    SensorSuite,
    Spacecraft,
    SpacecraftSensors,
    TargetPrior,
    load_scenario,
    load_sensors,
    shipped_scenario,
)
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.files.figures import COLORS, INK, new_figure
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.planner import Planner
from cpid_drake.report.page import Report, Section
from cpid_drake.simulation.joint_motions import HalfCosineMotion

LOG_PERIOD = 0.05  # [s]
ESTIMATE_PERIOD = 0.5  # [s]
MOST_MOTIONS = 6
FIRST_PLAN = PlanOptions(candidates=500, iterations=30, targets=2)


def following(planner: Planner, prior: TargetPrior | None) -> Planner:
    """Return the planner of the motion back to the last one's start, solved within seconds.

    The prior counts as if it came from a sensor, so that the motion shows what is least known.
    """
    last, names = planner.family, planner.spacecraft.joint_names
    ends = (dict(zip(names, q.tolist(), strict=True)) for q in (last.end, last.start))
    scenario = replace(planner.scenario, joint_motion=HalfCosineMotion(last.duration, *ends))
    short = replace(planner.options, targets=1, candidates=128, iterations=12)
    return Planner(scenario, planner.suite, short, prior)


@dataclass
class History:
    """What happened: ends of motions [s], and σ relative to the scale over time.

    `sigma` is NaN until all ten parameters are determined.
    """

    ends: list[float] = field(default_factory=list)
    time: list[float] = field(default_factory=list)
    sigma: list[float] = field(default_factory=list)


class Craft:
    """The spacecraft with a target that only its plant has, at rest after every motion."""

    def __init__(
        self,
        spacecraft: Spacecraft,
        target: InertialParameters,
        guess: InertialParameters,
        suite: SensorSuite,
        first: JointMotion,
        seed: int,
    ) -> None:
        self.spacecraft = spacecraft
        builder = DiagramBuilder()
        self.plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
        spacecraft.add_to(self.plant, target)
        state = self.plant.get_state_output_port()
        self.source = builder.AddSystem(JointTrajectory(first).source())
        desired = self.source.get_output_port()

        # From here on nothing has a model of the target.
        sensors = SpacecraftSensors.AddToBuilder(
            builder, spacecraft, state=state, suite=suite, seed=seed
        )
        self.identifier = SensorIdentifier.AddToBuilder(
            builder, spacecraft, **sensors.sample_ports(), suite=suite
        )
        self.controller = JointController.AddToBuilder(
            builder,
            spacecraft,
            state=state,
            desired_motion=desired,
            **self.identifier.estimate_ports(),
            generalized_force=self.plant.get_applied_generalized_force_input_port(),
            target=guess,
        )
        self.logs = {
            "state": LogVectorOutput(state, builder, LOG_PERIOD),
            "desired": LogVectorOutput(desired, builder, LOG_PERIOD),
            "model": LogVectorOutput(
                self.controller.GetOutputPort("model_target"), builder, LOG_PERIOD
            ),
        }
        self.simulator = Simulator(builder.Build())
        ResetIntegratorFromFlags(self.simulator, "runge_kutta5", 0.05)
        self.simulator.get_mutable_integrator().set_target_accuracy(1e-10)
        self.root = self.simulator.get_mutable_context()
        start = spacecraft.initial_state(target, first)
        context = self.plant.GetMyMutableContextFromRoot(self.root)
        self.plant.SetPositionsAndVelocities(context, start)

    def move(self, motion: JointMotion, history: History) -> None:
        """Make a motion from now on."""
        self.source.UpdateTrajectory(JointTrajectory(motion, self.root.get_time()))
        self.simulator.Initialize()
        begin = self.root.get_time()
        steps = round(motion.duration / ESTIMATE_PERIOD)
        for k in range(1, steps + 1):
            self.simulator.AdvanceTo(begin + motion.duration * k / steps)
            found = self.estimate()
            history.time.append(self.root.get_time())
            history.sigma.append(worst(found.parameters, found.covariance))
        history.ends.append(self.root.get_time())

    def estimate(self):
        """Return what is identified so far."""
        return self.identifier.identification(self.identifier.GetMyContextFromRoot(self.root))

    def logged(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times (N,) and values (N, ...) of a log."""
        log = self.logs[name].FindLog(self.root)
        return log.sample_times(), log.data().T

    def tracking_error(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times (N,) [s] and the largest error of the joints (N,) [rad]."""
        times, states = self.logged("state")
        q = states[:, self.spacecraft.state_columns["q"]]
        desired = self.logged("desired")[1][:, : q.shape[1]]
        return times, np.abs(q - desired).max(axis=1)


def worst(parameters: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Return the largest σ relative to the scale of its parameter; NaN if one is not known."""
    if not np.isfinite(covariance).all():
        return np.nan
    return float((np.sqrt(np.diag(covariance)) / parameter_scale(parameters)).max())


def run(
    scenario: Scenario, suite: SensorSuite, precision: float, seed: int
) -> tuple[Craft, History, InertialParameters]:
    """Plan, move and identify until the target is known; then make the scenario's transfer."""
    planner = Planner(scenario, suite, FIRST_PLAN)
    [drawn] = planner.plausible(1, 10_000 + seed)
    target = InertialParameters.from_vector(drawn)
    guess = InertialParameters.from_vector(planner.targets[0])
    transfer, history = planner.own_motion, History()
    craft = Craft(planner.spacecraft, target, guess, suite, transfer, seed)
    for count in range(1, MOST_MOTIONS + 1):
        begin = time.perf_counter()
        plan = planner.run().motion
        seconds = time.perf_counter() - begin
        craft.move(plan, history)
        found, known = craft.estimate(), history.sigma[-1]
        said = "not all ten known" if np.isnan(known) else f"worst σ {100 * known:.3g} %"
        print(f"motion {count}: planned in {seconds:.1f} s, {said}", flush=True)
        if known <= precision and not found.failures:
            break
        numbers = found.parameters, found.covariance, found.combinations
        prior = None if found.failures else TargetPrior("estimate", *numbers)
        planner = following(planner, prior)
    else:
        print(f"not as precise as asked after {MOST_MOTIONS} motions")
    start, end = (transfer.evaluate(at)[0] for at in (0.0, transfer.duration))
    if len(history.ends) % 2:  # every motion returns to where the one before it started
        start, end = end, start
    craft.move(HalfCosine(start, end, transfer.duration), history)
    return craft, history, target


def draw(craft: Craft, history: History, precision: float, path: Path) -> None:
    """Draw σ and the joint errors over time."""
    title = "Largest σ of the ten parameters; dashed: asked for"
    above = new_figure(title, "", "% of scale", height=300)
    above.add_scatter(x=history.time, y=100 * np.array(history.sigma), mode="lines+markers")
    above.add_hline(100 * precision, line={"color": COLORS[1], "dash": "dash"})
    times, error = craft.tracking_error()
    below = new_figure("Largest tracking error of the joints", "time [s]", "rad", height=300)
    below.add_scatter(x=times[1:], y=error[1:])
    for figure in (above, below):
        figure.update_yaxes(type="log", exponentformat="power")
        figure.update_xaxes(range=[0.0, times[-1]])
        for end in history.ends[:-1]:
            figure.add_vline(end, line={"color": INK, "width": 1})
    section = Section("Errors", figures=[above, below], columns=1)
    Report("Plan, identify, replan", "", [section]).write(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensors", default="coarse", help="a sensor preset or a file")
    parser.add_argument("--precision", type=float, default=0.15, help="largest σ [%% of scale]")
    parser.add_argument("--seed", type=int, default=1, help="of the target and the sensors' errors")
    parser.add_argument(
        "--figure", metavar="FILE", help="draw σ and tracking errors as an HTML page"
    )
    args = parser.parse_args()
    if not args.precision > 0:
        parser.exit(2, f"{parser.prog}: error: --precision must be > 0\n")
    if args.seed < 0:
        parser.exit(2, f"{parser.prog}: error: --seed must be ≥ 0\n")
    if args.figure and (Path(args.figure).is_dir() or not Path(args.figure).parent.is_dir()):
        parser.exit(2, f"{parser.prog}: error: {args.figure}: not a file in a folder\n")
    scenario = load_scenario(shipped_scenario("paper"))
    precision = args.precision / 100
    try:
        craft, history, target = run(
            scenario, load_sensors(args.sensors, unstated="exact"), precision, args.seed
        )
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")

    found = craft.estimate()
    error = (found.parameters - target.to_vector()) / parameter_scale(target.to_vector())
    print(f"largest error: {100 * np.abs(error).max():.2g} % of scale")
    times, tracking = craft.tracking_error()
    model = craft.logged("model")[1][:, 0]
    known = times[model != model[0]]
    if known.size:
        before = tracking[times < known[0]].max()
        after = tracking[times > history.ends[-2]].max()
        print(
            f"largest tracking error until {known[0]:.2f} s, without the estimate: {before:.1e} rad"
        )
        print(f"largest tracking error in the transfer, with the estimate: {after:.1e} rad")
    print(found.explain())
    if args.figure:
        draw(craft, history, precision, Path(args.figure))


if __name__ == "__main__":
    main()
