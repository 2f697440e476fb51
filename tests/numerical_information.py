"""What samples tell about a target, by differences of readings that `propagate_base` predicts.

It shares no equation with the estimators. The joint motion is taken as known.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.base_motion import propagate_base
from cpid_drake.dynamics.parameterizations import parameters_to_standard
from cpid_drake.dynamics.sensitivity import with_errors

_STEPS = np.array([1e-2, *3 * [1e-4], *6 * [1e-2], *3 * [1e-5], *3 * [1e-3], *3 * [1e-5]])
"""Steps of π, of attitude and position at the start, and of the gyro's bias."""


def numerical_information(
    craft, motion, target, suite, samples, momentum_W=None, known_bodies=None
) -> NDArray[np.float64]:
    """Return the information (10 + c, 10 + c) about π and the c errors p of the known bodies.

    Attitude and position at the start, the gyro's bias, and a momentum that is not zero are
    unknown. The prior N(0, 1) of p is not included.
    """
    tree, times = craft.tree, [samples[n].time for n in ("attitude", "gyro", "position")]
    c = 0 if known_bodies is None else known_bodies.count(tree.wheels, len(craft.joint_names))
    steps = np.concatenate([_STEPS, [] if momentum_W is None else 6 * [1e-2], c * [1e-2]])
    n = len(steps)
    everything = np.unique(np.round(np.concatenate([[0.0], *times]), 9))
    index = [np.searchsorted(everything, np.round(t, 9)) for t in times]

    def readings(tree, x):
        """Return attitudes, angular velocities in B and positions for the changes x (M, n)."""
        base = propagate_base(
            tree,
            motion,
            np.stack([parameters_to_standard(target.to_vector() + row[:10]) for row in x]),
            everything,
            quaternion_WB=Rotation.from_rotvec(x[:, 10:13]).as_quat(scalar_first=True),
            p_WB=x[:, 13:16],
            momentum_W=None if momentum_W is None else momentum_W + x[:, 19:25],
            max_step=0.05,
        )
        for j, row in enumerate(x):
            R = Rotation.from_quat(base.quaternion_WB[j], scalar_first=True)
            w = R[index[1]].inv().apply(base.w_WB[j, index[1]]) + row[16:19]
            yield R[index[0]], w, base.p_WB[j, index[2]]

    moves = np.diag(steps)
    found = list(readings(tree, np.concatenate([moves[: n - c], -moves[: n - c]])))
    ahead, behind = found[: n - c], found[n - c :]
    for errors in moves[n - c :, n - c :]:
        ahead += readings(with_errors(tree, known_bodies, errors), np.zeros((1, n)))
        behind += readings(with_errors(tree, known_bodies, -errors), np.zeros((1, n)))
    columns = []
    for one, other, step in zip(ahead, behind, steps, strict=True):
        turn = (other[0].inv() * one[0]).as_rotvec() @ suite.attitude.R_BS
        parts = [
            turn / suite.sigmas("attitude"),
            (one[1] - other[1]) / suite.sigmas("gyro"),
            (one[2] - other[2]) / suite.sigmas("position"),
        ]
        columns.append(np.concatenate([part.ravel() for part in parts]) / (2 * step))
    J = np.stack(columns, axis=1)
    information = J.T @ J
    information[16:19, 16:19] += np.eye(3) / suite.gyro.bias_sigma**2
    kept, gone = np.r_[:10, n - c : n], np.r_[10 : n - c]
    across = information[np.ix_(gone, kept)]
    less = across.T @ np.linalg.solve(information[np.ix_(gone, gone)], across)
    return information[np.ix_(kept, kept)] - less
