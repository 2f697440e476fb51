#!/usr/bin/env python3
"""Time the online fit for one second of samples of all sensors of a suite.

The fit has seen five seconds of the exciting motion by the flight suite, and solves one block after
the other. The next three seconds follow, block by block; no sample may be left out.

- reference: QR factorization of a fixed matrix of 400 rows and 100 columns, about as large as that
  of one linearization of a block.
- collecting: a simulation of a second in which a `SensorIdentifier` receives a sample of every
  sensor 100 times, and no block is complete.

Times are medians over interleaved rounds, so that all see the same machine.
"""

import argparse
import cProfile
import json
import pstats
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from scipy.linalg import qr

from cpid_drake import (
    Motion,
    SensorIdentifier,
    SensorSuite,
    Spacecraft,
    load_scenario,
    load_sensors,
    shipped_scenario,
)
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.estimation.block import BlockQueue, blocks_of
from cpid_drake.estimation.online import OnlineState, step
from cpid_drake.estimation.unknowns import Model
from cpid_drake.logs.log import ideal_log
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import SENSORS

SEEN, BLOCKS = 5.0, 3


class Clock(LeafSystem):
    """Sensors that have a new sample at every instant."""

    def __init__(self, widths: dict[str, int]) -> None:
        super().__init__()
        for name, width in widths.items():
            value = np.eye(width)[0]

            def calc(context: Context, output: BasicVector, value: np.ndarray = value) -> None:
                output.SetFromVector([context.get_time(), *value])

            self.DeclareVectorOutputPort(name, 1 + width, calc)


def collector(spacecraft: Spacecraft, suite: SensorSuite) -> Simulator:
    """Return a simulator of an identifier with a new sample of every sensor in each period."""
    builder = DiagramBuilder()
    joints = len(spacecraft.joint_names)
    clock = builder.AddSystem(Clock({n: SENSORS[n].width_of(joints) for n in suite.present()}))
    samples = {name: clock.GetOutputPort(name) for name in suite.present()}
    SensorIdentifier.AddToBuilder(builder, spacecraft, **samples, suite=suite)
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    return simulator


def milliseconds(work: Callable[[], object]) -> float:
    """Return the time that a call takes [ms]."""
    begin = time.perf_counter()
    work()
    return (time.perf_counter() - begin) * 1e3


def main() -> None:
    """Check that all samples are used, time the blocks and print the result as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=31)
    parser.add_argument("--profile", action="store_true", help="print where the time goes instead")
    args = parser.parse_args()

    scenario, suite = load_scenario(shipped_scenario("exciting_motion")), load_sensors("flight")
    spacecraft, target = scenario.spacecraft.make(), scenario.target_truth()
    arms = scenario.make_joint_motion(spacecraft)

    def motion(times: np.ndarray) -> Motion:
        base = propagate(spacecraft.tree, arms, target.to_standard_vector(), times)
        return base.to_motion(spacecraft.joint_names, times, arms)

    end = SEEN + BLOCKS
    ideal = ideal_log(suite, spacecraft.joint_names, motion, end)
    samples = add_noise(suite, ideal, seed=1)
    model = Model(spacecraft.tree, suite)
    blocks = list(blocks_of(BlockQueue.of(suite), [samples]))
    states, beginning = [OnlineState()], []
    for each in blocks:
        start = time.perf_counter()
        states.append(step(model, states[-1], each))
        beginning.append((time.perf_counter() - start) * 1e3)
    blocks, states = blocks[-BLOCKS:], states[-BLOCKS - 1 :]
    used = [sum(state.used.values()) for state in (states[0], states[-1])]
    given = sum(len(s) for each in blocks for _, s in each.samples.items())
    if states[0].window or used[1] - used[0] != given:
        raise SystemExit("the fit does not solve every block on its own")
    if any(states[-1].rejected.values()) or states[-1].events:
        raise SystemExit("samples were left out, or a change of momentum was found")

    def block(k: int) -> Callable[[], object]:
        return lambda: step(model, states[k], blocks[k])

    if args.profile:
        profile = cProfile.Profile()
        for k in [*range(BLOCKS)] * args.rounds:
            profile.runcall(block(k))
        pstats.Stats(profile, stream=sys.stdout).sort_stats("tottime").print_stats(25)
        return

    matrix = np.random.default_rng(0).normal(size=(400, 100))
    times, reference, collecting = [[] for _ in range(BLOCKS)], [], []
    for _ in range(args.rounds):
        for k, record in enumerate(times):
            record.append(milliseconds(block(k)))
            reference.append(milliseconds(lambda: qr(matrix, mode="r")))
        simulator = collector(spacecraft, suite)
        collecting.append(milliseconds(lambda: simulator.AdvanceTo(0.9)))  # noqa: B023
    each = [statistics.median(record) for record in times]
    one, factorization = statistics.median(each), statistics.median(reference)
    report = {
        "block_milliseconds": round(one, 2),
        "worst_block_milliseconds": round(max(each), 2),
        "worst_at_the_beginning_milliseconds": round(max(beginning), 2),
        "factorization_milliseconds": round(factorization, 3),
        "block_over_factorization": round(one / factorization, 1),
        "collecting_milliseconds": round(statistics.median(collecting) / 0.9, 2),
    }
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
