"""The paper's equations for one instant, in W."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.momentum import MomentumSamples
from cpid_drake.dynamics.parameterizations import tensor_to_vector, vector_to_tensor
from cpid_drake.dynamics.rotations import skew
from cpid_drake.dynamics.rows import inertia_operator

Rows = tuple[NDArray[np.float64], NDArray[np.float64]]


def linear_rows(samples: MomentumSamples) -> Rows:
    """Return rows (N, 3, 4) and right-hand sides (N, 3) of [P  ω̃] (1/m, c') = −v_C, in W."""
    A = np.concatenate([samples.P[:, :, None], skew(samples.motion.w_WC)], axis=2)
    return A, -samples.motion.v_WC


def angular_rows(samples: MomentumSamples) -> Rows:
    """Return rows (N, 3, 9) and right-hand sides (N, 3) of [P̃  [#ω]] (c', [I'#]) = −L, in W."""
    A = np.concatenate([skew(samples.P), inertia_operator(samples.motion.w_WC)], axis=2)
    return A, -samples.L


def instantaneous_rows(samples: MomentumSamples) -> Rows:
    """Return the rows (N, 6, 10) in (1/m, c', [I'#]), in W, of each instant."""
    top, b_top = linear_rows(samples)
    bottom, b_bottom = angular_rows(samples)
    A = np.zeros((len(samples), 6, 10))
    A[:, :3, :4] = top
    A[:, 3:, 1:] = bottom
    return A, np.concatenate([b_top, b_bottom], axis=1)


def eq18_to_world(R_WC: ArrayLike) -> NDArray[np.float64]:
    """Return T (N, 10, 10) with (1/m, c', [I'#]) in W = T (1/m, c, [I#]) in C."""
    R_WC = np.asarray(R_WC, dtype=float)
    T = np.zeros((len(R_WC), 10, 10))
    T[:, 0, 0] = 1.0
    T[:, 1:4, 1:4] = R_WC
    for j, unit in enumerate(np.eye(6)):
        I_W = R_WC @ vector_to_tensor(unit) @ np.swapaxes(R_WC, -1, -2)
        T[:, 4:, 4 + j] = tensor_to_vector(I_W)
    return T
