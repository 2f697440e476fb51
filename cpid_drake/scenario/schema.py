"""A scenario: everything that a simulated identification needs, as dataclasses and as YAML.

The declarations state the limits of single values; `checks` has the limits that concern several
values. `simulation` turns a scenario into a Drake Diagram.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Interval, Le, MinLen
from numpy.typing import NDArray

from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.input_files.validation import FirstUnlessTagged, Numbers
from cpid_drake.logs.burns import Burn
from cpid_drake.scenario.joint_motions import AnyMotion, HalfCosineMotion, Motion, MotionFile
from cpid_drake.sensors.disturbances import SimulatedDisturbance
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.compliant_wrist import CompliantWrist
from cpid_drake.spacecraft.sprung_mass import SprungMass

if TYPE_CHECKING:  # these import Drake or SciPy, which reading a scenario does not need
    from cpid_drake.dynamics.inertia import InertialParameters
    from cpid_drake.spacecraft.spacecraft import Spacecraft

Name = Annotated[str, MinLen(1)]
Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Seed = Annotated[int, Ge(0)]
Mass = Annotated[float, Le(1e9)]
Vector = Annotated[NDArray[np.float64], Numbers(3)]
Matrix = Annotated[NDArray[np.float64], Numbers(3, 3)]
Momentum = Annotated[NDArray[np.float64], Numbers(6)]
Gain = Annotated[float, Interval(gt=0, le=1e4)]
"""Largest natural frequency of a controller [rad/s]; stiffer ones are too slow to simulate."""


@dataclass
class SpacecraftConfig:
    """The known spacecraft: model file, base body and capture frame.

    Files are package:// URIs or paths relative to the scenario's folder; `packages` gives the
    folders of further packages by name. `configuration` is the default position of joints that the
    motion does not name [rad or m by joint name]; other joints are at zero. With `on_table` the
    spacecraft floats on a table, whose normal is the z axis of W and of the base.
    """

    model: Name
    base: Name
    capture_frame: Name
    packages: dict[str, str] = field(default_factory=dict)
    configuration: dict[str, float] = field(default_factory=dict)
    on_table: bool = False

    def make(self) -> "Spacecraft":
        """Return the known spacecraft.

        Raises:
            InputError: for the same reasons as `Spacecraft`.

        """
        from cpid_drake.spacecraft.spacecraft import Spacecraft

        spacecraft = Spacecraft(
            self.model, base=self.base, capture_frame=self.capture_frame, packages=self.packages
        )
        return spacecraft.on_table() if self.on_table else spacecraft


@dataclass
class TargetConfig:
    """The true target of the simulated plant [kg, m, kg·m²], and a model of its appearance."""

    mass: Mass
    p_CTcm_C: Vector
    I_TTcm_C: Matrix
    visual_model: str | None = None


@dataclass
class ControllerConfig:
    """The joint controller: its model of the target, and its feedback gains [rad/s, 1].

    A controller that does not know the target assumes a solid sphere about C's origin [kg, m]. Its
    mass must then be given; half or twice the true mass is good enough.
    """

    knows_target: bool = True
    nominal_mass: NotNegative = 0.0
    nominal_radius: Positive = 0.5
    natural_frequency: Gain = 10.0
    damping_ratio: Gain = 1.0


@dataclass
class SensorsConfig:
    """The spacecraft's sensors in the Diagram, and the seed of their errors.

    `suite` is a preset's name, a package:// URI or the path of a YAML file relative to the
    scenario's folder. `explicit` lists the sensors themselves, with the keys of such a file. Give
    one of the two; without either there are no sensors, and the identifier reads the exact state.
    """

    suite: str = ""
    explicit: SensorSuite | None = None
    seed: Seed = 1

    @property
    def present(self) -> bool:
        """Whether there are sensors."""
        return bool(self.suite) or self.explicit is not None


@dataclass
class PriorConfig:
    """A guess of the target before the first sample [kg, m, kg·m²], and its relative σ.

    The σ of the mass, of mass times position and of the moments of inertia about C's origin are
    this fraction of the guess's mass, mass times radius of gyration, and mass times its square.
    """

    mass: Mass
    p_CTcm_C: Vector
    I_TTcm_C: Matrix
    sigma: float = 0.5

    def guess(self) -> "InertialParameters":
        """Return the guessed target."""
        return _inertial_parameters(self)


@dataclass
class IdentificationConfig:
    """The identifier: estimator, rows, whether the momentum is unknown, period, first sample [s].

    `estimator` is one of `ONLINE_ESTIMATORS`; null for the recursive fit if the scenario has
    sensors and names no rows, else least squares. Rows, period and offset apply to least squares,
    which uses the exact state; null for standard rows. The recursive fit processes all samples of
    the sensors. `prior` is a guess of the target for the recursive fit; null for none.
    """

    estimator: str | None = None
    rows: str | None = None
    unknown_momentum: bool = False
    period: Positive = 1.0
    offset: NotNegative = 1.0
    prior: PriorConfig | None = None


@dataclass
class FiringConfig:
    """A thruster firing: its time [s], and the momentum [L; P] that it adds about W's origin, in W.

    Units: N·m·s and N·s.
    """

    time: float
    momentum_W: Momentum


@dataclass
class AccuracyConfig:
    """Monte Carlo trials with noisy sensors.

    `presets` are sensor suites, named as in `SensorsConfig`. If `momentum_known` is true, the
    estimators get the momentum in `SimulationConfig.momentum_W`; otherwise they estimate the
    momentum.
    """

    presets: Annotated[list[str], MinLen(1)] = field(
        default_factory=lambda: ["flight", "servicer", "testbed", "coarse"]
    )
    trials: Annotated[int, Ge(1)] = 200
    seed: Seed = 2016
    momentum_known: bool = False
    firing: FiringConfig | None = None


@dataclass
class IntegratorConfig:
    """Settings of Drake's Simulator, with the keys of `pydrake.systems.analysis.SimulatorConfig`.

    The allowed integration schemes are Drake's error-controlled schemes that conserve momentum well
    enough for identification.
    """

    integration_scheme: Literal["runge_kutta3", "runge_kutta5", "bogacki_shampine3", "radau3"] = (
        "runge_kutta3"
    )
    max_step_size: Positive = 0.05
    accuracy: Annotated[float, Ge(1e-13)] = 1e-9
    use_error_control: bool = True
    start_time: Annotated[float, Interval(ge=0, le=0)] = 0.0
    target_realtime_rate: NotNegative = 0.0
    publish_every_time_step: bool = False


@dataclass
class DisturbanceConfig:
    """Constant torque about the system's centre of mass, and acceleration of this centre, in W.

    Units: N·m and m/s². Null for the random value that the seed gives with the σ in
    `SensorSuite.disturbances`; zero without such a σ.
    """

    acceleration_W: Vector | None = None
    torque_W: Vector | None = None


@dataclass
class BurnConfig:
    """A burn of thrusters on the base: start and duration [s], and constant thrust in B.

    `force_B` acts at the point `p_BF_B` of the base; `torque_B` acts besides. Units: N, N·m, m.
    """

    time: NotNegative
    duration: Positive
    force_B: Vector = field(default_factory=lambda: np.zeros(3))
    p_BF_B: Vector = field(default_factory=lambda: np.zeros(3))
    torque_B: Vector = field(default_factory=lambda: np.zeros(3))

    def make(self) -> Burn:
        """Return the burn, with its torque about B's origin."""
        torque = self.torque_B + np.cross(self.p_BF_B, self.force_B)
        return Burn(self.time, self.duration, np.concatenate([torque, self.force_B]))


