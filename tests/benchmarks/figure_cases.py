"""The cases of the online figures: true motion, sensors and faults, by name and group."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from figure_faults import Dropout, Fault, Spikes, Stuck
from figure_motions import Delayed, Spinning, arm_motion, sines, write_spacecraft

from cpid_drake import InertialParameters, load_scenario, load_sensors, shipped_scenario
from cpid_drake.dynamics.base_motion import known_dynamics, target_spatial_inertia
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.studies.trials import Case, Firing, make_case

GROUPS = ("scenarios", "sensors", "ground", "faults")
FLIGHT_SENSORS = ("attitude", "gyro", "position", "encoders")
FIRED = np.array([6.0, -4.0, 5.0, 3.0, -2.0, 2.0])
"""Momentum [L; P] of a firing, that of thruster_firing.yaml [N·m·s, N·s]."""

WHEEL_SPEED = 3000 * np.pi / 30
"""Speed of the reaction wheels [rad/s]: 3000 rpm."""

REST = 60.0
"""Time at rest before the motion [s]."""


@dataclass(frozen=True)
class Figure:
    """One case.

    Attributes:
        group: one of `GROUPS`.
        build: returns the case; its argument is a folder for files of spacecraft.
        faults: faults of the sensors, in every trial at other samples.
        reference: name of the case without faults or firings, whose RMSE is compared; empty for
            none.

    """

    group: str
    build: Callable[[Path], Case]
    faults: tuple[Fault, ...] = ()
    reference: str = ""


# -- parts of cases -------------------------------------------------------------------------------


def scenario_case(name: str, sensors: str | SensorSuite = "flight", **changes) -> Case:
    """Return a shipped scenario with these sensors and changes of the case's fields."""
    scenario = load_scenario(shipped_scenario(name))
    suite = load_sensors(sensors) if isinstance(sensors, str) else sensors
    truth, seed = scenario.target_truth(), scenario.accuracy.seed
    case = make_case(scenario, scenario.spacecraft.make(), truth, suite, (), seed)
    return replace(case, **changes)


def flight_at(rate: float, *names: str) -> SensorSuite:
    """Return the flight suite with other rates [Hz] of the named sensors."""
    suite = load_sensors("flight")
    return replace(suite, **{name: replace(suite[name], rate=rate) for name in names})


def turning(case: Case, w_WB: np.ndarray, v_WScm: np.ndarray) -> Case:
    """Return the case with an unknown momentum, such that the base turns at the start.

    Args:
        case: the case; its joints may move at the start.
        w_WB: (3,) angular velocity of the base at the start [rad/s].
        v_WScm: (3,) velocity of the centre of mass of spacecraft and target [m/s].

    """
    q, qdot, _ = case.motion.evaluate(0.0)
    known = known_dynamics(case.spacecraft.make().tree, q[None], qdot[None])
    M, h, X, V_BC = (values[0] for values in (known.M, known.h, known.X, known.V_BC))
    target = X.T @ target_spatial_inertia(case.truth.to_standard_vector())
    M, h = M + target @ X, h + target @ V_BC
    p_BScm = np.array([M[2, 4], M[0, 5], M[1, 3]]) / M[5, 5]
    L_still = h[:3] - np.cross(p_BScm, h[3:])  # about the centre of mass
    inertia = M[:3, :3] + M[:3, 3:] @ M[:3, 3:] / M[5, 5]
    P = M[5, 5] * v_WScm
    L = inertia @ w_WB + L_still + np.cross(p_BScm, P)
    momentum = np.concatenate([L, P])
    return replace(case, momentum_W=momentum, momentum=TotalMomentum.unknown())


def only_joints(case: Case, *moving: str) -> Case:
    """Return the case in which only the named joints move."""
    names = case.spacecraft.make().joint_names
    still = [name not in moving for name in names]
    return replace(
        case, motion=replace(case.motion, amplitudes=np.where(still, 0, case.motion.amplitudes))
    )


def scaled_target(truth: InertialParameters, factor: float) -> InertialParameters:
    """Return a target of the same density and shape, with a mass that is `factor` times larger."""
    length = factor ** (1 / 3)
    inertia = factor * length**2 * np.asarray(truth.I_TTcm_C)
    return InertialParameters(factor * truth.mass, length * np.asarray(truth.p_CTcm_C), inertia)


# -- cases of other ground ------------------------------------------------------------------------


