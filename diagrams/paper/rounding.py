"""Identification from data of limited precision: Table 2 of Ning et al. 2016."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpid_drake import (
    Identification,
    InertialParameters,
    Motion,
    Scenario,
    TotalMomentum,
    identify,
    load_sensors,
)
from cpid_drake.dynamics.parameterizations import parameter_scale
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.identification.checked_log import log_of_states

_FINEST = 7  # decimals to which splines through the samples of the log follow its joint motion
_SUITE = "digits6"  # the suite of a state that is known but for rounding


def parameter_errors(
    parameters: NDArray[np.float64], truth: InertialParameters
) -> NDArray[np.float64]:
    """Return (10,) errors (π minus truth), relative to m, |c| and the trace of I."""
    scale = parameter_scale(truth.to_vector(), float(np.linalg.norm(truth.p_CTcm_C)))
    return (parameters - truth.to_vector()) / scale


def max_relative_error(parameters: NDArray[np.float64], truth: InertialParameters) -> float:
    """Return the largest magnitude of `parameter_errors`; NaN if an entry is NaN."""
    return float(np.abs(parameter_errors(parameters, truth)).max())


@dataclass(frozen=True)
class RoundedCase:
    """Identification from samples rounded to a number of decimals.

    Attributes:
        decimals: number of decimals, in SI units and radians.
        identification: the result.
        speed_in_steps: the base's largest speed, in steps of the rounding.

    """

    decimals: int
    identification: Identification
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
        if not self.identification.is_identifiable:
            return "not identifiable"
        if self.speed_in_steps < 1:
            return "lost in rounding"
        return "" if self.identification.passed else "a check failed"


def rounded_case(
    samples: Motion, decimals: int, identified: Callable[[Motion], Identification]
) -> RoundedCase:
    """Return the identification from samples rounded to a number of decimals."""
    speed = float(np.linalg.norm(samples.v_WB, axis=1).max())
    return RoundedCase(decimals, identified(samples.rounded(decimals)), speed * 10.0**decimals)


def exciting_motion(
    scenario: Scenario,
    times: NDArray[np.float64],
    decimals: Sequence[int],
    progress: Callable[[str], None],
) -> tuple[tuple[RoundedCase, ...], tuple[RoundedCase, ...]]:
    """Identify the target of another scenario from data of each number of decimals.

    The motion follows from conservation of momentum.

    Args:
        scenario: the scenario with this motion.
        times: instants of the samples that are used with the paper's equation [s].
        decimals: numbers of decimals.
        progress: called before every step with a short description of it.

    Returns:
        The identifications from these samples by Eq. 18, and from the whole log by the trajectory
        fit.

    """
    spacecraft, phi = scenario.spacecraft.make(), scenario.target_truth().to_standard_vector()
    motion, config = scenario.make_joint_motion(spacecraft), scenario.simulation

    def at(instants: NDArray[np.float64]) -> Motion:
        grid = np.union1d(0.0, instants)  # the base is at the world's origin at 0 s
        base = propagate(spacecraft.tree, motion, phi, grid)
        whole = base.to_motion(spacecraft.joint_names, grid, motion)
        return whole.select(np.flatnonzero(np.isin(grid, instants)))

    samples, log = at(times), at(np.arange(0.0, config.duration + 1e-9, config.log_period))
    zero, suite = TotalMomentum.zero(), load_sensors(_SUITE, unstated="exact")
    rows, fits = [], []
    for number in decimals:
        progress(f"fitting the exciting motion, {number} decimals")
        sensors = replace(suite, decimals=min(number, _FINEST))

        def by_rows(data: Motion) -> Identification:
            return identify(spacecraft, data, rows="eq18", momentum=zero)

        def by_fit(data: Motion, sensors=sensors) -> Identification:  # type: ignore[no-untyped-def]
            measured = log_of_states(data).measurements
            return identify(spacecraft, measured, sensors=sensors, momentum=zero)

        rows.append(rounded_case(samples, number, by_rows))
        fits.append(rounded_case(log, number, by_fit))
    return tuple(rows), tuple(fits)
