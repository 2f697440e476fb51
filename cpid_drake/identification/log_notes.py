"""What the logs say beside an estimate: warnings, failed checks, and causes of failures."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from cpid_drake.files.errors import InputError
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.checks import Check
from cpid_drake.identification.estimators import Estimator
from cpid_drake.identification.log_sensors import exact_sensors, excluded_bias
from cpid_drake.identification.planar import could_be_planar
from cpid_drake.identification.result import Identification
from cpid_drake.identification.words import PLANAR_PROPOSED, THRUST_NOT_USED, label_of
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft


def with_logs(
    result: Identification, logs: Iterable[CheckedLog], method: Estimator, arguments: Arguments
) -> Identification:
    """Return an identification with what the checks of its logs say."""
    warnings, checks, rejected = list[str](), list[Check](), Counter(result.rejected)
    for log in logs:
        texts = [*log.warnings, *(f"not checked: {text}" for text in log.conventions.unchecked)]
        failed = list(log.failures)
        if not method.uses_rows:
            texts += [
                f"the {label_of(name)} of the log is not used: the sensors' file has no '{name}:' "
                "with its rate and noise"
                for name in SENSORS
                if log.sensors and len(log.measurements[name]) and name not in log.sensors.present()
            ]
            texts += exact_sensors(log.sensors or SensorSuite())
        elif log.measurements.has_thrust:
            failed.append(THRUST_NOT_USED.format(f"{log.measurements.first_burn:.4g}", method.name))
        warnings += [log.where + text for text in texts]
        checks += [Check("log", log.where + text) for text in failed]
        for name in [each for each in SENSORS if log.rejected.get(each)]:
            count = log.rejected[name]
            total = count + log.counts.get(name, 0)
            text = f"{log.where}{count} of {total} samples of {name} could not be used"
            checks.append(Check.of(f"rejected share of {name}", text, count / total, 0.5))
        rejected.update(log.rejected)
    if method.uses_rows and not arguments.has_exact_bodies:
        warnings.append(
            f"{method.name} does not use the uncertainty of the spacecraft: its intervals are "
            "those of an exact model"
        )
    return replace(
        result,
        warnings=(*dict.fromkeys(warnings), *result.warnings),
        checks=(*checks, *result.checks),
        rejected={name: count for name, count in rejected.items() if count},
    )


def with_causes(
    result: Identification, spacecraft: Spacecraft, logs: Sequence[CheckedLog], planar: bool | None
) -> Identification:
    """Return an identification with what may explain that it failed, or is not whole."""
    tree, warnings, [log, *others] = spacecraft.tree, list(result.warnings), logs
    could_be = planar is None and could_be_planar(tree, log.measurements.attitude.value)
    if could_be and not (result.passed and result.is_complete):
        warnings.append(PLANAR_PROPOSED)
    if tree.jointed and tree.lumped.capture_body == 0:
        warnings.append(
            "the capture frame is fixed to the base: no joint moves the target relative to the "
            "base, and only the base's reaction to the joints, or to thrusters, shows it"
        )
    causes = [text for each in logs if (text := excluded_bias(each))]
    if result.passed:
        return replace(result, warnings=(*warnings, *causes))
    if not (causes or others or log.failures):
        causes = [*filter(None, [_convention(log, spacecraft)])]
    checks = (Check("log", f"most likely, {text}") for text in causes)
    return replace(result, warnings=tuple(warnings), checks=(*checks, *result.checks))


def explained(
    error: Exception, estimator: str, spacecraft: Spacecraft, logs: Iterable[CheckedLog]
) -> InputError:
    """Return the error of an estimator with what most likely causes it."""
    text = str(error)
    if isinstance(error, np.linalg.LinAlgError):
        text = (
            f"{estimator} cannot calculate with these samples ({error}): plot them, and compare "
            "units with the sensors' file and the model"
        )
    reasons = (log.failures or [_convention(log, spacecraft)] for log in logs)
    causes = "; ".join(dict.fromkeys(filter(None, chain.from_iterable(reasons))))
    return InputError(f"most likely, {causes}: {text}" if causes else text)


def _convention(log: CheckedLog, spacecraft: Spacecraft) -> str:
    """Return the convention that explains a log of which the identification failed; or nothing."""
    if spacecraft.tree.normal_B is not None:
        return ""  # the plane's few equations do not distinguish conventions
    return check_conventions(log.measurements, spacecraft.tree).sentence