def tumble(
    scenario: str, sensors: str, degrees_per_second: float, duration: float, folder: Path
) -> Case:
    case = scenario_case(scenario, sensors, duration=duration)
    case = replace(case, motion=replace(case.motion, duration=duration))
    axis = np.array([0.6, -0.48, 0.64])
    return turning(case, np.radians(degrees_per_second) * axis, np.array([4e-3, 2e-3, -3e-3]))


def uncertain(name: str, folder: Path) -> Case:
    """Return another case with a spacecraft as uncertain as that of `uncertain_spacecraft`."""
    uncertainty = scenario_case("uncertain_spacecraft").known_bodies
    return replace(CASES[name].build(folder), known_bodies=uncertainty)


def wheels(swing: float, zero_momentum: bool, folder: Path) -> Case:
    """Wheels that spin; with zero momentum their own momenta cancel, else the base starts at rest.

    Args:
        swing: amplitude of the slow change of their speeds [rad/s].
        zero_momentum: whether the total momentum is zero, and the estimators assume this.
        folder: not used.

    """
    case = scenario_case("single_arm_wheels")
    names = case.spacecraft.make().joint_names
    case = only_joints(case, *(name for name in names if "wheel" not in name))
    signs = {"wheel1_spin": 1.0, "wheel2_spin": -1.0, "wheel3_spin": 1.0, "wheel4_spin": -1.0}
    pattern = np.array([signs.get(name, 0.0) for name in names])
    speed = WHEEL_SPEED * (pattern if zero_momentum else np.abs(pattern))
    # The changes do not cancel: they turn the base.
    change = np.array([{"wheel1_spin": 1.0, "wheel3_spin": -0.5}.get(n, 0.0) for n in names])
    case = replace(case, motion=Spinning(case.motion, speed, swing * change))
    return case if zero_momentum else turning(case, np.zeros(3), np.zeros(3))


def planar(folder: Path) -> Case:
    """The motion is in the plane of symmetry of spacecraft and target."""
    case = scenario_case("single_arm_wheels")
    size = (0.2, 0.15)
    motion = sines(
        case.spacecraft.make().joint_names,
        {"arm_joint2": -0.8, "arm_joint4": 1.3, "arm_joint6": 0.6},
        {"arm_joint2": size, "arm_joint4": size, "arm_joint6": size},
        case.duration,
    )
    return replace(case, motion=motion, truth=scenario_case("paper").truth)


def planar_arms(folder: Path) -> Case:
    """All moving joints are parallel, but the arms are beside the plane of symmetry."""
    case = scenario_case("exciting_motion")
    centre = {"capture_arm_joint2": -0.4, "capture_arm_joint3": 1.0, "capture_arm_joint5": 1.0}
    centre |= {"operating_arm_joint2": -1.0, "operating_arm_joint3": 0.9}
    joints = (2, 3, 5)
    moving = {f"capture_arm_joint{k}": (0.2, 0.15) for k in joints}
    moving |= {f"operating_arm_joint{k}": (0.15, 0.1) for k in joints}
    return replace(case, motion=sines(case.spacecraft.make().joint_names, centre, moving))


def one_joint(name: str, folder: Path) -> Case:
    return only_joints(scenario_case("exciting_motion"), name)


def fast(folder: Path) -> Case:
    case = scenario_case("exciting_motion")
    motion = replace(
        case.motion, frequencies=3 * case.motion.frequencies, ramp=case.motion.ramp / 3
    )
    return replace(case, motion=motion)


def after_rest(scenario: str, sensors: str, unknown: bool, folder: Path) -> Case:
    case = scenario_case(scenario, sensors)
    case = replace(case, motion=Delayed(case.motion, REST), duration=case.duration + REST)
    return replace(case, momentum=TotalMomentum.unknown()) if unknown else case


def target_mass(share: float, folder: Path) -> Case:
    """A target with this share of the spacecraft's mass."""
    case = scenario_case("exciting_motion")
    factor = share * case.spacecraft.make().mass / case.truth.mass
    return replace(case, truth=scaled_target(case.truth, factor))


def arms(letters: tuple[str, ...], folder: Path) -> Case:
    """A spacecraft with other arms: see `write_spacecraft`."""
    case = scenario_case("exciting_motion")
    spacecraft = write_spacecraft(folder, *letters)
    motion = arm_motion(spacecraft.make().joint_names, letters, case.duration)
    return replace(case, spacecraft=spacecraft, motion=motion)


# -- the table ------------------------------------------------------------------------------------


def _shipped(name: str, sensors: str | SensorSuite = "flight", **changes) -> Callable[[Path], Case]:
    return lambda folder: scenario_case(name, sensors, **changes)


def _thruster(*firings: Firing) -> Figure:
    return Figure(
        "scenarios", _shipped("thruster_firing", firings=firings), reference="thruster_none"
    )


