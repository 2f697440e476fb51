"""A validation in words, as a table and as JSON."""

from dataclasses import asdict
from json import dumps

from cpid_drake.files.digits import significant
from cpid_drake.identification.validation import POWER, Validation
from cpid_drake.report.page import Table


def is_valid(validation: Validation, threshold: float) -> bool:
    """Return whether the target passes the test, and the residuals are below a threshold [σ]."""
    return validation.is_target_right and validation.in_sigma <= threshold


def validation_json(validation: Validation, threshold: float, **files: str) -> str:
    """Return a validation as JSON, with its verdict and the names of its files."""
    document = {
        **asdict(validation),
        "in_sigma": validation.in_sigma,
        "probability": validation.probability,
        "threshold": threshold,
        "is_valid": is_valid(validation, threshold),
        **files,
    }
    return dumps(document, indent=2) + "\n"


def verdict(validation: Validation, threshold: float) -> list[str]:
    """Return the verdict on a target, and what the test would have noticed, in words."""
    size, probability = validation.in_sigma, validation.probability
    text = f"valid: the log agrees with this target (p = {probability:.2g})"
    if not validation.is_target_right:
        text = (
            "not valid: the log's own estimate differs; from the right target it differs so much "
            f"with probability {max(probability, 1e-99):.2g}"
        )
    elif size > threshold:
        text = (
            f"not valid: a usual residual of {significant(size, 3)} σ (threshold {threshold:g}), "
            "which no other target explains better"
        )
    noticed = "Not even a target twice as heavy would be noticed"
    if validation.heavier <= 1:
        noticed = f"A target {100 * validation.heavier:.2g} % heavier would be noticed"
    return [
        text,
        f"{noticed} (probability {100 * POWER:g} %)",
        f"χ² of the target {validation.chi_squared:.3g}, of {validation.freedom} combinations of "
        f"parameters that the log determines; total momentum {validation.momentum}",
    ]


def prediction_table(validation: Validation) -> Table:
    """Return the errors of the prediction, sensor by sensor."""
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
