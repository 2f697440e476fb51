"""The study of Ning et al. 2016, from simulation to its tables and figures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.momentum import total_momentum
from cpid_drake.dynamics.rows import row_family
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.identify import identify
from cpid_drake.identification.result import Identification
from cpid_drake.input_files.validation import nulls
from cpid_drake.scenario.schema import Scenario
from cpid_drake.scenario.simulation import Simulation, make_simulation
from cpid_drake.studies.paper_values import PAPER_DIGITS, PAPER_TABLE_2, is_papers_target
from cpid_drake.studies.parameter_errors import error_scale, max_relative_error, parameter_errors
from cpid_drake.studies.rounding import (
    ExcitingMotion,
    RoundedCase,
    exciting_motion,
    rounded_cases,
)


@dataclass(frozen=True)
class SampleCase:
    """Identification from the first n exact samples; the error is NaN below rank 10."""

    n: int
    rank: int
    max_relative_error: float


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
        exciting: Table 2 for a motion that moves the base faster; None if there is none.
        by_count: batch identifications from the first 1 … 10 exact samples.
        orthonormality: largest entry of AᵀA − 1 of the capture frame's attitudes A (Eq. 17).
        online_parameters: (N, 10) the online identifier's estimate at the times of `telemetry`.
        online_minus_batch: largest difference between the final online and the batch estimate,
            relative as in `max_relative_error`.
        linear_drift: (N, 3) change of the total linear momentum since the start [N·s].
        angular_drift: (N, 3) change of the total angular momentum about W's origin [N·m·s].
        rounded_linear_momentum: largest total linear momentum computed from samples rounded to six
            decimals [N·s].
        rounded_angular_momentum: largest total angular momentum computed from these samples
            [N·m·s]; the paper gives 1e-2.
        resimulated_target: feasible parameters identified from samples rounded to six decimals.
        resimulated: motion of a second simulation, with these parameters.
        attitude_error, position_error: (N, 3) resimulated minus true motion [rad, m] (Fig. 7).

    """

    simulation: Simulation
    truth: InertialParameters
    telemetry: Telemetry
    samples: Telemetry
    exact: Identification
    rounded: tuple[RoundedCase, ...]
    exciting: ExcitingMotion | None
    by_count: list[SampleCase]
    orthonormality: float
    online_parameters: NDArray[np.float64]
    online_minus_batch: float
    linear_drift: NDArray[np.float64]
    angular_drift: NDArray[np.float64]
    rounded_linear_momentum: float
    rounded_angular_momentum: float
    resimulated_target: InertialParameters
    resimulated: Telemetry
    attitude_error: NDArray[np.float64]
    position_error: NDArray[np.float64]

    @property
    def is_papers_target(self) -> bool:
        """Whether the target is the paper's, so that the paper's results can be compared."""
        return is_papers_target(self.truth)

    def rounded_to(self, decimals: int) -> RoundedCase:
        """Return the case with this number of decimals."""
        return next(case for case in self.rounded if case.decimals == decimals)

    @property
    def max_attitude_relative_error(self) -> float:
        """Largest relative error of the attitude in Fig. 7; see `peak_relative_error`."""
        return peak_relative_error(self.attitude_error, self.telemetry.euler_321)

    @property
    def max_position_relative_error(self) -> float:
        """Largest relative error of the position in Fig. 7; see `peak_relative_error`."""
        return peak_relative_error(self.position_error, self.telemetry.p_WB)


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
    telemetry = simulation.telemetry(context)
    config = scenario.identification

    def identified(data: Telemetry) -> Identification:
        momentum = TotalMomentum(is_unknown=config.unknown_momentum)
        return identify(spacecraft, data, rows=scenario.online_rows, momentum=momentum)

    progress("identifying")
    exact = identified(samples)
    if not exact.is_observable:
        raise InputError(f"the scenario does not identify its target: {exact.explain()}")
    online = simulation.identification(context)
    parameter_log = simulation.parameter_log.FindLog(context)
    _, first = np.unique(parameter_log.sample_times(), return_index=True)
    difference = online.parameters - exact.parameters

    family = row_family(exact.rows or "standard")
    rounded = rounded_cases(samples, range(1, 13), identified, truth)
    of_exciting = None
    if exciting is not None and is_papers_target(truth):
        of_exciting = exciting_motion(
            exciting, samples.time, sorted(PAPER_TABLE_2), family.name, progress
        )
    _, capture = forward_kinematics(spacecraft.tree, **samples.states)
    R_WC = capture.R_WC
    by_count = []
    for n in range(1, len(samples) + 1):
        found = identified(samples.select(slice(0, n)))
        error = max_relative_error(found.parameters, truth)
        by_count.append(SampleCase(n, found.rank, error))

    P, L = total_momentum(spacecraft.tree, truth, telemetry)
    P_6, L_6 = total_momentum(spacecraft.tree, truth, samples.rounded(PAPER_DIGITS))

    progress("simulating again with the identified parameters")
    of_six = rounded[PAPER_DIGITS - 1].identification
    feasible = of_six.consistent
    if feasible is None:
        raise InputError(f"rounded to six decimals, {of_six.explain()}")
    again = make_simulation(scenario, target=feasible)
    resimulated = again.telemetry(again.run())

    return PaperStudy(
        simulation=simulation,
        truth=truth,
        telemetry=telemetry,
        samples=samples,
        exact=exact,
        rounded=rounded,
        exciting=of_exciting,
        by_count=by_count,
        orthonormality=float(np.abs(np.swapaxes(R_WC, -1, -2) @ R_WC - np.eye(3)).max()),
        online_parameters=parameter_log.data()[:, first].T.copy(),
        online_minus_batch=float(np.abs(difference / error_scale(truth)).max()),
        linear_drift=P - P[0],
        angular_drift=L - L[0],
        rounded_linear_momentum=float(np.linalg.norm(P_6, axis=1).max()),
        rounded_angular_momentum=float(np.linalg.norm(L_6, axis=1).max()),
        resimulated_target=feasible,
        resimulated=resimulated,
        attitude_error=resimulated.euler_321 - telemetry.euler_321,
        position_error=resimulated.p_WB - telemetry.p_WB,
    )


