"""White torque and acceleration as effects on a block, and the reading that is their prior."""

import numpy as np
from numpy.typing import NDArray

from cpid_drake.estimation.likelihood.effects import Effect, MotionChange
from cpid_drake.estimation.likelihood.motion import BaseMotion, Trajectory
from cpid_drake.estimation.likelihood.white_force import TORQUE_NOISE, WhiteForce
from cpid_drake.logs.log import Samples


class White(Effect):
    """A white force; nothing of it continues in the next block."""

    def __init__(self, motion: BaseMotion, force: WhiteForce) -> None:
        self.force = force

        def change_motion(trajectory: Trajectory, change: MotionChange) -> None:
            if force.name == TORQUE_NOISE:
                Rt = np.swapaxes(trajectory.R, -1, -2)
                change.w[:] = trajectory.inverse @ (Rt @ force.impulse(motion.times))
                return
            assert change.position is not None
            assert change.velocity is not None
            change.position[:] = force.travel(motion.times)
            change.velocity[:] = force.impulse(motion.times)

        super().__init__(force.name, force.size, change_motion)

    @property
    def at_start(self) -> NDArray[np.intp]:
        """See `Effect`."""
        return np.empty(0, dtype=np.intp)

    @property
    def at_end(self) -> NDArray[np.intp]:
        """See `Effect`."""
        return np.empty(0, dtype=np.intp)

    def change_reading(
        self, sensor: str, times: NDArray[np.float64], rows: NDArray[np.float64]
    ) -> None:
        """See `Effect`."""
        if sensor == self.name:
            rows += np.eye(self.size).reshape(rows.shape)


class WhiteReading:
    """The prior of a white force: it reads zero. It has the methods of a sensor's model."""

    at_instants = False

    def __init__(self, force: WhiteForce) -> None:
        self._force = force
        shape = force.pieces, force.size // force.pieces
        zeros = np.zeros(shape)
        self.samples = Samples(np.asarray(force.middles, dtype=np.float64), zeros)

    def residuals(self, trajectory: Trajectory) -> NDArray[np.float64]:
        """See `SensorModel`."""
        forces = trajectory.state.forces[self._force.rows]
        return np.asarray(-forces.reshape(self.samples.value.shape))

    def whitened(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `SensorModel`."""
        return values

    def jacobian(
        self, trajectory: Trajectory, change: MotionChange, xi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `SensorModel`; only the force itself changes its reading."""
        return np.zeros((*self.samples.value.shape, xi.shape[-1]))

    def by_constants(self, trajectory: Trajectory) -> dict[str, NDArray[np.float64]]:
        """See `SensorModel`."""
        return {}
