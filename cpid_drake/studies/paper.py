"""The study of Ning et al. 2016, from simulation to its tables and figures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.momentum import total_momentum
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.identification.identify import identify
from cpid_drake.identification.result import Identification
from cpid_drake.input_files.validation import nulls
from cpid_drake.scenario.schema import Scenario
from cpid_drake.scenario.simulation import Simulation, make_simulation

PAPER_TARGET = InertialParameters(
    100.0, np.array([0.4330127, 0.0, 0.0]), np.diag([20.0, 30.0, 10.0])
)
"""The true target of Ning et al. 2016, Table 1; the paper's results are for this target only."""

PAPER_TABLE_1 = InertialParameters.from_vector(
    [99.897213, 0.434876, 0.001487, -0.000866]
    + [18.962848, 30.018296, 9.706598, -0.279775, -0.09017, -0.075827]
)
"""The identified parameters that Ning et al. 2016 report in Table 1."""

PAPER_TABLE_2 = {
    1: 234.521597,
    2: 98.798019,
    3: 99.015893,
    4: 99.897745,
    5: 99.895927,
    6: 99.897213,
    7: 99.897998,
    8: 99.898010,
    9: 99.897998,
}
"""Decimals of the data, and the identified mass [kg], as Ning et al. 2016 report in Table 2."""

PAPER_FIGURE_7 = {"attitude": 0.0025, "position": 0.0004}
"""Largest relative errors after re-simulation that Ning et al. 2016 report (Fig. 7)."""

PAPER_DIGITS = 6
"""Decimals of the data of Table 1: its mass is that for six decimals in Table 2."""


@dataclass(frozen=True)
class RoundedCase:
    """Identification from samples rounded to a number of decimals."""

    decimals: int
    identification: Identification
    max_relative_error: float


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
        by_count: batch identifications from the first 1 … 10 exact samples.
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
    rounded: list[RoundedCase]
    by_count: list[SampleCase]
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
        return np.allclose(self.truth.to_vector(), PAPER_TARGET.to_vector(), rtol=1e-6, atol=1e-6)

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


def _scale(truth: InertialParameters) -> NDArray[np.float64]:
    """Return the scale (10,) of the errors: m, |c| for c, the trace of I for I."""
    return parameter_scale(truth.to_vector(), float(np.linalg.norm(truth.p_CTcm_C)))


def parameter_errors(
    parameters: NDArray[np.float64], truth: InertialParameters
) -> NDArray[np.float64]:
    """Return (10,) errors (π minus truth), relative to m, |c| and the trace of I."""
    return (parameters - truth.to_vector()) / _scale(truth)


def max_relative_error(parameters: NDArray[np.float64], truth: InertialParameters) -> float:
    """Return the largest magnitude of `parameter_errors`; NaN if an entry is NaN."""
    return float(np.abs(parameter_errors(parameters, truth)).max())


def peak_relative_error(error: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Return the largest error (N, 3) of any axis, relative to that axis's peak motion.

    Ning et al. 2016 give "the maximum relative error" of angle and position. An error
    relative to the value at the same instant is unbounded where a curve crosses zero; here the peak
    error of an axis is relative to the peak of its motion.
    """
    excursion = np.abs(reference - reference[0]).max(axis=0)
    return float((np.abs(error).max(axis=0) / excursion).max())


def run_paper_study(
    scenario: Scenario, progress: Callable[[str], None] = lambda step: None
) -> PaperStudy:
    """Simulate the scenario, identify online and in batch, and repeat it as the paper did.

    Args:
        scenario: a scenario like `models/scenarios/paper.yaml`.
        progress: called at the start of every step with a short description of it.

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
        return identify(spacecraft, data, rows=config.rows, momentum=momentum)

    progress("identifying")
    exact = identified(samples)
    if not exact.is_observable:
        raise InputError(f"the scenario does not identify its target: {exact.explain()}")
    online = simulation.identification(context)
    parameter_log = simulation.parameter_log.FindLog(context)
    _, first = np.unique(parameter_log.sample_times(), return_index=True)
    difference = online.parameters - exact.parameters

    rounded = []
    for decimals in range(1, 13):
        found = identified(samples.rounded(decimals))
        rounded.append(RoundedCase(decimals, found, max_relative_error(found.parameters, truth)))
    by_count = []
    for n in range(1, len(samples) + 1):
        found = identified(samples.select(slice(0, n)))
        error = max_relative_error(found.parameters, truth)
        by_count.append(SampleCase(n, found.solution.rank, error))

    P, L = total_momentum(spacecraft.tree, truth, telemetry)
    P_6, L_6 = total_momentum(spacecraft.tree, truth, samples.rounded(PAPER_DIGITS))

    progress("simulating again with the identified parameters")
    of_six = rounded[PAPER_DIGITS - 1].identification
    if not of_six.is_observable:
        raise InputError(f"rounded to six decimals, {of_six.explain()}")
    feasible = of_six.feasible()
    again = make_simulation(scenario, target=feasible)
    resimulated = again.telemetry(again.run())

    return PaperStudy(
        simulation=simulation,
        truth=truth,
        telemetry=telemetry,
        samples=samples,
        exact=exact,
        rounded=rounded,
        by_count=by_count,
        online_parameters=parameter_log.data()[:, first].T.copy(),
        online_minus_batch=float(np.abs(difference / _scale(truth)).max()),
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
        error = nulls(max_relative_error(found.parameters, study.truth))
        return {"mass": mass, "com": rest[:3], "inertia": rest[3:], "max_relative_error": error}

    return {
        "table1": {
            "exact": table_1(study.exact),
            "rounded6": table_1(study.rounded_to(PAPER_DIGITS).identification),
        },
        "table2": [
            {
                "decimals": case.decimals,
                "mass": nulls(case.identification.parameters[0]),
                "max_relative_error": nulls(case.max_relative_error),
            }
            for case in study.rounded
        ],
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
        "online_minus_batch": study.online_minus_batch,
        "wall_seconds": wall_seconds,
    }
