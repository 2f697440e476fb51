"""The kinds of errors that sensors, forces, grasp and thrusters have: one record for each.

`with_plausible` is the only place that decides what an estimate does not know: an error whose σ is
not stated has a plausible one, because no real error is exactly zero. An error that leaves no trace
in the samples may still be in the estimate, so none is left out because the samples do not show it.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from cpid_drake.dynamics.tree import KinematicTree, TreeBody
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.sensors import ARCSECOND, DEGREE_PER_HOUR, Gyro
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.sensors.thrusters import Thrusters

MASS, RADIUS = 10.0, 0.2
"""Mass [kg] and radius of gyration [m] of a craft whose errors have the sizes of the table."""

WALKS = 0.03
"""σ by which a force changes in a second, as a share of its own."""

BIAS_WALKS = 1 / 3
"""The same of a gyro's bias in the root of an hour."""

PLAUSIBLE_BODIES = BodyUncertainty(mass=0.01, com=0.005, inertia=0.01)
"""Uncertainty of bodies of which nobody says how well they are known."""

Owner = Literal["sensor", "disturbances", "thrusters", "valve"]


@dataclass(frozen=True)
class ErrorKind:
    """A kind of constant errors.

    Attributes:
        name: of the kind.
        owner: whose error it is.
        field: key of its σ in a sensors' file.
        entries: number of its entries; 0 for one per joint.
        unit: unit in texts.
        scale: SI value of this unit.
        sigma: plausible σ of a craft of `MASS` and `RADIUS`, in the unit of the field.
        words: the estimate in words.
        by_mass, by_length: powers of mass and radius of gyration with which it grows.
        file_scale: SI value of the field's unit; 0 if it is `scale`.
        is_shared: whether all logs of one hardware have the same error.
        walk: attribute of the owner that is its random walk [SI units/√s]; empty for none.
        least: an owner that states less has this σ [SI units, rad].

    """

    name: str
    owner: Owner
    field: str
    entries: int
    unit: str
    scale: float
    sigma: float
    words: str
    by_mass: float = 0.0
    by_length: float = 0.0
    file_scale: float = 0.0
    is_shared: bool = True
    walk: str = ""
    least: float = 0.0

    @property
    def to_SI(self) -> float:
        """SI value of the unit of the field."""
        return self.file_scale or self.scale

    def plausible(self, tree: KinematicTree) -> float:
        """Return the plausible σ for a craft with these bodies, in the unit of the field."""
        at_rest = tree.at_rest
        size = (at_rest.mass / MASS) ** self.by_mass * (_radius(at_rest) / RADIUS) ** self.by_length
        return float(self.sigma * size)


def _radius(body: TreeBody) -> float:
    """Return the radius of gyration [m]."""
    return float(np.sqrt(np.trace(body.I_BBcm) / 2 / body.mass))


_AREA = 2 / 3
"""Power of the mass with which forces grow: as the area of a craft."""


def _acceleration(frame: str, name: str) -> ErrorKind:
    words = f"an external acceleration of {{}}, in {frame}"
    unit, power = "m/s²", _AREA - 1
    return ErrorKind(
        *(name, "disturbances", name, 3, unit, 1.0, 1e-3, words),
        by_mass=power,
        is_shared=False,
        walk=f"{name}_walk",
    )


def _torque(frame: str, name: str) -> ErrorKind:
    words = f"an external torque of {{}} about the centre of mass, in {frame}"
    unit = "N·m"
    return ErrorKind(
        *(name, "disturbances", name, 3, unit, 1.0, 3e-3, words),
        by_mass=_AREA,
        by_length=1,
        is_shared=False,
        walk=f"{name}_walk",
    )