def _with_faults(*faults: Fault) -> Figure:
    return Figure("faults", _shipped("exciting_motion"), faults, reference="exciting_motion")


CASES: dict[str, Figure] = {
    **{
        name: Figure("scenarios", _shipped(name))
        for name in ("exciting_motion", "paper", "tumbling_capture", "uncertain_spacecraft")
    },
    "thruster_none": Figure("scenarios", _shipped("thruster_firing", firings=())),
    "thruster_firing": _thruster(Firing(5.0, FIRED)),
    "thruster_burn": _thruster(Firing(5.0, FIRED, 0.5)),
    "thruster_two": _thruster(Firing(4.0, FIRED), Firing(6.5, FIRED[[1, 2, 0, 4, 5, 3]])),
    "thruster_at_0.6": _thruster(Firing(0.6, FIRED)),
    "thruster_at_1.5": _thruster(Firing(1.5, FIRED)),
    "single_arm_wheels": Figure("scenarios", _shipped("single_arm_wheels")),
    "free_flyer_payload": Figure("scenarios", _shipped("free_flyer_payload")),
    "ideal": Figure("sensors", _shipped("exciting_motion", "ideal")),
    "20_Hz": Figure(
        "sensors",
        lambda folder: scenario_case("exciting_motion", flight_at(20.0, "encoders", "gyro")),
    ),
    **{
        name: Figure("sensors", _shipped("exciting_motion", name))
        for name in ("servicer", "testbed", "coarse")
    },
    "cubesat": Figure("sensors", _shipped("free_flyer_payload", "coarse")),
    "tumble_30": Figure("ground", partial(tumble, "exciting_motion", "flight", 30.0, 10.0)),
    "tumble_30_servicer": Figure(
        "ground", partial(tumble, "exciting_motion", "servicer", 30.0, 10.0)
    ),
    "tumble_30_free_flyer": Figure(
        "ground", partial(tumble, "free_flyer_payload", "flight", 30.0, 10.0)
    ),
    **{
        f"uncertain_{name}": Figure("ground", partial(uncertain, name))
        for name in ("tumbling_capture", "tumble_30", "coarse", "wheels", "wheels_changing")
    },
    "tumble_5": Figure("ground", partial(tumble, "exciting_motion", "flight", 5.0, 59.99)),
    "wheels": Figure("ground", partial(wheels, 0.0, False)),
    "wheels_changing": Figure("ground", partial(wheels, 10.0, False)),
    "wheels_zero_momentum": Figure("ground", partial(wheels, 10.0, True)),
    "planar": Figure("ground", planar),
    "planar_arms": Figure("ground", planar_arms),
    "one_joint": Figure("ground", partial(one_joint, "capture_arm_joint2")),
    "one_joint_forearm": Figure("ground", partial(one_joint, "capture_arm_joint4")),
    "one_joint_wrist": Figure("ground", partial(one_joint, "capture_arm_joint6")),
    "fast": Figure("ground", fast),
    **{
        f"all_{rate}_Hz": Figure(
            "ground",
            lambda folder, rate=rate: scenario_case(
                "exciting_motion", flight_at(float(rate), *FLIGHT_SENSORS)
            ),
        )
        for rate in (5, 10, 1000)
    },
    "rest": Figure("ground", partial(after_rest, "exciting_motion", "flight", False)),
    "rest_unknown": Figure("ground", partial(after_rest, "exciting_motion", "flight", True)),
    "rest_tumbling": Figure("ground", partial(after_rest, "tumbling_capture", "flight", True)),
    "rest_free_flyer": Figure("ground", partial(after_rest, "free_flyer_payload", "testbed", True)),
    "heavy_target": Figure("ground", partial(target_mass, 5.0)),
    "light_target": Figure("ground", partial(target_mass, 0.01)),
    "four_joints": Figure("ground", partial(arms, ("zyxy",))),
    "prismatic": Figure("ground", partial(arms, ("zyXyx",))),
    "three_arms": Figure("ground", partial(arms, ("zyxy", "zyy", "yzy"))),
    **{f"spikes_{name}": _with_faults(Spikes(name)) for name in FLIGHT_SENSORS},
    "spikes_all": _with_faults(*map(Spikes, FLIGHT_SENSORS)),
    **{f"dropout_{name}": _with_faults(Dropout(name)) for name in FLIGHT_SENSORS},
    **{f"stuck_{name}": _with_faults(Stuck(name)) for name in FLIGHT_SENSORS},
}
"""All cases by name."""
