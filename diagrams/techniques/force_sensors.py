"""Sensors of forces, torques and accelerations: what the momentum techniques do not need."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from cpid_drake import InputError
from cpid_drake.files.checked_yaml import load_yaml
from cpid_drake.files.constraints import Limits

Array = NDArray[np.float64]
Size = Annotated[float, Limits(ge=0)]
Sizes = Annotated[list[Size], Limits(min_length=1)]
Pair = Annotated[list[Annotated[float, Limits(gt=0)]], Limits(min_length=2, max_length=2)]

RATE = 100.0
"""Samples per second of these sensors [Hz]: the rate of the encoders of the shipped suites, so that
no technique has more samples than another."""

LABORATORY = Path(__file__).with_name("laboratory.yaml")
"""The file of sensors of this study."""


@dataclass
class Accelerometer:
    """Three accelerometers at the base frame's origin: noise [m/s²/√Hz] and σ of the bias."""

    noise_density: Size
    bias: Size


@dataclass
class Wrist:
    """A force/torque sensor at the capture point: of torque and force each, the range, σ.

    σ is that of the noise of a sample and that of the zero.
    """

    name: Annotated[str, Limits(min_length=1)]
    range: Pair
    noise: Pair
    zero: Pair

    @property
    def ratios(self) -> Array:
        """(6, 6) ratios of the ranges: a calibration error of the same size in each entry."""
        ranges = np.repeat(self.range, 3)
        return np.asarray(ranges[:, None] / ranges)


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
    joint_torques: Sizes
    wrists: Annotated[list[Wrist], Limits(min_length=1)]
    calibrations: Sizes = field(default_factory=lambda: [0.0])

    def wrist_for(self, wrench: Array) -> Wrist:
        """Return the smallest wrist sensor that measures a wrench (N, 6), [n; f].

        A larger range has more noise; a smaller one would make the technique look better than it
        can be.

        Raises:
            InputError: the largest is overloaded.

        """
        torque, force = np.abs(wrench[:, :3]).max(), np.abs(wrench[:, 3:]).max()
        for wrist in self.wrists:
            if (overload := max(torque / wrist.range[0], force / wrist.range[1])) <= 1.0:
                return wrist
        raise InputError(
            f"wrist sensor '{wrist.name}' is overloaded by a factor of {overload:.2g}: the motion "
            f"needs {force:.3g} N, {torque:.3g} N·m; choose a sensor of a larger range, or a slower"
            " motion"
        )


def load_force_sensors(path: str | Path = LABORATORY) -> ForceSensors:
    """Return the sensors of a YAML file.

    Raises:
        InputError: no such file, not YAML, unknown keys or values of the wrong type.

    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    return load_yaml(ForceSensors, Path(path), str(path), "force sensors")
