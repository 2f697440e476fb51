#!/usr/bin/env python3
"""Time what users wait for, and print the medians as JSON.

- An update of `MomentumIdentifier`: the estimate's alone, and as an event of a Diagram.
- A block, about a second, of all samples of the flight suite in the recursive fit: once it is
  converged, and the longest from the start.
- Ten seconds of the paper's motion: propagated for 300 targets at once, and simulated.
- The replay of that motion, and help of the command line in a new interpreter.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from cpid_drake import MomentumIdentifier, Motion, load_scenario, load_sensors, make_simulation
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.estimation.block import BlockQueue, blocks_of
from cpid_drake.estimation.least_squares import updated_information
from cpid_drake.estimation.online import OnlineState, step
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.resources import find_scenario
from cpid_drake.logs.log import ideal_log
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.report.replay import replay_html

TARGETS, SEEN, BLOCKS = 300, 5.0, 3


def seconds(work: Callable[[], object], calls: int = 1) -> float:
    """Return the time of a call [s]."""
    start = time.perf_counter()
    for _ in range(calls):
        work()
    return (time.perf_counter() - start) / calls


def main() -> None:
    """Time everything several times in turn, so that all see the same machine."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds

    scenario = load_scenario(find_scenario("paper"))
    scenario.simulation.simulator.accuracy = 3e-11
    simulation = make_simulation(scenario)
    craft, arms, truth = simulation.spacecraft, simulation.joint_motion, simulation.truth
    context = simulation.run()
    motion, found = simulation.motion(context), simulation.identification(context)
    phi = np.tile(truth.to_standard_vector(), (TARGETS, 1))
    again = propagate(craft.tree, arms, phi, motion.time).p_WB[0]
    np.testing.assert_allclose(again, motion.p_WB, rtol=0, atol=1e-7)

    identifier, state = MomentumIdentifier(craft), craft.to_states(motion.select([-40]))[0]
    event_context = identifier.CreateDefaultContext()
    identifier.GetInputPort("state").FixValue(event_context, state)
    root = updated_information(np.zeros((11, 11)), identifier.rows(state))

    def event() -> None:
        event_context.SetTime(event_context.get_time() + 1.0)  # else Drake answers from its cache
        identifier.EvalUniquePeriodicDiscreteUpdate(event_context)

    suite = load_sensors("flight", unstated="exact")
    model = Model.of(craft.tree, suite)
    exciting = load_scenario(find_scenario("exciting_motion")).make_joint_motion(craft)

    def moved(times: np.ndarray) -> Motion:
        base = propagate(craft.tree, exciting, phi[0], times)
        return base.to_motion(craft.joint_names, times, exciting)

    log = add_noise(suite, ideal_log(suite, craft.joint_names, moved, SEEN + BLOCKS), seed=1)
    blocks, states, beginning = [*blocks_of(BlockQueue.of(suite), [log])], [OnlineState()], []
    for block in blocks:
        beginning.append(seconds(lambda: states.append(step(model, states[-1], block))))  # noqa: B023
    if states[-1].waiting or states[-1].found.logs[0].past is None:
        raise SystemExit("no block has left the window")

    help_of = [sys.executable, "-m", "cpid_drake", "identify", "--help"]
    works = {
        "update_microseconds": (
            lambda: updated_information(root, identifier.rows(state)), 500, 1e6),
        "update_as_event_microseconds": (event, 500, 1e6),
        "block_milliseconds": (partial(step, model, states[-2], blocks[-1]), 3, 1e3),
        "propagation_of_a_motion_milliseconds": (
            partial(propagate, craft.tree, arms, phi, np.arange(11.0)), 1, 1e3 / TARGETS),
        "simulation_seconds": (simulation.run, 1, 1),
        "replay_seconds": (
            lambda: replay_html(craft, motion, [(motion.time[-1], found)], truth=truth), 1, 1),
        "help_seconds": (partial(subprocess.run, help_of, capture_output=True, check=True), 1, 1),
    }  # fmt: skip
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, (work, calls, unit) in works.items():
            times[name].append(unit * seconds(work, calls))
    report = {name: float(f"{statistics.median(each):.3g}") for name, each in times.items()}
    report["longest_block_from_the_start_milliseconds"] = float(f"{1e3 * max(beginning):.3g}")
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
