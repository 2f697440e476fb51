"""A scenario: everything that a simulated identification needs, as dataclasses and as YAML.

A dataclass states the limits of single values where it declares them, and those of several values
in `__post_init__`. `simulation` turns a scenario into a Drake Diagram.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import inertia_of_second_moment
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.files.constraints import FirstUnlessTagged, Limits, Numbers, Vector
from cpid_drake.files.errors import InputError
from cpid_drake.identification.prior import PriorConfig
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.sensors.simulated_disturbance import SimulatedDisturbance
from cpid_drake.sensors.suite import SensorSuite, check_sensors
from cpid_drake.simulation.burns import Burn
from cpid_drake.simulation.flexible import CompliantWrist, SprungMass
from cpid_drake.simulation.joint_motions import (
    AnyMotion,
    HalfCosineMotion,
    MotionFile,
    MotionSchema,
)
from cpid_drake.spacecraft.reference import SpacecraftReference
from cpid_drake.spacecraft.spacecraft import Spacecraft

MOST_STEPS = 1_000_000
"""Largest number of logged samples, of identified samples and of longest steps of a simulation;
more would fill the memory."""

Positive = Annotated[float, Limits(gt=0)]
NotNegative = Annotated[float, Limits(ge=0)]
Momentum = Annotated[Array, Numbers(6)]
Gain = Annotated[float, Limits(gt=0, le=1e4)]  # [rad/s]; stiffer ones are too slow to simulate


@dataclass
class SpacecraftConfig(SpacecraftReference):
    """The spacecraft model; files are package:// URIs or paths relative to the scenario's folder.

    `configuration` is the default position of joints that the
    motion does not name [rad or m by joint name]; other joints are at zero. With `on_table` the
    spacecraft floats on a table, whose normal is the z axis of W and of the base.
    """

    configuration: dict[str, float] = field(default_factory=dict)
    on_table: bool = False

    def make(self) -> Spacecraft:
        """Return the spacecraft model; raises as `Spacecraft`."""
        spacecraft = super().make()
        return spacecraft.on_table() if self.on_table else spacecraft


@dataclass
class SolidConfig:
    """A homogeneous solid, with its extent along the axes of C [m]; a cylinder's axis is C's z."""

    shape: Literal["box", "cylinder", "ellipsoid"]
    size: Vector

    def inertia(self, mass: float) -> Array:
        """Return the inertia (3, 3) about the centre of mass [kg·m²]."""
        parts = {"box": [12, 12, 12], "cylinder": [16, 16, 12], "ellipsoid": [20, 20, 20]}
        return inertia_of_second_moment(np.diag(mass * self.size**2 / parts[self.shape]))


@dataclass
class TargetConfig:
    """The true target of the simulated plant, in C [kg, m, kg·m²], and a model of its appearance.

    The inertia about the centre of mass is given, or is that of a `solid`.
    """

    mass: Annotated[float, Limits(le=1e9)]
    p_CTcm_C: Vector
    I_TTcm_C: Annotated[Array, Numbers(3, 3)] | None = None
    visual_model: str | None = None
    solid: SolidConfig | None = None

    def __post_init__(self) -> None:
        inertia = self._inertia()
        radius = np.sqrt(np.abs(inertia).max() / abs(self.mass)) if self.mass else 0.0
        length = max(np.abs(self.p_CTcm_C).max(), radius)
        if length > 100:
            raise InputError(
                f"a centre of mass or a radius of gyration of {length:.3g} m; are these "
                "millimetres? lengths are in metres, masses in kg, inertias in kg·m²"
            )

    def parameters(self) -> InertialParameters:
        """Return the target; it need not be physically consistent."""
        return InertialParameters(self.mass, self.p_CTcm_C, self._inertia())

    def _inertia(self) -> Array:
        if self.I_TTcm_C is not None and self.solid is None:
            return self.I_TTcm_C
        if self.I_TTcm_C is None and self.solid is not None:
            return self.solid.inertia(self.mass)
        raise InputError("I_TTcm_C and solid: give one of the two")


@dataclass
class ControllerConfig:
    """The joint controller: its model of the target, and its feedback gains [rad/s, 1].

    With a model of the target it has the forces from outside, too, and the joints follow their
    motion exactly. Without one it assumes a solid sphere about C's origin
    [kg, m]. Its mass must then be given; half or twice the true mass is good enough.
    """

    has_target_model: bool = True
    nominal_mass: NotNegative = 0.0
    nominal_radius: Positive = 0.5
    natural_frequency: Gain = 10.0
    damping_ratio: Gain = 1.0

    def __post_init__(self) -> None:
        if not (self.has_target_model or self.nominal_mass > 0):
            raise InputError("nominal_mass must be > 0 where has_target_model is false")


@dataclass
class SensorsConfig:
    """The spacecraft's sensors in the Diagram, and the seed of their errors.

    `suite` is a preset's name, a package:// URI or the path of a YAML file relative to the
    scenario's folder. `explicit` lists the sensors themselves, with the keys of such a file. Give
    one of the two; without either there are no sensors, and the identifier reads the exact state.
    """

    suite: str = ""
    explicit: SensorSuite | None = None
    seed: Annotated[int, Limits(ge=0)] = 1

    def __post_init__(self) -> None:
        if self.explicit is not None:
            if self.suite:
                raise InputError("suite and explicit: give one of the two")
            check_sensors(self.explicit, "explicit")

    @property
    def present(self) -> bool:
        """Whether there are sensors."""
        return bool(self.suite) or self.explicit is not None


@dataclass
class IdentificationConfig:
    """The identifier: estimator, rows, whether the momentum is unknown, period, first sample [s].

    `estimator` is one that can run in a Diagram; null for the recursive fit if the scenario has
    sensors and names no rows, else least squares. Rows, period and offset apply to least squares,
    which uses the exact state; null for standard rows. The recursive fit processes all samples of
    the sensors. `prior` is what is known of the target before, for the recursive fit; null for
    nothing.
    """

    estimator: Literal["least_squares", "recursive_fit"] | None = None
    rows: str | None = None
    momentum: Literal["zero", "unknown"] = "zero"
    period: Positive = 1.0
    offset: NotNegative = 1.0
    prior: PriorConfig | None = None


@dataclass
class SimulatorSettings:
    """Drake's `SimulatorConfig`; the default conserves momentum to about 1e-8 N·s."""

    integration_scheme: Literal["runge_kutta3", "runge_kutta5", "bogacki_shampine3", "radau3"] = (
        "runge_kutta3"
    )
    max_step_size: Positive = 0.05
    accuracy: Annotated[float, Limits(ge=1e-13)] = 1e-9
    use_error_control: bool = True


