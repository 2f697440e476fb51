"""One type for the motion data from simulations, from sensors and from files."""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from cpid_drake.array import Array
from cpid_drake.files.errors import InputError


@dataclass(frozen=True, eq=False)
class Motion:
    """N samples of a spacecraft's base motion and joint motion, all at the same instants.

    Attributes:
        joint_names: the joints, in the order of the columns of `q` and `qdot`.
        time: (N,) strictly increasing [s].
        quaternion_WB: (N, 4) attitude of the base as unit quaternions (w, x, y, z).
        p_WB: (N, 3) position of the base frame's origin in W [m].
        w_WB: (N, 3) angular velocity of the base, in W [rad/s].
        v_WB: (N, 3) velocity of the base frame's origin, in W [m/s].
        q: (N, J) joint positions [rad or m].
        qdot: (N, J) joint rates [rad/s or m/s].

    Raises:
        InputError: the shapes do not match, the times do not increase, an entry is not finite, or
            the norm of a quaternion differs from 1 by more than 1e-3 (a smaller difference is
            treated as rounding).

    """

    joint_names: tuple[str, ...]
    time: Array
    quaternion_WB: Array
    p_WB: Array
    w_WB: Array
    v_WB: Array
    q: Array
    qdot: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        count, joints = np.size(self.time), (len(self.joint_names),)
        shapes = {"time": (), "quaternion_WB": (4,), "p_WB": (3,), "w_WB": (3,), "v_WB": (3,)}
        for name, width in {**shapes, "q": joints, "qdot": joints}.items():
            try:
                values = np.array(getattr(self, name), dtype=float)
            except (TypeError, ValueError) as error:
                raise InputError(f"motion: '{name}' must be an array of numbers: {error}") from None
            if values.shape != (count, *width):
                raise InputError(
                    f"motion: '{name}' must have shape {(count, *width)}, not {values.shape}"
                )
            bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
            if bad.any():
                raise InputError(f"motion: '{name}' is not finite in sample {bad.argmax()}")
            object.__setattr__(self, name, values)
        backwards = np.diff(self.time) <= 0
        if backwards.any():
            k = int(backwards.argmax()) + 1
            raise InputError(
                f"motion: time does not increase at sample {k} (t = {self.time[k]:g} s)"
            )
        off = np.abs(np.linalg.norm(self.quaternion_WB, axis=1) - 1) > 1e-3
        if off.any():
            raise InputError(
                f"motion: quaternion_WB is not of unit norm in sample {off.argmax()}: it is no "
                "attitude yet, or the steps of an integrator are too long"
            )

    def __len__(self) -> int:
        return self.time.size

    @property
    def R_WB(self) -> Array:
        """(N, 3, 3) attitude of the base: columns are B's axes in W."""
        return np.asarray(self._rotations().as_matrix())

    @property
    def states(self) -> dict[str, Array]:
        """The motion of base and joints as arguments of `kinematics.forward_kinematics`."""
        names = ("q", "qdot", "R_WB", "p_WB", "w_WB", "v_WB")
        return {name: getattr(self, name) for name in names}

    @property
    def euler_321(self) -> Array:
        """(N, 3) attitude as 3-2-1 Euler angles (yaw, pitch, roll) [rad], continuous in time."""
        return np.unwrap(self._rotations().as_euler("ZYX"), axis=0)

    def _rotations(self) -> "scipy.spatial.transform.Rotation":
        # SciPy imports scipy.spatial here, at its first use; the import takes 0.25 s.
        return scipy.spatial.transform.Rotation.from_quat(self.quaternion_WB, scalar_first=True)

    def select(self, samples: ArrayLike | slice) -> "Motion":
        """Return the samples with these indices, in this slice, or where this (N,) mask is true."""
        if not isinstance(samples, slice):
            samples = np.asarray(samples)
            samples = samples if samples.size else samples.astype(int)
        return replace(self, **{name: getattr(self, name)[samples] for name in ("time", *_ARRAYS)})

    def rounded(self, decimals: int) -> "Motion":
        """Return the motion with all numbers but the times rounded, in SI units and radians.

        The attitude is rounded as 3-2-1 Euler angles: the paper's sensors give attitude angles
        (Ning et al. 2016, "Identification results and analysis").
        """
        angles = np.round(self.euler_321, decimals)
        attitude = scipy.spatial.transform.Rotation.from_euler("ZYX", angles)
        parts = {name: np.round(getattr(self, name), decimals) for name in _ARRAYS[1:]}
        return replace(self, quaternion_WB=attitude.as_quat(scalar_first=True), **parts)


_ARRAYS = ("quaternion_WB", "p_WB", "w_WB", "v_WB", "q", "qdot")
