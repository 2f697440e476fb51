"""Errors of encoders: by how much measured positions of joints are larger than true ones.

The errors are functions x(m, t) of a measured position m and of the time t since the origin, so the
true motion q = m − x follows without a solution of equations. Measured rates have their rate

    ẋ = ∂x/∂m ṁ + ∂x/∂t.

A scale is that of gears or belts, sine and cosine are those of a disc beside its axis.
"""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.likelihood.constants import ConstantError, Constants
from cpid_drake.estimation.likelihood.joint_model import JointPart


class JointErrors:
    """The errors of the joints' motion in a block.

    Args:
        joints: the measured motion.
        constants: the constant errors.
        nominal: (k,) their values in units of their σ.
        origin: time at which zeros that drift have their values [s].
        tree: the spacecraft model: its wheels have no errors once a turn.

    """

    def __init__(
        self,
        joints: JointPart,
        constants: Constants,
        nominal: Array,
        origin: float,
        tree: KinematicTree,
    ) -> None:
        self._joints, self._origin = joints, origin
        wheels = [b.joint for b, wheel in zip(tree.bodies, tree.wheels) if wheel]
        self._errors = list[tuple[ConstantError, Array, Array]]()  # with values, each by its σ
        for error in constants.acting["joints"]:
            unit = np.full(error.size, error.sigma)
            if not error.effect.on_wheels:
                unit[wheels] = 0.0
            self._errors.append((error, unit * nominal[constants.place(error.name)], unit))

    def motion(self, times: Array) -> Array:
        """Return true positions and rates (M, 2, J) at times (M,) [s]."""
        samples = self._joints.evaluate(times)
        if not self._errors:
            return samples
        m, rate, elapsed = samples[:, 0], samples[:, 1], (times - self._origin)[:, None]
        errors = np.zeros_like(samples)
        for error, value, _ in self._errors:
            x, by_m, by_time = error.effect.how(m, elapsed)
            errors[:, 0] += value * x
            errors[:, 1] += value * (by_m * rate + by_time)
        return samples - errors

    def by_errors(self, times: Array) -> dict[str, Array]:
        """Return the derivative (M, J) of each true position by the errors of its own joint."""
        if not self._errors:
            return {}
        m = self._joints.basis(times) @ self._joints.coefficients
        elapsed, zero = (times - self._origin)[:, None], np.zeros_like(m)
        return {
            error.name: -unit * (error.effect.how(m, elapsed)[0] + zero)
            for error, _, unit in self._errors
        }

    def of_coefficients(self) -> dict[str, Array]:
        """Return the derivatives (J K, J) of the coefficients of the true motion by each error.

        The spline through the errors at K instants is the error for all but once-a-turn errors,
        and close to those.
        """
        if not self._errors:
            return {}
        times, to_coefficients = self._joints.sites
        K, J = self._joints.coefficients.shape
        derivatives, each = {}, np.arange(J)
        for name, by in self.by_errors(times).items():
            of_each = np.zeros((J, K, J))
            of_each[each, :, each] = (to_coefficients @ by).T
            derivatives[name] = of_each.reshape(J * K, J)
        return derivatives
