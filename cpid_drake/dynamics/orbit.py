"""A circular orbit: its gravity gradient, and motion relative to a body that moves along it.

W has constant axes, and its origin moves along the orbit. With the mean motion n and the nadir r̂,
the torque on a system about its centre of mass, and the acceleration of this centre at p, are

    τ = 3 n² r̂ × J r̂,      p'' = n² (3 r̂ r̂ᵀ p − p),

with J the system's inertia about its centre of mass. The second equation is that of Clohessy and
Wiltshire in axes that do not rotate. Source: Hughes 2004, Spacecraft Attitude Dynamics, ch. 8;
Clohessy & Wiltshire 1960, Terminal Guidance System for Satellite Rendezvous.
"""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import cross, rotate, skew
from cpid_drake.files.constraints import Limits, Numbers
from cpid_drake.files.errors import InputError


@dataclass
class Orbit:
    """A circular orbit, given by its altitude over the Earth or by its mean motion.

    Attributes:
        altitude_km: altitude over the Earth's equatorial radius [km]; None if `rate` is given.
        rate: mean motion n [rad/s]; None if `altitude_km` is given.
        nadir_W: (3,) direction from W's origin to the centre of the orbit at t = 0.
        normal_W: (3,) direction of the orbital angular momentum, perpendicular to the nadir.

    Raises:
        InputError: not exactly one of altitude and rate; a direction of no length; directions that
            are not perpendicular.

    """

    altitude_km: Annotated[float, Limits(gt=0, le=1e6)] | None = None
    rate: Annotated[float, Limits(gt=0, le=1)] | None = None
    nadir_W: Annotated[Array, Numbers(3)] = field(
        default_factory=lambda: np.array([0.0, 0.0, -1.0])
    )
    normal_W: Annotated[Array, Numbers(3)] = field(
        default_factory=lambda: np.array([0.0, 1.0, 0.0])
    )

    def __post_init__(self) -> None:
        if (self.altitude_km is None) == (self.rate is None):
            raise InputError("give one of altitude_km and rate")
        lengths = [float(np.linalg.norm(v)) for v in (self.nadir_W, self.normal_W)]
        if not min(lengths) > 0:
            raise InputError("nadir_W and normal_W must be directions, not zero")
        cosine = float(np.dot(self.nadir_W, self.normal_W)) / (lengths[0] * lengths[1])
        if abs(cosine) > 0.02:  # a degree
            raise InputError(
                "nadir_W and normal_W must be perpendicular; the angle between them is "
                f"{np.degrees(np.arccos(cosine)):.1f}°"
            )

    @property
    def n(self) -> float:
        """Mean motion [rad/s], from the Earth's gravitational parameter and equatorial radius."""
        if self.altitude_km is None:
            assert self.rate is not None
            return self.rate
        return float(np.sqrt(3.986004418e14 / (6378.137e3 + 1e3 * self.altitude_km) ** 3))

    def axes(self, times: Array) -> Array:
        """Return R_WH (M, 3, 3) at times (M,) [s]: columns away from the centre, ahead, normal."""
        normal = self.normal_W / np.linalg.norm(self.normal_W)
        away = -self.nadir_W + normal * (normal @ self.nadir_W)
        away = away / np.linalg.norm(away)
        ahead = np.cross(normal, away)
        c, s = (f(self.n * np.asarray(times, dtype=float))[..., None] for f in (np.cos, np.sin))
        x = c * away + s * ahead
        return np.stack([x, np.cross(normal, x), np.broadcast_to(normal, x.shape)], axis=-1)

    def nadir(self, times: Array) -> Array:
        """Return the unit vectors (M, 3) from W's origin to the centre of the orbit, in W."""
        return -self.axes(times)[..., 0]

    def torque(self, J_W: Array, times: Array) -> Array:
        """Return the torque (M, 3) about the system's centre of mass, in W [N·m].

        Args:
            J_W: (M, 3, 3) inertia of the system about its centre of mass, in W [kg·m²].
            times: (M,) [s].

        """
        r = self.nadir(times)
        return 3 * self.n**2 * cross(r, rotate(J_W, r))

    def torque_by_attitude(self, J_W: Array, times: Array) -> Array:
        """Return the derivative (M, 3, 3) of `torque` by a rotation of the system, in W."""
        r = self.nadir(times)
        turned = J_W @ skew(r) - skew(rotate(J_W, r))
        return np.asarray(3 * self.n**2 * skew(r) @ turned)

    def tide(self, times: Array) -> Array:
        """Return the matrices (M, 3, 3) that map a position in W to its acceleration [1/s²]."""
        r = self.nadir(times)
        return self.n**2 * (3 * r[..., :, None] * r[..., None, :] - np.eye(3))

    def transition(self, start: float, times: Array) -> Array:
        """Return the matrices (M, 6, 6) from position and velocity in W at `start` to `times`.

        Without other forces, [p; v] at a time is this matrix times [p; v] at `start`.
        Source: Clohessy & Wiltshire 1960, rotated to W.
        """
        times, n = np.asarray(times, dtype=float), self.n
        angle = n * (times - start)
        s, c = np.sin(angle), np.cos(angle)
        Phi = np.zeros((*times.shape, 6, 6))
        Phi[..., 0, 0], Phi[..., 0, 3], Phi[..., 0, 4] = 4 - 3 * c, s / n, 2 * (1 - c) / n
        Phi[..., 1, 0], Phi[..., 1, 1] = 6 * (s - angle), 1.0
        Phi[..., 1, 3], Phi[..., 1, 4] = -2 * (1 - c) / n, (4 * s - 3 * angle) / n
        Phi[..., 2, 2], Phi[..., 2, 5] = c, s / n
        Phi[..., 3, 0], Phi[..., 3, 3], Phi[..., 3, 4] = 3 * n * s, c, 2 * s
        Phi[..., 4, 0], Phi[..., 4, 3], Phi[..., 4, 4] = -6 * n * (1 - c), -2 * s, 4 * c - 3
        Phi[..., 5, 2], Phi[..., 5, 5] = -n * s, c
        return self._to_W(times) @ Phi @ np.linalg.inv(self._to_W(np.asarray(start)))

    def _to_W(self, times: Array) -> Array:
        """Return the matrices (M, 6, 6) from position and velocity in the rotating axes to W."""
        R = self.axes(times)
        T = np.zeros((*R.shape[:-2], 6, 6))
        T[..., :3, :3] = T[..., 3:, 3:] = R
        T[..., 3:, :3] = R @ skew([0.0, 0.0, self.n])
        return T