@dataclass
class SimulationConfig:
    """Duration of the simulation and logging period [s], and the settings of Drake's Simulator.

    `momentum_W` is the total momentum [L; P] about W's origin, in W, at the start; not zero if the
    target was tumbling at capture. `disturbance` and `burns` act in the Diagram and in the trials
    of `AccuracyConfig`. The estimators read a log of the burns if `burns_logged` is true; it has
    the error of scale that the seed gives with the σ in `SensorSuite.disturbances`. `wrist` is
    null for a rigid grasp.
    """

    duration: Positive = 10.0
    momentum_W: Momentum = field(default_factory=lambda: np.zeros(6))
    disturbance: DisturbanceConfig = field(default_factory=DisturbanceConfig)
    sprung_masses: list[SprungMass] = field(default_factory=list)
    wrist: CompliantWrist | None = None
    burns: list[BurnConfig] = field(default_factory=list)
    burns_logged: bool = True
    log_period: Positive = 0.0625
    simulator: IntegratorConfig = field(default_factory=IntegratorConfig)


@dataclass
class Scenario:
    """A simulated identification, from spacecraft to simulator."""

    spacecraft: SpacecraftConfig
    target: TargetConfig
    joint_motion: Annotated[Motion | MotionFile, FirstUnlessTagged()] = field(
        default_factory=HalfCosineMotion
    )
    controller: ControllerConfig = field(default_factory=ControllerConfig)
    sensors: SensorsConfig = field(default_factory=SensorsConfig)
    identification: IdentificationConfig = field(default_factory=IdentificationConfig)
    known_bodies: BodyUncertainty = field(default_factory=BodyUncertainty)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)
    accuracy: AccuracyConfig = field(default_factory=AccuracyConfig)

    @property
    def online_estimator(self) -> str:
        """Name of the online estimator: the given one, or the best for the scenario's sensors."""
        config = self.identification
        if config.estimator is not None:
            return config.estimator
        by_sensors = self.sensors.present and config.rows is None
        return "recursive_fit" if by_sensors else "least_squares"

    @property
    def online_rows(self) -> str:
        """Name of the row family of least squares."""
        return self.identification.rows or "standard"

    def target_truth(self) -> "InertialParameters":
        """Return the true target.

        Raises:
            InputError: the target is not a rigid body.

        """
        truth = _inertial_parameters(self.target)
        problems = truth.infeasibilities()
        if problems:
            raise InputError(f"target: not a rigid body: {'; '.join(problems)}")
        return truth

    def make_joint_motion(self, spacecraft: "Spacecraft") -> AnyMotion:
        """Return the joint motion of this spacecraft's joints.

        Raises:
            InputError: a joint is unknown or an angle is in degrees; also the errors of the
                motion's class.

        """
        default = self.spacecraft.configuration
        spacecraft.configuration(default, "spacecraft.configuration")
        return self.joint_motion.make(spacecraft, default)

    def make_suite(self) -> SensorSuite | None:
        """Return the sensors, or None if there are none.

        Raises:
            InputError: for the same reasons as `presets.load_sensors`.

        """
        if self.sensors.explicit is not None:
            return self.sensors.explicit
        return load_sensors(self.sensors.suite) if self.sensors.suite else None

    def make_disturbance(self) -> SimulatedDisturbance:
        """Return the external forces and torques of the simulation; see `DisturbanceConfig`.

        Raises:
            InputError: for the same reasons as `presets.load_sensors`.

        """
        suite = self.make_suite()
        return SimulatedDisturbance(
            None if suite is None else suite.disturbances,
            self.sensors.seed,
            **vars(self.simulation.disturbance),
        )

    def make_burns(self) -> tuple[Burn, ...]:
        """Return the burns of thrusters."""
        return tuple(burn.make() for burn in self.simulation.burns)

    def body_uncertainty(self) -> BodyUncertainty | None:
        """Return the uncertainty of the spacecraft, or None if it is known exactly."""
        return None if self.known_bodies.is_zero else self.known_bodies


def _inertial_parameters(body: TargetConfig | PriorConfig) -> "InertialParameters":
    from cpid_drake.dynamics.inertia import InertialParameters

    return InertialParameters(body.mass, body.p_CTcm_C, body.I_TTcm_C)
