"""A scenario: everything a simulated identification needs, as dataclasses and as YAML.

Its values are numbers and names; `cpid_drake.scenario.simulation` turns them into a Drake Diagram.
"""

from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.analysis import SimulatorConfig

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import JointMotion
from cpid_drake.dynamics.sensitivity import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.scenario.joint_motions import (
    HalfCosineMotion,
    JointMotionConfig,
    joint_configuration,
)
from cpid_drake.sensing.presets import load_sensors
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass
class SpacecraftConfig:
    """The known spacecraft: model file, base body and capture frame.

    Files are package:// URIs or paths, which start at the scenario's own folder; `packages` gives
    the folders of further packages by name. `configuration` is where joints stand that the motion
    does not name [rad or m by joint name]; joints that it does not name either stand at zero.
    """

    model: str = ""
    base: str = ""
    capture_frame: str = ""
    packages: dict[str, str] = field(default_factory=dict)
    configuration: dict[str, float] = field(default_factory=dict)


@dataclass
class TargetConfig:
    """The target's truth, for the simulated plant only [kg, m, kg·m²]; a model for its look."""

    mass: float = np.nan
    p_CTcm_C: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    I_TTcm_C: np.ndarray = field(default_factory=lambda: np.full((3, 3), np.nan))
    visual_model: str | None = None


@dataclass
class ControllerConfig:
    """The joint controller: what its model holds at C, and its feedback gains [rad/s, 1].

    If it does not know the target, it takes it for a solid sphere about C's origin [kg, m], whose
    mass must then be given: half or double the true one will do.
    """

    knows_target: bool = True
    nominal_mass: float = 0.0
    nominal_radius: float = 0.5
    natural_frequency: float = 10.0
    damping_ratio: float = 1.0


@dataclass
class SensorsConfig:
    """The spacecraft's sensors in the Diagram, and the seed of their errors.

    `suite` is a preset's name, a package:// URI or a YAML file's path, which starts at the
    scenario's own folder. `explicit` are the sensors themselves, with the keys of such a file. Give
    one of the two; with neither there are none: the identifier then sees the exact state.
    """

    suite: str = ""
    explicit: SensorSuite | None = None
    seed: int = 1

    @property
    def present(self) -> bool:
        """Whether there are sensors."""
        return bool(self.suite) or self.explicit is not None


@dataclass
class PriorConfig:
    """A guess of the target beforehand [kg, m, kg·m²], and how good it is: σ, relative.

    Mass, mass times place and moments of inertia about C's origin are each known to this part of
    the guess's own mass, mass times radius of gyration, and mass times its square.
    """

    mass: float = np.nan
    p_CTcm_C: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    I_TTcm_C: np.ndarray = field(default_factory=lambda: np.full((3, 3), np.nan))
    sigma: float = 0.5

    def guess(self) -> InertialParameters:
        """Return the guessed target."""
        return InertialParameters(self.mass, self.p_CTcm_C, self.I_TTcm_C)


@dataclass
class IdentificationConfig:
    """The identifier: estimator, rows, whether the momentum is unknown, period, first sample [s].

    `estimator` is one of `ONLINE_ESTIMATORS`. Rows, period and offset are those of least squares:
    the momentum filter takes every sample of the sensors, which it needs. `prior` is what the
    momentum filter knows of the target before the first sample; null for nothing.
    """

    estimator: str = "least_squares"
    rows: str = "eq18"
    unknown_momentum: bool = False
    period: float = 1.0
    offset: float = 1.0
    prior: PriorConfig | None = None


@dataclass
class KnownBodiesConfig:
    """How well the spacecraft is known: σ of its bodies' masses, centres of mass and inertias.

    Mass and inertia are relative, `com` is in metres; see `momentum_sensitivity.BodyUncertainty`.
    """

    mass: float = 0.0
    com: float = 0.0
    inertia: float = 0.0


@dataclass
class FiringConfig:
    """A thruster's firing: when [s], and the momentum [L; P] that it adds about W's origin, in W.

    Units: N·m·s and N·s.
    """

    time: float = np.nan
    momentum_W: np.ndarray = field(default_factory=lambda: np.full(6, np.nan))


@dataclass
class AccuracyConfig:
    """Monte Carlo trials with noisy sensors.

    `presets` are sensor suites, named as in `SensorsConfig`. `momentum_known` tells the estimators
    the momentum in `simulation.momentum_W`, which they have to estimate otherwise.
    """

    presets: list[str] = field(default_factory=lambda: ["flight", "servicer", "testbed", "coarse"])
    trials: int = 200
    seed: int = 2016
    momentum_known: bool = False
    firing: FiringConfig | None = None


@dataclass
class SimulationConfig:
    """How long to simulate and how often to log [s], and Drake's simulator settings.

    `momentum_W` is the total momentum [L; P] about W's origin, in W: a tumbling capture's.
    """

    duration: float = 10.0
    momentum_W: np.ndarray = field(default_factory=lambda: np.zeros(6))
    log_period: float = 0.0625
    simulator: SimulatorConfig = field(
        default_factory=lambda: SimulatorConfig(
            integration_scheme="runge_kutta3", max_step_size=0.05, accuracy=1e-9
        )
    )


@dataclass
class Scenario:
    """A simulated identification, from spacecraft to simulator."""

    spacecraft: SpacecraftConfig = field(default_factory=SpacecraftConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    joint_motion: JointMotionConfig = field(default_factory=HalfCosineMotion)
    controller: ControllerConfig = field(default_factory=ControllerConfig)
    sensors: SensorsConfig = field(default_factory=SensorsConfig)
    identification: IdentificationConfig = field(default_factory=IdentificationConfig)
    known_bodies: KnownBodiesConfig = field(default_factory=KnownBodiesConfig)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    accuracy: AccuracyConfig = field(default_factory=AccuracyConfig)

    def make_spacecraft(self) -> Spacecraft:
        """Return the known spacecraft.

        Raises:
            InputError: as `Spacecraft`.

        """
        config = self.spacecraft
        return Spacecraft(
            config.model,
            base=config.base,
            capture_frame=config.capture_frame,
            packages=config.packages,
        )

    def target_truth(self) -> InertialParameters:
        """Return the true target.

        Raises:
            InputError: not numbers of the right shape, or not a rigid body.

        """
        truth = InertialParameters(self.target.mass, self.target.p_CTcm_C, self.target.I_TTcm_C)
        problems = truth.infeasibilities()
        if problems:
            raise InputError(f"target: not a rigid body: {'; '.join(problems)}")
        return truth

    def make_joint_motion(self, spacecraft: Spacecraft) -> JointMotion:
        """Return the joint motion of this spacecraft's joints.

        Raises:
            InputError: unknown joints, positions out of limits, rates above the model's limits, or
                as the motion's own class.

        """
        standing = self.spacecraft.configuration
        joint_configuration(spacecraft, {}, standing, "spacecraft.configuration")
        return self.joint_motion.make(spacecraft, standing)

    def make_suite(self) -> SensorSuite | None:
        """Return the sensors, or None for none.

        Raises:
            InputError: as `sensor_files.load_sensors`.

        """
        if self.sensors.explicit is not None:
            return self.sensors.explicit
        return load_sensors(self.sensors.suite) if self.sensors.suite else None

    def body_uncertainty(self) -> BodyUncertainty | None:
        """Return how well the spacecraft is known, or None if it is known exactly."""
        config = self.known_bodies
        if not (config.mass or config.com or config.inertia):
            return None
        return BodyUncertainty(config.mass, config.com, config.inertia)
