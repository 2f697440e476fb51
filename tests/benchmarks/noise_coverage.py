#!/usr/bin/env python3
"""Measure whether 95 % intervals hold if the noise is not as the sensors are said to have it.

Every trial adds noise of one kind to all sensors of a simulated log, and fits the target with the
nominal sensors. One row for each kind: trials, doubted answers, the share of the intervals of all
other answers that contain the truth, and the RMS of their errors in σ.
"""

import argparse
import os
import warnings
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from cpid_drake import identify, load_scenario, load_sensors, shipped_scenario
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.studies.trials import ideal_samples, make_case

Array = NDArray[np.float64]


def _coloured(rho: float) -> Callable[[np.random.Generator, tuple[int, int]], Array]:
    def draw(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
        white = rng.standard_normal((shape[0] + 500, shape[1])) * np.sqrt(1 - rho**2)
        return np.asarray(lfilter([1.0], [1.0, -rho], white, axis=0)[500:])

    return draw


KINDS: dict[str, Callable[[np.random.Generator, tuple[int, int]], Array]] = {
    "white": lambda rng, shape: rng.standard_normal(shape),
    "double": lambda rng, shape: 2 * rng.standard_normal(shape),
    "ar0.5": _coloured(0.5),
    "ar0.9": _coloured(0.9),
    "t3": lambda rng, shape: rng.standard_t(3, shape),
}
"""Noise in units of the given σ, by name of the kind."""


def noisy(suite: SensorSuite, ideal: Measurements, kind: str, seed: int) -> Measurements:
    """Return samples with noise of one kind, and a constant bias of the gyro."""
    rng, result = np.random.default_rng([seed, 77]), {}
    for name, samples in ideal.items():
        if name not in suite.present() or not len(samples):
            continue
        width = 3 if name == "attitude" else samples.value.shape[1]
        errors = KINDS[kind](rng, (len(samples), width)) * suite.sigmas(name)
        if name == "attitude":
            R_WB = Rotation.from_quat(samples.value, scalar_first=True)
            turn = Rotation.from_rotvec(errors @ suite[name].R_BS.T)
            value = np.asarray((R_WB * turn).as_quat(scalar_first=True))
        else:
            value = samples.value + errors
        if name == "gyro":
            value = value + suite.gyro.bias_sigma * rng.standard_normal(3)
        result[name] = Samples(samples.time, value)
    return ideal.updated(result)


def main() -> None:
    """Run the trials and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenario", default="exciting_motion")
    parser.add_argument("--sensors", default="flight")
    parser.add_argument("--kinds", default=",".join(KINDS), help="names, by commas")
    parser.add_argument("--trials", type=int, default=40)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    scenario, suite = load_scenario(shipped_scenario(args.scenario)), load_sensors(args.sensors)
    craft, truth = scenario.spacecraft.make(), scenario.target_truth()
    case = make_case(scenario, craft, truth, suite, (), 1)
    ideal = ideal_samples(case, craft.tree, craft.joint_names)
    print(f"{'kind':8}{'trials':>7}{'doubted':>9}{'inside':>8}{'RMS':>6}", flush=True)
    for kind in args.kinds.split(","):
        inside, squares = [], []
        for seed in range(args.trials):
            log = noisy(suite, ideal, kind, seed)
            found = identify(craft, log, sensors=suite, momentum=case.momentum, is_final=False)
            if found.is_trustworthy:
                error = np.abs(found.parameters - truth.to_vector())
                half = np.diff(found.intervals, axis=1)[:, 0] / 2
                inside.append(error <= half)
                squares.append((1.96 * error / half) ** 2)
        doubted, share = args.trials - len(inside), np.mean(inside) if inside else np.nan
        rms = np.sqrt(np.mean(squares)) if squares else np.nan
        print(f"{kind:8}{args.trials:7}{doubted:9}{share:8.3f}{rms:6.2f}", flush=True)


if __name__ == "__main__":
    main()
