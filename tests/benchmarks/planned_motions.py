"""Figures of planned motions: against the scenario's motion, random motions, and other targets.

    python tests/benchmarks/planned_motions.py SCENARIO MOTION.yaml [--targets N] [--draws 1000]

The true target of the scenario, which the planner does not know, is used here for the comparison.
"""

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.planning.base_limits import BaseAttitude, BaseDisplacement, BaseRate
from cpid_drake.planning.efforts import JointEfforts
from cpid_drake.planning.objective import Objective, PlausibleTarget
from cpid_drake.planning.plan_options import PlanOptions
from cpid_drake.planning.plan_problem import PlanProblem
from cpid_drake.planning.search import candidates, ranked, refined
from cpid_drake.resources import find_scenario
from cpid_drake.scenario.files import load_scenario
from cpid_drake.scenario.joint_motions import MotionFile
from cpid_drake.sensing.presets import load_sensors
from cpid_drake.spacecraft.clearance import Clearance

RANDOM = 1000
SCORED = 10_000


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenario")
    parser.add_argument("motion", type=Path)
    parser.add_argument("--sensors", default="flight")
    parser.add_argument("--targets", type=int, default=0, help="plans made for single targets")
    parser.add_argument("--draws", type=int, default=0, help="targets in Drake's plant")
    parser.add_argument("--clearance", type=float, default=0.05, help="of the plan [m]")
    parser.add_argument("--only-draws", action="store_true", help="no other figures")
    arguments = parser.parse_args()
    scenario = load_scenario(find_scenario(arguments.scenario))
    options = PlanOptions(frequency=0.4, jobs=os.cpu_count() or 1)
    problem = PlanProblem(scenario, load_sensors(arguments.sensors), options)
    motion = MotionFile(str(arguments.motion)).make(problem.spacecraft, {})
    if arguments.draws:
        check_draws(problem, motion, arguments.draws, arguments.clearance)
    if arguments.only_draws:
        return
    truth = scenario.target_truth().to_vector()
    known = replace(problem.objective, targets=(PlausibleTarget(truth),))

    def exact(each) -> float:
        return problem.setting.predict(each, truth).worst

    own, plan = exact(problem.own_motion), exact(motion)
    print(f"worst σ, % of scale: own motion {100 * own:.3g}, plan {100 * plan:.3g}")
    print(f"  own motion / plan: {own / plan:.3g}")
    start = time.perf_counter()
    best = ranked(known, candidates(problem.limited, RANDOM, 7), 1)[0]
    random = exact(problem.motion(best))
    print(f"  best of {RANDOM} random motions / plan: {random / plan:.3g}")
    start = time.perf_counter()
    ranked(known, candidates(problem.limited, SCORED, 8), options.jobs)
    print(f"{SCORED} candidates scored in {time.perf_counter() - start:.1f} s, {options.jobs} jobs")
    if arguments.targets:
        compare_targets(problem, motion, arguments.targets)


def check_draws(problem: PlanProblem, motion, count: int, clearance: float) -> None:
    """Print what a motion needs in Drake's plant with many targets, and how many exceed a limit.

    Positions, rates and distances are the same for all targets, which have the scenario's shape.
    """
    setting, craft = problem.setting, problem.spacecraft
    drawn = problem.plausible(count, 51)
    limits = craft.limits
    times = np.linspace(0.0, motion.duration, int(motion.duration / 0.02) + 1)
    q, qdot, _ = np.moveaxis(motion.evaluate(times), 1, 0)
    inside = bool((q >= limits.lowest).all() and (q <= limits.highest).all())
    print(f"positions within their limits: {inside}")
    print(f"largest share of a rate's limit: {(np.abs(qdot) / limits.rates).max():.3g}")
    first = InertialParameters.from_vector(drawn[0].parameters)
    shapes = Clearance(craft, first, problem.scenario.target.visual_model)
    [closest] = shapes.approaches(q)[:1]
    print(
        f"smallest distance at {len(times)} instants: {closest.distance:.3g} m between "
        f"{' and '.join(closest.bodies)}; asked: {clearance:g} m"
    )
    shares, base = np.zeros(count), np.zeros((count, 3))
    for k, target in enumerate(drawn):
        efforts = setting.largest_efforts(motion, target.parameters[None])[0]
        shares[k] = (efforts / limits.efforts).max()
        moved = setting.telemetry(motion, target.parameters, times)
        base[k] = [
            each(problem.objective, 1.0).measured(moved)
            for each in (BaseAttitude, BaseRate, BaseDisplacement)
        ]
        if (k + 1) % 100 == 0:
            print(f"  {k + 1} targets, largest share of a torque {shares.max():.3g}", flush=True)
    over = int(np.sum(shares > 1))
    print(f"torques too large for {over} of {count} targets; largest share {shares.max():.3g}")
    angle, rate, shift = base.max(axis=0)
    print(
        f"base, all targets: turn {np.degrees(angle):.4g} deg, rate {np.degrees(rate):.4g} deg/s, "
        f"displacement {shift:.4g} m"
    )


def compare_targets(problem: PlanProblem, motion, count: int) -> None:
    """Print how much better plans are that are made with the truth of a target from the range.

    A plan for one target keeps the limits of torques with this target only.
    """
    drawn = problem.plausible(count, 50)
    limits = problem.spacecraft.limits.efforts
    at_nodes = motion.evaluate(problem.objective.model.times)[:, None, :2]
    ratios = []
    for target in drawn:
        known: Objective = replace(problem.objective, targets=(target,))
        constraints = [*problem.geometric, JointEfforts(known, np.arange(limits.size), limits)]
        order = ranked(known, candidates(problem.limited, 500, 9), 1)
        kept = next(
            each
            for each in order
            if all(one.values(each.parameters).min() >= 0 for one in constraints)
        )
        found = refined(known, problem.limited, constraints, kept, 60)
        robust = np.sqrt(np.diag(known.covariances(at_nodes)[0, 0]).max())
        ratios.append(robust / found[0].score)
        print(f"  target of {target.parameters[0]:.0f} kg: {ratios[-1]:.2f}", flush=True)
    print(
        f"robust plan / plan for the target: worst {max(ratios):.3g}, mean {np.mean(ratios):.3g}, "
        f"{sum(ratio > 3 for ratio in ratios)} of {count} targets above 3"
    )


if __name__ == "__main__":
    main()
