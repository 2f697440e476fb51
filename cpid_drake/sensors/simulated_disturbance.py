"""Simulated external forces and torques: values that a seed determines."""

from collections.abc import Iterator

import numpy as np

from cpid_drake.array import Array
from cpid_drake.sensors.disturbances import Disturbances

WALK_PERIOD = 0.5
"""Simulated random walks and white forces change in steps of this period [s]."""


def random_stream(seed: int, *key: int) -> np.random.Generator:
    """Return the generator of one stream; it differs from `numpy.random.default_rng(seed)`.

    Args:
        seed: a whole number >= 0.
        key: whole numbers >= 0. Keys of different length never give the same stream: one number
            for errors that differ from sample to sample, two for constant errors of a sensor and
            its dropouts, and three for disturbances.

    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


class SimulatedDisturbance:
    """Values of torque and acceleration as a function of time, which a seed determines.

    Attributes:
        thrust_scale: error of the scale of logged thrust; see `Disturbances`.

    Args:
        disturbances: their σ; None for no disturbances but the given ones.
        seed: a whole number >= 0.
        torque_W: (3,) constant torque about the system's centre of mass, in W, which replaces the
            random one [N·m].
        acceleration_W: (3,) constant acceleration of this centre, in W, which replaces the random
            one [m/s²].

    """

    def __init__(
        self,
        disturbances: Disturbances | None,
        seed: int = 0,
        *,
        torque_W: Array | None = None,
        acceleration_W: Array | None = None,
    ) -> None:
        size = disturbances or Disturbances()
        self._seed = int(seed)

        def stated(kind: str) -> Array:
            sigmas = [getattr(size, f"{name}{kind}") or 0.0 for name in ("torque", "acceleration")]
            return np.repeat(sigmas, 3)

        self._walk, self._noise = stated("_walk"), stated("_noise")
        self._constant = stated("") * self._normal(0, 1)[0]
        for part, given in ((slice(0, 3), torque_W), (slice(3, 6), acceleration_W)):
            if given is not None:
                self._constant[part] = given
        self._pieces = np.empty((0, 6))
        self.thrust_scale = float((size.thrust_scale or 0.0) * self._normal(2, 1)[0, 0])

    @property
    def is_zero(self) -> bool:
        """Whether torque and acceleration are zero at all times."""
        return not (self._constant.any() or self.walks)

    @property
    def walks(self) -> bool:
        """Whether torque or acceleration change with time."""
        return bool(self._walk.any() or self._noise.any())

    def piece(self, number: int) -> Array:
        """Return [torque; acceleration] (6,) from number * `WALK_PERIOD` to the next multiple.

        Torque about the system's centre of mass and acceleration of this centre, in W [N·m, m/s²].
        The random walk starts at zero.
        """
        if not self.walks:
            return np.asarray(self._constant)
        pieces = self._pieces  # other threads may write it meanwhile
        if number >= len(pieces):
            count = max(64, 2 * number)
            steps = self._walk * np.sqrt(WALK_PERIOD) * self._normal(1, count)
            walk = np.cumsum(steps, axis=0)
            pieces = self._constant + np.vstack([np.zeros(6), walk])
            pieces += self._noise / np.sqrt(WALK_PERIOD) * self._normal(3, count + 1)
            self._pieces = pieces
        return np.asarray(pieces[number])

    def at(self, time: float) -> Array:
        """Return [torque; acceleration] (6,) just after a time [s]; see `piece`."""
        return self.piece(int(np.floor(max(time, 0.0) / WALK_PERIOD + 1e-9)))

    def changes(self, start: float, end: float) -> Iterator[float]:
        """Yield the times between `start` and `end` at which a piece ends [s]."""
        first, last = np.floor(start / WALK_PERIOD) + 1, np.ceil(end / WALK_PERIOD)
        return (float(k * WALK_PERIOD) for k in np.arange(first, last) if self.walks)

    def _normal(self, kind: int, count: int) -> Array:
        """Return (count, 6) numbers: constant values (0), walks (1), scale (2) or noise (3)."""
        return random_stream(self._seed, 0, 0, kind).standard_normal((count, 6))
