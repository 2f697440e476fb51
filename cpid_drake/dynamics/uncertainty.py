"""Uncertainty of the spacecraft model: of its bodies, of the arm's geometry and of the grasp."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cpid_drake.array import Array
from cpid_drake.files.constraints import Limits

Size = Annotated[float, Limits(ge=0)]


@dataclass(frozen=True)
class BodyUncertainty:
    """Uncertainty of the bodies and of their geometry; the same σ for every body and joint.

    A reaction wheel remains balanced: its centre of mass stays on its axis, and its inertia stays
    symmetric about the axis. See `KinematicTree.wheels`.

    The target's parameters refer to the true capture frame C: the frame in which the target is
    held. An error of C's pose on its body is therefore an error of the estimate. With `grasp_mm`
    and `grasp_mrad` of zero, C is by definition where the model has it.

    Attributes:
        mass: relative σ of the mass.
        com: σ of each coordinate of the centre of mass [m].
        inertia: relative σ of the principal second moments, and σ of the directions of the
            principal axes [rad].
        joint_position_mm: σ of each coordinate of a joint's place on its inboard body [mm].
        joint_axis_mrad: σ of the direction of a joint's axis on its inboard body, about each of two
            axes perpendicular to it [mrad]. The bodies outboard of the joint rotate with its axis.
        grasp_mm: σ of each coordinate of C's origin on the body that holds the target [mm].
        grasp_mrad: σ of C's attitude on this body, about each axis [mrad].

    """

    mass: Size = 0.0
    com: Size = 0.0
    inertia: Size = 0.0
    joint_position_mm: Size = 0.0
    joint_axis_mrad: Size = 0.0
    grasp_mm: Size = 0.0
    grasp_mrad: Size = 0.0

    @property
    def is_zero(self) -> bool:
        """Whether the spacecraft is known exactly."""
        return not any(vars(self).values())

    def all_sigmas(self, wheels: Sequence[bool], joints: int) -> Array:
        """Return (n,) the σ of all bodies, then of all joints, then of C; zeros too.

        Of a body, they are those of its relative mass (1), centre of mass (3) [m] and stretch (6),
        see `sensitivity.error_directions`; of a joint, those of its place (3) [m] and of its axis'
        direction (2) [rad]; of C, those of its place (3) [m] and attitude (3) [rad]. `wheels` says
        of each body whether it is a wheel; `joints` is their number.
        """
        stretch = self.inertia / 2  # the second moment grows by twice the stretch
        body = [self.mass, *3 * [self.com], *6 * [stretch]]
        wheel = [self.mass, self.com, 0, 0, stretch, stretch, 0, 0, 0, 0]  # remains balanced
        joint = [*3 * [1e-3 * self.joint_position_mm], *2 * [1e-3 * self.joint_axis_mrad]]
        grasp = [*3 * [1e-3 * self.grasp_mm], *3 * [1e-3 * self.grasp_mrad]]
        of_bodies = [wheel if is_wheel else body for is_wheel in wheels]
        return np.concatenate([*of_bodies, *joints * [joint], grasp])

    def count(self, wheels: Sequence[bool], joints: int) -> int:
        """Return the number of uncertain quantities: of those whose σ is not zero."""
        return int(np.count_nonzero(self.all_sigmas(wheels, joints)))
