"""Motion in a plane, as of a spacecraft that floats on a table.

The table's normal is W's z axis. The table (its air bearings, or the joint of a simulation) holds
the base's height and tilt by a force along the normal and by moments across it. These reactions do
not change the linear momentum in the plane and the angular momentum about the normal, so only

    P_x, P_y  and  L_z

are conserved. The other three equations of a free spacecraft do not hold: with a product of inertia
Ixz, for example, a free spacecraft would tilt, and a table prevents this. They must not be used.
What remains is linear in four unknowns of the target if all joints keep it in the plane: with n the
normal in C, these are m, the two components of m c across n, and nᵀ J n.

Sources: Ning et al. 2016, Eqs. 5 and 9, of which three components are conserved.
"""

from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.rotations import conjugate, cross, rotate, rotate_by_quaternion

NORMAL_W = np.array([0.0, 0.0, 1.0])
"""The table's normal in W."""

HELD = {
    "attitude": (0, 1),
    "p_Wcm": (2,),
    "L": (0, 1),
    "v_Wcm": (2,),
    "torque": (0, 1),
    "acceleration": (2,),
    "torque_B": (0, 1, 2),
    "wheel": (0, 1, 2),
    "target_wheel": (0, 1, 2),
}
"""Entries in W of what a table holds: tilt, height, and what would change them. In the plane a
spinning wheel in base or target cannot be distinguished from a momentum, nor a torque that rotates
with the base from one that does not."""

ALONG = 1e-3
"""Largest entry across an axis of a unit vector that counts as parallel to the axis."""


def parallel_axis(direction: Array) -> int:
    """Return the number of the coordinate axis that is parallel to a unit vector (3,); −1: none."""
    axis = int(np.abs(direction).argmax())
    return axis if np.abs(np.delete(direction, axis)).max() < ALONG else -1


def tilt(quaternion_WB: ArrayLike, normal_B: Array) -> Array:
    """Return the rotation vectors (N, 3) in W [rad] that rotate the normal in B to W's z axis."""
    axis_W = rotate_by_quaternion(np.asarray(quaternion_WB, dtype=float), normal_B)
    turn = cross(axis_W, np.broadcast_to(NORMAL_W, axis_W.shape))
    sine = np.linalg.norm(turn, axis=-1)
    angle = np.arctan2(sine, axis_W[..., 2])
    return np.asarray(turn * (angle / np.maximum(sine, 1e-300))[..., None])


def mean_normal(quaternion_WB: ArrayLike) -> Array:
    """Return the mean direction (3,) of W's z axis in B, of attitudes (N, 4)."""
    inverse = conjugate(np.asarray(quaternion_WB, dtype=float))
    mean = np.mean(rotate_by_quaternion(inverse, NORMAL_W), axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def in_plane(motion: Motion, normal_B: Array) -> Motion:
    """Return motion without its components out of the plane, which are noise.

    The attitude is rotated by the smallest angle so that the base's normal (3,) is W's z axis.
    """
    w_B = rotate(np.swapaxes(motion.R_WB, -1, -2), motion.w_WB)
    return replace(
        motion,
        quaternion_WB=levelled(motion.quaternion_WB, normal_B),
        p_WB=motion.p_WB * [1.0, 1.0, 0.0],
        w_WB=np.outer(w_B @ normal_B, NORMAL_W),
        v_WB=motion.v_WB * [1.0, 1.0, 0.0],
    )


def levelled(quaternion_WB: Array, normal_B: Array) -> Array:
    """Return attitudes (N, 4) rotated by the smallest angle so that the normal in B is W's z."""
    Rotation = scipy.spatial.transform.Rotation  # imported at its first use; it takes 0.25 s
    level = Rotation.from_rotvec(tilt(quaternion_WB, normal_B))
    level = level * Rotation.from_quat(quaternion_WB, scalar_first=True)
    return np.asarray(level.as_quat(scalar_first=True))
