"""Joints that no log has, such as those of a gripper: fixed, if that changes little."""

from collections.abc import Collection

import numpy as np

from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.spacecraft import Spacecraft

LARGEST_SHIFT = 1e-3
"""Largest shift of the spacecraft's centre of mass by a joint that is not logged [m]."""

LARGEST_CHANGE = 0.01
"""Largest change of the spacecraft's inertia by it, relative. Both are below the σ that a body of
the spacecraft has unless it is declared; see `identify`."""

_PLACES = 9


def lock_unlogged(
    spacecraft: Spacecraft, logged: Collection[str]
) -> tuple[Spacecraft, tuple[str, ...]]:
    """Return the spacecraft with joints fixed that no log has, and what that could change.

    A joint is fixed at the model's default position, within its limits, if it does not carry C, is
    no wheel, and little changes over its whole range. Others remain, and must be in each log.

    Args:
        spacecraft: the spacecraft.
        logged: the joints of all logs; if none of them is the spacecraft's, no joint is fixed.

    Raises:
        InputError: a joint that no log has changes too much, but does not carry C.

    """
    notes, names, tree = list[str](), list[str](), spacecraft.tree
    for k, name in enumerate(spacecraft.joint_names):
        is_needed = name in logged or k in tree.carrying or tree.is_rotor(k)
        if is_needed or not {*logged} & {*spacecraft.joint_names}:
            continue
        shift, change = _effect(spacecraft, k)
        could = (
            "over its range it moves the spacecraft's centre of mass by "
            f"{round(1e3 * shift, 6):.2g} mm and changes its inertia by {100 * change:.3g} %"
        )
        if not (shift <= LARGEST_SHIFT and change <= LARGEST_CHANGE):
            raise InputError(
                f"there is no column 'q:{name}', and {could}: give its positions, or make it fixed "
                "in a copy of the model"
            )
        unit = "m" if k in tree.sliding else "rad"
        place = spacecraft.coupling.rest(k)
        notes.append(f"{name} is not logged, and fixed at {place:.3g} {unit}: {could}")
        names.append(name)
    return (spacecraft.locked(names) if names else spacecraft), tuple(notes)


def _effect(spacecraft: Spacecraft, k: int) -> tuple[float, float]:
    """Return the largest shift of the centre of mass [m] and change of the inertia, relative."""
    low, high = spacecraft.limits.lowest[k], spacecraft.limits.highest[k]
    if k not in spacecraft.tree.sliding and not high - low < 2 * np.pi:
        low, high = -np.pi, np.pi
    if not np.isfinite(high - low):
        return np.inf, np.inf
    q = np.zeros((_PLACES + 1, len(spacecraft.joint_names)))
    q[:-1, k] = np.linspace(low, high, _PLACES)
    q[-1, k] = spacecraft.coupling.rest(k)
    at = BodyDynamics.at(spacecraft.tree, q, 0 * q)
    shift = np.linalg.norm(at.p_BK - at.p_BK[-1], axis=-1).max()
    change = np.abs(at.I_K - at.I_K[-1]).max() / np.abs(at.I_K[-1]).max()
    return float(shift), float(change)
