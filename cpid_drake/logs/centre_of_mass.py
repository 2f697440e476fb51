"""The motion of the base that follows from the centre of mass of spacecraft and target.

Without external forces, the centre of mass of all bodies moves at a constant velocity. With the
share μ of the target in the total mass, its first moment h' about C's origin in units of the total
mass, the known bodies' centre of mass b(q) and the capture point c(q), both from B's origin in B,

    p_WBo = a₀ + a₁ t − R_WB ((1 − μ) b(q) + μ c(q)) − R_WC h'.

This is linear in μ, h', a₀ and a₁, and remains so if the log has the position p_WBo + R_WB d of
another point of the base. No velocity is needed. Units, points and conventions with which no
possible target explains the logged positions are therefore wrong.

Source: Ning et al. 2016, Eq. 5, integrated over time, as in the row family "com_position".
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.kinematics import forward_kinematics
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.log import Measurements, Samples
from cpid_drake.logs.noise_estimation import noise_level

_MOST = 1000
"""Largest number of positions that are compared."""

_GAP = 3.0
"""Ratio to the usual step of samples above which a step is a gap, which no spline bridges."""

_FEWEST = 20

_ROUNDING = 1e-6
"""Residuals below this share of the motion are treated as equal."""

_INTERPOLATION = 1e-4
"""Residuals below this share of the motion can be errors of interpolated attitudes and joints."""

_MOST_NOISE = 1.5
"""Ratio of residuals to their noise up to which a fit explains the motion."""

_MODEL_ERROR = 0.02
"""Share of the total mass by which a target's mass may be impossible because of model errors."""


@dataclass(frozen=True, eq=False)
class BaseTravel:
    """Positions of the base, and the attitudes and joint positions at the same times.

    Attributes:
        time: (N,) from the first position [s].
        position: (N, 3) p_WBo_W as logged [m].
        R_WB: (N, 3, 3) attitudes.
        q: (N, J) joint positions [rad or m].

    """

    time: NDArray[np.float64]
    position: NDArray[np.float64]
    R_WB: NDArray[np.float64]
    q: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TravelFit:
    """A least-squares fit of the base's positions by the conservation of linear momentum.

    Attributes:
        mass_share, mass_share_sigma: μ and its standard deviation.
        point_B: (3,) the point d from B's origin in B [m]; zero if it is not free.
        residuals: (N, 3) in W [m].
        travel: root mean square of the motion that a constant velocity does not explain [m].
        reach: largest distance of the capture point from B's origin [m].

    """

    mass_share: float
    mass_share_sigma: float
    point_B: NDArray[np.float64]
    residuals: NDArray[np.float64]
    travel: float
    reach: float

    @property
    def is_possible(self) -> bool:
        """Whether a target of positive mass and a point near the base can explain the positions."""
        margin = 3 * self.mass_share_sigma + _MODEL_ERROR
        near = np.linalg.norm(self.point_B) < 2 * self.reach + 1.0
        return bool(-margin < self.mass_share < 1 + margin and near)

    @property
    def count(self) -> int:
        """Number of residuals."""
        return self.residuals.size

    @property
    def error(self) -> float:
        """The root mean square of the residuals relative to the motion, at least `_ROUNDING`."""
        return max(_rms(self.residuals) / max(self.travel, 1e-300), _ROUNDING)

    @property
    def is_complete(self) -> bool:
        """Whether the fit explains the motion down to its noise, or down to interpolation errors.

        Noise is seen from the differences of neighbouring residuals, whatever sensors it is from.
        """
        in_order = Samples(np.arange(len(self.residuals), dtype=float), self.residuals)
        noise = noise_level(in_order)
        return _rms(self.residuals) < max(_MOST_NOISE * noise, _INTERPOLATION * self.travel)


