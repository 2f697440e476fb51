"""The noise inside the regressors of rows: how much of their information is noise.

Least squares treats the regressors A of A x = b as exact. If they have errors δA, AᵀA contains
E[δAᵀ δA] as well, which looks like information about unknowns that the motion does not excite, and
the estimate has the bias −(AᵀA)⁻¹ E[δAᵀ (δA x − δb)]. The expectations are computed from rows of
slightly changed samples. Source: Fuller 1987, Measurement Error Models, ch. 1 and 2.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.estimation.least_squares import LeastSquaresSolution, solve_compressed
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.noise_estimation import noise_level, sensor_noise

MOST_DECIMALS = 12
"""Numbers with more decimals are not treated as rounded."""

SMOOTH = 0.05
"""Largest noise of joint positions, as a share of their spread, in samples of one motion."""

DRAWS = 4
"""Number of random errors of every sample."""

_QUANTITIES = ("attitude", "gyro", "position", "velocity", "encoders", "joint_rates")


def changed(telemetry: Telemetry, shift: NDArray[np.float64]) -> Telemetry:
    """Return motion with changed quantities, at unconnected times 0, 1, 2, ….

    Args:
        telemetry: the motion at N instants.
        shift: (M N, 12 + 2J) changes of the attitude (a rotation in B), of the angular velocity in
            B, of p_WB and v_WB, and of q and q̇; for M times the motion.

    """
    J, count = len(telemetry.joint_names), len(shift) // len(telemetry)

    def tiled(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.tile(values, (count, 1))

    attitude = Rotation.from_quat(tiled(telemetry.quaternion_WB), scalar_first=True)
    w_B = attitude.inv().apply(tiled(telemetry.w_WB)) + shift[:, 3:6]
    attitude = attitude * Rotation.from_rotvec(shift[:, :3])
    return Telemetry(
        telemetry.joint_names,
        np.arange(len(shift), dtype=float),
        quaternion_WB=attitude.as_quat(scalar_first=True),
        p_WB=tiled(telemetry.p_WB) + shift[:, 6:9],
        w_WB=attitude.apply(w_B),
        v_WB=tiled(telemetry.v_WB) + shift[:, 9:12],
        q=tiled(telemetry.q) + shift[:, 12 : 12 + J],
        qdot=tiled(telemetry.qdot) + shift[:, 12 + J :],
    )


def sample_sigmas(measurements: Measurements, *, is_motion: bool = True) -> NDArray[np.float64]:
    """Return σ (12 + 2J,) of the noise in one sample, in the order of `changed`.

    Args:
        measurements: samples of the sensors; σ is zero for a sensor without samples.
        is_motion: whether the samples belong to one motion, so that differences between neighbours
            show the noise. If not, rounding is the only noise.

    """
    is_motion = is_motion and _is_one_motion(measurements.encoders)
    parts = []
    for name in _QUANTITIES:
        samples = measurements[name]
        width = samples.value.shape[1] if name in ("encoders", "joint_rates") else 3
        sigma = rounding(samples.value) / np.sqrt(12) if len(samples) else 0.0
        if is_motion and len(samples):
            with suppress(InputError):  # too few samples
                sigma = max(sigma, sensor_noise(name, samples))
        parts.append(np.full(width, sigma))
    return np.concatenate(parts)


def _is_one_motion(encoders: Samples) -> bool:
    """Return whether joint positions change little from sample to sample."""
    try:
        return noise_level(encoders) < SMOOTH * float(np.std(encoders.value, axis=0).max())
    except InputError:  # too few samples
        return False


def rounding(values: NDArray[np.float64]) -> float:
    """Return the unit of the last decimal of rounded numbers; zero for numbers of all digits."""
    values = values[np.isfinite(values) & (values != 0)]
    for decimals in range(MOST_DECIMALS + 1):
        scaled = values * 10.0**decimals
        whole = np.round(scaled)
        if np.all(whole != 0) and np.all(np.abs(scaled - whole) < 1e-3):
            return float(10.0**-decimals) if len(values) else 0.0
    return 0.0


def changes(telemetry: Telemetry, covariance: NDArray[np.float64]) -> Iterator[Telemetry]:
    """Yield the motion with random errors, `DRAWS` times.

    Args:
        telemetry: the motion at N instants.
        covariance: (N, 12 + 2J, 12 + 2J) of the errors of one sample, in the order of `changed`.

    """
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) + 1e-300
    correlation = covariance / sigma[:, :, None] / sigma[:, None, :]
    root = sigma[:, :, None] * np.linalg.cholesky(correlation + 1e-9 * np.eye(sigma.shape[1]))
    generator = np.random.default_rng(0)
    for _ in range(DRAWS):
        shift = np.einsum("nij,nj->ni", root, generator.standard_normal(sigma.shape))
        yield changed(telemetry, shift)


def above_noise(
    solution: LeastSquaresSolution, root: NDArray[np.float64], noise: NDArray[np.float64]
) -> LeastSquaresSolution:
    """Return a solution without the combinations whose information is noise, with its bias added.

    Args:
        solution: of the target's u unknowns, the last ones.
        root: (≥ k + u + 1, k + u + 1) square-root information of the rows [N | A | b].
        noise: (k + u + 1, k + u + 1) expectation of δᵀ δ for the errors δ of the rows.

    """
    R, z, rho, E = _without_momentum(solution, root, noise)
    found = solve_compressed(R, z, rho**2, max(solution.row_count, 0), noise=E[:-1, :-1])
    return with_bias(solution if found.rank == solution.rank else found, root, noise)


def with_bias(
    solution: LeastSquaresSolution, root: NDArray[np.float64], noise: NDArray[np.float64]
) -> LeastSquaresSolution:
    """Return a solution whose covariance contains the square of its bias.

    The arguments are those of `above_noise`.
    """
    known = np.isfinite(solution.estimate)
    if not known.any():
        return solution
    R, _, _, E = _without_momentum(solution, root, noise)
    pull = (E[:-1, :-1] @ np.nan_to_num(solution.estimate) - E[:-1, -1])[known]
    bias = np.zeros(len(known))
    size = np.linalg.norm(R[:, known], axis=0) + 1e-300
    unit = R[:, known] / size
    bias[known] = np.linalg.pinv(unit.T @ unit, hermitian=True) @ (pull / size) / size
    return replace(solution, covariance=solution.covariance + np.outer(bias, bias))


def expected_residuals(
    solution: LeastSquaresSolution, root: NDArray[np.float64], noise: NDArray[np.float64]
) -> float:
    """Return the expected sum of squares of A x − b due to the noise of the rows.

    The arguments are those of `above_noise`.
    """
    E = _without_momentum(solution, root, noise)[-1]
    x = np.append(np.nan_to_num(solution.estimate), -1.0)
    return float(x @ E @ x)


def _without_momentum(
    solution: LeastSquaresSolution, root: NDArray[np.float64], noise: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, NDArray[np.float64]]:
    """Return R (n, u), z (n,) and ρ of the target's u unknowns, and their noise (u + 1, u + 1)."""
    k = root.shape[1] - 1 - len(solution.estimate)
    # Changes of the k momentum unknowns that follow changes of the others.
    T = np.eye(root.shape[1])[:, k:]
    T[:k] = -np.linalg.lstsq(root[:k, :k], root[:k, k:], rcond=None)[0]
    return root[k:-1, k:-1], root[k:-1, -1], float(root[-1, -1]), T.T @ noise @ T
