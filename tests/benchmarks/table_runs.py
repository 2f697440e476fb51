#!/usr/bin/env python3
"""Measure several runs of one target on a table out of level: do they agree, do they predict?

Every repetition draws the errors of the sensors once, and for each run the tilt of the table and
the noise. The target is identified from each run alone, and from all together; the joint estimate
then predicts one more run that was not used. Printed are, over all repetitions:

- the share of the 95 % intervals of single runs that contain the joint estimate, and the truth;
- the share of the 95 % intervals of the joint estimate that contain the truth;
- the share of the joint estimates that are doubted, or whose runs contradict each other;
- the error of the predicted yaw over its noise and over its expected size: median and worst.
"""

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from cpid_drake import identify_together, load_scenario, load_sensors, shipped_scenario
from cpid_drake.identification.result import Identification
from cpid_drake.identification.target_prior import Combinations, TargetPrior
from cpid_drake.identification.validation import BEGINNING, validate
from cpid_drake.processes import shared_work
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.noise import add_noise
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.trials import Case, ideal_samples, make_case

UNLIKELY = 1e-3
"""Probability below which the runs of one target are said to contradict each other."""


@dataclass(frozen=True, eq=False)
class Repetition:
    """What one repetition gave: whether intervals hold, and the error of the prediction.

    Attributes:
        joint_in_single: (runs, 4) whether the intervals of a run contain the joint estimate.
        truth_in_single: (runs, 4) whether they contain the truth.
        truth_in_joint: (4,) whether those of the joint estimate do.
        doubts: doubts about the joint estimate.
        probability: of so large differences between the runs.
        yaw_over_noise: error of the predicted attitude over the sensor's noise.
        yaw_in_sigma: the same over its expected size.
        seconds: processor time.

    """

    joint_in_single: NDArray[np.bool_]
    truth_in_single: NDArray[np.bool_]
    truth_in_joint: NDArray[np.bool_]
    doubts: tuple[str, ...]
    probability: float
    yaw_over_noise: float
    yaw_in_sigma: float
    seconds: float


def _repetitions_of(inputs: tuple[Case, int, float]) -> Callable[[int], Repetition]:
    """Return the function that does the repetition of a number."""
    case, runs, beginning = inputs
    return partial(_repetition, case, case.spacecraft.make(), runs, beginning)


def _run(case: Case, spacecraft: Spacecraft, hardware: int, seed: int) -> Measurements:
    disturbance = case.disturbance(seed)
    ideal = ideal_samples(case, spacecraft.tree, spacecraft.joint_names, disturbance)
    return add_noise(case.suite, ideal, seed, hardware)


def _repetition(
    case: Case, spacecraft: Spacecraft, runs: int, beginning: float, number: int
) -> Repetition:
    begin = time.process_time()
    hardware, *seeds = np.random.SeedSequence(case.seed, spawn_key=(number,)).generate_state(
        runs + 2
    )
    *used, unused = (_run(case, spacecraft, int(hardware), int(seed)) for seed in seeds)
    options = {"sensors": case.suite, "momentum": case.momentum, "planar": True}
    found = identify_together(spacecraft, dict(zip("abcdefgh", used)), **options)
    assert found.joint is not None
    truth, known = case.truth.to_vector(), np.isfinite(found.parameters)
    separate = [each.intervals[known] for each in found.joint.logs]
    prediction = validate(spacecraft, _prior(found), unused, beginning=beginning, **options)
    yaw = next(each for each in prediction.errors if each.sensor == "attitude")
    return Repetition(
        np.array([_inside(found.parameters[known], each) for each in separate]),
        np.array([_inside(truth[known], each) for each in separate]),
        _inside(truth[known], found.intervals[known]),
        found.doubts,
        found.joint.probability,
        yaw.rms / yaw.noise,
        yaw.in_sigma,
        time.process_time() - begin,
    )


def _inside(value: NDArray[np.float64], intervals: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (intervals[:, 0] <= value) & (value <= intervals[:, 1])


def _prior(found: Identification) -> TargetPrior:
    """Return what an identification on a table knows."""
    solution = found.solution
    known = Combinations(found.parameterization.name, solution.values, solution.information)
    return TargetPrior("the other runs", found.parameters, found.covariance, known)


def main() -> None:
    """Run the repetitions and print the figures."""
    args = _arguments()
    scenario = load_scenario(shipped_scenario("air_bearing"))
    craft, target = scenario.spacecraft.make(), scenario.target_truth()
    suite = load_sensors("air_bearing")
    case = make_case(scenario, craft, target, suite, (), args.seed)
    case = replace(case, torque_W=None, acceleration_W=None)  # every run has its own
    inputs = case, args.runs, args.beginning
    done = list(shared_work(_repetitions_of, inputs, range(args.repetitions), args.jobs))
    for name in ("joint_in_single", "truth_in_single", "truth_in_joint"):
        share = np.mean(np.concatenate([np.ravel(getattr(each, name)) for each in done]))
        print(f"{name:16} {100 * share:.1f} %")
    doubted = [each for each in done if each.doubts]
    print(f"doubted {len(doubted)}, contradicting {sum(r.probability < UNLIKELY for r in done)}")
    for text in sorted({each.doubts[0][:120] for each in doubted}):
        print(f"  {text}")
    for name in ("yaw_over_noise", "yaw_in_sigma", "seconds"):
        values = np.array([getattr(each, name) for each in done])
        print(f"{name:16} median {np.median(values):.2f}, worst {values.max():.2f}")
    share = np.mean([each.yaw_over_noise <= 2 for each in done])
    print(f"yaw at most twice its noise: {100 * share:.0f} %")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--runs", type=int, default=4, help="runs of one target, at most 8")
    parser.add_argument("--seed", type=int, default=2023)
    parser.add_argument(
        "--beginning",
        type=float,
        default=BEGINNING,
        help="share of the unused run that shows its start and its forces",
    )
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    return parser.parse_args()


if __name__ == "__main__":
    main()
