"""Refuses scenarios that would fail deep inside Drake, or silently do something else."""

import numpy as np

from cpid_drake.errors import InputError
from cpid_drake.identification.sensor_identification import check_guess
from cpid_drake.scenario.naming import naming
from cpid_drake.scenario.schema import PriorConfig, Scenario, TargetConfig
from cpid_drake.sensing.suite import check_sensors

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

MOST_STEPS = 1_000_000
"""Samples that a simulation logs or identifies from at most, and longest steps in it."""


def check_scenario(scenario: Scenario, where: str) -> None:
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
