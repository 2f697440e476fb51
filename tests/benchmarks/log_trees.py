"""True spacecraft that differ from their models: bodies, joints and forgotten payloads."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.dynamics.spatial_inertia import point_mass_inertia
from cpid_drake.dynamics.tree import KinematicTree, TreeBody

TreeChange = Callable[[KinematicTree], KinematicTree]


def changed_body(name: str, change: Callable[[TreeBody], TreeBody]) -> TreeChange:
    """Return a change of one body of the true spacecraft."""

    def apply(tree: KinematicTree) -> KinematicTree:
        assert name in [body.name for body in tree.bodies]
        bodies = (change(body) if body.name == name else body for body in tree.bodies)
        return replace(tree, bodies=tuple(bodies))

    return apply


def heavier(name: str, mass: float, inertia: float) -> TreeChange:
    """Return a change that multiplies a body's mass and inertia."""
    return changed_body(name, lambda b: replace(b, mass=mass * b.mass, I_BBcm=inertia * b.I_BBcm))


def payload(body: str, mass: float, place: ArrayLike, radius: float) -> TreeChange:
    """Return a change that fixes a solid sphere on a body.

    Args:
        body: name of the body.
        mass: [kg].
        place: (3,) centre of the sphere in the body's frame [m].
        radius: [m].

    """
    p, sphere = np.asarray(place, dtype=float), 0.4 * mass * radius**2 * np.eye(3)

    def change(b: TreeBody) -> TreeBody:
        total = b.mass + mass
        com = (b.mass * b.p_BBcm + mass * p) / total
        inertia = b.I_BBcm + point_mass_inertia(b.mass, b.p_BBcm - com)
        inertia = inertia + sphere + point_mass_inertia(mass, p - com)
        return replace(b, mass=total, p_BBcm=com, I_BBcm=inertia)

    return changed_body(body, change)
