"""The study of Ning et al. 2016, from simulation to its tables and figures."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake import (
    Identification,
    InertialParameters,
    InputError,
    Motion,
    Scenario,
    Simulation,
    TotalMomentum,
    identify,
    make_simulation,
)
from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.files.dumping import nulls
from paper.rounding import (
    RoundedCase,
    exciting_motion,
    max_relative_error,
    parameter_errors,
    rounded_case,
)
from paper.values import PAPER_DIGITS, PAPER_TABLE_2, is_papers_target


@dataclass(frozen=True, eq=False)
class PaperStudy:
    """The results that the tables and figures show.

    Attributes:
        simulation: the simulated diagram.
        truth: the simulated target.
        telemetry: the logged motion.
        samples: the telemetry at the identifier's sampling instants.
        exact: batch identification from `samples`.
        rounded: batch identifications from samples rounded to 1 … 12 decimals (Table 2).
        exciting: Table 2 for a motion that moves the base faster, by Eq. 18 and by the trajectory
            fit; empty if the target is not the paper's.
        by_count: batch identifications from the first 1, 2, … exact samples.
        online_minus_batch: largest difference between the final online and the batch estimate,
            relative as in `max_relative_error`.
        drift: (2,) largest change of the total momentum, linear [N·s] and angular about W's origin
            [N·m·s].
        rounded_momentum: (2,) largest total momentum computed from samples rounded to six decimals;
            the paper gives 1e-2 for the angular one.
        resimulated_target: physically consistent parameters identified from samples rounded to six
            decimals.
        resimulated: motion of a second simulation, with these parameters (Fig. 7).

    """

    simulation: Simulation
    truth: InertialParameters
    telemetry: Motion
    samples: Motion
    exact: Identification
    rounded: tuple[RoundedCase, ...]
    exciting: tuple[tuple[RoundedCase, ...], ...]
    by_count: tuple[Identification, ...]
    online_minus_batch: float
    drift: NDArray[np.float64]
    rounded_momentum: NDArray[np.float64]
    resimulated_target: InertialParameters
    resimulated: Motion

    @property
    def is_papers_target(self) -> bool:
        """Whether the target is the paper's, so that the paper's results can be compared."""
        return is_papers_target(self.truth)

    @property
    def six_decimals(self) -> Identification:
        """The identification from samples rounded to six decimals, as in Table 1."""
        return self.rounded[PAPER_DIGITS - 1].identification

    @property
    def attitude_error(self) -> NDArray[np.float64]:
        """(N, 3) re-simulated minus true attitude [rad], 3-2-1 angles (Fig. 7)."""
        return self.resimulated.euler_321 - self.telemetry.euler_321

    @property
    def position_error(self) -> NDArray[np.float64]:
        """(N, 3) re-simulated minus true position [m] (Fig. 7)."""
        return self.resimulated.p_WB - self.telemetry.p_WB

    @property
    def figure_7(self) -> dict[str, float]:
        """Largest relative errors of attitude and position; see `peak_relative_error`."""
        return {
            "attitude": peak_relative_error(self.attitude_error, self.telemetry.euler_321),
            "position": peak_relative_error(self.position_error, self.telemetry.p_WB),
        }


def peak_relative_error(error: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Return the largest error (N, 3) of any axis, relative to that axis's peak motion.

    Ning et al. 2016 give "the maximum relative error" of angle and position. An error
    relative to the value at the same instant is unbounded where a curve crosses zero; here the peak
    error of an axis is relative to the peak of its motion.
    """
    excursion = np.abs(reference - reference[0]).max(axis=0)
    return float((np.abs(error).max(axis=0) / excursion).max())


