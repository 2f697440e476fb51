"""A scenario: everything a simulated identification needs, as dataclasses and as YAML.

Its values are numbers and names; `cpid_drake.simulation` turns them into a Drake Diagram.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydrake.common.yaml import yaml_dump_typed
from pydrake.systems.analysis import SimulatorConfig

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import HalfCosine, JointMotion, MultiSine
from cpid_drake.dynamics.sensitivity import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.identification.sensor_identification import check_guess
from cpid_drake.resources import models_directory, resolve_model
from cpid_drake.sensing.presets import load_sensors, sensor_presets
from cpid_drake.sensing.suite import SensorSuite, check_sensors
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.yaml_files import choose_from, load_strictly

INTEGRATION_SCHEMES = ("runge_kutta3", "runge_kutta5", "bogacki_shampine3", "radau3")
"""Drake's error-controlled schemes that conserve momentum well enough to identify with."""

ONLINE_ESTIMATORS = ("least_squares", "momentum_filter")
"""What can identify in a Diagram: least squares on the exact state, or a filter on sensors."""

LONGEST_LENGTH = 100.0
"""Centres of mass and radii of gyration beyond are taken for another unit than metres."""

LARGEST_MASS = 1e9
"""Of a target [kg]; what is more cannot be simulated."""

STIFFEST = 1e4
"""Of a controller: natural frequency [rad/s] and damping ratio; more would take forever."""

SHORTEST_RAMP = 1e-3
"""Of a motion [s]; accelerations would be beyond all numbers."""

MOST_STEPS = 1_000_000
"""Samples that a simulation logs or identifies from at most, and longest steps in it."""


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
class HalfCosineMotion:
    """Half-cosine motion between two configurations [rad or m by joint name], T = duration [s].

    Joints that a configuration does not name stand as `spacecraft.configuration` says.
    """

    duration: float = 10.0
    initial: dict[str, float] = field(default_factory=dict)
    final: dict[str, float] = field(default_factory=dict)

    def make(self, spacecraft: Spacecraft, standing: Mapping[str, float]) -> HalfCosine:
        """Return the motion of this spacecraft's joints; errors as `Scenario.make_joint_motion`.

        Args:
            spacecraft: whose joints move.
            standing: where joints are that the motion does not name [rad or m by joint name].

        """
        motion = HalfCosine(
            _configuration(spacecraft, standing, self.initial, "joint_motion.initial"),
            _configuration(spacecraft, standing, self.final, "joint_motion.final"),
            self.duration,
        )
        _check_rates(motion, spacecraft, "give a longer duration")
        return motion


@dataclass
class MultiSineMotion:
    """Sums of sines about a configuration, tagged `!MultiSineMotion` in YAML.

    `centre` [rad or m], `amplitudes` [rad or m] and `phases` [rad] are by joint name; the latter
    two are lists, one entry for each of the frequencies [Hz]. Where a joint is not named, its
    centre is as `spacecraft.configuration` says, the others are zero. The motion rises over the
    first `ramp` [s] and falls over the last.
    """

    duration: float = 10.0
    ramp: float = 2.0
    frequencies: np.ndarray = field(default_factory=lambda: np.zeros(0))
    centre: dict[str, float] = field(default_factory=dict)
    amplitudes: dict[str, np.ndarray] = field(default_factory=dict)
    phases: dict[str, np.ndarray] = field(default_factory=dict)

    def make(self, spacecraft: Spacecraft, standing: Mapping[str, float]) -> MultiSine:
        """Return the motion of this spacecraft's joints; as `HalfCosineMotion.make`."""
        if 0 < self.ramp < SHORTEST_RAMP:
            raise InputError(f"joint_motion.ramp must be at least {SHORTEST_RAMP:g} s")
        motion = MultiSine(
            centre=_configuration(spacecraft, standing, self.centre, "joint_motion.centre"),
            amplitudes=self._table(spacecraft, "amplitudes"),
            frequencies=self.frequencies,
            phases=self._table(spacecraft, "phases"),
            ramp=self.ramp,
            duration=self.duration,
        )
        for extreme in motion.position_range():
            angles = dict(zip(spacecraft.joint_names, extreme, strict=True))
            spacecraft.configuration(angles, "joint_motion")
        _check_rates(motion, spacecraft, "give smaller amplitudes or frequencies")
        return motion

    def _table(self, spacecraft: Spacecraft, key: str) -> np.ndarray:
        """Return amplitudes or phases as (K, J)."""
        names, count = spacecraft.joint_names, np.size(self.frequencies)
        table = np.zeros((count, len(names)))
        for name, values in getattr(self, key).items():
            _check_joint(spacecraft, name, f"joint_motion.{key}")
            if np.shape(values) != (count,) or not np.isfinite(values).all():
                raise InputError(
                    f"joint_motion.{key}: {name} needs finite numbers, one for each of the "
                    f"{count} frequencies"
                )
            table[:, names.index(name)] = values
        return table


