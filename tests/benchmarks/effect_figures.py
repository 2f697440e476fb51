#!/usr/bin/env python3
"""Measure the fit with errors of sensors and external forces, one at a time and all at once.

Each trial draws the size of the effect from a normal distribution, then the noise. Two modes:

- declared: the fit knows the effect's σ. One row for each effect: RMSE over the Cramér-Rao bound
  that includes the effect (worst and mean over the ten parameters), share of the 95 % intervals
  that contain the truth, mean normalized error squared (10 is right), processor time.
- hidden (`--hidden`): the fit does not know the effect. One row for each effect: trials whose
  answer is doubted; trials in which the effect is named, by the search for undeclared errors or
  by the refusal of the log; share of the intervals that contain the truth, of the trials that are
  not doubted; the same of all trials; processor time.

`--size` multiplies the σ from which the true effect is drawn, but not the declared one.
"""

import argparse
import json
import os
import time
import warnings
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cpid_drake import load_scenario, load_sensors, shipped_scenario
from cpid_drake.errors import InputError
from cpid_drake.estimation.intervals import quantile_95
from cpid_drake.identification.identify import identify
from cpid_drake.identification.result import Identification
from cpid_drake.identification.undeclared import ACCELERATION, PLAUSIBLE, TORQUE
from cpid_drake.processes import shared_work
from cpid_drake.sensing.disturbances import Disturbances
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.trials import Case, bound_of, draw, ideal_samples, make_case

SENSOR_ERRORS = {
    "attitude.delay": "delay_ms",
    "gyro.delay": "delay_ms",
    "position.delay": "delay_ms",
    "encoders.delay": "delay_ms",
    "attitude.mounting": "mounting_arcsec",
    "gyro.scale": "scale_ppm",
    "gyro.misalignment": "misalignment_arcsec",
    "position.lever_arm": "lever_arm_mm",
    "encoders.zero": "zero_mrad",
}
REFUSALS = {"position.lever_arm": "seems to be that of the point"}
"""Words of a refusal that name an effect."""

FORCES = {"acceleration": ACCELERATION, "torque": TORQUE}
EFFECTS = ("none", *SENSOR_ERRORS, *FORCES, "all")


@dataclass(frozen=True, eq=False)
class Trial:
    """What one trial gave: error and covariance, or the reason of a failure."""

    error: np.ndarray
    covariance: np.ndarray
    seconds: float
    problem: str = ""
    is_doubted: bool = False
    named: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Job:
    """The inputs of all trials: `known` are the sensors that the fit is told."""

    case: Case
    known: SensorSuite
    hidden: bool


def with_effect(sensors: SensorSuite, effect: str, size: float) -> SensorSuite:
    """Return sensors with an effect of `size` times its usual σ."""
    result = deepcopy(sensors)
    for name in EFFECTS[1:-1] if effect == "all" else (effect,):
        sensor, _, _ = name.partition(".")
        if name in SENSOR_ERRORS:
            field = SENSOR_ERRORS[name]
            setattr(getattr(result, sensor), field, size * PLAUSIBLE[field])
        elif name in FORCES:
            old = result.disturbances or Disturbances()
            result.disturbances = replace(old, **{name: size * FORCES[name]})
    return result


def job_of(scenario_name: str, preset: str, effect: str, size: float, hidden: bool) -> Job:
    """Return the job of one effect."""
    scenario = load_scenario(shipped_scenario(scenario_name))
    plain = load_sensors(preset)
    true = with_effect(plain, effect, size)
    craft, target = scenario.spacecraft.make(), scenario.target_truth()
    case = make_case(scenario, craft, target, true, (), 7)
    return Job(case, plain if hidden else with_effect(plain, effect, 1.0), hidden)


def _trials_of(job: Job) -> Callable[[int], Trial]:
    """Return the function that does the trial of a number."""
    spacecraft = job.case.spacecraft.make()
    ideal = ideal_samples(job.case, spacecraft.tree, spacecraft.joint_names)
    return partial(_trial, job, spacecraft, ideal)