def run_paper_study(
    scenario: Scenario,
    progress: Callable[[str], None] = lambda step: None,
    exciting: Scenario | None = None,
) -> PaperStudy:
    """Simulate the scenario, identify online and in batch, and repeat it as the paper did.

    Args:
        scenario: a scenario like `models/scenarios/paper.yaml`.
        progress: called at the start of every step with a short description of it.
        exciting: a scenario with the paper's target and a motion that moves the base faster, for
            Table 2. It is not used if the target of `scenario` is another.

    Raises:
        InputError: the scenario cannot be built, or its samples do not determine the target.

    """
    progress("simulating the motion")
    simulation = make_simulation(scenario)
    spacecraft, truth = simulation.spacecraft, simulation.truth
    context, samples = simulation.run_sampled(sampling_times(scenario))
    telemetry = simulation.motion(context)
    momentum = TotalMomentum.named(scenario.identification.momentum)

    def identified(data: Motion) -> Identification:
        return identify(
            spacecraft, data, rows=scenario.identification.rows or "standard", momentum=momentum
        )

    progress("identifying")
    exact = identified(samples)
    if not exact.is_identifiable:
        raise InputError(f"the scenario does not identify its target: {exact.explain()}")
    online = simulation.identification(context).parameters
    rounded = tuple(rounded_case(samples, number, identified) for number in range(1, 13))
    consistent = rounded[PAPER_DIGITS - 1].identification.consistent
    if consistent is None:
        raise InputError("rounded to six decimals, the samples determine no rigid body")
    of_exciting: tuple[tuple[RoundedCase, ...], ...] = ()
    if exciting is not None and is_papers_target(truth):
        of_exciting = exciting_motion(exciting, samples.time, sorted(PAPER_TABLE_2), progress)

    progress("simulating again with the identified parameters")
    again = make_simulation(scenario, target=consistent)
    exact_momentum = system_momentum(spacecraft.tree, truth, telemetry)
    six_momentum = system_momentum(spacecraft.tree, truth, samples.rounded(PAPER_DIGITS))
    return PaperStudy(
        simulation=simulation,
        truth=truth,
        telemetry=telemetry,
        samples=samples,
        exact=exact,
        rounded=rounded,
        exciting=of_exciting,
        by_count=tuple(identified(samples.select(slice(0, n))) for n in range(1, len(samples) + 1)),
        online_minus_batch=max_relative_error(online - exact.parameters + truth.to_vector(), truth),
        drift=_largest(momentum - momentum[0] for momentum in exact_momentum),
        rounded_momentum=_largest(six_momentum),
        resimulated_target=consistent,
        resimulated=again.motion(again.run()),
    )


def _largest(vectors: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the largest lengths of vectors (N, 3)."""
    return np.array([np.linalg.norm(each, axis=1).max() for each in vectors])


def sampling_times(scenario: Scenario) -> NDArray[np.float64]:
    """Return the sampling times of the scenario's identifier [s]."""
    config, duration = scenario.identification, scenario.simulation.duration
    count = int(np.floor((duration - config.offset) / config.period + 1e-9)) + 1
    if count < 1:
        raise InputError(
            f"identification starts at {config.offset:g} s, after the simulation's end"
        )
    return config.offset + config.period * np.arange(count, dtype=float)


def summarize(study: PaperStudy, wall_seconds: float) -> dict[str, Any]:
    """Return the study's numbers for `summary.json`; missing values are None."""

    def error(found: Identification) -> float | None:
        largest: float | None = nulls(max_relative_error(found.parameters, study.truth))
        return largest

    def table_1(found: Identification) -> dict[str, Any]:
        errors = parameter_errors(found.parameters, study.truth)
        values = {"parameters": nulls(found.parameters), "relative_errors": nulls(errors)}
        return {**values, "max_relative_error": error(found)}

    def table_2(cases: Iterable[RoundedCase]) -> list[dict[str, Any]]:
        return [
            {
                "decimals": case.decimals,
                "mass": nulls(case.mass),
                "max_relative_error": error(case.identification),
                "objection": case.objection,
            }
            for case in cases
        ]

    names = ("linear", "angular")
    return {
        "table1": {"exact": table_1(study.exact), "rounded6": table_1(study.six_decimals)},
        "table2": table_2(study.rounded),
        "exciting": [table_2(cases) for cases in study.exciting],
        "figure7": study.figure_7,
        "momentum_drift": dict(zip(names, study.drift.tolist())),
        "rounded6_momentum": dict(zip(names, study.rounded_momentum.tolist())),
        "samples": [
            {"n": n, "rank": found.rank, "max_relative_error": error(found)}
            for n, found in enumerate(study.by_count, 1)
        ],
        "online_minus_batch": study.online_minus_batch,
        "wall_seconds": wall_seconds,
    }