_KINDS = (
    _acceleration("W", "acceleration"),
    _torque("W", "torque"),
    _acceleration("B", "acceleration_B"),
    _torque("B", "torque_B"),
    ErrorKind(
        *("thrust_scale", "disturbances", "thrust_scale", 1, "%", 0.01, 0.1),
        "the true thrust differs from the logged one by {}",
        file_scale=1.0,
        is_shared=False,
    ),
    ErrorKind(
        *("wheel", "disturbances", "wheel", 3, "N·m·s", 1.0, 1e-2),
        "rotors in the base that the model has not have the angular momentum {}, in B",
        by_mass=1,
        by_length=2,
        is_shared=False,
    ),
    ErrorKind(
        *("target_wheel", "disturbances", "target_wheel", 3, "N·m·s", 1.0, 1e-2),
        "rotors in the target have the angular momentum {}, in C",
        by_mass=1,
        by_length=2,
        is_shared=False,
    ),
    ErrorKind(
        *("joint_compliance", "disturbances", "joint_compliance_urad", 0, "µrad/(N·m)", 1e-6),
        *(300.0, "the joints are flexible: by {}"),
        by_mass=-1,
    ),
    ErrorKind(
        *("compliance", "disturbances", "compliance_urad", 3, "µrad/(N·m)", 1e-6, 300.0),
        "the grasp is flexible: the target rotates against C by {} about its axes",
        by_mass=-1,
    ),
    ErrorKind(
        *("translational_compliance", "disturbances", "translational_compliance_um", 3),
        *("µm/N", 1e-6, 10.0),
        "the grasp is flexible: the target moves along C's axes by {}",
        by_mass=-1,
    ),
    ErrorKind(
        *("force", "valve", "force_sigma", 1, "%", 0.01, 0.1),
        "the force of valve {sensor} is off by {}",
        file_scale=1.0,
    ),
    ErrorKind(
        *("common_force", "thrusters", "common_force", 1, "%", 0.01, 0.05),
        "the forces of all valves are off by {}",
        file_scale=1.0,
    ),
    ErrorKind(
        *("loss", "thrusters", "loss", 1, "%", 0.01, 0.1),
        "each further open valve costs {} of the force",
        file_scale=1.0,
    ),
    ErrorKind(
        *("valve_delay", "thrusters", "delay_ms", 1, "ms", 1e-3, 100.0),
        "the thrust acts {} later than its log",
    ),
    ErrorKind(
        *("delay", "sensor", "delay_ms", 1, "ms", 1e-3, 30.0),
        "the stamps of the {sensor} are {} late",
    ),
    # Nobody disciplines the clock: quartz is sold with tolerances of 20 to 100 ppm, and temperature
    # and age add as much. Two clocks then differ by 71 ppm; a survey of 20,000 computers found a
    # median error of 78 ppm (Mills 2006).
    ErrorKind(
        *("clock_drift", "sensor", "clock_drift_ppm", 1, "ppm", 1e-6, 50.0),
        "the clock of the {sensor} is fast by {}",
    ),
    ErrorKind(
        *("mounting", "sensor", "mounting_arcsec", 3, "arcsec", ARCSECOND, 360.0),
        "the {sensor} is rotated by {} from the axes of the base",
    ),
    ErrorKind(
        *("scale", "sensor", "scale_ppm", 3, "ppm", 1e-6, 1000.0),
        "the {sensor} shows {} too much about its axes",
    ),
    ErrorKind(
        *("misalignment", "sensor", "misalignment_arcsec", 6, "arcsec", ARCSECOND, 200.0),
        "the axes of the {sensor} are misaligned by {}",
    ),
    ErrorKind(
        *("lever_arm", "sensor", "lever_arm_mm", 3, "mm", 1e-3, 30.0),
        "the {sensor} is that of a point at {} from the origin of the base",
        by_length=1,
    ),
    ErrorKind(
        *("zero", "sensor", "zero_mrad", 0, "mrad", 1e-3, 2.0),
        "the zeros of the joints are off by {}",
    ),
    ErrorKind(
        *("drift", "sensor", "drift_mrad_per_s", 0, "mrad/s", 1e-3, 0.02),
        "the zeros of the joints move by {}",
    ),
    # A disc of 20 mm radius whose centre is 20 µm beside the axis shows 1 mrad too much, and too
    # little half a turn later. A scale has no plausible σ: gears have whole numbers of teeth, and
    # over less than a turn a sine of this size has a slope of 1000 ppm. Belts, cables and
    # potentiometers differ by more; their σ is to be stated.
    ErrorKind(
        *("joint_scale", "sensor", "joint_scale_ppm", 0, "ppm", 1e-6, 0.0),
        "the {sensor} show {} too much of the joints' motion",
    ),
    ErrorKind(
        *("eccentricity_sine", "sensor", "eccentricity_mrad", 0, "mrad", 1e-3, 1.0),
        "the {sensor} show {} too much where the sine of the joint is 1",
    ),
    ErrorKind(
        *("eccentricity_cosine", "sensor", "eccentricity_mrad", 0, "mrad", 1e-3, 1.0),
        "the {sensor} show {} too much where the cosine of the joint is 1",
    ),
    ErrorKind(
        *("bias", "sensor", "bias", 3, "deg/h", DEGREE_PER_HOUR, 10.0),
        "the bias of the {sensor} is {}",
        is_shared=False,
        walk="bias_growth",
        least=1e-9,  # it walks, in units of a σ, even if it is zero at the start
    ),
)

KINDS: dict[str, ErrorKind] = {kind.name: kind for kind in _KINDS}
"""The kinds by name."""