def _trial(job: Job, spacecraft: Spacecraft, ideal: Measurements, number: int) -> Trial:
    samples = draw(job.case, spacecraft, ideal, number)
    begin = time.process_time()
    nothing = np.full(10, np.nan), np.full((10, 10), np.nan)
    try:
        found: Identification = identify(
            spacecraft,
            samples,
            estimator="trajectory_fit",
            sensors=job.known,
            momentum=job.case.momentum,
            known_bodies=job.case.known_bodies,
            is_final=job.hidden,
        )
    except InputError as error:
        return Trial(*nothing, time.process_time() - begin, str(error), True)
    effects = () if found.undeclared is None else found.undeclared.effects
    return Trial(
        found.parameters - job.case.truth.to_vector(),
        found.covariance,
        time.process_time() - begin,
        "" if found.converged else "did not converge",
        bool(found.doubts),
        tuple(each.name for each in effects),
    )


def coverage(trials: list[Trial]) -> float:
    """Return the share of the 95 % intervals that contain the truth; NaN without intervals."""
    inside = [
        np.abs(t.error) <= quantile_95() * np.sqrt(np.diag(t.covariance))
        for t in trials
        if not t.problem
    ]
    return float(np.mean(inside)) if inside else np.nan


def of_declared(job: Job, trials: list[Trial]) -> dict[str, float]:
    """Return the figures of a declared effect."""
    spacecraft = job.case.spacecraft.make()
    case = replace(job.case, suite=job.known)
    ideal = ideal_samples(case, spacecraft.tree, spacecraft.joint_names)
    bound = bound_of(case, spacecraft, ideal)
    good = [t for t in trials if not t.problem]
    ratio = np.sqrt(np.mean([t.error**2 for t in good], axis=0)) / bound
    nees = [t.error @ np.linalg.solve(t.covariance, t.error) for t in good]
    return {
        "failed": len(trials) - len(good),
        "worst_ratio": float(ratio.max()),
        "mean_ratio": float(ratio.mean()),
        "coverage": coverage(good),
        "nees": float(np.mean(nees)),
    }


def of_hidden(effect: str, trials: list[Trial]) -> dict[str, float]:
    """Return the figures of an effect that the fit does not know.

    Where nothing is hidden, what is named is a false alarm.
    """
    trusted = [t for t in trials if not t.is_doubted]
    if effect == "none":
        named = [bool(t.named) for t in trials]
    else:
        hidden = set(EFFECTS[1:-1]) if effect == "all" else {effect}
        named = [
            bool(hidden & set(t.named)) or REFUSALS.get(effect, "\n") in t.problem for t in trials
        ]
    return {
        "doubted": len(trials) - len(trusted),
        "named": float(np.mean(named)),
        "coverage_if_trusted": coverage(trusted),
        "coverage": coverage(trials),
    }


def main() -> None:
    """Run the effects, print the table and write it as JSON."""
    args = _arguments()
    warnings.simplefilter("ignore")
    rows = []
    for effect in args.effect or EFFECTS:
        job = job_of(args.scenario, args.sensors, effect, args.size, args.hidden)
        trials = list(shared_work(_trials_of, job, range(args.trials), args.jobs))
        figures = of_hidden(effect, trials) if args.hidden else of_declared(job, trials)
        seconds = float(np.mean([t.seconds for t in trials]))
        rows.append({"effect": effect, "trials": len(trials), **figures, "seconds": seconds})
        cells = [f"{k} {v:.3g}" for k, v in rows[-1].items() if k != "effect"]
        print(f"{effect:20} {', '.join(cells)}", flush=True)
        if args.out is not None:
            args.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenario", default="exciting_motion")
    parser.add_argument("--sensors", default="flight", help="preset or file of the sensors")
    parser.add_argument("--effect", action="append", choices=EFFECTS, help="may be repeated")
    parser.add_argument("--size", type=float, default=1.0, help="true σ over declared σ")
    parser.add_argument("--hidden", action="store_true", help="the fit does not know the effect")
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--out", type=Path, help="JSON file of the rows")
    return parser.parse_args()


if __name__ == "__main__":
    main()
