"""The estimates of constant errors of sensors and of external forces, and their words."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.least_squares import FAR, quantile_95
from cpid_drake.estimation.likelihood.constants import VALVE_FORCE, ConstantError
from cpid_drake.files.constraints import Numbers
from cpid_drake.files.digits import with_half_width
from cpid_drake.sensors.error_kinds import KINDS

LEARNED = 0.5
"""Share of the prior σ below which the samples have determined an entry."""


@dataclass(frozen=True, eq=False)
class EffectEstimate:
    """The estimate of one constant error; see `cpid_drake.estimation.likelihood.constants`.

    Attributes:
        name: such as "acceleration" or "attitude.delay".
        unit: unit of all numbers.
        value: (k,) the estimate.
        sigma: (k,) its σ.
        prior_sigma: σ of each entry before the first sample.
        log: name of the log to which an external force belongs; empty for errors that several logs
            have in common, and if there is only one log.
        hardware: the first log whose sensors have this error; empty if those of all logs have it.

    """

    name: str
    unit: str
    value: Annotated[Array, Numbers()]
    sigma: Annotated[Array, Numbers()]
    prior_sigma: float
    log: str = ""
    hardware: str = ""

    @classmethod
    def of(
        cls, error: ConstantError, value: Array, sigma: Array, **others: str
    ) -> "EffectEstimate":
        """Return the estimate from value and σ (k,) in units of the error's own σ."""
        unit = error.sigma / error.scale
        return cls(error.name, error.unit, unit * value, unit * sigma, unit, **others)

    @property
    def is_learned(self) -> bool:
        """Whether the samples determine an entry much better than its prior, or contradict it."""
        is_far = np.abs(self.value) > FAR * np.maximum(self.sigma, self.prior_sigma)
        return bool((is_far | (self.sigma < LEARNED * self.prior_sigma)).any())

    @property
    def may_fail(self) -> bool:
        """Whether it is the force of a valve."""
        return self.name.rpartition(".")[2] == VALVE_FORCE

    @property
    def failed_valve(self) -> str:
        """The valve whose force is far from the declared one; empty for other errors."""
        is_far = self.may_fail and abs(self.value[0]) > FAR * self.prior_sigma
        return self.name.rpartition(".")[0] if is_far else ""

    def describe(self) -> str:
        """Return the estimate in words, with 95 % intervals."""
        half = quantile_95() * self.sigma
        numbers = ", ".join(map(with_half_width, self.value, half))
        text = f"{numbers} {self.unit}" if len(self.value) == 1 else f"({numbers}) {self.unit}"
        sensor, _, kind = self.name.rpartition(".")
        where = f" during {self.log}" if self.log else ""
        where += with_sensors_of(self.hardware) if self.hardware else ""
        return KINDS[kind].words.format(text, sensor=sensor) + where


def with_sensors_of(hardware: str) -> str:
    """Return the words behind an error of one hardware; see `EffectEstimate`."""
    return f" with the sensors of {hardware}"
