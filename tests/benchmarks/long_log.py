#!/usr/bin/env python3
"""Measure time and memory of `cpid identify` on hours of samples of sensors.

The log is made first, part by part: the joints repeat the motion of a scenario, the base moves as
the momentum demands, and every sensor has its noise. A CSV file can be kept for further runs.

The motion repeats exactly, so the rounding errors of the encoders repeat too and do not average
out: over hours the errors of the estimate exceed its σ, which the noise alone determines.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cpid_drake import load_scenario, shipped_scenario
from cpid_drake.dynamics.base_motion import propagate_base
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensing.files.table import table_of
from cpid_drake.sensing.measurements import Measurements, Samples, ideal_measurements
from cpid_drake.sensing.noise import SensorNoise
from cpid_drake.sensing.presets import load_sensors

PART = 60.0
"""Length of the parts in which a log is made [s]."""


class RepeatedMotion:
    """The joint motion of a scenario, again and again; it is at rest at both ends."""

    def __init__(self, scenario: Scenario) -> None:
        self._motion = scenario.make_joint_motion(scenario.spacecraft.make())
        self._duration = scenario.simulation.duration

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        return self._motion.evaluate(np.mod(np.asarray(time, float), self._duration))


class LogMaker:
    """Makes the samples of a suite's sensors in parts that continue each other."""

    def __init__(self, scenario: Scenario, preset: str) -> None:
        self._craft, self._motion = scenario.spacecraft.make(), RepeatedMotion(scenario)
        self._phi = scenario.target_truth().to_standard_vector()
        self._noise = SensorNoise(load_sensors(preset), seed=1)
        self._counts: Counter[str] = Counter()
        self._period: Telemetry | None = None
        self._R_WV, self._p_WV = Rotation.identity(), np.zeros(3)
        self._time = 0.0

    def next_part(self) -> Measurements:
        """Return the samples of the next `PART` seconds."""
        names, suite = self._craft.joint_names, self._noise.suite
        step = 1 / max(sensor.rate for sensor in suite.present().values())
        ideal = ideal_measurements(suite, names, self._states, PART - step / 2)
        samples = {}
        for name in suite.present():
            value = self._noise.apply(name, ideal[name].value, self._counts[name])
            self._counts[name] += len(value)
            samples[name] = Samples(ideal[name].time + self._time, value)
        self._time += PART
        return Measurements(names, samples)

    def _states(self, times: NDArray[np.float64]) -> Telemetry:
        """Return the true motion at times in the part.

        With zero momentum, the motion from V, the base's pose at the start of a part, is the same
        in all parts.
        """
        if self._period is None:
            times = np.append(times, PART)
            base = propagate_base(self._craft.tree, self._motion, self._phi, times, max_step=0.02)
            self._period = base.to_telemetry(self._craft.joint_names, times, self._motion)
        in_V, R = self._period, self._R_WV
        in_W = replace(
            in_V,
            quaternion_WB=(R * _attitude(in_V)).as_quat(scalar_first=True),
            p_WB=self._p_WV + R.apply(in_V.p_WB),
            w_WB=R.apply(in_V.w_WB),
            v_WB=R.apply(in_V.v_WB),
        )
        self._R_WV, self._p_WV = _attitude(in_W)[-1], in_W.p_WB[-1]
        return in_W.select(slice(-1))


def _attitude(telemetry: Telemetry) -> Rotation:
    return Rotation.from_quat(telemetry.quaternion_WB, scalar_first=True)


def make_log(path: Path, scenario: Scenario, preset: str, hours: float) -> None:
    """Write the samples of a preset's sensors to a CSV file."""
    maker = LogMaker(scenario, preset)
    with path.open("w") as file:
        for number in range(round(hours * 3600 / PART)):
            columns, values = table_of(maker.next_part())
            if not number:
                file.write(",".join(columns) + "\n")
            lines = (",".join("" if x != x else repr(x) for x in row) for row in values.tolist())
            file.write("\n".join(lines) + "\n")


def main() -> None:
    """Make the log, run the command on it in another process, and print its costs as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--estimator", default="least_squares")
    parser.add_argument("--scenario", default="exciting_motion")
    parser.add_argument("--sensors", default="flight")
    parser.add_argument("--log", type=Path, help="the log; made if it does not exist, and kept")
    parser.add_argument("--report", type=Path, help="also write a report to this file")
    parser.add_argument("--only-make", action="store_true", help="only make the log")
    args = parser.parse_args()
    scenario = load_scenario(shipped_scenario(args.scenario))
    if args.only_make:
        make_log(args.log, scenario, args.sensors, args.hours)
        return
    with tempfile.TemporaryDirectory() as folder:
        path = args.log or Path(folder) / "log.csv"
        if not path.exists():
            # In a process of its own: a process begins with the peak memory of its parent.
            words = ["--only-make", "--hours", str(args.hours), "--log", str(path)]
            words += ["--scenario", args.scenario, "--sensors", args.sensors]
            subprocess.run([sys.executable, __file__, *words], check=True)
        found = Path(folder) / "found.json"
        craft = scenario.spacecraft
        command = [sys.executable, "-m", "cpid_drake", "identify", str(path)]
        command += ["--spacecraft", str(craft.model), "--base", craft.base]
        command += ["--capture-frame", craft.capture_frame, "--sensors", args.sensors]
        command += ["--estimator", args.estimator, "--json", str(found), "--quiet"]
        command += ["--report", str(args.report)] if args.report else []
        begin = time.perf_counter()
        process = subprocess.Popen(command)
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - begin
        if status:
            sys.exit(f"failed: {shlex.join(command)}")
        result = json.loads(found.read_text())
        megabytes = path.stat().st_size / 1e6
    truth = scenario.target_truth().to_vector()
    estimate = np.array([result["mass"], *result["com"], *result["inertia"]])
    sigma = np.sqrt(np.diag(np.array(result["covariance"], dtype=float)))
    report = {
        "hours": args.hours,
        "log_megabytes": round(megabytes, 1),
        "seconds": round(seconds, 1),
        "cpu_seconds": round(used.ru_utime + used.ru_stime, 1),
        "peak_megabytes": round(used.ru_maxrss / 1024, 1),
        "largest_error_in_sigma": round(float(np.max(np.abs(estimate - truth) / sigma)), 2),
    }
    if args.report:
        report["report_megabytes"] = round(args.report.stat().st_size / 1e6, 2)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
