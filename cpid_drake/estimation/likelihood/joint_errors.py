"""Errors of encoders: by how much measured positions of joints are larger than true ones.

Of a measured position m, at a time t since the origin, the error is

    zero + t drift + m scale + sin(m) sine + cos(m) cosine,

so the true motion follows from the measured one without a solution of equations. A scale is that
of gears or belts, sine and cosine those of a disc beside its axis: once a turn. Measured rates have
the rate of this error.
"""

from collections.abc import Callable

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.likelihood.constants import (
    COSINE,
    DRIFT,
    JOINT_SCALE,
    SINE,
    ZERO,
    Constants,
)
from cpid_drake.estimation.likelihood.joint_model import JointPart

Shape = Callable[[Array, Array], tuple[Array | float, Array | float, Array | float]]
"""Returns a unit of a kind of error, and its derivatives by position and time, of both."""

_SHAPES: dict[str, Shape] = {
    ZERO: lambda m, t: (1.0, 0.0, 0.0),
    DRIFT: lambda m, t: (t, 0.0, 1.0),
    JOINT_SCALE: lambda m, t: (m, 1.0, 0.0),
    SINE: lambda m, t: (np.sin(m), np.cos(m), 0.0),
    COSINE: lambda m, t: (np.cos(m), -np.sin(m), 0.0),
}


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
        self._joints, self._errors, self._origin = joints, constants.of_joints, origin
        self._units = dict[str, Array]()
        for error in self._errors:
            unit = np.full(error.size, error.sigma)
            if error.kind in (SINE, COSINE):
                unit[[b.joint for b, wheel in zip(tree.bodies, tree.wheels) if wheel]] = 0.0
            self._units[error.name] = unit
        self._nominal = [nominal[constants.place(error.name)] for error in self._errors]

    def motion(self, times: Array) -> Array:
        """Return true positions and rates (M, 2, J) at times (M,) [s]."""
        samples = self._joints.evaluate(times)
        if not self._errors:
            return samples
        m, rate, elapsed = samples[:, 0], samples[:, 1], (times - self._origin)[:, None]
        errors = np.zeros_like(samples)
        for error, nominal in zip(self._errors, self._nominal, strict=True):
            value = self._units[error.name] * nominal
            unit, by_m, by_time = _SHAPES[error.kind](m, elapsed)
            errors[:, 0] += value * unit
            errors[:, 1] += value * (by_m * rate + by_time)
        return samples - errors

    def by_errors(self, times: Array) -> dict[str, Array]:
        """Return the derivative (M, J) of each true position by the errors of its own joint."""
        if not self._errors:
            return {}
        m = self._joints.basis(times) @ self._joints.coefficients
        elapsed = (times - self._origin)[:, None]
        return {
            e.name: -self._units[e.name] * (_SHAPES[e.kind](m, elapsed)[0] + np.zeros_like(m))
            for e in self._errors
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
