"""Constant errors of sensors: delay, mounting, scale, lever arm and zeros of joints.

A seed determines their values. Every error has its own stream of random numbers, so that an error
does not change the values of the others or the noise of the samples.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.motion import Motion
from cpid_drake.errors import InputError
from cpid_drake.sensors.sensors import (
    ARCSECOND,
    ATTITUDE,
    JOINT_POSITIONS,
    POSITION,
    AttitudeSensor,
    Gyro,
    JointSensor,
    Sensor,
    SensorErrors,
    VectorSensor,
)

KINDS = ("delay", "mounting", "scale", "misalignment", "lever_arm", "zero", "dropouts")
"""What has a random stream of its own for each sensor; a place is the second number of its key."""


def random_stream(seed: int, *key: int) -> np.random.Generator:
    """Return the generator of one stream; it differs from `numpy.random.default_rng(seed)`.

    Args:
        seed: a whole number >= 0.
        key: whole numbers >= 0. Keys of different length never give the same stream:
            (number in the table of sensors) for errors that differ from sample to sample,
            (number in the table, place in `KINDS`) for constant errors of a sensor and its
            dropouts, and three numbers for disturbances.

    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


@dataclass(frozen=True, eq=False)
class ConstantErrors:
    """Values of one sensor's constant errors; those that a sensor cannot have are zero.

    Attributes:
        delay: stamp minus true time of a sample [s].
        mounting_B: (3,) rotation vector ε in B: the measured attitude is R_WB Exp(ε) [rad].
        scale: (3, 3) matrix S: the measured angular velocity is (1 + S) ω. Its diagonal has the
            errors of the axes' scales, its other entries those of their directions.
        lever_arm_B: (3,) position in B of the measured point, from B's origin [m].
        zero: (J,) measured minus true joint positions [rad or m].

    """

    delay: float = 0.0
    mounting_B: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    scale: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    lever_arm_B: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    zero: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))

    def change(
        self, sensor: Sensor, ideal: NDArray[np.float64], motion: Motion | None
    ) -> NDArray[np.float64]:
        """Return samples (N, width) with the errors; the same array if all are zero.

        Args:
            sensor: the sensor.
            ideal: (N, width) samples without errors.
            motion: the true motion at the N samples; only a lever arm needs it.

        Raises:
            InputError: a lever arm without the true motion.

        """
        if sensor.quantity is ATTITUDE and self.mounting_B.any():
            attitude = Rotation.from_quat(ideal, scalar_first=True)
            turned = attitude * Rotation.from_rotvec(self.mounting_B)
            return np.asarray(turned.as_quat(scalar_first=True))
        if self.scale.any():
            return ideal + ideal @ self.scale.T
        if self.lever_arm_B.any():
            if motion is None:
                raise InputError(
                    f"sensor '{sensor.name}': its lever arm needs the true motion at its samples; "
                    "a log from ideal_log contains it"
                )
            arm_W = motion.R_WB @ self.lever_arm_B
            return ideal + (arm_W if sensor.quantity is POSITION else np.cross(motion.w_WB, arm_W))
        return ideal + self.zero if self.zero.any() else ideal


def draw_constant_errors(
    sensor: Sensor, errors: SensorErrors, seed: int, joint_count: int
) -> ConstantErrors:
    """Return the values of a sensor's constant errors that a seed determines.

    Args:
        sensor: the sensor.
        errors: the σ of its errors.
        seed: a whole number >= 0.
        joint_count: number J of joints.

    """

    def normal(kind: str, *shape: int) -> NDArray[np.float64]:
        return random_stream(seed, sensor.stream, KINDS.index(kind)).standard_normal(shape)

    values: dict[str, NDArray[np.float64]] = {}
    if isinstance(errors, AttitudeSensor):
        values["mounting_B"] = errors.mounting_arcsec * ARCSECOND * normal("mounting", 3)
    elif isinstance(errors, Gyro):
        scale = errors.misalignment_arcsec * ARCSECOND * normal("misalignment", 3, 3)
        np.fill_diagonal(scale, errors.scale_ppm * 1e-6 * normal("scale", 3))
        values["scale"] = scale
    elif isinstance(errors, VectorSensor):
        values["lever_arm_B"] = errors.lever_arm_mm * 1e-3 * normal("lever_arm", 3)
    elif isinstance(errors, JointSensor) and sensor.quantity is JOINT_POSITIONS:
        values["zero"] = errors.zero_mrad * 1e-3 * normal("zero", joint_count)
    delay = errors.delay_ms * 1e-3 * float(normal("delay", 1)[0])
    return ConstantErrors(delay, **values)