JointMotionConfig = HalfCosineMotion | MultiSineMotion
"""The kinds of joint motion. In YAML the first is meant unless a tag, `!NAME`, says another."""


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
        _configuration(spacecraft, {}, standing, "spacecraft.configuration")
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


def _configuration(
    spacecraft: Spacecraft,
    standing: Mapping[str, float],
    angles: Mapping[str, float],
    where: str,
) -> NDArray[np.float64]:
    """Return q (J,) with the joints that `angles` names there, and the others as they stand.

    Raises:
        InputError: as `Spacecraft.configuration`; a position that is degrees is called that.

    """
    for name, value in angles.items():
        _check_joint(spacecraft, name, where)
        try:
            spacecraft.configuration({name: value}, where)
        except InputError as error:
            if abs(value) > 2 * np.pi and _is_possible(spacecraft, name, np.radians(value)):
                raise InputError(
                    f"{error}; angles are in radians: {value:g} degrees are {np.radians(value):.4g}"
                ) from error
            raise
    return spacecraft.configuration({**standing, **angles}, where)


def _is_possible(spacecraft: Spacecraft, joint: str, position: float) -> bool:
    try:
        spacecraft.configuration({joint: position}, "")
    except InputError:
        return False
    return True


def _check_joint(spacecraft: Spacecraft, name: str, where: str) -> None:
    if name not in spacecraft.joint_names:
        raise InputError(f"{where}: no joint '{name}'; {choose_from(name, spacecraft.joint_names)}")


def _check_rates(motion: HalfCosine | MultiSine, spacecraft: Spacecraft, remedy: str) -> None:
    rates, limits = motion.peak_rates(), spacecraft.velocity_limits
    if (rates > limits).any():
        k = int((rates > limits).argmax())
        raise InputError(
            f"joint_motion: {spacecraft.joint_names[k]} would reach {rates[k]:.3g}, above its "
            f"limit {limits[k]:.3g} rad/s; {remedy}"
        )


def shipped_scenario(name: str) -> Path:
    """Return the path of a scenario that comes with the package, such as "paper".

    Raises:
        InputError: there is none of this name.

    """
    folder = models_directory() / "scenarios"
    path = folder / f"{name}.yaml"
    if not path.is_file():
        names = sorted(file.stem for file in folder.glob("*.yaml"))
        raise InputError(f"no shipped scenario '{name}'; {choose_from(name, names)}")
    return path


def find_scenario(name_or_path: str) -> Path | str:
    """Return what a user means by a scenario: a file, or a shipped one's name, such as "paper".

    What has an ending or a slash is a file (or a package:// URI), whether it exists or not.

    Raises:
        InputError: a name of no shipped scenario.

    """
    is_file = Path(name_or_path).suffix or "/" in name_or_path
    return name_or_path if is_file else shipped_scenario(name_or_path)


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario from a YAML file; keys it leaves out keep their defaults.

    Raises:
        InputError: no such file, not YAML, unknown keys, or values of the wrong type or size.

    """
    file = resolve_model(path)
    scenario = load_strictly(Scenario, file, str(path), "a scenario")
    _check(scenario, str(path))
    spacecraft, target = scenario.spacecraft, scenario.target
    with naming(str(path)):
        spacecraft.model = _from_folder(file.parent, spacecraft.model)
        spacecraft.packages = {
            name: _from_folder(file.parent, folder) for name, folder in spacecraft.packages.items()
        }
        if target.visual_model is not None:
            target.visual_model = _from_folder(file.parent, target.visual_model)
    _find_suites(scenario, file.parent, str(path))
    return scenario


def dump_scenario(scenario: Scenario) -> str:
    """Return a scenario with all its defaults as YAML; `load_scenario` gives the same again.

    Files that a scenario names are written as absolute paths, as it has been loaded.
    """
    text = yaml_dump_typed(scenario)
    # Not every version of Drake knows this key, and a simulation here does not depend on it.
    lines = [line for line in text.splitlines() if "publish_every_time_step:" not in line]
    return "\n".join(lines) + "\n"


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Let what is wrong with a scenario that has been loaded say which scenario it is.

    Raises:
        InputError: the one raised inside, with `where` before it.

    """
    try:
        yield
    except InputError as error:
        raise error if str(error).startswith(where) else InputError(f"{where}: {error}") from error


