"""The sections about the data: request, checks, convergence, residuals, sensors, base motion."""

import numpy as np

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.rows import ROW_FAMILIES
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.files.digits import significant
from cpid_drake.files.pictures import curves
from cpid_drake.identification.estimators import estimator_label
from cpid_drake.identification.identify_files import Evidence
from cpid_drake.identification.result import History, Identification
from cpid_drake.logs.log import Log
from cpid_drake.report.figures import convergence_pictures, motion_pictures
from cpid_drake.report.page import Section, Table
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.simulation.run_files import versions


def request_section(result: Identification) -> Section:
    """Return the section with data and options of the identification, and how to repeat it."""
    facts: list[tuple[str, str]] = []
    for source in result.sources:
        facts += [
            ("Log", source.request.telemetry),
            ("SHA-256", source.sha256.get("telemetry") or "none (a folder)"),
            ("Time window", f"{source.start:.6g} to {source.end:.6g} s"),
            ("Sensors", source.request.sensors or "not given"),
        ]
    for source in result.sources[:1]:
        request, craft = source.request, source.request.spacecraft
        given = {
            "Total momentum": request.momentum or "not given",
            "Spacecraft": craft.model,
            "Base body": craft.base,
            "Capture frame": craft.capture_frame,
            "Map of columns": request.columns,
            "Prior": request.prior,
            "Identified by": f"cpid-drake {source.cpid_drake or '(not installed)'}",
        }
        facts += [(name, text) for name, text in given.items() if text]
    how = estimator_label(result.estimator) + (f" ({result.rows})" if result.rows else "")
    used, rejected = result.sample_count, sum(result.rejected.values())
    facts += [("Estimator", how), ("Samples", f"{used} used, {rejected} left out"), written_by()]
    text = (
        "Mass, centre of mass and inertia of the target that a free-floating spacecraft holds, "
        "identified from the motion of the base while the arms move."
    )
    return Section("Request", texts=[text], facts=facts, command=result.command)


def written_by() -> tuple[str, str]:
    """Return the versions of the software as a fact of a section."""
    used = ", ".join(f"{name} {number}" for name, number in versions().items())
    return "Report written by", used


def checks_section(result: Identification, again: Identification | None) -> Section:
    """Return the section with the warnings and the checks of a result.

    `again` is the result of the same log, identified again for the report, if it was.
    """
    texts = list(result.warnings)
    if again is not None:
        sigma, values = np.sqrt(np.nan_to_num(np.diag(result.covariance))), again.parameters
        close = np.abs(values - result.parameters) <= 1e-3 * sigma + 1e-9 * np.abs(values)
        if not np.all(close | (np.isnan(values) & np.isnan(result.parameters))):
            texts.append(
                "For this report the log was identified again; the values differ from those of "
                "the result file, and the figures below show the new ones. The model, the "
                "sensors or the software have changed since the result file was written."
            )
    rows = [
        [
            check.name,
            *("" if x is None else significant(x, 3) for x in (check.statistic, check.limit)),
            "passed" if check.passed else "failed",
        ]
        for check in result.checks
    ]
    table = Table(["", "statistic", "limit", ""], rows, "Checks of the assumptions of the estimate")
    return Section("Checks", warnings=texts, tables=[table] if rows else [])


def convergence_section(estimates: History, truth: InertialParameters | None) -> Section:
    """Return the section with the estimates from growing parts of the log."""
    text = (
        "Estimates from the samples up to each time, with their 95 % intervals as a band. The axes "
        "are scaled for the later estimates; earlier ones may lie outside. At times without a "
        "point the samples do not determine the parameter yet. A dashed line is the true value, "
        "where it is known."
    )
    return Section("Convergence", texts=[text], pictures=convergence_pictures(estimates, truth))


def residuals_section(found: Identification) -> Section:
    """Return the section with size, whiteness and pictures of the residuals."""
    if not found.residuals:
        text = "This estimator gives no residuals, or not all ten parameters are known."
        return Section("Residuals", texts=[text])
    rows, units = [], dict.fromkeys(found.residuals, "σ")
    if found.rows is not None:
        units = {"linear": ROW_FAMILIES[found.rows].linear_unit, "angular": "N·m·s"}
    for name, series in found.residuals.items():
        white = whiteness(series.value)
        sizes = [significant(size, 3) for size in np.sqrt(np.mean(series.value**2, axis=0))]
        correlation = f"{white.lag_one:+.3f} ± {white.band:.3f}"
        row = [name, str(len(series)), ", ".join(sizes), units[name], correlation]
        rows.append([*row, "yes" if white.is_white else "no"])
    heads = ["", "samples", "rms of each axis", "unit", "lag-one correlation", "white"]
    note = (
        "Residuals: measured minus predicted samples in units of the assumed noise (σ), or the "
        "momentum balance in the capture frame, of a long log in parts that are spread over it. "
        "White: the correlation of neighbours is within the ± band of white noise, or below 0.1, "
        "which changes no interval by more than a tenth."
    )
    return Section(
        "Residuals",
        tables=[Table(heads, rows, note=note)],
        pictures=[
            curves(name, each.time, each.value, units[name], line=".")
            for name, each in found.residuals.items()
        ],
    )


def sensors_section(evidence: Evidence) -> Section:
    """Return the section that compares the samples of every sensor with the assumed noise."""
    found, rows = evidence.found, []
    for name, samples in evidence.log.items():
        if not len(samples):
            continue
        step = f"{1e3 * np.median(np.diff(samples.time)):.4g}" if len(samples) > 1 else ""
        sigma, left = "", found.residuals.get(name)
        if found.sensors is not None and name in found.sensors.present():
            sigma = ", ".join(f"{value:.2g}" for value in np.unique(found.sensors.sigmas(name)))
        row = [SENSORS[name].quantity, str(len(samples)), step, str(found.rejected.get(name, 0))]
        row += [sigma, SENSORS[name].unit if sigma else ""]
        rows.append([*row, "" if left is None else f"{np.mean(left.value**2):.3f}"])
    if found.sensors is None:
        text = "No noise was assumed: all complete samples have the same weight."
    else:
        whose = "given" if evidence.inputs.sensors is not None else "estimated from the log"
        text = f"The noise of the sensors was {whose}."
    heads = ["", "samples", "every [ms]", "not used", "σ assumed", "unit", "χ² per reading"]
    note = "χ² per reading is 1 if the samples scatter as much as assumed."
    return Section("Sensors", texts=[text], tables=[Table(heads, rows, note=note)])


def base_motion_section(measurements: Log) -> Section:
    """Return the section with the measured motion of the base."""
    text = (
        "Measured motion of the base, not filtered. Rotation and displacement are relative to the "
        "first sample. Of a long log, the figures show an even selection of the samples."
    )
    return Section("Base motion", texts=[text], pictures=motion_pictures(measurements.thinned()))
