"""Momentum wheels: rotors that turn about their axes of symmetry."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.errors import InputError


def wheel_rates(
    tree: KinematicTree, names: Sequence[str], moves: NDArray[np.bool_], momentum: float
) -> NDArray[np.float64]:
    """Return the rates (J,) [rad/s] at which each wheel stores a momentum; infinite for others.

    The stored momentum is that relative to the body that carries the wheel: its inertia about its
    axis times the rate of its joint.

    Args:
        tree: the spacecraft.
        names: its J joints.
        moves: (J,) whether a joint moves.
        momentum: the angular momentum [N·m·s].

    Raises:
        InputError: the spacecraft has no wheels, or none of them moves.

    """
    wheels = [body for body in tree.bodies if body.joint >= 0 and tree.is_rotor(body.joint)]
    if not wheels:
        raise InputError(
            "the spacecraft has no wheels (balanced bodies that turn about an axis of symmetry); "
            "plan without a limit of their momentum"
        )
    if not any(moves[wheel.joint] for wheel in wheels):
        listed = ", ".join(names[wheel.joint] for wheel in wheels)
        raise InputError(
            f"no wheel moves, so a limit of their momentum has no effect; give the wheels that may "
            f"move with --joint, beside the other joints: {listed}"
        )
    rates = np.full(len(names), np.inf)
    for wheel in wheels:
        axis_B = wheel.R_MB.T @ wheel.axis_F
        rates[wheel.joint] = momentum / (axis_B @ wheel.I_BBcm @ axis_B)
    return rates
