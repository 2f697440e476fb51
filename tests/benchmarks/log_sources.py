"""Sources of logs: true motions with sensors, from which clean and spoiled logs are made."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from figure_cases import arms, planar, scenario_case, turning
from numpy.typing import NDArray

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.relative_motion import relative_dynamics
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.noise import add_noise
from cpid_drake.sensing.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.studies.trials import Case, Firing, ideal_samples

RATE = 16.0
"""Rate of exact logs [Hz], as `cpid simulate` writes them."""

EXACT = SensorSuite(
    attitude=AttitudeSensor(RATE),
    gyro=Gyro(RATE),
    position=VectorSensor(RATE),
    velocity=VectorSensor(RATE),
    encoders=JointSensor(RATE),
    joint_rates=JointSensor(RATE),
)
"""All sensors without errors, at the same times."""


@dataclass(frozen=True)
class Source:
    """A true motion with sensors.

    Attributes:
        build: returns the case; its argument is a folder for files of spacecraft.
        sensors: value of `--sensors` that describes the errors of the samples; empty for exact
            logs.
        options: further options that a careful user of `cpid identify` gives.

    """

    build: Callable[[Path], Case]
    sensors: str
    options: tuple[str, ...] = ()


def _shipped(scenario: str, sensors: str, *options: str, **changes) -> Source:
    suite = sensors or EXACT
    return Source(lambda folder: scenario_case(scenario, suite, **changes), sensors, options)


def _three_arms(folder: Path) -> Case:
    return arms(("zyxy", "zyy", "yzy"), folder)


def _exact_planar(folder: Path) -> Case:
    return replace(planar(folder), suite=EXACT)


UNKNOWN = ("--momentum", "unknown")

SOURCES: dict[str, Source] = {
    "arms_exact": _shipped("exciting_motion", ""),
    "arms_flight": _shipped("exciting_motion", "flight"),
    "arms_servicer": _shipped("exciting_motion", "servicer"),
    "arms_testbed": _shipped("exciting_motion", "testbed"),
    "arms_coarse": _shipped("exciting_motion", "coarse"),
    "paper_exact": _shipped("paper", ""),
    "paper_flight": _shipped("paper", "flight"),
    "paper_servicer": _shipped("paper", "servicer"),
    "flyer_exact": _shipped("free_flyer_payload", ""),
    "flyer_testbed": _shipped("free_flyer_payload", "testbed"),
    "flyer_coarse": _shipped("free_flyer_payload", "coarse"),
    "flyer_digits": _shipped("free_flyer_payload", "digits6"),
    "wheels_exact": _shipped("single_arm_wheels", ""),
    "wheels_servicer": _shipped("single_arm_wheels", "servicer"),
    "wheels_flight": _shipped("single_arm_wheels", "flight"),
    "tumbling_exact": _shipped("tumbling_capture", "", *UNKNOWN),
    "tumbling_flight": _shipped("tumbling_capture", "flight", *UNKNOWN),
    "tumbling_servicer": _shipped("tumbling_capture", "servicer", *UNKNOWN),
    "three_arms_flight": Source(_three_arms, "flight"),
    "planar_exact": Source(_exact_planar, ""),
    "planar_flight": Source(planar, "flight"),
}
"""All sources by name."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Changes of the truth that the model or the options of `cpid identify` do not contain.

    Attributes:
        tree: returns the true spacecraft from the model's; None for the model's.
        momentum_W: (6,) total momentum [L; P] about W's origin; None for the source's.
        force_W: (3,) constant force [N] on the system's centre of mass, or on `point_B`.
        point_B: (3,) point of B on which the force acts at the start [m]; None for the centre of
            mass.
        firing: firing of a thruster; None for none.
        suite: returns the true sensors from the suite that the user knows; None for the same.
        turned: angular velocity of B at the start [rad/s], in place of a momentum.

    """

    tree: Callable[[KinematicTree], KinematicTree] | None = None
    momentum_W: tuple[float, ...] | None = None
    force_W: tuple[float, float, float] | None = None
    point_B: tuple[float, float, float] | None = None
    firing: Firing | None = None
    suite: Callable[[SensorSuite], SensorSuite] | None = None
    turned: tuple[float, float, float] | None = None


CLEAN = Motion()


@dataclass(frozen=True, eq=False)
class TrueLog:
    """The case of a source, its spacecraft, and the samples without errors."""

    case: Case
    spacecraft: Spacecraft
    ideal: Measurements

    def noisy(self, seed: int) -> Measurements:
        """Return samples with the errors of the case's suite; the seed determines them."""
        return add_noise(self.case.suite, self.ideal, seed)


class Workshop:
    """Makes true logs, each once.

    Args:
        folder: folder for files of spacecraft.

    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.true_log = cache(self._true_log)
        self._case = cache(self._build)

    def _build(self, source: str) -> tuple[Case, Spacecraft]:
        case = SOURCES[source].build(self._folder)
        return case, case.spacecraft.make()

    def _true_log(self, source: str, motion: Motion = CLEAN) -> TrueLog:
        """Return the true log of a source with changes of the truth."""
        case, spacecraft = self._case(source)
        tree = spacecraft.tree
        if motion.tree is not None:
            tree = motion.tree(tree)
        if motion.suite is not None:
            case = replace(case, suite=motion.suite(case.suite))
        if motion.momentum_W is not None:
            case = replace(case, momentum_W=np.array(motion.momentum_W))
        if motion.turned is not None:
            case = turning(case, np.array(motion.turned), np.zeros(3))
        if motion.force_W is not None:
            point = motion.point_B or tuple(_com(case, tree))
            force = np.array(motion.force_W)
            wrench = np.concatenate([np.cross(point, force), force])
            push = Firing(0.0, wrench * case.duration, case.duration)
            case = replace(case, firings=(push,))
        elif motion.firing is not None:
            case = replace(case, firings=(motion.firing,))
        else:
            case = replace(case, firings=())
        return TrueLog(case, spacecraft, ideal_samples(case, tree, spacecraft.joint_names))


def _com(case: Case, tree: KinematicTree) -> NDArray[np.float64]:
    """Return the system's centre of mass at the start, from B's origin, in B (3,) [m]."""
    psi = relative_parameterization(tree.mass).from_parameters(case.truth.to_vector())
    start = case.motion.evaluate(np.zeros(1))
    return relative_dynamics(tree, start[:, 0], start[:, 1]).com(psi)[0]
