"""What tests of motion on a table share: a spacecraft whose joints turn about the normal."""

from functools import partial

import numpy as np
from model_parts import joint, link, moments, urdf
from sensing_cases import FREE, Sines, measured

from cpid_drake import InertialParameters, Spacecraft
from cpid_drake.logs.log import Log
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, JointSensor, VectorSensor
from cpid_drake.sensors.suite import SensorSuite

TARGET = InertialParameters(
    2.5, [0.18, -0.07, 0.12], [[0.09, 0.01, -0.03], [0.01, 0.08, 0.02], [-0.03, 0.02, 0.07]]
)
"""Above the plane, and with products of inertia: free, it would tilt the spacecraft."""

KNOWN = [0, 1, 2, 6]
"""Places of m, cx, cy and Izz: what motion in C's xy plane shows."""

SUITE = SensorSuite(
    "motion capture",
    attitude=AttitudeSensor(10.0, 200.0, 200.0),
    position=VectorSensor(10.0, 5e-4),
    encoders=JointSensor(50.0, 2e-4),
    unstated="exact",
)
DURATION = 12.0


def planar_craft(folder, *, grip_rpy: str = "0 0 0.7", wrist_rpy: str = "0 0 0") -> Spacecraft:
    """Return a base of 11 kg with an arm of three joints about z, and C turned by `grip_rpy`."""
    hinge = partial(joint, axis="0 0 1", rpy="0 0 0", **FREE)
    body = partial(link, com_rpy="0 0 0")
    parts = [
        body("base", 11.0, "", "0.02 -0.01 0.05", **moments(0.25, 0.3, 0.28, 0.01, 0.02, -0.03)),
        body("upper", 1.2, "", "0.15 0.01 0.03", **moments(0.003, 0.02, 0.02, 0, 0.004, 0)),
        body("fore", 0.9, "", "0.12 -0.01 0.02", **moments(0.002, 0.01, 0.01, 0, 0, 0.001)),
        body("hand", 0.4, "", "0.04 0 0.01", **moments(0.001, 0.001, 0.001)),
        '<link name="grip"/>',
        hinge("shoulder", "base", "upper", xyz="0.2 0.05 0.1"),
        hinge("elbow", "upper", "fore", xyz="0.32 0 0.02"),
        hinge("wrist", "fore", "hand", xyz="0.28 0 -0.01", rpy=wrist_rpy),
        hinge("hold", "hand", "grip", "fixed", xyz="0.08 0.01 0.02", rpy=grip_rpy),
    ]
    path = folder / "planar.urdf"
    path.write_text(urdf(*parts, name="planar"))
    return Spacecraft(path, base="base", capture_frame="grip")


def motion(seed: int = 0, duration: float = DURATION) -> Sines:
    return Sines.drawn(3, seed, duration, size=0.7)


def samples(craft: Spacecraft, seed: int, suite: SensorSuite = SUITE, **changes) -> Log:
    """Return noisy samples of the motion on the table."""
    ideal = measured(craft.on_table(), motion(), TARGET, suite, **changes)
    return add_noise(suite, ideal, seed)


def errors(found) -> np.ndarray:
    """Return the errors of the four in units of their σ."""
    error = found.parameters - TARGET.to_vector()
    return (error / np.sqrt(np.diag(found.covariance)))[KNOWN]
