#!/usr/bin/env python3
"""Time the momentum-consistent propagator against the full simulation of the same motion.

The propagator gets three hundred targets at once, the simulation one; both are the paper's ten
seconds, and the end pose of the one target that they share is compared before anything is timed.
"""

import argparse
import json
import statistics
import time

import numpy as np

from cpid_drake import load_scenario, make_simulation, shipped_scenario
from cpid_drake.dynamics.propagation import propagate


def main() -> None:
    """Check that both agree, time them and print the result as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", type=int, default=300)
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()

    scenario = load_scenario(shipped_scenario("paper"))
    scenario.simulation.simulator.accuracy = 3e-11
    simulation = make_simulation(scenario)
    times = np.arange(0.0, 10.5, 1.0)
    factors = np.random.default_rng(1).uniform(0.9, 1.1, (args.targets, 1))
    factors[0] = 1.0
    phi = factors * simulation.truth.to_standard_vector()
    tree, motion = simulation.spacecraft.tree, simulation.joint_motion

    def run_propagation() -> np.ndarray:
        return propagate(tree, motion, phi, times).p_WB[0, -1]

    def simulate() -> np.ndarray:
        return simulation.motion(simulation.run()).p_WB[-1]

    np.testing.assert_allclose(run_propagation(), simulate(), rtol=0, atol=1e-7)
    seconds = {}
    for name, run in (("propagate", run_propagation), ("simulate", simulate)):
        samples = []
        for _ in range(args.repeats):
            start = time.perf_counter()
            run()
            samples.append(time.perf_counter() - start)
        seconds[name] = statistics.median(samples)
    report = {
        "motions_per_second": round(args.targets / seconds["propagate"], 1),
        "simulations_per_second": round(1 / seconds["simulate"], 2),
    }
    ratio = report["motions_per_second"] / report["simulations_per_second"]
    report["propagator_over_simulation"] = round(ratio, 1)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
