"""The sensors' errors of checked logs, as given or as the logs show them; the unknowns of a fit."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.least_squares import FAR
from cpid_drake.estimation.unknowns import Model
from cpid_drake.files.digits import significant
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.words import bias_advice, bias_words, noise_not_stated
from cpid_drake.logs.gyro_bias import gyro_bias
from cpid_drake.logs.noise_estimation import estimate_suite
from cpid_drake.sensors.sensors import CALIBRATED_GYRO_BIAS, DEGREE_PER_HOUR, Gyro
from cpid_drake.sensors.suite import SensorSuite


def suites_of(
    logs: Mapping[str, CheckedLog],
) -> tuple[dict[str, SensorSuite], tuple[str, ...]]:
    """Return the sensors' errors of each log, by default as the logs show them, and warnings.

    Without given ones, several logs have the sensors of all. Of a sensor in many it is the least
    noise: a log with more has a noise factor of its own.
    """
    given = {name: log.sensors for name, log in logs.items() if log.sensors is not None}
    if len(given) == len(logs):
        return with_biases(logs, given)
    [suite, *others] = (estimate_suite(log.measurements) for log in logs.values())
    for other in others:
        for name, errors in other.present().items():
            if name not in suite.present() or other.sigmas(name)[0] < suite.sigmas(name)[0]:
                setattr(suite, name, errors)
    text = "the sensors' noise was estimated from the log; give the sensors if you know them"
    suites, biases = with_biases(logs, dict.fromkeys(logs, suite))
    return suites, (text, *biases)


def with_biases(
    logs: Mapping[str, CheckedLog], suites: Mapping[str, SensorSuite]
) -> tuple[dict[str, SensorSuite], tuple[str, ...]]:
    """Return sensors in which the gyro's bias may be as large as the logs show it, and warnings.

    As noise, it is as declared unless the samples show clearly that it is larger. Sensors that are
    one object stay one; a gyro that is said to have no bias stays so.
    """
    made, warnings = {id(suite): suite for suite in suites.values()}, list[str]()
    for name, log in logs.items():
        gyro = suites[name].gyro
        if gyro is None or _excludes_bias(gyro, suites[name]):
            continue
        bias = gyro_bias(log.measurements, suites[name])
        declared = max(
            gyro.bias_sigma, DEGREE_PER_HOUR * CALIBRATED_GYRO_BIAS * (gyro.bias is None)
        )
        if bias is None or bias.ratio(declared) <= FAR:
            continue
        suite = made[id(suites[name])]
        assert suite.gyro is not None
        wider = replace(suite.gyro, bias=max(suite.gyro.bias or 0.0, bias.size / DEGREE_PER_HOUR))
        made[id(suites[name])] = replace(suite, gyro=wider)
        text = log.where + bias_words(bias)
        if log.sensors is not None and gyro.bias is not None:
            times = significant(float(np.nanmax(np.abs(bias.value))) / declared)
            text += (
                f", {times} times the sigma that its file declares, "
                f"and was assumed to have it; {bias_advice(bias)} and remove gyro.bias"
            )
        warnings.append(text)
    return {name: made[id(suite)] for name, suite in suites.items()}, tuple(warnings)


def exact_sensors(suite: SensorSuite) -> list[str]:
    """Return, in words, of which sensors no noise is stated, without a word that they are exact."""
    return [
        noise_not_stated(name)
        for name, sensor in suite.present().items()
        if suite.unstated is None and not (sensor.sigmas.any() or suite.step(name))
    ]


def excluded_bias(log: CheckedLog) -> str:
    """Return the gyro's bias that a log shows and its sensors exclude, in words; or nothing."""
    suite = log.sensors
    if suite is None or suite.gyro is None or not _excludes_bias(suite.gyro, suite):
        return ""
    bias = gyro_bias(log.measurements, suite)
    if bias is None or bias.ratio(0.0) <= FAR:
        return ""
    text, advice = log.where + bias_words(bias), bias_advice(bias)
    if suite.gyro.bias is None:
        return f"{text}, which `unstated: exact` excludes: {advice}"
    return f"{text}, which `bias: 0` excludes: {advice} and remove gyro.bias"


def _excludes_bias(gyro: Gyro, suite: SensorSuite) -> bool:
    """Return whether a gyro has no bias by its file."""
    return gyro.bias == 0 or (gyro.bias is None and suite.unstated is not None)


def model_of(
    tree: KinematicTree, logs: Mapping[str, CheckedLog], known_bodies: BodyUncertainty | None
) -> tuple[Model, tuple[str, ...]]:
    """Return the unknowns of a fit of some logs, and the warnings of `suites_of`."""
    suites, warnings = suites_of(logs)
    has_thrust = any(log.measurements.has_thrust for log in logs.values())
    return Model.of(tree, suites, known_bodies, has_thrust=has_thrust), warnings


def open_model_of(
    tree: KinematicTree, logs: Mapping[str, CheckedLog], known_bodies: BodyUncertainty | None
) -> Model | None:
    """Return the unknowns if no error is exact that nobody states; None if none is."""
    suites, _ = suites_of(logs)
    if all(suite.unstated != "exact" for suite in suites.values()):
        return None
    made = {id(suite): replace(suite, unstated=None) for suite in suites.values()}
    has_thrust = any(log.measurements.has_thrust for log in logs.values())
    opened = {name: made[id(suite)] for name, suite in suites.items()}
    return Model.of(tree, opened, known_bodies, has_thrust=has_thrust)
