"""Validation from files: a result, and a log that was not used for it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.identification.checked_log import left_out_warnings
from cpid_drake.identification.identify_files import file_hash, open_log
from cpid_drake.identification.prior import prior_of_result
from cpid_drake.identification.result_files import read_result
from cpid_drake.identification.validation import Validation, validate


def validate_files(
    result: str | Path,
    log: str,
    *,
    sensors: str | None = None,
    momentum: str | None = None,
    beginning: float = 0.3,
    **reading: Any,
) -> Validation:
    """Test the target of a result file with another log, and predict this log.

    Args:
        result: the result file; a check of it that failed is among the warnings.
        log: the log's file.
        sensors: a preset or a file; default: that of the result.
        momentum, beginning: see `validate`.
        **reading: fields of `Request` that say how to read the log; default: columns of the result.

    Raises:
        InputError: the log was used for the result; a file cannot be read; see also `validate`.

    """
    identified = read_result(result)
    if not identified.sources:
        raise InputError(f"{result}: the result does not name its spacecraft")
    used = identified.sources[0].request
    if sensors is None and len({source.request.sensors for source in identified.sources}) > 1:
        raise InputError(f"{result}: its logs have different sensors; give --sensors of {log}")
    used_hashes = {source.sha256.get("telemetry") for source in identified.sources} - {None}
    if file_hash(log) in used_hashes:
        raise InputError(f"{log}: the result was identified from this log; give another one")
    reading["columns"] = reading.get("columns") or used.columns
    request = replace(used, telemetry=log, sensors=sensors or used.sensors, prior=None, **reading)
    craft = used.spacecraft.make()
    target = prior_of_result(identified, str(result), craft.mass, used.spacecraft.capture_frame)
    _, file = open_log(request, craft.joint_names)
    with prefix_errors(log):
        validation = validate(
            craft,
            target,
            file.log,
            sensors=request.sensors,
            momentum=momentum,
            known_bodies=used.known_bodies,
            planar=used.planar,
            beginning=beginning,
        )
    failed = (f"failed check of the result: {failure}" for failure in identified.failures)
    left_out = left_out_warnings(file.left_out_joints)
    return replace(validation, warnings=(*failed, *left_out, *validation.warnings))