def _from_folder(folder: Path, path: str) -> str:
    """Return a path that the scenario's author wrote, seen from the scenario's folder."""
    try:
        return path if "://" in path else str(folder / Path(path).expanduser())
    except RuntimeError as error:  # there is no such user
        raise InputError(f"{path:.200}: {error}") from error


def _find_suites(scenario: Scenario, folder: Path, where: str) -> None:
    """Turn the sensor suites' paths into those seen from the folder, and see that all can be read.

    An unknown suite would else be missed only when a study has been running for a while.
    """
    known = sensor_presets()

    def find(suite: str, key: str) -> str:
        try:
            found = suite if suite in known else _from_folder(folder, suite)
            load_sensors(found)
        except InputError as error:
            raise InputError(f"{where}: {key}: {error}") from error
        return found

    if scenario.sensors.suite:
        scenario.sensors.suite = find(scenario.sensors.suite, "sensors.suite")
    presets = scenario.accuracy.presets
    presets[:] = [find(suite, f"accuracy.presets[{k}]") for k, suite in enumerate(presets)]


def _check(scenario: Scenario, where: str) -> None:
    """Refuse what would fail deep inside Drake, or silently do something else."""
    config = scenario.simulation
    for name in ("model", "base", "capture_frame"):
        if not getattr(scenario.spacecraft, name):
            raise InputError(f"{where}: spacecraft.{name} is missing")
    _check_body(scenario.target, f"{where}: target")
    momentum = config.momentum_W
    if np.shape(momentum) != (6,) or not np.isfinite(momentum).all():
        raise InputError(f"{where}: simulation.momentum_W needs 6 finite numbers: L, then P")
    positive = {
        "simulation.duration": config.duration,
        "simulation.log_period": config.log_period,
        "simulation.simulator.max_step_size": config.simulator.max_step_size,
        "simulation.simulator.accuracy": config.simulator.accuracy,
        "joint_motion.duration": scenario.joint_motion.duration,
        "identification.period": scenario.identification.period,
        "controller.nominal_radius": scenario.controller.nominal_radius,
    }
    if not scenario.controller.knows_target:
        positive["controller.nominal_mass"] = scenario.controller.nominal_mass
    for name, value in positive.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{where}: {name} must be a number > 0, not {value}")
    for name in ("natural_frequency", "damping_ratio"):
        if getattr(scenario.controller, name) > STIFFEST:
            raise InputError(f"{where}: controller.{name} must be at most {STIFFEST:g}")
    for name in (
        "simulation.log_period",
        "simulation.simulator.max_step_size",
        "identification.period",
    ):
        if config.duration / positive[name] > MOST_STEPS:
            raise InputError(
                f"{where}: {name} of {positive[name]:g} s is more than {MOST_STEPS} times in "
                f"simulation.duration, {config.duration:g} s"
            )
    offset = scenario.identification.offset
    if not (np.isfinite(offset) and offset >= 0):
        raise InputError(f"{where}: identification.offset must be a number >= 0, not {offset}")
    if config.simulator.accuracy < 1e-13:
        raise InputError(f"{where}: simulation.simulator.accuracy is below rounding; give >= 1e-13")
    if config.simulator.start_time != 0:
        raise InputError(f"{where}: simulation.simulator.start_time must be 0, as motions' is")
    rate = config.simulator.target_realtime_rate
    if not 0 <= rate < np.inf:
        raise InputError(
            f"{where}: simulation.simulator.target_realtime_rate must be a number >= 0, not {rate}"
        )
    scheme = config.simulator.integration_scheme
    if scheme not in INTEGRATION_SCHEMES:
        raise InputError(
            f"{where}: simulation.simulator.integration_scheme must be one of "
            f"{', '.join(INTEGRATION_SCHEMES)}, not '{scheme:.60}'"
        )
    _check_sensing(scenario, where)


