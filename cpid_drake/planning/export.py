"""Joint motions as tables for a robot's controller."""

import csv
import io

import numpy as np

from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.errors import InputError


def motion_table(motion: JointMotion, joint_names: tuple[str, ...], rate: float) -> str:
    """Return a motion as CSV: time, positions, rates and accelerations of all joints.

    The columns are `time`, `q:JOINT`, `qd:JOINT` and `qdd:JOINT` [s, rad or m], as in telemetry.
    The last row is at the end of the motion.

    Args:
        motion: the motion.
        joint_names: its J joints.
        rate: rows per second [Hz].

    Raises:
        InputError: the rate is not positive, or there are more than a million rows.

    """
    if not (np.isfinite(rate) and rate > 0 and motion.duration * rate < 1e6):
        raise InputError(
            f"{rate:g} rows per second: give a rate > 0 with at most a million rows in "
            f"{motion.duration:g} s"
        )
    times = np.arange(int(motion.duration * rate * (1 + 1e-12)) + 1) / rate
    if motion.duration - times[-1] > 1e-9 * motion.duration:
        times = np.append(times, motion.duration)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    prefixes = ("q:", "qd:", "qdd:")
    writer.writerow(["time", *(prefix + name for prefix in prefixes for name in joint_names)])
    for time, values in zip(times, motion.evaluate(times), strict=True):
        writer.writerow([f"{time:.12g}", *(f"{value:.12g}" for value in values.ravel())])
    return stream.getvalue()
