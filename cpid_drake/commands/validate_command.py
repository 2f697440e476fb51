"""`cpid validate`."""

from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number as Within

from cpid_drake.commands import options
from cpid_drake.commands.options import CHECK_FAILED
from cpid_drake.files.drafts import write_text
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.identification.validate_files import validate_files
from cpid_drake.report.terminal import print_table
from cpid_drake.report.validation_tables import is_valid, prediction_table, validation_json, verdict


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
        log: A log of the same spacecraft and target that was not used for the result: CSV,
            Parquet or ROS bag.
        threshold: Largest usual residual of the log, in σ and whatever its cause, with which the
            result is valid.
        beginning: Share of the log to which start, momentum and biases are fitted; the rest is
            predicted.
        sensors: Sensor noise. Default: that of the result.
        json: Write the errors to this file.

    """
    check_outputs([("--json", json)], [result, log, sensors, part.columns], force=force)
    with options.log_console(quiet).status("predicting"):
        validation = validate_files(
            result,
            log,
            sensors=sensors,
            momentum=momentum,
            beginning=beginning,
            **part.reading(),
        )
    if json is not None:
        write_text(json, validation_json(validation, threshold, result=str(result), telemetry=log))
    options.print_warnings(validation.warnings)
    if not quiet:
        print("\n".join(verdict(validation, threshold)))
        print_table(prediction_table(validation))
    return 0 if is_valid(validation, threshold) else CHECK_FAILED
