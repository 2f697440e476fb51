"""What a user can choose of a plan, in Python and at the command line."""

from dataclasses import dataclass
from math import inf

from cpid_drake.files.errors import InputError

_MAY_BE_ZERO = ("opportunistic", "seed", "clearance")


@dataclass(frozen=True)
class PlanOptions:
    """The choices; their texts are those of the options of `cpid plan`.

    Raises:
        InputError: a number is not positive; both a duration and more time are given.

    """

    duration: float | None = None
    """Duration [s]. Default: that of the scenario's motion."""
    opportunistic: float = 0.0
    """Plan the transfer of the scenario to be as informative as possible, with at most this many
    more seconds than the scenario's motion takes [s]."""
    frequency: float = 0.4
    """Highest frequency; arms of spacecraft are slow [Hz]."""
    joint: list[str] | None = None
    """Joint that moves; may be repeated. Default: all but wheels."""
    rate_share: float = 0.95
    """Share of the model's rate limits that may be used."""
    acceleration: float = inf
    """Largest acceleration of the joints [rad/s² or m/s²]. Default: any."""
    clearance: float = 0.05
    """Smallest distance of bodies that are not neighbours [m]."""
    base_attitude: float = inf
    """Largest rotation of the base [deg]. Default: any."""
    base_rate: float = inf
    """Largest angular rate of the base [deg/s]. Default: any."""
    base_displacement: float = inf
    """Largest displacement of the base's origin [m]. Default: any."""
    targets: int = 8
    """Number of plausible targets; the least favourable one counts."""
    candidates: int = 2000
    """Motions of the global search."""
    iterations: int = 60
    """Iterations of the gradient method."""
    seed: int = 1
    """Seed; the same seed, the same motions."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, (int, float)):
                continue
            if not (value > 0 or (name in _MAY_BE_ZERO and value == 0)):
                sign = "≥" if name in _MAY_BE_ZERO else ">"
                raise InputError(f"{name} must be {sign} 0, not {value}")
        if self.duration is not None and self.opportunistic:
            raise InputError("give either --duration or --opportunistic")
