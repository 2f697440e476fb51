"""Limits that concern several values of a scenario; `schema` has the limits of single values."""

import numpy as np

from cpid_drake.errors import InputError, prefix_errors
from cpid_drake.scenario.schema import PriorConfig, Scenario, TargetConfig
from cpid_drake.sensors.suite import check_sensors

ONLINE_ESTIMATORS = ("least_squares", "recursive_fit")
"""Estimators that can run in a Diagram."""

LONGEST_LENGTH = 100.0
"""Largest centre of mass and radius of gyration [m]; larger values must be in another unit."""

MOST_STEPS = 1_000_000
"""Largest number of logged samples, of identified samples and of longest steps of a simulation."""


def check_scenario(scenario: Scenario, where: str) -> None:
    """Refuse a scenario that would fail inside Drake, or whose values contradict each other.

    Args:
        scenario: the scenario, whose single values are within the limits that `schema` declares.
        where: its name in error messages.

    Raises:
        InputError: two values contradict each other; the message names them.

    """
    with prefix_errors(where):
        _check_body(scenario.target, "target")
        _check_controller(scenario)
        _check_steps(scenario)
        _check_sensors_and_estimator(scenario)
        _check_firing(scenario)


def _check_body(body: TargetConfig | PriorConfig, where: str) -> None:
    """Refuse a body so large that its lengths seem to be in millimetres."""
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


def _check_controller(scenario: Scenario) -> None:
    config = scenario.controller
    if scenario.simulation.wrist is not None and not config.knows_target:
        raise InputError(
            "controller.knows_target must be true with simulation.wrist: a controller without the "
            "springs of the wrist cannot hold a light last link"
        )
    if not (config.knows_target or config.nominal_mass > 0):
        raise InputError(
            "controller.nominal_mass must be a number > 0 where knows_target is false, not "
            f"{config.nominal_mass}"
        )


def _check_steps(scenario: Scenario) -> None:
    """Refuse periods that are too short for the duration of the simulation."""
    config = scenario.simulation
    for name, period in (
        ("simulation.log_period", config.log_period),
        ("simulation.simulator.max_step_size", config.simulator.max_step_size),
        ("identification.period", scenario.identification.period),
    ):
        if config.duration / period > MOST_STEPS:
            raise InputError(
                f"{name} of {period:g} s is more than {MOST_STEPS} times in simulation.duration, "
                f"{config.duration:g} s"
            )


def _check_sensors_and_estimator(scenario: Scenario) -> None:
    sensors = scenario.sensors
    if sensors.explicit is not None:
        if sensors.suite:
            raise InputError("sensors.suite and sensors.explicit: give one of the two")
        check_sensors(sensors.explicit, "sensors.explicit")
    estimator = checked_estimator(scenario)
    prior = scenario.identification.prior
    if prior is not None:
        if estimator != "recursive_fit":
            raise InputError(
                f"identification.prior: {estimator} uses no prior; give estimator: "
                "recursive_fit, or leave prior out"
            )
        _check_body(prior, "identification.prior")
        from cpid_drake.identification.online import check_guess

        with prefix_errors("identification.prior"):
            check_guess(prior.guess(), prior.sigma)


def checked_estimator(scenario: Scenario) -> str:
    """Return the name of the online estimator.

    Raises:
        InputError: there is no such estimator, or it lacks sensors.

    """
    estimator = scenario.online_estimator
    if estimator not in ONLINE_ESTIMATORS:
        raise InputError(
            f"identification.estimator must be one of {', '.join(ONLINE_ESTIMATORS)}, "
            f"not '{estimator:.60}'"
        )
    if estimator == "recursive_fit" and not scenario.sensors.present:
        raise InputError(
            "identification.estimator: recursive_fit needs sensors; give sensors.suite or "
            "sensors.explicit"
        )
    return estimator


def _check_firing(scenario: Scenario) -> None:
    firing, duration = scenario.accuracy.firing, scenario.simulation.duration
    for k, burn in enumerate(scenario.simulation.burns):
        if not burn.time < duration:
            raise InputError(
                f"simulation.burns[{k}].time must be before the simulation's end, {duration:g} s, "
                f"not {burn.time}"
            )
    if firing is not None and not 0 < firing.time < duration:
        raise InputError(
            "accuracy.firing.time must be within the simulation's duration, "
            f"{duration:g} s, not {firing.time}"
        )
