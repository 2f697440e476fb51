"""Joints that follow another joint, such as a gripper's fingers: together they are one coordinate.

A joint follows as q = m q_leader + b, with multiplier m and offset b. The plant has a coordinate of
each joint; the spacecraft's joints are those that lead.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError


@dataclass(frozen=True)
class Mimic:
    """What a model file says of a joint that follows another: q = multiplier · q_leader + offset.

    Attributes:
        leader: the name of the other joint.
        multiplier: m.
        offset: b [rad or m].

    """

    leader: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class JointCoupling:
    """The positions of all movable joints of a plant by those of the joints that lead: A q + b.

    Attributes:
        joints: the joints that lead in the order of q, then all others.
        count: the number J of joints that lead.
        A: (n, J) the multipliers; one entry in a row at most.
        b: (n,) the offsets [rad or m].

    """

    joints: tuple[Joint, ...]
    count: int
    A: Array
    b: Array

    @property
    def leaders(self) -> tuple[Joint, ...]:
        """The joints that lead, in the order of q."""
        return self.joints[: self.count]

    def rest(self, k: int) -> float:
        """Return the default position of a leading joint, or its limit if that is beyond it."""
        joint = self.joints[k]
        low, high = joint.position_lower_limit(), joint.position_upper_limit()
        return float(np.clip(joint.default_positions()[0], low, high))

    def locked(self, columns: Collection[int]) -> "JointCoupling":
        """Return the coupling with some of the leading joints fixed, see `rest`."""
        kept = [k for k in range(self.count) if k not in columns]
        rows = [*kept, *columns, *range(self.count, len(self.joints))]
        b = self.b + self.A[:, [*columns]] @ np.array([self.rest(k) for k in columns])
        joints = tuple(self.joints[k] for k in rows)
        return JointCoupling(joints, len(kept), self.A[rows][:, kept], b[rows])

    def positions(self, q: Array) -> Array:
        """Return the positions (..., n) of all joints by those (..., J) of the joints that lead."""
        return np.asarray(q @ self.A.T + self.b)

    def rates(self, qdot: Array) -> Array:
        """Return the rates (..., n), or accelerations, of all joints."""
        return np.asarray(qdot @ self.A.T)

    def efforts(self, tau: Array) -> Array:
        """Return the efforts (..., J) that do the work of efforts (..., n) of all joints."""
        return np.asarray(tau @ self.A)

    def of(self, joint: Joint) -> tuple[int, float, float]:
        """Return the column of q that a joint moves with, or −1, its multiplier and its offset."""
        row = next(k for k, each in enumerate(self.joints) if each.index() == joint.index())
        columns = np.flatnonzero(self.A[row])
        column = int(columns[0]) if columns.size else -1
        return column, float(self.A[row].sum()), float(self.b[row])


def couple_joints(
    plant: MultibodyPlant, joints: Sequence[Joint], mimics: Mapping[str, Mimic | None], where: str
) -> JointCoupling:
    """Return how the movable joints of a plant follow each other.

    A joint that follows a fixed one stands at its offset.

    Args:
        plant: a finalized plant.
        joints: its movable joints, in the order of q.
        mimics: what the files say of joints by their names; None of a joint that does not follow.
        where: the model, for messages.

    Raises:
        InputError: a joint follows one that there is not, or itself.

    """
    leading = [joint for joint in joints if mimics.get(joint.name()) is None]
    column = {joint.index(): k for k, joint in enumerate(leading)}
    following = [joint for joint in joints if joint.index() not in column]
    A, b = np.eye(len(joints), len(leading)), np.zeros(len(joints))

    def row(joint: Joint, around: tuple[str, ...]) -> tuple[Array, float]:
        """Return the multipliers (J,) and the offset of a joint."""
        name, own = joint.name(), np.zeros(len(leading))
        mimic = mimics.get(name)
        if joint.index() in column:
            own[column[joint.index()]] = 1.0
        if mimic is None or joint.num_velocities() == 0:
            return own, 0.0
        if name in around:
            raise InputError(f"{where}: joint '{name}' follows itself: {' -> '.join(around)}")
        if not plant.HasJointNamed(mimic.leader, joint.model_instance()):
            raise InputError(
                f"{where}: joint '{name}' follows '{mimic.leader}' (mimic), and there is no such "
                "joint"
            )
        other = plant.GetJointByName(mimic.leader, joint.model_instance())
        by, offset = row(other, (*around, name))
        return mimic.multiplier * by, mimic.multiplier * offset + mimic.offset

    for k, joint in enumerate(following, start=len(leading)):
        A[k], b[k] = row(joint, ())
    return JointCoupling((*leading, *following), len(leading), A, b)
