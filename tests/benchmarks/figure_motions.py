"""Joint motions and spacecraft that no shipped scenario has."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpid_drake.dynamics.joint_motion import JointMotion, MultiSine
from cpid_drake.scenario.schema import SpacecraftConfig


@dataclass(frozen=True, eq=False)
class Delayed:
    """A motion that starts later; before, the joints keep its first positions [s]."""

    motion: JointMotion
    delay: float

    @property
    def duration(self) -> float:
        """Duration with the delay [s]."""
        return self.motion.duration + self.delay

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        return self.motion.evaluate(np.asarray(time, dtype=float) - self.delay)


@dataclass(frozen=True, eq=False)
class Spinning:
    """A motion of which some joints also spin, at ω(t) = speed + swing sin(2π f t).

    Attributes:
        motion: the motion of all joints without the spin.
        speed: (J,) mean rates [rad/s].
        swing: (J,) amplitudes of the change of the rates [rad/s].
        frequency: f [Hz].

    """

    motion: JointMotion
    speed: NDArray[np.float64]
    swing: NDArray[np.float64]
    frequency: float = 0.05

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.motion.duration

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return positions, rates and accelerations (..., 3, J) at times (...)."""
        t = np.asarray(time, dtype=float)[..., None]
        w = 2 * np.pi * self.frequency
        q = self.speed * t + self.swing * (1 - np.cos(w * t)) / w
        qdot = self.speed + self.swing * np.sin(w * t)
        qddot = self.swing * w * np.cos(w * t)
        return self.motion.evaluate(time) + np.stack([q, qdot, qddot], axis=-2)


def sines(
    joints: tuple[str, ...],
    centre: dict[str, float],
    amplitudes: dict[str, tuple[float, float]],
    duration: float = 10.0,
) -> MultiSine:
    """Return a motion at 0.15 and 0.35 Hz; the phases are drawn from a fixed seed."""
    size = np.array([amplitudes.get(name, (0.0, 0.0)) for name in joints]).T
    return MultiSine(
        centre=np.array([centre.get(name, 0.0) for name in joints]),
        amplitudes=size,
        frequencies=np.array([0.15, 0.35]),
        phases=np.random.default_rng(11).uniform(-np.pi, np.pi, size.shape),
        ramp=3.0,
        duration=duration,
    )


def write_spacecraft(folder: Path, *arms: str) -> SpacecraftConfig:
    """Write the URDF of a base with arms, and return the spacecraft; the first arm captures.

    Args:
        folder: of the file.
        arms: one string for each arm, with one letter for each joint: the axis x, y or z of a
            revolute joint, or X, Y or Z of a prismatic one. The joints are `arm1_joint1`, …

    """
    places = ((0.6, -0.4, 0.0, 0.0), (0.6, 0.5, 0.2, 0.4), (-0.6, 0.1, -0.3, 2.8))
    parts = [_link("base", 700.0, (0.02, -0.03, 0.05), (190.0, 210.0, 240.0))]
    for a, letters in enumerate(arms, start=1):
        parent, (x, y, z, yaw) = "base", places[a - 1]
        for k, letter in enumerate(letters, start=1):
            child = "hand" if a == 1 and k == len(letters) else f"arm{a}_link{k}"
            mass = 14.0 - 2.0 * k
            moments = (0.1, 0.1 + mass * 0.03, 0.1 + mass * 0.03)
            parts += [
                _link(child, mass, (0.3, 0.01, -0.02), moments),
                _joint(f"arm{a}_joint{k}", parent, child, letter, (x, y, z), yaw),
            ]
            parent, (x, y, z, yaw) = child, (0.6, 0.0, 0.0, 0.0)
    path = folder / f"{'_'.join(arms)}.urdf"
    text = f'<?xml version="1.0"?>\n<robot name="craft">\n{chr(10).join(parts)}\n</robot>\n'
    path.write_text(text, encoding="utf-8")
    return SpacecraftConfig(str(path), base="base", capture_frame="hand")


def arm_motion(joints: tuple[str, ...], arms: tuple[str, ...], duration: float) -> MultiSine:
    """Return a motion of all joints of `write_spacecraft`, drawn from a fixed seed."""
    rng = np.random.default_rng(5)
    letters = {
        f"arm{a}_joint{k}": letter
        for a, arm in enumerate(arms, start=1)
        for k, letter in enumerate(arm, start=1)
    }
    size = np.array([0.3 if letters[name].isupper() else 1.0 for name in joints])
    centre = size * rng.uniform(-0.8, 0.8, len(joints))
    amplitudes = size * rng.uniform(0.1, 0.45, (2, len(joints)))
    return sines(
        joints, dict(zip(joints, centre)), dict(zip(joints, map(tuple, amplitudes.T))), duration
    )


def _link(
    name: str, mass: float, com: tuple[float, ...], moments: tuple[float, float, float]
) -> str:
    xx, yy, zz = moments
    return (
        f'<link name="{name}"><inertial><origin xyz="{_text(com)}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(
    name: str, parent: str, child: str, letter: str, place: tuple[float, float, float], yaw: float
) -> str:
    kind = "prismatic" if letter.isupper() else "revolute"
    axis = _text(float(letter.lower() == each) for each in "xyz")
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{_text(place)}" rpy="0 0 {yaw}"/><axis xyz="{axis}"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="5"/></joint>'
    )


def _text(numbers) -> str:
    return " ".join(map(str, numbers))
