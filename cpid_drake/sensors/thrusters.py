"""Thrusters whose valves are logged: where each pushes, how strongly, and what is not known of it.

A log has one column `valve:NAME` for each valve: its opening u, from 0 (closed) to 1, which holds
until the next row. With n = Σu, the valve pushes with the force

    F (1 + c) (1 + s) u (1 − loss max(n − 1, 0)),

a delay after the log. The relative errors s of each valve and c of all (they share a pressure), the
delay and the loss are unknowns; a valve that fails has a force far from the declared one, so the
prior of s has a heavy tail.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from cpid_drake.files.constraints import Limits, Vector
from cpid_drake.files.errors import InputError
from cpid_drake.sensors.sensors import Stated

VALVE = "valve:"
"""Prefix of the columns of valves."""


@dataclass
class Valve:
    """One valve.

    Attributes:
        position: (3,) where it pushes, in the frame that `on` names [m].
        direction: (3,) of the force on the spacecraft, of any length.
        force: the force of the open valve [N].
        force_sigma: σ of the force [N].
        on: "body" for the base, in its frame B; "target" for the capture frame C.
        axes: frame of the direction: "body" for that of the position, or "world".

    Raises:
        InputError: the direction has no length.

    """

    position: Vector = field(default_factory=lambda: np.zeros(3))
    direction: Vector = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    force: Annotated[float, Limits(gt=0)] = 1.0
    force_sigma: Stated = None
    on: Literal["body", "target"] = "body"
    axes: Literal["body", "world"] = "body"

    def __post_init__(self) -> None:
        if not 1e-100 < np.linalg.norm(self.direction) < 1e100:
            raise InputError("direction must be of finite length, not zero")


@dataclass
class Thrusters:
    """All valves.

    Attributes:
        valves: by name.
        delay_ms: σ of the delay of all forces after the log [ms].
        loss: σ of the share of the force that each further open valve costs.
        common_force: σ of the relative error that all forces have in common.

    Raises:
        InputError: there are no valves.

    """

    valves: dict[str, Valve] = field(default_factory=dict)
    delay_ms: Stated = None
    loss: Stated = None
    common_force: Stated = None

    def __post_init__(self) -> None:
        if not self.valves:
            raise InputError("valves are missing: give position, direction and force of each")
