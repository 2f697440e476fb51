"""One dense least-squares problem of a whole log, by differences of what `propagate` predicts."""

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.parameterizations import parameters_to_standard
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.sensitivity import with_errors

STEPS = np.array([1e-2, *3 * [1e-4], *6 * [1e-2], *3 * [1e-5], *3 * [1e-3], *3 * [1e-5]])
"""Steps of π, of attitude and position at the start, and of the gyro's bias."""


class Dense:
    """All unknowns of a log: π, attitude and position at the start, gyro bias, [L; P], bodies."""

    def __init__(self, craft, motion, suite, samples, momentum_W=None, bodies=None):
        self.craft, self.motion, self.samples, self.bodies = craft, motion, samples, bodies
        self.suite = suite
        self.momentum_W = momentum_W
        tree, J = craft.tree, len(craft.joint_names)
        count = 0 if bodies is None else bodies.count(tree.wheels, J)
        momentum = [] if momentum_W is None else 6 * [1e-2]
        self.steps = np.concatenate([STEPS, momentum, count * [0.1]])
        self.of_bodies = slice(len(self.steps) - count, None)
        times = [samples[n].time for n in ("attitude", "gyro", "position")]
        self.times = np.unique(np.round(np.concatenate([[0.0], *times]), 9))
        self.index = [np.searchsorted(self.times, np.round(t, 9)) for t in times]

    def residuals(self, x):
        """Return measured minus predicted (N, M) in σ for unknowns (N, K), then the prior's."""
        errors, group = np.unique(x[:, self.of_bodies], axis=0, return_inverse=True)
        readings = [self.of_tree(x[group == k]) for k in range(len(errors))]
        order = np.argsort(np.argsort(group, kind="stable"))
        prior = [x[:, 16:19] / self.suite.gyro.bias_sigma, x[:, self.of_bodies]]
        return np.hstack([np.concatenate(readings)[order], *(-part for part in prior)])

    def of_tree(self, x):
        tree, momentum_W = self.craft.tree, self.momentum_W
        if self.bodies is not None:
            tree = with_errors(tree, self.bodies, x[0, self.of_bodies])
        momentum_W = np.zeros(6) if momentum_W is None else momentum_W + x[:, 19:25]
        base = propagate(
            tree,
            self.motion,
            np.stack([parameters_to_standard(pi) for pi in x[:, :10]]),
            self.times,
            quaternion_WB=Rotation.from_rotvec(x[:, 10:13]).as_quat(scalar_first=True),
            p_WB=x[:, 13:16],
            momentum_W=momentum_W,
            max_step=0.1,
        )
        rows = []
        for k in range(len(x)):
            R, log = Rotation.from_quat(base.quaternion_WB[k], scalar_first=True), self.samples
            measured_R = Rotation.from_quat(log.attitude.value, scalar_first=True)
            turn = (R[self.index[0]].inv() * measured_R).as_rotvec() @ self.suite.attitude.R_BS
            w = R[self.index[1]].inv().apply(base.w_WB[k, self.index[1]]) + x[k, 16:19]
            p = base.p_WB[k, self.index[2]]
            parts = [
                turn / self.suite.sigmas("attitude"),
                (log.gyro.value - w) / self.suite.sigmas("gyro"),
                (log.position.value - p) / self.suite.sigmas("position"),
            ]
            rows.append(np.concatenate([part.ravel() for part in parts]))
        return np.array(rows)

    def jacobian(self, x):
        moves = np.diag(self.steps)
        values = self.residuals(np.concatenate([x + moves, x - moves]))
        ahead, behind = np.split(values, 2)
        return ((behind - ahead) / (2 * self.steps[:, None])).T

    def solved(self, x, steps=2):
        """Return the minimum, the covariance there and χ², by Gauss-Newton steps."""
        for _ in range(steps):
            J, r = self.jacobian(x), self.residuals(x[None])[0]
            scale = np.linalg.norm(J, axis=0)
            x = x + np.linalg.lstsq(J / scale, r, rcond=None)[0] / scale
        J = J / scale
        chi_squared = np.sum(self.residuals(x[None]) ** 2)
        return x, np.linalg.inv(J.T @ J) / scale / scale[:, None], chi_squared

    def information(self, x):
        """Return the information about π and the bodies' errors, without the prior of these."""
        n, count = len(x), len(x[self.of_bodies])
        J = self.jacobian(x)
        J = J[: len(J) - count]
        H, kept, gone = J.T @ J, np.r_[:10, n - count : n], np.r_[10 : n - count]
        across = H[np.ix_(gone, kept)]
        return H[np.ix_(kept, kept)] - across.T @ np.linalg.solve(H[np.ix_(gone, gone)], across)
