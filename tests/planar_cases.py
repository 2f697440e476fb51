"""What tests of motion on a table share: a spacecraft whose joints turn about the normal."""

import numpy as np
from sensing_cases import Sines, measured

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
)
DURATION = 12.0


def _link(name: str, mass: float, com: str, inertia: str) -> str:
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    values = " ".join(f'{n}="{v}"' for n, v in zip(names, inertia.split()))
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f"<inertia {values}/></inertial></link>"
    )


def _joint(name: str, parent: str, child: str, xyz: str, kind: str = "revolute", rpy="0 0 0"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
        '<limit lower="-9" upper="9" effort="10" velocity="5"/></joint>'
    )


def planar_craft(folder, *, grip_rpy: str = "0 0 0.7", wrist_rpy: str = "0 0 0") -> Spacecraft:
    """Return a base of 11 kg with an arm of three joints about z, and C turned by `grip_rpy`."""
    parts = [
        _link("base", 11.0, "0.02 -0.01 0.05", "0.25 0.3 0.28 0.01 0.02 -0.03"),
        _link("upper", 1.2, "0.15 0.01 0.03", "0.003 0.02 0.02 0 0.004 0"),
        _link("fore", 0.9, "0.12 -0.01 0.02", "0.002 0.01 0.01 0 0 0.001"),
        _link("hand", 0.4, "0.04 0 0.01", "0.001 0.001 0.001 0 0 0"),
        '<link name="grip"/>',
        _joint("shoulder", "base", "upper", "0.2 0.05 0.1"),
        _joint("elbow", "upper", "fore", "0.32 0 0.02"),
        _joint("wrist", "fore", "hand", "0.28 0 -0.01", rpy=wrist_rpy),
        _joint("hold", "hand", "grip", "0.08 0.01 0.02", "fixed", grip_rpy),
    ]
    path = folder / "planar.urdf"
    path.write_text(f'<?xml version="1.0"?><robot name="planar">{"".join(parts)}</robot>')
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
