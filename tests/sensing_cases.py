"""What tests of the sensors' estimators share: a small spacecraft, its motion, its sensors."""

from dataclasses import dataclass, replace

import numpy as np
from model_parts import joint, link, moments, urdf
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from cpid_drake import Identification, InertialParameters, Motion, Spacecraft
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.logs.log import Log, Samples, ideal_log
from cpid_drake.sensors.sensors import (
    SENSORS,
    AttitudeSensor,
    Gyro,
    JointSensor,
    VectorSensor,
)
from cpid_drake.sensors.suite import SensorSuite

MOMENTUM = np.array([30.0, -20.0, 25.0, 4.0, 2.0, -3.0])
"""Total momentum [L; P] of a tumbling capture about W's origin, in W [N·m·s, N·s]."""

RPY = (0.3, -0.2, 0.4)
"""Attitude of every joint's frame on its parent, as in URDF."""


FREE = {"limits": (-9, 9), "velocity": 5}
"""Limits of joints that no motion reaches."""


def mimic(leader: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    """Return what makes a joint of URDF follow another one."""
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/></joint>'


def _following(text: str, *how) -> str:
    return text.replace("</joint>", mimic(*how))


_PARTS = {
    "arm": (
        link("base", 400.0, com="0.05 -0.02 0.1", **moments(60.0, 70.0, 50.0)),
        link("boom", 15.0, com="0.3 0.0 0.1", **moments(0.5, 2.0, 2.1)),
        link("tube", 10.0, com="0.2 0.1 0.0", **moments(0.3, 1.0, 1.1)),
        link("wrist", 6.0, com="0.1 0.0 0.05", **moments(0.1, 0.2, 0.2)),
        link("hand", 5.0, com="0.0 0.1 0.1", **moments(0.1, 0.1, 0.1)),
        joint("shoulder", "base", "boom", "revolute", "0 0 1", "0.6 0.1 0.2", **FREE),
        joint("slide", "boom", "tube", "prismatic", "0.8 0 0.6", "0.5 0.0 0.1", **FREE),
        joint("elbow", "tube", "wrist", "revolute", "0 1 0", "0.4 0.1 0.0", **FREE),
        joint("roll", "wrist", "hand", "revolute", "0.6 0.8 0", "0.3 0.0 0.0", **FREE),
    ),
    "wheels": (
        link("wheel_x", 4.0, com="0 0 0", com_rpy="0 0 0", **moments(0.04, 0.03, 0.03)),
        link("wheel_y", 4.0, com="0 0 0", com_rpy="0 0 0", **moments(0.03, 0.05, 0.03)),
        joint("spin_x", "base", "wheel_x", "continuous", "1 0 0", "0.2 0.0 -0.3", **FREE),
        joint("spin_y", "base", "wheel_y", "continuous", "0 1 0", "-0.2 0.1 -0.3", **FREE),
    ),
    "gripper": (
        link("finger", 2.0, com="0.02 0.1 0.0", **moments(0.02, 0.01, 0.02)),
        link("thumb", 3.0, com="0.0 0.1 0.1", **moments(0.03, 0.02, 0.02)),
        link("tip", 1.5, com="0.1 0.0 0.05", **moments(0.01, 0.01, 0.01)),
        link("strut", 20.0, com="0.0 0.3 0.2", **moments(0.9, 0.8, 0.3)),
        joint("grip", "hand", "finger", "prismatic", "0 1 0", "0.1 0.1 0.0", **FREE),
        _following(
            joint("oppose", "hand", "thumb", "prismatic", "0 1 0", "0.1 -0.1 0.0", **FREE),
            *("grip", -1.5, 0.03),
        ),
        _following(
            joint("bend", "thumb", "tip", "revolute", "0.6 0 0.8", "0.1 0.0 0.1", **FREE),
            *("oppose", 2.0, 0.4),
        ),
        _following(
            joint("fold", "base", "strut", "revolute", "0 0.8 0.6", "-0.5 0.0 0.2", **FREE),
            *("shoulder", -0.5, -0.3),
        ),
    ),
}


def small_craft(folder, *, wheels: bool = False, gripper: bool = False) -> Spacecraft:
    """Return a base with an arm of three turning joints and a sliding one, and reaction wheels.

    A gripper has two fingers that slide and a knuckle that turns with them, at the hand, and a boom
    of the base follows the shoulder: two coordinates more in the plant than in the spacecraft.
    """
    path = folder / "craft.urdf"
    parts = [*_PARTS["arm"]]
    for name, is_there in (("wheels", wheels), ("gripper", gripper)):
        parts += _PARTS[name] if is_there else ()
    parts = "".join(parts)
    path.write_text(urdf(parts, name="craft"))
    return Spacecraft(path, base="base", capture_frame="hand")


@dataclass(frozen=True, eq=False)
class Sines:
    """Every joint a sum of two sines; it moves from the start on."""

    middle: NDArray[np.float64]
    amplitude: NDArray[np.float64]
    phase: NDArray[np.float64]
    frequency: NDArray[np.float64]
    duration: float

    @classmethod
    def drawn(cls, joints: int, seed: int, duration: float, size: float = 0.4) -> "Sines":
        """Return one whose amplitudes and phases a seed fixes; 0.1 Hz and 0.23 Hz."""
        rng = np.random.default_rng(seed)
        return cls(
            rng.uniform(-0.5, 0.5, joints),
            size * rng.uniform(0.5, 1.0, (2, joints)),
            rng.uniform(0.0, 2 * np.pi, (2, joints)),
            2 * np.pi * np.array([[0.1], [0.23]]),
            duration,
        )

    def evaluate(self, time: ArrayLike) -> NDArray[np.float64]:
        t = np.asarray(time, dtype=float)[..., None, None]
        angle, a, w = self.frequency * t + self.phase, self.amplitude, self.frequency
        q = self.middle + (a * np.sin(angle)).sum(-2)
        qdot, qddot = (a * w * np.cos(angle)).sum(-2), -(a * w**2 * np.sin(angle)).sum(-2)
        return np.stack([q, qdot, qddot], axis=-2)

    def breaks(self):
        return np.empty(0)


def true_telemetry(tree, joint_names, motion, target, times, momentum_W=None) -> Motion:
    """Return the true motion at increasing times, by `propagate` from W's origin at 0 s."""
    times = np.asarray(times, dtype=float)
    later = int(times[0] > 0)
    times = np.append(0.0, times) if later else times
    phi = target.to_standard_vector()
    momentum_W = np.zeros(6) if momentum_W is None else momentum_W
    base = propagate(tree, motion, phi, times, momentum_W=momentum_W)
    return base.to_motion(joint_names, times, motion).select(slice(later, None))


def measured(
    spacecraft: Spacecraft,
    motion,
    target: InertialParameters,
    suite: SensorSuite,
    momentum_W=None,
    tree=None,
) -> Log:
    """Return what the sensors would give without noise; of a spacecraft that is `tree` in truth."""
    tree, names = tree or spacecraft.tree, spacecraft.joint_names
    return ideal_log(
        suite,
        names,
        lambda times: true_telemetry(tree, names, motion, target, times, momentum_W),
        motion.duration,
    )


def true_psi(spacecraft: Spacecraft, target: InertialParameters) -> NDArray[np.float64]:
    return relative_parameterization(spacecraft.mass).from_parameters(target.to_vector())


def momentum_about_com(
    spacecraft: Spacecraft, motion, target: InertialParameters, momentum_W: NDArray[np.float64]
) -> TotalMomentum:
    """Return a momentum [L; P] about W's origin, where the base starts, as one about the Scm."""
    q = motion.evaluate(0.0)[0]
    return TotalMomentum.with_base_at_origin(spacecraft.tree, target, q, momentum_W)


def coarse_suite(**changes) -> SensorSuite:
    """Return sensors of flight quality, slow for speed."""
    sensors = {
        "attitude": AttitudeSensor(5.0, 5.0, 40.0, np.array([0.0, 0.6, 0.8])),
        "gyro": Gyro(20.0, 0.005, 1.0, 0.1),
        "position": VectorSensor(5.0, 1e-3),
        "encoders": JointSensor(20.0, 1e-5),
    }
    return SensorSuite("coarse", **(sensors | changes)).exact()


def every_sensor(**changes) -> SensorSuite:
    """Return all sensors, at rates that do not divide each other."""
    suite = SensorSuite(
        attitude=AttitudeSensor(rate=4.0, cross_boresight_arcsec=5.0, boresight_arcsec=40.0),
        gyro=Gyro(rate=100.0, angle_random_walk=0.07, bias=1.0, bias_random_walk=0.5),
        position=VectorSensor(rate=10.0, sigma=1e-3),
        velocity=VectorSensor(rate=7.0, sigma=1e-3),
        encoders=JointSensor(rate=30.0, bits=17),
        joint_rates=JointSensor(rate=3.0, sigma=1e-4),
    )
    return replace(suite, **changes).exact()


def log_of(telemetry, decimals=None) -> Log:
    """Return a log of all quantities at common times, rounded to a number of decimals."""
    samples = {}
    for name in SENSORS:
        value = SENSORS[name].ideal(telemetry)
        samples[name] = Samples(
            telemetry.time, value if decimals is None else np.round(value, decimals)
        )
    return Log(telemetry.joint_names, samples)


def sigmas(found: Identification) -> NDArray[np.float64]:
    """Return the σ (10,) of an estimate."""
    return np.sqrt(np.diag(found.covariance))


def nees(found: Identification, target: InertialParameters) -> float:
    """Return the squared error of what is known, in units of its covariance."""
    error = found.parameters - target.to_vector()
    known = np.isfinite(error)
    return float(
        error[known] @ np.linalg.solve(found.covariance[np.ix_(known, known)], error[known])
    )


def with_drawn_errors(suite: SensorSuite, ideal: Log, draw) -> Log:
    """Return samples with errors `draw(times, shape)` in units of σ; of attitudes in S."""
    samples = {}
    for name in suite.present():
        each = ideal[name]
        is_attitude = hasattr(suite[name], "R_BS")
        shape = len(each), 3 if is_attitude else each.value.shape[1]
        error = draw(each.time, shape) * suite.sigmas(name)
        if is_attitude:
            turn = Rotation.from_rotvec(error @ suite[name].R_BS.T)
            R_WB = Rotation.from_quat(each.value, scalar_first=True) * turn
            value = R_WB.as_quat(scalar_first=True)
        else:
            value = each.value + error
        samples[name] = Samples(each.time, value)
    return ideal.updated(samples)


def gauss_markov(rng, times, shape, tau):
    """Return noise (N, d) of variance 1 at any times, by its own recursion."""
    noise = rng.standard_normal(shape)
    for k in range(1, len(times)):
        rho = np.exp(-(times[k] - times[k - 1]) / tau)
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    return noise
