"""Identification from sets of instants, and the time that an update takes."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from math import comb
from statistics import median

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import momentum_samples
from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.estimation.least_squares import (
    LeastSquaresSolution,
    empty_information,
    solve_compressed,
    solve_information,
)
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.parameter_errors import error_scale
from cpid_drake.systems.identifier import MomentumIdentifier

MOST_SETS = 200
"""Largest number of sets of one size; of more sets, this many are drawn at random."""


@dataclass(frozen=True)
class InstantSets:
    """Identifications from sets of n instants.

    Attributes:
        n: number of instants in a set.
        count: number of sets.
        ranks: smallest and largest rank.
        complete: number of sets that determine all ten parameters.
        disagreement: largest difference of any parameter between two sets, relative to its scale;
            NaN if fewer than two sets determine all ten.
        disagreement_rounded: the same with rounded samples.

    """

    n: int
    count: int
    ranks: tuple[int, int]
    complete: int
    disagreement: float
    disagreement_rounded: float


def instant_sets(
    spacecraft: Spacecraft,
    family: RowFamily,
    samples: Telemetry,
    rounded: Telemetry,
    truth: InertialParameters,
) -> list[InstantSets]:
    """Return the agreement of sets of two, three, … instants of the samples.

    Args:
        spacecraft: the known spacecraft.
        family: the row family.
        samples: exact samples; the total momentum is zero.
        rounded: the same samples, rounded.
        truth: the true target, which gives the scale of the parameters.

    """
    to_parameters = family.parameterization(spacecraft.mass).to_parameters
    rows, rounded_rows = (
        family.augmented_rows(momentum_samples(spacecraft.tree, data)).reshape(
            len(data), family.rows_per_sample, 11
        )
        for data in (samples, rounded)
    )
    scale, results = error_scale(truth), []
    for n in range(2, len(samples) + 1):
        sets = list(_sets(len(samples), n))
        exact = [_solve(rows[list(chosen)]) for chosen in sets]
        complete = [k for k, solution in enumerate(exact) if solution.is_observable]
        of_rounded = [_solve(rounded_rows[list(sets[k])]) for k in complete]
        spreads = []
        for solutions in ([exact[k] for k in complete], of_rounded):
            found = [to_parameters(s.estimate) / scale for s in solutions]
            spreads.append(float(np.ptp(found, axis=0).max()) if len(found) > 1 else np.nan)
        ranks = [solution.rank for solution in exact]
        results.append(InstantSets(n, len(sets), (min(ranks), max(ranks)), len(complete), *spreads))
    return results


def _solve(rows: NDArray[np.float64]) -> LeastSquaresSolution:
    """Return the solution of rows (n, rows of a sample, 11)."""
    stacked = rows.reshape(-1, rows.shape[-1])
    return solve_compressed(stacked[:, :-1], stacked[:, -1], 0.0, len(stacked))


def _sets(size: int, n: int) -> Iterator[tuple[int, ...]]:
    if comb(size, n) <= MOST_SETS:
        yield from combinations(range(size), n)
        return
    rng = np.random.default_rng(size + n)
    for _ in range(MOST_SETS):
        yield tuple(sorted(map(int, rng.choice(size, n, replace=False))))


def seconds_per_update(
    spacecraft: Spacecraft, rows: str, samples: Telemetry, repetitions: int = 400
) -> float:
    """Return the median time on this machine of an update of the online estimate [s].

    An update computes momentum and rows of a sample, adds them and solves for the parameters.
    """
    identifier = MomentumIdentifier(spacecraft, rows=rows)
    information = empty_information()
    states = spacecraft.to_states(samples)
    for state in states:
        information = identifier.update(information, state)
    durations = []
    for _ in range(repetitions):
        start = time.perf_counter()
        updated = identifier.update(information, states[0])
        solve_information(updated, 6 * len(states))
        durations.append(time.perf_counter() - start)
    return median(durations)
