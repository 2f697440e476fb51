"""The limits of a spacecraft's joints: position, rate and effort."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint

from cpid_drake.spacecraft.parsing import ModelFile


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of J joints; infinite where the model has none.

    Attributes:
        lowest: (J,) lowest positions [rad or m].
        highest: (J,) highest positions [rad or m].
        rates: (J,) largest speeds [rad/s or m/s].
        efforts: (J,) largest efforts of the motors [N·m or N].

    """

    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    rates: NDArray[np.float64]
    efforts: NDArray[np.float64]


def joint_limits(model: ModelFile, plant: MultibodyPlant, joints: Sequence[Joint]) -> JointLimits:
    """Return the limits of these joints of a finalized plant of the model.

    The effort limit is that of the joint's actuator in the plant. A joint without actuator has the
    limit in its URDF. An effort limit of zero means that none is stated.
    """
    efforts = [model.contents.efforts.get(joint.name()) or np.inf for joint in joints]
    order = {joint.index(): k for k, joint in enumerate(joints)}
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.joint().index() in order and actuator.effort_limit() > 0:
            efforts[order[actuator.joint().index()]] = actuator.effort_limit()
    return JointLimits(
        lowest=np.array([joint.position_lower_limit() for joint in joints]),
        highest=np.array([joint.position_upper_limit() for joint in joints]),
        rates=np.array([joint.velocity_upper_limits()[0] for joint in joints]),
        efforts=np.array(efforts),
    )