@dataclass
class DisturbanceConfig:
    """Constant torque about the system's centre of mass, and acceleration of this centre, in W.

    Units: N·m and m/s². Null for the random value that the seed gives with the σ in
    `SensorSuite.disturbances`; zero without such a σ.
    """

    acceleration_W: Vector | None = None
    torque_W: Vector | None = None


@dataclass
class SimulationConfig:
    """Duration of the simulation and logging period [s], and the settings of Drake's Simulator.

    `momentum_W` is the total momentum [L; P] about W's origin, in W, at the start; not zero if the
    target was tumbling at capture. `disturbance` and `burns` act in the Diagram and in the trials
    of a campaign. The estimators read a log of the burns if `burns_logged` is true; it has
    the error of scale that the seed gives with the σ in `SensorSuite.disturbances`. `wrist` is
    null for a rigid grasp. `joint_compliance_urad` is that of all joints [10⁻⁶ rad/(N·m), m/N],
    between their encoders and what they move.
    """

    duration: Positive = 10.0
    momentum_W: Momentum = field(default_factory=lambda: np.zeros(6))
    disturbance: DisturbanceConfig = field(default_factory=DisturbanceConfig)
    sprung_masses: list[SprungMass] = field(default_factory=list)
    wrist: CompliantWrist | None = None
    joint_compliance_urad: Annotated[float, Limits(ge=0)] = 0.0
    burns: list[Burn] = field(default_factory=list)
    burns_logged: bool = True
    log_period: Positive = 0.0625
    simulator: SimulatorSettings = field(default_factory=SimulatorSettings)


