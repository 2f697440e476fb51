"""What a user can choose of a plan, in Python and at the command line."""

from dataclasses import dataclass
from math import inf
from typing import Annotated

from cpid_drake.files.errors import InputError

_MOTION, _LIMITS, _SEARCH = "The motion", "Limits", "The search"
_MAY_BE_ZERO = ("opportunistic", "seed", "clearance")


@dataclass(frozen=True)
class PlanOptions:
    """The choices; their annotations are the groups and the help of the options of `cpid plan`.

    Raises:
        InputError: a number is not positive; both a duration and more time are given.

    """

    duration: Annotated[
        float | None, _MOTION, "Duration [s]. Default: that of the scenario's motion."
    ] = None
    opportunistic: Annotated[
        float,
        _MOTION,
        "Plan the transfer of the scenario to be as informative as possible, with at most this "
        "many more seconds than the scenario's motion takes [s].",
    ] = 0.0
    frequency: Annotated[float, _MOTION, "Highest frequency; arms of spacecraft are slow [Hz]."] = (
        0.4
    )
    joint: Annotated[
        list[str] | None, _MOTION, "Joint that moves; may be repeated. Default: all but wheels."
    ] = None
    rate_share: Annotated[float, _LIMITS, "Share of the model's rate limits that may be used."] = (
        0.95
    )
    acceleration: Annotated[
        float, _LIMITS, "Largest acceleration of the joints [rad/s² or m/s²]. Default: any."
    ] = inf
    clearance: Annotated[
        float, _LIMITS, "Smallest distance of bodies that are not neighbours [m]."
    ] = 0.05
    base_attitude: Annotated[float, _LIMITS, "Largest turn of the base [deg]. Default: any."] = inf
    base_rate: Annotated[
        float, _LIMITS, "Largest angular rate of the base [deg/s]. Default: any."
    ] = inf
    base_displacement: Annotated[
        float, _LIMITS, "Largest displacement of the base's origin [m]. Default: any."
    ] = inf
    targets: Annotated[
        int, _SEARCH, "Number of plausible targets; the least favourable one counts."
    ] = 8
    candidates: Annotated[int, _SEARCH, "Motions of the global search."] = 2000
    iterations: Annotated[int, _SEARCH, "Iterations of the gradient method."] = 60
    seed: Annotated[int, _SEARCH, "Seed; the same seed, the same motions."] = 1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, (int, float)):
                continue
            if not (value > 0 or (name in _MAY_BE_ZERO and value == 0)):
                sign = "≥" if name in _MAY_BE_ZERO else ">"
                raise InputError(f"{name} must be {sign} 0, not {value}")
        if self.duration is not None and self.opportunistic:
            raise InputError("give either --duration or --opportunistic")
