"""What a user can choose of a plan."""

from dataclasses import dataclass

import numpy as np

from cpid_drake.planning import HIGHEST_FREQUENCY


@dataclass(frozen=True)
class PlanOptions:
    """What a user can choose; see `cpid plan motion --help`.

    Attributes:
        duration: [s]; None for that of the scenario's motion.
        opportunistic: time that the plan may take longer than the scenario's motion [s].
        frequency: highest frequency of the motion [Hz].
        joints: names of the joints that move; empty for all.
        rate_share: share of the model's rate limits that may be used.
        acceleration: largest acceleration of all joints [rad/s² or m/s²].
        clearance: smallest distance of bodies that are not neighbours [m].
        base_attitude: largest turn of the base [rad]; None for any.
        base_rate: its largest angular rate [rad/s]; None for any.
        base_displacement: largest displacement of its origin [m]; None for any.
        wheel_momentum: largest angular momentum in each wheel [N·m·s]; None for any.
        targets: number of plausible targets.
        candidates: number of motions of the global search.
        starts: number of candidates that the gradient method improves.
        iterations: of the gradient method, for each of them.
        seed: determines candidates and plausible targets.
        jobs: number of processes.

    """

    duration: float | None = None
    opportunistic: float = 0.0
    frequency: float = HIGHEST_FREQUENCY
    joints: tuple[str, ...] = ()
    rate_share: float = 0.95
    acceleration: float = np.inf
    clearance: float = 0.05
    base_attitude: float | None = None
    base_rate: float | None = None
    base_displacement: float | None = None
    wheel_momentum: float | None = None
    targets: int = 8
    candidates: int = 2000
    starts: int = 2
    iterations: int = 60
    seed: int = 1
    jobs: int = 1
