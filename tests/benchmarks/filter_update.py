#!/usr/bin/env python3
"""Time one momentum filter update with all sensors against one least-squares update.

The filter has seen 2.9 s of the exciting motion by the flight suite, and runs alone. Ten updates
follow, one every 20 ms: two samples of the encoders and one each of gyro, attitude and position, of
which none may be rejected. In every fifth the filter computes anew what errors of the encoders do,
so the worst of the ten is given as well.

- reference: `MomentumIdentifier.update` on a state of the same motion: one sample, six rows (see
  identifier_update.py for how that compares with Pinocchio).

Times are medians over interleaved blocks, so that both see the same machine.
"""

import argparse
import cProfile
import json
import pstats
import statistics
import sys
import time

import numpy as np

from cpid_drake import MomentumIdentifier, Telemetry, load_scenario, load_sensors, shipped_scenario
from cpid_drake.dynamics.base_motion import propagate_base
from cpid_drake.estimation.momentum_filter import FilterState, MomentumFilter
from cpid_drake.estimation.online import OnlineEstimator, in_order
from cpid_drake.estimation.square_root import empty_information
from cpid_drake.identification.filter_estimator import online_estimator
from cpid_drake.sensing.measurements import Measurements, ideal_measurements
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.sensors import SENSORS

Sample = tuple[str, float, np.ndarray]
UPDATE = ("encoders", "gyro", "attitude", "encoders", "position")
PERIOD = 0.02


def copied(state: FilterState) -> FilterState:
    """Return a copy of a filter's state."""
    return FilterState(**{name: value.copy() for name, value in vars(state).items()})


def process(momentum_filter: MomentumFilter, state: FilterState, samples: list[Sample]) -> None:
    """Take samples in, in place."""
    for name, stamp, value in samples:
        momentum_filter.process(state, name, stamp, value)


def filtering(
    online: OnlineEstimator, measurements: Measurements, earliest: float
) -> tuple[FilterState, float]:
    """Return the filter's state and its time, when it runs alone and no encoder sample waits."""
    state = online.start()
    for name, stamp, value in in_order(measurements):
        online.process(state, name, stamp, value)
        ready = name == "encoders" and stamp == state.filter.joints[0, 0]
        if ready and stamp >= earliest and not state.initializing:
            return state.filter, stamp
    raise SystemExit("the filter does not run alone yet")


def ten_updates(start: float, motion) -> list[list[Sample]]:
    """Return the samples of ten updates after `start`, without errors."""
    updates = []
    for k in range(10):
        ends = start + k * PERIOD + np.array([PERIOD / 2, PERIOD])
        instants = [ends[0], *4 * [ends[1]]]
        telemetry = motion(np.array(instants[:2]))
        samples = [
            SENSORS[name].quantity.ideal(telemetry)[int(i > 0)] for i, name in enumerate(UPDATE)
        ]
        updates.append(list(zip(UPDATE, instants, samples, strict=True)))
    return updates


def main() -> None:
    """Check that all samples are used, time the updates and print the result as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blocks", type=int, default=201)
    parser.add_argument("--profile", action="store_true", help="print where the time goes instead")
    args = parser.parse_args()

    scenario = load_scenario(shipped_scenario("exciting_motion"))
    suite = load_sensors("flight")
    spacecraft, target = scenario.spacecraft.make(), scenario.target_truth()
    arms = scenario.make_joint_motion(spacecraft)

    def motion(times: np.ndarray) -> Telemetry:
        t = np.concatenate([[0.0], times[times > 0]])  # the motion starts at the first of them
        base = propagate_base(spacecraft.tree, arms, target.to_standard_vector(), t)
        telemetry = base.to_telemetry(spacecraft.joint_names, t, arms)
        return telemetry.select(slice(-len(times), None))

    perfect = ideal_measurements(suite, spacecraft.joint_names, motion, 3.0)
    online = online_estimator(spacecraft, suite)
    momentum_filter = online.filter
    state, start = filtering(online, add_noise(suite, perfect, seed=1), 2.9)
    updates = ten_updates(start, motion)
    states = []
    for samples in updates:
        states.append(copied(state))
        process(momentum_filter, state, samples)
    names = (*set(UPDATE), "agreement")
    for name, wanted in zip(names, [20 if n == "encoders" else 10 for n in names], strict=True):
        k = momentum_filter.index(name)
        used = state.used[k] - states[0].used[k]
        if used != wanted or state.rejected[k] != states[0].rejected[k]:
            raise SystemExit(f"{name}: {used:g} of {wanted} samples used")

    if args.profile:
        profile = cProfile.Profile()
        for _ in range(args.blocks):
            for before, samples in zip(states, updates, strict=True):
                fresh = copied(before)
                profile.runcall(process, momentum_filter, fresh, samples)
        pstats.Stats(profile, stream=sys.stdout).sort_stats("tottime").print_stats(25)
        return

    identifier, root = MomentumIdentifier(spacecraft, rows="standard"), empty_information()
    [sample] = spacecraft.to_states(motion(np.array([start])))
    times, reference = [[] for _ in updates], []
    for _ in range(args.blocks):
        for record, before, samples in zip(times, states, updates, strict=True):
            fresh = copied(before)
            begin = time.perf_counter()
            process(momentum_filter, fresh, samples)
            record.append((time.perf_counter() - begin) * 1e6)
        for _ in updates:
            begin = time.perf_counter()
            identifier.update(root, sample)
            reference.append((time.perf_counter() - begin) * 1e6)
    each = [statistics.median(record) for record in times]
    update, least_squares = statistics.median(each), statistics.median(reference)
    report = {
        "update_microseconds": round(update, 1),
        "worst_update_microseconds": round(max(each), 1),
        "mean_update_microseconds": round(statistics.mean(each), 1),
        "least_squares_update_microseconds": round(least_squares, 1),
        "update_over_least_squares": round(update / least_squares, 2),
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
