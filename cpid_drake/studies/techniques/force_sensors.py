"""Sensors of forces, torques and accelerations: what the momentum techniques do not need."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, MinLen
from numpy.typing import NDArray

from cpid_drake.errors import InputError
from cpid_drake.input_files.validation import load_yaml
from cpid_drake.logs.log import Samples
from cpid_drake.resources import models_directory, resolve_model
from cpid_drake.sensors.disturbances import random_stream
from cpid_drake.spacecraft.spacecraft import Spacecraft

Array = NDArray[np.float64]
Size = Annotated[float, Ge(0)]
Positive = Annotated[float, Gt(0)]

RATE = 100.0
"""Samples per second of these sensors [Hz]: the rate of the encoders of the shipped suites, so that
no technique has more samples than another."""

ACCELERATION, WRENCH, EFFORTS = "acceleration", "wrench", "efforts"
"""Names of their samples: of B's origin in B (N, 3), of the arm on the target about C's origin in C
(N, 6) as [n; f], and of the joints (N, J)."""

SHIPPED = "laboratory"
"""The shipped file of these sensors."""

_STREAM = 100  # random streams that no sensor of a suite has


@dataclass
class Accelerometer:
    """Three accelerometers at the base frame's origin: noise [m/s²/√Hz] and σ of the bias."""

    noise_density: Size
    bias: Size

    @property
    def sigma(self) -> float:
        """Noise of one sample [m/s²]."""
        return self.noise_density * float(np.sqrt(RATE))


@dataclass
class Wrist:
    """A force/torque sensor at the capture point: ranges, noise of a sample, σ of the zeros."""

    name: Annotated[str, MinLen(1)]
    force_range: Positive
    torque_range: Positive
    force_noise: Positive
    torque_noise: Positive
    force_zero: Size
    torque_zero: Size

    @property
    def ranges(self) -> Array:
        """(6,) of [n; f] [N·m, N]."""
        return np.repeat([self.torque_range, self.force_range], 3)

    @property
    def noise(self) -> Array:
        """(6,) σ of one sample of [n; f]."""
        return np.repeat([self.torque_noise, self.force_noise], 3)

    @property
    def zeros(self) -> Array:
        """(6,) σ of the zeros of [n; f]."""
        return np.repeat([self.torque_zero, self.force_zero], 3)

    @property
    def ratios(self) -> Array:
        """(6, 6) ratios of the ranges: a calibration error of the same size in each entry."""
        return self.ranges[:, None] / self.ranges

    def overload(self, wrench: Array) -> float:
        """Return the largest of a wrench (N, 6) as a share of the range."""
        return float(np.max(np.abs(wrench) / self.ranges))


@dataclass
class ForceSensors:
    """The sensors of a file; `wrists` from the smallest range to the largest.

    Attributes:
        accelerometer: of the base.
        joint_torques: noise of a sample and σ of the zero, as shares of full scale; one or more.
        wrists: the sensors to choose from.
        calibrations: relative σ of the entries of a wrist sensor's calibration; one or more.

    """

    accelerometer: Accelerometer
    joint_torques: Annotated[list[Size], MinLen(1)]
    wrists: Annotated[list[Wrist], MinLen(1)]
    calibrations: Annotated[list[Size], MinLen(1)] = field(default_factory=lambda: [0.0])

    def wrist_for(self, wrench: Array) -> Wrist:
        """Return the smallest wrist sensor that measures a wrench (N, 6).

        A larger range has more noise; a smaller one would make the technique look better than it
        can be.

        Raises:
            InputError: the largest is overloaded.

        """
        for wrist in self.wrists:
            if (overload := wrist.overload(wrench)) <= 1.0:
                return wrist
        raise InputError(
            f"wrist sensor '{wrist.name}' is overloaded by a factor of {overload:.2g}: the motion "
            f"needs {np.abs(wrench[:, 3:]).max():.3g} N, {np.abs(wrench[:, :3]).max():.3g} N·m; "
            "choose a sensor of a larger range, or a slower motion"
        )

    def measured(
        self, ideal: Mapping[str, Samples], spacecraft: Spacecraft, seed: int | None
    ) -> dict[str, Samples]:
        """Return what the sensors measure; the seed determines the errors, None is for none.

        Efforts and wrenches of all errors come from the same random numbers. Names are those of
        `effort_name` and `wrench_name`.
        """
        draws: Iterator[Callable[..., Array]] = repeat(np.zeros, 3)
        if seed is not None:
            draws = (random_stream(seed, _STREAM + k).standard_normal for k in range(3))
        found, accelerometer = {}, self.accelerometer
        for (name, exact), draw in zip(ideal.items(), draws, strict=True):
            noise = draw(exact.value.shape)
            zero, calibration = draw(exact.value.shape[1]), draw((6, 6))
            if name == ACCELERATION:
                value = exact.value + accelerometer.sigma * noise + accelerometer.bias * zero
                found[name] = Samples(exact.time, value)
            elif name == EFFORTS:
                for share in self.joint_torques:
                    error = share * spacecraft.limits.efforts * (noise + zero)
                    found[effort_name(share)] = Samples(exact.time, exact.value + error)
            else:
                wrist = self.wrist_for(exact.value)
                error = noise * wrist.noise + zero * wrist.zeros
                for size in self.calibrations:
                    K = size * wrist.ratios * calibration
                    value = exact.value @ (np.eye(6) + K).T + error
                    found[wrench_name(size)] = Samples(exact.time, value)
        return found


def effort_name(share: float) -> str:
    """Return the name of the joint torques with this error."""
    return f"{EFFORTS} {100 * share:g} %"


def wrench_name(calibration: float) -> str:
    """Return the name of the wrench with this error of the calibration."""
    return f"{WRENCH} {100 * calibration:g} %"


def load_force_sensors(name_or_path: str | Path = SHIPPED) -> ForceSensors:
    """Return the shipped sensors, or those of a YAML file.

    Raises:
        InputError: no such file, not YAML, unknown keys or values of the wrong type.

    """
    folder = models_directory() / "force_sensors"
    file = folder / f"{SHIPPED}.yaml" if name_or_path == SHIPPED else resolve_model(name_or_path)
    return load_yaml(ForceSensors, file, str(name_or_path), "force sensors")
