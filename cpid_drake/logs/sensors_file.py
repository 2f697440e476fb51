"""The sensors' file that a log shows: rates, white noise and the gyro's bias, with their origin."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cpid_drake.files.digits import rounded_pair, significant
from cpid_drake.logs.gyro_bias import gyro_bias
from cpid_drake.logs.log import Log
from cpid_drake.logs.noise_estimation import estimate_suite, noise_order
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite

_KEYS = {
    "attitude": ("noise_deg", np.pi / 180, "deg about each axis"),
    "gyro": ("noise_deg_per_s", np.pi / 180, "deg/s in one sample"),
    "position": ("sigma_mm", 1e-3, "mm"),
    "velocity": ("sigma_mm", 1e-3, "mm/s"),
    "encoders": ("sigma", 1.0, "rad or m"),
    "joint_rates": ("sigma", 1.0, "rad/s or m/s"),
}
"""The key of each sensor's white noise, its unit in SI units and radians, and its words."""


@dataclass(frozen=True)
class SensorsFile:
    """A sensors' file that a log shows.

    Attributes:
        text: YAML for `load_sensors`, with the origin of each number as a comment.
        warnings: sentences on what the log does not show well.

    """

    text: str
    warnings: tuple[str, ...]


def sensors_file(log: Log, name: str) -> SensorsFile:
    """Return the sensors' file that a log shows.

    Noise is that of high-order differences, as without any file. Errors that the log alone does not
    show are not stated: an identification takes plausible ones.

    Args:
        log: a screened log.
        name: its name in the text.

    Raises:
        InputError: see `noise_estimation.estimate_suite`.

    """
    suite = estimate_suite(log)
    lines = [
        f"# Sensors of {name}, estimated from it by `cpid log noise`.",
        "# What is not stated, such as delays, mountings and zeros, has a plausible size.",
        f'description: "estimated from {name}"'.replace("\\", "/"),
    ]
    warnings = []
    for sensor in suite.present():
        samples = log[sensor]
        order, has_motion = noise_order(sensor, samples)
        key, unit, words = _KEYS[sensor]
        sigma = significant(float(suite[sensor].sigmas[0]) / unit, 3)
        origin = f"{words}, by differences of order {order} of {len(samples)} samples"
        if has_motion:
            origin += "; motion may be in it"
            warnings.append(
                f"the motion is fast for the rate of the {SENSORS[sensor].quantity}: its noise may "
                f"be smaller than the {sigma} {words} of {key}"
            )
        lines += [
            "",
            f"{sensor}:",
            f"  rate: {significant(suite[sensor].rate, 4)} # Hz, by the median of the intervals",
            f"  {key}: {sigma} # {origin}",
        ]
        if sensor == "gyro":
            lines += _bias_lines(log, suite)
    return SensorsFile("\n".join(lines) + "\n", tuple(warnings))


def _bias_lines(log: Log, suite: SensorSuite) -> Iterator[str]:
    """Yield the lines of the σ of the gyro's bias."""
    bias = gyro_bias(log, suite)
    if bias is None:
        yield "  # The bias is not stated: there is no attitude to compare with."
        return
    is_measured = np.isfinite(bias.value)
    sigma = float(np.degrees(np.max(bias.sigma[is_measured])))
    value = np.degrees(bias.value[is_measured])
    shown = ", ".join(rounded_pair(each, sigma)[0] for each in value)
    size = significant(float(np.degrees(bias.size)))
    yield (
        f"  bias_deg_per_s: {size} # deg/s, by the integral of "
        f"the gyro and the attitude over {significant(bias.seconds, 3)} s: {shown} "
        f"(± {significant(sigma)})"
    )
