"""`cpid validate`."""

from dataclasses import asdict, replace
from json import dumps
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number as Within

from cpid_drake.commands import options
from cpid_drake.commands.options import CHECK_FAILED
from cpid_drake.files.digits import significant
from cpid_drake.files.drafts import write_text
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.identification.checked_log import left_out_warnings
from cpid_drake.identification.identify_files import file_hash, open_log
from cpid_drake.identification.prior import prior_of_result
from cpid_drake.identification.result_files import read_result
from cpid_drake.identification.validation import POWER, Validation
from cpid_drake.identification.validation import validate as validate_target
from cpid_drake.report.page import Table
from cpid_drake.report.terminal import print_table


def validate(
    result: options.Result,
    log: options.FileName,
    /,
    *,
    part: options.PartOptions = options.PartOptions(),
    threshold: Annotated[options.Number, Parameter(validator=Within(gte=1e-6, lte=1e6))] = 3.0,
    beginning: options.Number = 0.3,
    sensors: options.Sensors | None = None,
    momentum: options.Momentum | None = None,
    json: options.File | None = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> int:
    """Test an identified target with another log, and predict this log.

    The difference of the target from the log's own estimate is tested by its χ²: a right target
    fails in one log of a hundred. Start, momentum and biases are also fitted to the beginning of
    the log, and the rest of the base's motion is predicted from the joint motion. Sensors and
    columns are those of the result by default.

    Exit codes: 0 the target passes the test, and the residuals are below the threshold; 2 bad input
    or usage; 4 the result is not valid.

    Args:
        log: A log of the same spacecraft and target that was not used for the result: CSV, NPZ,
            Parquet or ROS 2 bag.
        threshold: Largest usual residual of the log, in σ and whatever its cause, with which the
            result is valid.
        beginning: Share of the log to which start, momentum and biases are fitted; the rest is
            predicted.
        sensors: Sensor noise. Default: that of the result.
        json: Write the errors to this file.

    """
    check_outputs([("--json", json)], [result, log, sensors, part.columns], force=force)
    found = read_result(result)
    if not found.sources:
        raise InputError(f"{result}: the result does not name its spacecraft")
    used = found.sources[0].request
    if sensors is None and len({source.request.sensors for source in found.sources}) > 1:
        raise InputError(f"{result}: its logs have different sensors; give --sensors of {log}")
    used_hashes = {source.sha256.get("telemetry") for source in found.sources} - {None}
    if file_hash(log) in used_hashes:
        raise InputError(f"{log}: the result was identified from this log; give another one")
    request = replace(
        used,
        telemetry=log,
        sensors=sensors or used.sensors,
        start=part.start,
        end=part.end,
        topics=part.topics(),
        leave_out_bad=part.leave_out_bad,
        columns=part.columns or used.columns,
        prior=None,
    )
    with options.log_console(quiet).status("reading") as status:
        craft = used.spacecraft.make()
        target = prior_of_result(found, str(result), craft, used.spacecraft.capture_frame)
        _, file = open_log(request, craft.joint_names)
        status.update("predicting")
        with prefix_errors(log):
            validation = validate_target(
                craft,
                target,
                file.log,
                sensors=request.sensors,
                momentum=momentum,
                known_bodies=used.known_bodies,
                planar=used.planar,
                beginning=beginning,
            )
    warnings = (*left_out_warnings(file.left_out_joints), *validation.warnings)
    validation = replace(validation, warnings=warnings)
    is_valid = validation.is_target_right and validation.in_sigma <= threshold
    if json is not None:
        judged = {"threshold": threshold, "is_valid": is_valid}
        size = {"in_sigma": validation.in_sigma, "probability": validation.probability}
        files = {"result": str(result), "telemetry": log}
        content = asdict(validation) | size | judged | files
        write_text(json, dumps(content, indent=2) + "\n")
    options.print_warnings(f"failed check of the result: {failure}" for failure in found.failures)
    options.print_warnings(validation.warnings)
    if not quiet:
        print("\n".join(_verdict(validation, threshold)))
        print_table(_predicted(validation))
    return 0 if is_valid else CHECK_FAILED


def _verdict(validation: Validation, threshold: float) -> list[str]:
    size, probability = validation.in_sigma, validation.probability
    verdict = f"valid: the log agrees with this target (p = {probability:.2g})"
    if not validation.is_target_right:
        verdict = (
            "not valid: the log's own estimate differs; from the right target it differs so much "
            f"with probability {max(probability, 1e-99):.2g}"
        )
    elif size > threshold:
        verdict = (
            f"not valid: a usual residual of {significant(size, 3)} σ (threshold {threshold:g}), "
            "which no other target explains better"
        )
    noticed = "Not even a target twice as heavy would be noticed"
    if validation.heavier <= 1:
        noticed = f"A target {100 * validation.heavier:.2g} % heavier would be noticed"
    return [
        verdict,
        f"{noticed} (probability {100 * POWER:g} %)",
        f"χ² of the target {validation.chi_squared:.3g}, of {validation.freedom} combinations of "
        f"parameters that the log determines; total momentum {validation.momentum}",
    ]


def _predicted(validation: Validation) -> Table:
    rows = []
    for each in validation.errors:
        sizes = [f"{x:.3g}" for x in (each.rms, each.largest, each.noise)]
        residual = f"{significant(each.in_sigma, 3)} σ"
        rows.append([each.sensor, str(each.samples), *sizes, each.unit, residual])
    heads = ["", "samples", "rms error", "largest", "noise", "", "residual"]
    start, end = validation.start, validation.end
    caption = f"Predicted {start:.6g} to {end:.6g} s from the joint motion"
    note = "Residual: of a fit of the whole log with the target that explains it best."
    return Table(heads, rows, caption, note)