def base_travel(measurements: Measurements) -> BaseTravel | None:
    """Return the base's positions with attitudes and joint positions, while no thruster fires.

    Attitudes and joint positions between samples come from cubic splines; positions in a gap of
    these samples are left out.

    Args:
        measurements: screened samples with all joints of the spacecraft, in its order.

    Returns:
        The positions, an even selection if they are many; None without enough of them.

    """
    coasting = measurements.coasting
    position, attitude, encoders = (coasting[n] for n in ("position", "attitude", "encoders"))
    if min(map(len, (position, attitude, encoders))) < _FEWEST or np.isnan(encoders.value).any():
        return None
    first = max(attitude.time[0], encoders.time[0])
    last = min(attitude.time[-1], encoders.time[-1])
    inside = (position.time >= first) & (position.time <= last)
    for samples in (attitude, encoders):
        inside &= ~_in_gap(samples.time, position.time)
    chosen = np.flatnonzero(inside)
    chosen = chosen[:: -(-chosen.size // _MOST) or 1]
    if chosen.size < _FEWEST:
        return None
    time = position.time[chosen]
    value = attitude.value
    signs = np.cumprod(np.where(np.sum(value[1:] * value[:-1], axis=1) < 0, -1.0, 1.0))
    continuous = Samples(attitude.time, value * np.append(1.0, signs)[:, None])
    R_WB = Rotation.from_quat(_at(continuous, time), scalar_first=True).as_matrix()
    return BaseTravel(time - time[0], position.value[chosen], R_WB, _at(encoders, time))


class TravelModel:
    """Fits of one joint motion with several conventions of attitude and position.

    Args:
        tree: the known spacecraft.
        q: (N, J) joint positions [rad or m].

    """

    def __init__(self, tree: KinematicTree, q: NDArray[np.float64]) -> None:
        lumped = tree.lumped
        bodies, capture = forward_kinematics(lumped, q, np.zeros_like(q))
        masses = np.array([body.mass for body in lumped.bodies])
        self._known = np.einsum("k,kni->ni", masses, bodies.r) / masses.sum()
        self._capture, self._R_BC = capture.p_WC, capture.R_WC

    def fit(
        self,
        travel: BaseTravel,
        *,
        free_point: bool = False,
        constant_force: bool = False,
    ) -> TravelFit:
        """Fit the base's positions.

        Args:
            travel: the logged motion, with the joint positions of this model.
            free_point: whether the positions may belong to another point than B's origin.
            constant_force: whether the centre of mass may have a constant acceleration.

        """
        clock = travel.time / max(travel.time[-1], 1e-9)
        powers = [np.ones_like(clock), clock]
        basis = np.stack(powers, axis=1)
        drift = travel.position - basis @ np.linalg.lstsq(basis, travel.position, rcond=None)[0]
        if constant_force:
            powers.append(clock**2)
        R_WB = travel.R_WB
        columns = [-rotate(R_WB, self._capture - self._known)[:, :, None], -R_WB @ self._R_BC]
        columns += [R_WB] if free_point else []
        columns += [power[:, None, None] * np.eye(3) for power in powers]
        A = np.concatenate(columns, axis=2).reshape(drift.size, -1)
        y = (travel.position + rotate(R_WB, self._known)).reshape(-1)
        estimate, sigma = _least_squares(A, y)
        return TravelFit(
            float(estimate[0]),
            float(sigma[0]),
            estimate[4:7] if free_point else np.zeros(3),
            (y - A @ estimate).reshape(-1, 3),
            _rms(drift),
            float(np.linalg.norm(self._capture, axis=1).max()),
        )


def in_unit(travel: BaseTravel, scale: float) -> BaseTravel:
    """Return a motion whose positions are in a unit of `scale` metres instead of metres."""
    return replace(travel, position=travel.position * scale)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _least_squares(
    A: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return estimates and standard deviations.

    Unknowns that the rows do not determine have very large standard deviations.
    """
    norms = np.linalg.norm(A, axis=0)
    norms[norms == 0] = 1.0
    U, s, Vt = np.linalg.svd(A / norms, full_matrices=False)
    known = s > 1e-7 * s[0]
    inverse = np.where(known, 1 / np.where(known, s, 1.0), 0.0)
    estimate = Vt.T @ (inverse * (U.T @ y)) / norms
    error = y - A @ estimate
    noise = float(np.sqrt(error @ error / max(len(y) - A.shape[1], 1)))
    weights = np.where(known, inverse * noise, 1e6 * (noise + np.abs(y).max(initial=0.0)))
    sigma = np.sqrt(np.sum((Vt.T * weights) ** 2, axis=1)) / norms
    return estimate, sigma


def _in_gap(time: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether some times are between samples that are farther apart than most."""
    steps = np.diff(time)
    return np.asarray(steps > _GAP * np.median(steps))[
        np.searchsorted(time[1:-1], at, side="right")
    ]


def _at(samples: Samples, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the values at these times, from a cubic spline unless they are sampled then."""
    index = np.searchsorted(samples.time, times).clip(max=len(samples) - 1)
    if (samples.time[index] == times).all():
        return samples.value[index]
    return np.asarray(CubicSpline(samples.time, samples.value)(times))
