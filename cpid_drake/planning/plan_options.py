"""What a user can choose of a plan."""

from dataclasses import dataclass
from math import inf

from cpid_drake.errors import InputError


@dataclass(frozen=True)
class PlanOptions:
    """What a user can choose; see `cpid plan motion --help`.

    Attributes:
        duration: [s]; None for that of the scenario's motion.
        opportunistic: time that the plan may take longer than the scenario's motion [s].
        frequency: highest frequency of the motion [Hz]; arms of spacecraft are slow.
        joints: names of the joints that move; empty for all.
        rate_share: share of the model's rate limits that may be used.
        acceleration: largest acceleration of all joints [rad/s² or m/s²].
        clearance: smallest distance of bodies that are not neighbours [m].
        base_attitude: largest turn of the base [rad].
        base_rate: its largest angular rate [rad/s].
        base_displacement: largest displacement of its origin [m].
        wheel_momentum: largest angular momentum in each wheel [N·m·s]; infinite for any, also for a
            spacecraft without wheels.
        targets: number of plausible targets.
        candidates: number of motions of the global search.
        starts: number of candidates that the gradient method improves.
        iterations: of the gradient method, for each of them.
        seed: determines candidates and plausible targets.

    Raises:
        InputError: a number is not positive; both a duration and more time are given.

    """

    duration: float | None = None
    opportunistic: float = 0.0
    frequency: float = 0.4
    joints: tuple[str, ...] = ()
    rate_share: float = 0.95
    acceleration: float = inf
    clearance: float = 0.05
    base_attitude: float = inf
    base_rate: float = inf
    base_displacement: float = inf
    wheel_momentum: float = inf
    targets: int = 8
    candidates: int = 2000
    starts: int = 2
    iterations: int = 60
    seed: int = 1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            may_be_zero = name in ("opportunistic", "seed", "clearance")
            if name == "joints" or value is None or value > 0 or (may_be_zero and value == 0):
                continue
            raise InputError(f"{name} must be {'≥' if may_be_zero else '>'} 0, not {value}")
        if self.duration is not None and self.opportunistic:
            raise InputError("give either --duration or --opportunistic")
