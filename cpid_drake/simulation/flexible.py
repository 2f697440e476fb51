"""What is not rigid: a grasp on springs, and masses on springs inside of a body."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    Frame,
    LinearBushingRollPitchYaw,
    PrismaticJoint,
    PrismaticSpring,
    RpyFloatingJoint,
    SpatialInertia,
    UnitInertia,
)

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.files.constraints import Limits, Vector
from cpid_drake.files.errors import InputError
from cpid_drake.spacecraft.plant_names import find_element


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


@dataclass
class SprungMass:
    """A part of a body's mass that moves on springs, such as propellant or the tip of a wing.

    Three prismatic joints with Drake's springs and dampers hold a point mass at its place of rest,
    equally stiff in all directions. A body of the negative mass, welded there, takes the mass out
    of its body; with relaxed springs the body is then the same as in the model.

    Attributes:
        body: name of the body, one of the spacecraft or captured_target.
        p_BS: (3,) place of the mass at rest, in the body's frame [m].
        mass: [kg].
        frequency: natural frequency with the body held fixed [Hz].
        damping_ratio: of this oscillation.

    """

    body: Annotated[str, Limits(min_length=1)]
    p_BS: Vector
    mass: Annotated[float, Limits(gt=0)]
    frequency: Annotated[float, Limits(gt=0)]
    damping_ratio: Annotated[float, Limits(ge=0)] = 0.01

    def add_to(self, plant: MultibodyPlant) -> None:
        """Add bodies, joints and springs to a plant that has the body and is not finalized.

        Raises:
            InputError: no such body, or what remains of the body is not a rigid body.

        """
        body = find_element(plant, "Body", self.body, "simulation.sprung_masses")
        whole = InertialParameters.from_spatial_inertia(body.default_spatial_inertia())
        part = InertialParameters(self.mass, self.p_BS, np.zeros((3, 3)))
        remainder = whole.to_standard_vector() - part.to_standard_vector()
        problems = ["no mass remains"] if remainder[0] <= 0 else []
        problems += InertialParameters.from_standard_vector(remainder).inconsistencies()
        if problems:
            where = f"a sprung mass of {self.mass:g} kg in {self.body}"
            raise InputError(f"{where}: {'; '.join(problems)}")
        name = f"sprung_mass_{plant.num_bodies()}"
        instance = plant.AddModelInstance(name)
        rest = plant.AddFrame(
            FixedOffsetFrame(f"{name}_rest", body.body_frame(), RigidTransform(self.p_BS))
        )
        removed = plant.AddRigidBody(f"{name}_removed", instance, _point(-self.mass))
        plant.WeldFrames(rest, removed.body_frame())
        w, parent = 2 * np.pi * self.frequency, rest
        damping = 2 * self.damping_ratio * self.mass * w
        for axis, direction in zip("xyz", np.eye(3), strict=True):
            mass = self.mass if axis == "z" else 0.0
            child = plant.AddRigidBody(f"{name}_{axis}", instance, _point(mass)).body_frame()
            joint = plant.AddJoint(
                PrismaticJoint(f"{name}_{axis}", parent, child, direction, damping=damping)
            )
            plant.AddForceElement(PrismaticSpring(joint, 0.0, self.mass * w**2))
            parent = child


def _point(mass: float) -> SpatialInertia:
    return SpatialInertia(mass, np.zeros(3), UnitInertia(0.0, 0.0, 0.0), skip_validity_check=True)
