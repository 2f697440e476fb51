"""A grasp that is not rigid: a spring and a damper between the capture frame and the target."""

from dataclasses import dataclass, field

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    Frame,
    LinearBushingRollPitchYaw,
    RpyFloatingJoint,
)

from cpid_drake.files.checked_yaml import Vector
from cpid_drake.files.errors import InputError


@dataclass
class CompliantWrist:
    """Springs and dampers that hold the target at the capture frame C.

    The target's frame T coincides with C if the springs are relaxed. The moments act along the
    roll-pitch-yaw axes of T relative to C, and the forces along the axes of a frame halfway between
    C and T; see Drake's `LinearBushingRollPitchYaw`. They act on both bodies at one point with
    opposite signs, so linear and angular momentum are conserved.

    Attributes:
        stiffness: (3,) of the rotation about the axes of C [N·m/rad], greater than zero.
        damping: (3,) of the rotation [N·m·s/rad].
        translational_stiffness: (3,) along the axes of C [N/m]; None if T's origin stays at C's.
        translational_damping: (3,) [N·s/m]; not used without a translational stiffness.

    Raises:
        InputError: a stiffness is not greater than zero, or a damping is negative.

    """

    stiffness: Vector
    damping: Vector = field(default_factory=lambda: np.zeros(3))
    translational_stiffness: Vector | None = None
    translational_damping: Vector = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is None:
                continue
            is_stiffness = name.endswith("stiffness")
            if not (np.all(value > 0) if is_stiffness else np.all(value >= 0)):
                raise InputError(
                    f"wrist.{name} must be three numbers {'>' if is_stiffness else '>='}"
                    f" 0, not {np.asarray(value).tolist()}"
                )

    def connect(self, plant: MultibodyPlant, frame_C: Frame, frame_T: Frame) -> None:
        """Add joint, springs and dampers between C and the target to a plant in the making."""
        moves = self.translational_stiffness is not None
        joint = RpyFloatingJoint if moves else BallRpyJoint
        plant.AddJoint(joint("wrist", frame_C, frame_T))
        none = np.zeros(3)
        plant.AddForceElement(
            LinearBushingRollPitchYaw(
                frame_C,
                frame_T,
                self.stiffness,
                self.damping,
                self.translational_stiffness if moves else none,
                self.translational_damping if moves else none,
            )
        )
