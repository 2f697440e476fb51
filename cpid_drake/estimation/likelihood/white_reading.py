"""The readings of zero that are the priors of white torques and accelerations."""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.rotations import rotate
from cpid_drake.estimation.likelihood.forces import Force
from cpid_drake.estimation.likelihood.kinematic_changes import inertia_changes
from cpid_drake.estimation.likelihood.motion_change import MotionChange
from cpid_drake.estimation.likelihood.motion_model import BaseMotion, Trajectory
from cpid_drake.logs.log import Samples


class WhiteReading:
    """The prior of a white force: it reads zero. It has the methods of a sensor's model.

    Torques of a given size turn a lighter system more. Their prior as unknowns would therefore
    prefer small inertia and weak thrusters, which need smaller torques for the same motion. The
    prior is that of the angular accelerations: with the present inertia J, a torque τ reads
    J J_new⁻¹ τ for that of another target, of joints elsewhere, or of another spacecraft.
    """

    at_instants = False

    def __init__(self, motion: BaseMotion, force: Force) -> None:
        self._force, self._motion = force, motion
        zeros = np.zeros((force.pieces, len(force.axes)))
        self.samples = Samples(np.asarray(force.middles, dtype=np.float64), zeros)

    def residuals(self, trajectory: Trajectory) -> Array:
        """See `SensorModel`."""
        forces = trajectory.state.forces[self._force.rows]
        return np.asarray(-forces.reshape(self.samples.value.shape))

    def by_unknowns(self, trajectory: Trajectory) -> dict[str, Array]:
        """Return the derivatives (M, d, n) of the readings in units of σ; see `SensorModel`.

        They are those by the force itself, and of torques by what the inertia depends on.
        """
        shape = *self.samples.value.shape, self._force.size
        itself = {self._force.name: np.eye(self._force.size).reshape(shape)}
        if not self._force.turns:
            return itself
        forces = trajectory.state.forces[self._force.rows]
        nodes = np.searchsorted(self._motion.nodes, self.samples.time)
        R, axes = trajectory.R[nodes], self._force.axes
        torque = rotate(np.swapaxes(R, -1, -2), forces.reshape(self.samples.value.shape) @ axes)
        acceleration = rotate(trajectory.inverse[nodes], torque)
        by = inertia_changes(trajectory, nodes, acceleration)
        return itself | {name: -axes @ R @ value for name, value in by.items()}

    def normalized(self, values: Array) -> Array:
        """See `SensorModel`."""
        return values

    def jacobian(self, trajectory: Trajectory, change: MotionChange, xi: Array) -> Array:
        """See `SensorModel`; the motion changes nothing."""
        return np.zeros((*self.samples.value.shape, xi.shape[-1]))