OF_JOINTS = ("zero", "drift", "joint_scale", "eccentricity_sine", "eccentricity_cosine")
"""Kinds of errors of encoders that change the joints' motion."""

FLOOR = 1e-3
"""Plausible white noise of the acceleration by a table's floor, for a craft of `MASS`
[m/s²/√Hz]."""


def with_plausible(
    suite: SensorSuite, tree: KinematicTree, *, has_thrust: bool = False
) -> SensorSuite:
    """Return a suite in which every σ is stated: plausible, or zero with `unstated: exact`.

    Args:
        suite: the sensors.
        tree: the bodies of the spacecraft, whose mass and size scale forces, lever arms and
            compliances.
        has_thrust: whether thrusters fired.

    """

    def stated(errors: Any, sizes: Mapping[str, float]) -> Any:
        """Return errors with these σ where none is stated."""
        own = {key: size for key, size in sizes.items() if getattr(errors, key) is None}
        return replace(errors, **(dict.fromkeys(own, 0.0) if suite.unstated == "exact" else own))

    def with_kinds(errors: Any, owner: Owner, without: Collection[str] = ()) -> Any:
        """Return errors with a σ of each kind that the owner has."""
        own = (kind for kind in _KINDS if kind.owner == owner and hasattr(errors, kind.field))
        sizes = {k.field: 0.0 if k.name in without else k.plausible(tree) for k in own}
        return stated(errors, sizes)

    thrusters = suite.thrusters
    without = {"thrust_scale"} if thrusters or not has_thrust else set()  # valves have their own
    if has_thrust:  # the first order needs loads that change slowly against the grasp's modes
        without |= {"joint_compliance", "compliance", "translational_compliance"}
    forces = with_kinds(suite.disturbances or Disturbances(), "disturbances", without)
    walking = ("acceleration", "torque", "acceleration_B", "torque_B")
    forces = stated(forces, {f"{name}_walk": WALKS * getattr(forces, name) for name in walking})
    forces = stated(forces, _white_forces(thrusters, tree))
    if thrusters is not None:
        share = KINDS["force"].plausible(tree)
        valves = thrusters.valves.items()
        valves_by_name = {n: stated(v, {"force_sigma": share * v.force}) for n, v in valves}
        thrusters = replace(with_kinds(thrusters, "thrusters"), valves=valves_by_name)
    made = replace(suite, disturbances=forces, thrusters=thrusters)
    for name, errors in suite.present().items():
        left_out = set[str]()
        if name == "joint_rates":  # their clock and their zeros are those of the encoders
            left_out = {"delay", "clock_drift", *OF_JOINTS}
        elif name == "attitude" and thrusters is not None and thrusters.delay_ms:
            left_out = {"delay", "clock_drift"}  # all late is the thrust early: it is the clock
        elif isinstance(errors, Gyro) and forces.torque_noise:
            left_out = {"delay", "clock_drift"}  # a torque in every sample takes what a delay does
        filled = with_kinds(errors, "sensor", left_out)
        if isinstance(filled, Gyro):
            filled = stated(filled, {"bias_random_walk": BIAS_WALKS * (filled.bias or 0.0)})
        setattr(made, name, filled)
    return made


def bodies_of(bodies: BodyUncertainty | None, *suites: SensorSuite) -> BodyUncertainty | None:
    """Return the uncertainty of the spacecraft's bodies; None if they are exact.

    Args:
        bodies: as declared; None if nothing is.
        suites: the sensors; `unstated: exact` of all of them is said of the bodies too.

    """
    if bodies is None:
        is_exact = all(suite.unstated == "exact" for suite in suites)
        return None if is_exact else PLAUSIBLE_BODIES
    return None if bodies.is_zero else bodies


def _white_forces(thrusters: Thrusters | None, tree: KinematicTree) -> dict[str, float]:
    """Return σ of white forces: of a table's floor, and of valves, in a second as their errors.

    Without these there are none; see `identification.changing_forces`.
    """
    at_rest, a = tree.at_rest, 0.0
    radius = _radius(at_rest)
    if tree.normal_B is not None:
        a = FLOOR * (at_rest.mass / MASS) ** (_AREA - 1)
    torque = a * at_rest.mass * radius
    if thrusters is not None:  # the target is taken to be as heavy as the spacecraft
        share = KINDS["force"].sigma
        force = share * float(np.mean([valve.force for valve in thrusters.valves.values()]))
        a = float(np.hypot(a, force / at_rest.mass / 2))
        torque = float(np.hypot(torque, force * radius))
    return {"acceleration_noise": a, "torque_noise": torque} if a else {}