def sampling_times(scenario: Scenario) -> NDArray[np.float64]:
    """Return the sampling times of the scenario's identifier [s]."""
    config, duration = scenario.identification, scenario.simulation.duration
    count = int(np.floor((duration - config.offset) / config.period + 1e-9)) + 1
    if count < 1:
        raise InputError(
            f"identification starts at {config.offset:g} s, after the simulation's end"
        )
    return config.offset + config.period * np.arange(count, dtype=float)


def summarize(study: PaperStudy, wall_seconds: float) -> dict:
    """Return the study's numbers for `summary.json`; missing values are None."""

    def table_1(found: Identification) -> dict:
        mass, *rest = nulls(found.parameters)
        return {
            "mass": mass,
            "com": rest[:3],
            "inertia": rest[3:],
            "relative_errors": nulls(parameter_errors(found.parameters, study.truth)),
            "max_relative_error": nulls(max_relative_error(found.parameters, study.truth)),
        }

    def table_2(cases: Sequence[RoundedCase]) -> list[dict]:
        return [
            {
                "decimals": case.decimals,
                "mass": nulls(case.mass),
                "max_relative_error": nulls(case.max_relative_error),
                "objection": case.objection,
            }
            for case in cases
        ]

    return {
        "table1": {
            "exact": table_1(study.exact),
            "rounded6": table_1(study.rounded_to(PAPER_DIGITS).identification),
        },
        "table2": table_2(study.rounded),
        "exciting": None
        if study.exciting is None
        else {
            "rate_share": study.exciting.rate_share,
            "log_size": study.exciting.log_size,
            "by_rows": table_2(study.exciting.by_rows),
            "by_fit": table_2(study.exciting.by_fit),
        },
        "figure7": {
            "max_attitude_relative_error": study.max_attitude_relative_error,
            "max_position_relative_error": study.max_position_relative_error,
        },
        "momentum": {
            "max_linear_drift": float(np.linalg.norm(study.linear_drift, axis=1).max()),
            "max_angular_drift": float(np.linalg.norm(study.angular_drift, axis=1).max()),
            "rounded6_linear": study.rounded_linear_momentum,
            "rounded6_angular": study.rounded_angular_momentum,
        },
        "samples": [
            {"n": case.n, "rank": case.rank, "max_relative_error": nulls(case.max_relative_error)}
            for case in study.by_count
        ],
        "orthonormality": study.orthonormality,
        "online_minus_batch": study.online_minus_batch,
        "wall_seconds": wall_seconds,
    }
