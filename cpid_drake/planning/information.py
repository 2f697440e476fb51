"""Fisher information about a target from joint motions, in closed form, for many motions at once.

With ξ a small rotation of the base in W and the notation of `base_motion`, the first-order effects
of the target's unknowns ψ, of the start and of an unknown momentum (L, v) are

    δω = J⁻¹ (Rᵀ (δL + L × ξ) − Y δψ),      ξ' = R δω,
    δp = δp₀ + t δv − ξ × Rρ − R (∂ρ/∂ψ) δψ,

with Y the relative rows. Attitude sensor, gyro (with a constant bias), position and velocity
sensors measure ξ, δω, δp and its rate; their information is that per second of their samples. What
follows about ψ when all other unknowns are eliminated is the information about the target. Errors
of encoders, mountings, delays and the spacecraft's bodies are left out: `Planner.predict`
contains them in the exact bound, which takes much longer.
"""

import numpy as np
from scipy.interpolate import CubicSpline

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import rotate, skew
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.planning.base_motion import PlannedBaseMotion
from cpid_drake.sensors.suite import SensorSuite

ANYWHERE = 1e3
"""σ of attitude [rad] and place [m] at the start: without effect where a sensor measures them."""


def covariance(model: Model, motion: PlannedBaseMotion, information: Array | None = None) -> Array:
    """Return the Cramér-Rao bound (B, 10, 10) on the covariance of ψ in B motions.

    Args:
        model: the spacecraft model with its sensors.
        motion: of the base.
        information: (10, 10) about ψ before the motion, besides the prior of its sizes; default:
            none.

    """
    suite = model.suite
    places = _places(suite, motion)
    n = max(place.stop for place in places.values())
    xi, w = _rotations(motion, places, n)
    sigma = np.full(n, ANYWHERE)
    sigma[places["psi"]] = np.inf
    if "momentum" in places:
        sigma[places["momentum"]] = model.unknown(MOMENTUM).sigma
    gyro, duration = suite.gyro, motion.times[-1]
    F = np.zeros((motion.R.shape[0] // len(motion.times), n, n))
    R_BW = np.swapaxes(motion.R, 1, 2)
    if suite.attitude is not None:
        rows = np.swapaxes(motion.R @ suite.attitude.R_BS, 1, 2) @ xi
        F += _gain(suite, motion, "attitude", rows)
    if gyro is not None:
        sigma[places["bias"]] = np.sqrt(gyro.bias_sigma**2 + gyro.bias_growth**2 * duration)
        rows = R_BW @ w
        rows[..., places["bias"]] += np.eye(3)
        F += _gain(suite, motion, "gyro", rows)
    if "position" in places:
        rows = skew(rotate(motion.R, motion.dynamics.com(motion.psi))) @ xi
        rows[..., :4] -= motion.R @ motion.dynamics.com_regressor()
        if "momentum" in places:
            times = np.repeat(motion.times, len(F))[:, None, None]
            rows[..., n - 3 :] += times * np.eye(3)
        rows[..., places["position"]] += np.eye(3)
        if suite.position is not None:
            F += _gain(suite, motion, "position", rows)
        if suite.velocity is not None:
            spline = CubicSpline(motion.times, motion.by_node(rows))
            F += _gain(suite, motion, "velocity", spline(motion.times, 1).reshape(rows.shape))
    F += np.diag(sigma**-2.0)
    prior = model.cone.prior(PSI, motion.psi).R
    F[:, :10, :10] += prior.T @ prior + (0.0 if information is None else information)
    unit = 1 / np.sqrt(np.diagonal(F, axis1=1, axis2=2))
    unit = unit[:, :, None] * unit[:, None]
    return np.asarray((np.linalg.inv(F * unit) * unit)[:, :10, :10])


def _places(suite: SensorSuite, motion: PlannedBaseMotion) -> dict[str, slice]:
    """Return the columns of the unknowns; those of the momentum [L; v] are the last."""
    sizes = {"psi": 10, "attitude": 3}
    sizes |= {} if suite.gyro is None else {"bias": 3}
    sizes |= {} if suite.position is None and suite.velocity is None else {"position": 3}
    sizes |= {"momentum": 6} if motion.momentum.is_unknown else {}
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(a, b) for name, a, b in zip(sizes, ends, ends[1:])}


def _rotations(motion: PlannedBaseMotion, places: dict[str, slice], n: int) -> tuple[Array, Array]:
    """Return ξ and R δω (U, 3, n) for each unknown, in W."""
    R, L, step = motion.R, motion.momentum.L_WScm_W, motion.times[1]
    mobility = R @ motion.mobility
    w = np.zeros((len(R), 3, n))
    w[..., places["psi"]] = -mobility @ motion.dynamics.regressor(motion.w)
    mobility = mobility @ np.swapaxes(R, 1, 2)
    if "momentum" in places:
        w[..., n - 6 : n - 3] = mobility
    w, coupling = motion.by_node(w), motion.by_node(mobility @ skew(L))
    xi = np.zeros_like(w)
    xi[0, :, :, places["attitude"]] = np.eye(3)
    if L.any():
        for k in range(len(w) - 1):
            w[k] += coupling[k] @ xi[k]
            later = w[k + 1] + coupling[k + 1] @ (xi[k] + step * w[k])
            xi[k + 1] = xi[k] + step / 2 * (w[k] + later)
        w[-1] += coupling[-1] @ xi[-1]
    else:
        xi[1:] = xi[0] + np.cumsum(step / 2 * (w[1:] + w[:-1]), axis=0)
    return xi.reshape(-1, 3, n), w.reshape(-1, 3, n)


def _gain(suite: SensorSuite, motion: PlannedBaseMotion, sensor: str, rows: Array) -> Array:
    """Return the information (B, n, n) of a sensor whose samples change by rows (U, 3, n)."""
    N, n = len(motion.times), rows.shape[-1]
    count = motion.times[-1] * suite[sensor].rate + 1
    white = rows * (np.sqrt(count / N) / suite.sigmas(sensor))[:, None]
    white = np.swapaxes(motion.by_node(white), 0, 1).reshape(-1, 3 * N, n)
    return np.asarray(np.swapaxes(white, 1, 2) @ white)