def _check_body(body: TargetConfig | PriorConfig, where: str) -> None:
    """Refuse a body that is not given, or as large as if its lengths were in millimetres."""
    if np.shape(body.p_CTcm_C) != (3,) or np.shape(body.I_TTcm_C) != (3, 3):
        raise InputError(f"{where} needs p_CTcm_C of 3 and I_TTcm_C of 3x3 numbers")
    if not np.isfinite(body.mass):
        raise InputError(f"{where}.mass is missing or not finite")
    if body.mass > LARGEST_MASS:
        raise InputError(f"{where}.mass of {body.mass:g} is too large; masses are in kg")
    if not (np.isfinite(body.p_CTcm_C).all() and np.isfinite(body.I_TTcm_C).all()):
        return  # what is not finite is refused where the body is made
    distance = np.abs(body.p_CTcm_C).max()
    radius = np.sqrt(np.abs(body.I_TTcm_C).max() / abs(body.mass)) if body.mass else 0.0
    for key, what, length in (
        ("p_CTcm_C", "a centre of mass", distance),
        ("I_TTcm_C", "with this mass a radius of gyration", radius),
    ):
        if length > LONGEST_LENGTH:
            raise InputError(
                f"{where}.{key}: {what} of {length:.3g} m; are these millimetres? "
                "lengths are in metres, masses in kg, inertias in kg·m²"
            )


def _check_sensing(scenario: Scenario, where: str) -> None:
    """Refuse sensors, uncertainties and trials that cannot be."""
    estimator, accuracy = scenario.identification.estimator, scenario.accuracy
    if estimator not in ONLINE_ESTIMATORS:
        raise InputError(
            f"{where}: identification.estimator must be one of {', '.join(ONLINE_ESTIMATORS)}, "
            f"not '{estimator:.60}'"
        )
    if estimator == "momentum_filter" and not scenario.sensors.present:
        raise InputError(
            f"{where}: identification.estimator: momentum_filter needs sensors; give sensors.suite "
            "or sensors.explicit"
        )
    prior = scenario.identification.prior
    if prior is not None:
        if estimator != "momentum_filter":
            raise InputError(
                f"{where}: identification.prior: {estimator} starts from nothing; give estimator: "
                "momentum_filter, or leave prior out"
            )
        _check_body(prior, f"{where}: identification.prior")
        with naming(f"{where}: identification.prior"):
            check_guess(prior.guess(), prior.sigma)
    if scenario.sensors.explicit is not None:
        if scenario.sensors.suite:
            raise InputError(f"{where}: sensors.suite and sensors.explicit: give one of the two")
        check_sensors(scenario.sensors.explicit, f"{where}: sensors.explicit")
    for name, value in vars(scenario.known_bodies).items():
        if not (np.isfinite(value) and value >= 0):
            raise InputError(f"{where}: known_bodies.{name} must be a number >= 0, not {value}")
    least = {
        "sensors.seed": (scenario.sensors.seed, 0),
        "accuracy.trials": (accuracy.trials, 1),
        "accuracy.seed": (accuracy.seed, 0),
    }
    for name, (value, smallest) in least.items():
        if value < smallest:
            raise InputError(f"{where}: {name} must be >= {smallest}, not {value}")
    if not accuracy.presets:
        raise InputError(f"{where}: accuracy.presets must name a sensor suite at least")
    firing = accuracy.firing
    if firing is None:
        return
    if not 0 < firing.time < scenario.simulation.duration:
        raise InputError(
            f"{where}: accuracy.firing.time must be within the simulation's duration, "
            f"{scenario.simulation.duration:g} s, not {firing.time}"
        )
    if np.shape(firing.momentum_W) != (6,) or not np.isfinite(firing.momentum_W).all():
        raise InputError(f"{where}: accuracy.firing.momentum_W needs 6 finite numbers: L, then P")
