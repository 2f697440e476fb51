"""Identification from data of limited precision: Table 2 of Ning et al. 2016."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.identification.checked_log import log_of_states
from cpid_drake.identification.identify import identify
from cpid_drake.identification.result import Identification
from cpid_drake.scenario.schema import Scenario
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.studies.parameter_errors import max_relative_error

Identify = Callable[[Telemetry], Identification]

_STEP = 0.02  # of the propagation of the base's motion [s]
_FINEST = 7  # decimals to which splines through the samples of the log follow its joint motion
_SUITE = "digits6"  # the suite of a state that is known but for rounding


@dataclass(frozen=True)
class RoundedCase:
    """Identification from samples rounded to a number of decimals.

    Attributes:
        decimals: number of decimals, in SI units and radians.
        identification: the result.
        max_relative_error: see `parameter_errors.max_relative_error`.
        speed_in_steps: the base's largest speed, in steps of the rounding.

    """

    decimals: int
    identification: Identification
    max_relative_error: float
    speed_in_steps: float

    @property
    def mass(self) -> float:
        """The identified mass [kg]; NaN if the samples do not determine it."""
        return float(self.identification.parameters[0])

    @property
    def objection(self) -> str:
        """Why the values are no answer; empty if they are one.

        They are lost in rounding if the base's speed is less than one step of the rounding.
        """
        if not self.identification.is_observable:
            return "not determined"
        if self.speed_in_steps < 1:
            return "lost in rounding"
        return "" if self.identification.passed else "a check failed"


@dataclass(frozen=True)
class ExcitingMotion:
    """Table 2 for a motion that moves the base faster.

    Attributes:
        rate_share: the largest rate of a joint as a share of the joint's limit.
        log_size: number of samples in the whole log.
        by_rows: identifications from as many samples as the paper's, by the paper's equation.
        by_fit: identifications by the trajectory fit from the whole log.

    """

    rate_share: float
    log_size: int
    by_rows: tuple[RoundedCase, ...]
    by_fit: tuple[RoundedCase, ...]


def rounded_cases(
    samples: Telemetry, decimals: Sequence[int], identified: Identify, truth: InertialParameters
) -> tuple[RoundedCase, ...]:
    """Return the identifications from samples rounded to each number of decimals."""
    speed = float(np.linalg.norm(samples.v_WB, axis=1).max())
    cases = []
    for number in decimals:
        found = identified(samples.rounded(number))
        error = max_relative_error(found.parameters, truth)
        cases.append(RoundedCase(number, found, error, speed * 10.0**number))
    return tuple(cases)


def exciting_motion(
    scenario: Scenario,
    times: NDArray[np.float64],
    decimals: Sequence[int],
    rows: str,
    progress: Callable[[str], None],
) -> ExcitingMotion:
    """Identify the target of another scenario from data of each number of decimals.

    The motion follows from conservation of momentum.

    Args:
        scenario: the scenario with this motion.
        times: instants of the samples that are used with `rows` [s].
        decimals: numbers of decimals.
        rows: the row family of the few samples.
        progress: called before every step with a short description of it.

    """
    spacecraft, truth = scenario.spacecraft.make(), scenario.target_truth()
    motion, config = scenario.make_joint_motion(spacecraft), scenario.simulation
    log_times = np.arange(0.0, config.duration + 1e-9, config.log_period)
    together = np.union1d(np.round(log_times, 9), np.round(times, 9))
    phi = truth.to_standard_vector()
    base = propagate(spacecraft.tree, motion, phi, together, max_step=_STEP)
    whole = base.to_telemetry(spacecraft.joint_names, together, motion)
    samples = whole.select(np.flatnonzero(np.isin(together, np.round(times, 9))))
    log = whole.select(np.flatnonzero(np.isin(together, np.round(log_times, 9))))
    zero, suite = TotalMomentum.zero(), load_sensors(_SUITE)

    def by_rows(data: Telemetry) -> Identification:
        return identify(spacecraft, data, rows=rows, momentum=zero)

    fits: list[RoundedCase] = []
    for number in decimals:
        progress(f"fitting the exciting motion, {number} decimals")

        def by_fit(data: Telemetry, number: int = number) -> Identification:
            measured = log_of_states(data).measurements
            sensors = replace(suite, decimals=min(number, _FINEST), digits=None)
            return identify(spacecraft, measured, sensors=sensors, momentum=zero)

        fits += rounded_cases(log, [number], by_fit, truth)
    return ExcitingMotion(
        rate_share=float((np.abs(log.qdot) / spacecraft.limits.rates).max()),
        log_size=len(log),
        by_rows=rounded_cases(samples, decimals, by_rows, truth),
        by_fit=tuple(fits),
    )
