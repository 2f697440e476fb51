#!/usr/bin/env python3
"""A step of `OnlineIdentifier` after half an hour beside one after a minute: its cost and memory.

It fails if a figure is larger in the last minute than in the second by more than its factor. The
median second counts: one in which a change of momentum is sought costs seven times as much, when
ever it comes. Means are shown.
"""

import argparse
import gc
import pickle
import statistics
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import groupby

from benchmark import CALLS, DRAKE, counted, drakes_calls, rounded, scenario_of, seconds

import cpid_drake as cpid
from cpid_drake.logs.log import ideal_log
from cpid_drake.logs.simulated_noise import add_noise

RATE = 20.0
"""Rate of gyro and encoders [Hz]; position and attitude have those of the preset `flight`."""

LENGTH, BLOCKS = "pickled length [bytes]", "blocks of memory"
"""What there is after a second of data: of the identifier, and of the whole interpreter."""

FACTORS = {DRAKE: 1.5, CALLS: 1.1, LENGTH: 1.1, BLOCKS: 1.01}
"""How much larger a figure may be in the last minute than in the second."""

Minutes = dict[str, tuple[list[float], list[float]]]
"""Figures of the seconds of the second and of the last minute."""


def log_of(minutes: int) -> tuple[cpid.Spacecraft, cpid.SensorSuite, cpid.Log]:
    """Return 12 joints that move on, their sensors, and their samples."""
    scenario, duration = scenario_of("exciting_motion"), 60.0 * minutes
    craft, truth = scenario.spacecraft.make(), scenario.target_truth()
    suite = cpid.load_sensors("flight", unstated="exact")
    assert suite.gyro
    assert suite.encoders
    gyro, encoders = replace(suite.gyro, rate=RATE), replace(suite.encoders, rate=RATE)
    suite = replace(suite, gyro=gyro, encoders=encoders)
    joints = replace(scenario.make_joint_motion(craft), duration=duration + 4.0)
    moved = partial(craft.predicted_motion, truth, joints)
    return craft, suite, add_noise(suite, ideal_log(suite, craft.joint_names, moved, duration), 1)


def measured(minutes: int) -> Minutes:
    """Return the figures: times of even seconds, and calls of odd ones, as counting takes time."""
    craft, suite, log = log_of(minutes)
    identifier, (reference, calls) = cpid.OnlineIdentifier(craft, suite), drakes_calls()
    found: Minutes = {figure: ([], []) for figure in FACTORS}

    def add(samples: list[tuple]) -> None:
        for sample in samples:
            identifier.add(*sample)

    for second, messages in groupby(log.messages(), lambda message: int(message[1])):
        work = partial(add, list(messages))
        if second // 60 not in (1, minutes - 1):
            work()
            continue
        of = int(second // 60 == minutes - 1)
        if second % 2:
            found[CALLS][of].append(counted("", work)["", CALLS])
        else:
            found[DRAKE][of].append(seconds(work) / (seconds(reference) / calls))
        gc.collect()
        found[LENGTH][of].append(len(pickle.dumps(identifier)))
        found[BLOCKS][of].append(sys.getallocatedblocks())
    return found


def growth(found: Minutes) -> Iterator[tuple[str, bool]]:
    """Yield a line for each figure, and whether it has grown too much."""
    for figure, both in found.items():
        early, late = map(statistics.median, both)
        shown = [rounded(value, 4) for value in (early, late, *map(statistics.mean, both))]
        text = "{}: {}, then {} (means {}, {}); limit: {} times as much"
        is_grown = not 0 < late <= FACTORS[figure] * early
        yield text.format(figure, *shown, FACTORS[figure]), is_grown


def main() -> None:
    """Measure, print and judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=int, default=30, help="of data, 3 or more")
    minutes = parser.parse_args().minutes
    if minutes < 3:
        parser.error("--minutes must be 3 or more")
    print(f"A second of data in the second minute, then in minute {minutes}")
    lines = list(growth(measured(minutes)))
    print(*(line for line, _ in lines), sep="\n")
    if grown := [line for line, is_grown in lines if is_grown]:
        sys.exit("\n".join(("Beyond the limit:", *grown)))


if __name__ == "__main__":
    main()