@dataclass
class Scenario:
    """A simulated identification, from spacecraft to simulator."""

    spacecraft: SpacecraftConfig
    target: TargetConfig
    joint_motion: Annotated[MotionSchema | MotionFile, FirstUnlessTagged()] = field(
        default_factory=HalfCosineMotion
    )
    controller: ControllerConfig = field(default_factory=ControllerConfig)
    sensors: SensorsConfig = field(default_factory=SensorsConfig)
    identification: IdentificationConfig = field(default_factory=IdentificationConfig)
    known_bodies: BodyUncertainty = field(default_factory=BodyUncertainty)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)

    def __post_init__(self) -> None:
        """Refuse values that contradict each other, by an InputError that names them."""
        simulation, duration = self.simulation, self.simulation.duration
        if simulation.wrist is not None and not self.controller.has_target_model:
            raise InputError(
                "controller.has_target_model must be true with simulation.wrist: a controller "
                "without the springs of the wrist cannot hold a light last link"
            )
        for name, period in (
            ("simulation.log_period", simulation.log_period),
            ("simulation.simulator.max_step_size", simulation.simulator.max_step_size),
            ("identification.period", self.identification.period),
        ):
            if duration / period > MOST_STEPS:
                raise InputError(
                    f"{name} of {period:g} s is more than {MOST_STEPS} times in "
                    f"simulation.duration, {duration:g} s"
                )
        if self.online_estimator != "recursive_fit" and self.identification.prior is not None:
            raise InputError(
                f"identification.prior: {self.online_estimator} uses no prior; give estimator: "
                "recursive_fit, or leave prior out"
            )
        times = {f"simulation.burns[{k}]": burn.time for k, burn in enumerate(simulation.burns)}
        for name, time in times.items():
            if not 0 <= time < duration:
                raise InputError(
                    f"{name}.time must be within the simulation's duration, {duration:g} s, "
                    f"not {time}"
                )

    @property
    def online_estimator(self) -> str:
        """Name of the online estimator: the given one, or the best for the scenario's sensors."""
        config = self.identification
        by_sensors = self.sensors.present and config.rows is None
        name = config.estimator or ("recursive_fit" if by_sensors else "least_squares")
        if name == "recursive_fit" and not self.sensors.present:
            raise InputError(
                "identification.estimator: recursive_fit needs sensors; give sensors.suite or "
                "sensors.explicit"
            )
        return name

    def target_truth(self) -> InertialParameters:
        """Return the true target; raises InputError if it is not a rigid body."""
        truth = self.target.parameters()
        problems = truth.inconsistencies()
        if problems:
            raise InputError(f"target: not a rigid body: {'; '.join(problems)}")
        return truth

    def make_joint_motion(self, spacecraft: Spacecraft) -> AnyMotion:
        """Return the joint motion of this spacecraft's joints.

        Raises:
            InputError: a joint is unknown or an angle is in degrees; or by the motion's class.

        """
        default = self.spacecraft.configuration
        spacecraft.configuration(default, "spacecraft.configuration")
        return self.joint_motion.make(spacecraft, default)

    def make_suite(self) -> SensorSuite | None:
        """Return the sensors of the simulated world, which has no other errors than theirs.

        None if there are none; raises as `presets.load_sensors`.
        """
        own = self.stated_suite()
        return None if own is None else own.exact()

    def stated_suite(self) -> SensorSuite | None:
        """Return the sensors with the errors that the file states; None if there are none."""
        config = self.sensors
        return config.explicit or (load_sensors(config.suite) if config.suite else None)

    def make_disturbance(self) -> SimulatedDisturbance:
        """Return the external forces and torques of the simulation; see `DisturbanceConfig`."""
        suite = self.make_suite()
        return SimulatedDisturbance(
            None if suite is None else suite.disturbances,
            self.sensors.seed,
            **vars(self.simulation.disturbance),
        )

    def body_uncertainty(self) -> BodyUncertainty | None:
        """Return the uncertainty of the spacecraft, or None if it is known exactly."""
        return None if self.known_bodies.is_zero else self.known_bodies
