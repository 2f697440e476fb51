"""The sections about the data: request, checks, convergence, residuals, sensors, base motion."""

import numpy as np

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.rows import ROW_FAMILIES
from cpid_drake.estimation.whiteness import LagSums
from cpid_drake.files.digits import significant
from cpid_drake.files.figures import curves
from cpid_drake.identification.estimators import estimator_label
from cpid_drake.identification.identify_files import Evidence
from cpid_drake.identification.result import History, Identification
from cpid_drake.identification.words import label_of
from cpid_drake.logs.log import Log
from cpid_drake.report.figures import convergence_figures, motion_figures
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
    return Section("Request", facts=facts, command=result.command, folded=True)


def written_by() -> tuple[str, str]:
    """Return the versions of the software as a fact of a section."""
    used = ", ".join(f"{name} {number}" for name, number in versions().items())
    return "Report written by", used


def checks_section(result: Identification) -> Section:
    """Return the section with the statistic and the limit of each check."""
    rows = [
        [
            check.name,
            *("" if x is None else significant(x, 3) for x in (check.statistic, check.limit)),
            "passed" if check.passed else "failed",
        ]
        for check in result.checks
    ]
    note = "Each check tests a consequence of the assumptions behind the estimate with the data."
    tables = [Table(["", "statistic", "limit", ""], rows, note=note)] if rows else []
    return Section("Checks", tables=tables, folded=True)


def convergence_section(estimates: History, truth: InertialParameters | None) -> Section:
    """Return the section with the estimates from growing parts of the log."""
    text = "Estimates from the samples up to each time [s], with their 95 % intervals as a band"
    text += "." if truth is None else "; dashed: the true values."
    figures = convergence_figures(estimates, truth)
    return Section("Convergence", texts=[text], figures=figures, columns=5)


def residuals_section(result: Identification) -> Section:
    """Return the section with size, whiteness and figures of the residuals."""
    if not result.residuals:
        text = "This estimator gives no residuals, or not all ten parameters are known."
        return Section("Residuals", texts=[text], folded=True)
    rows, units = [], dict.fromkeys(result.residuals, "σ")
    if result.rows is not None:
        units = {"linear": ROW_FAMILIES[result.rows].linear_unit, "angular": "N·m·s"}
    for name, series in result.residuals.items():
        white = LagSums().added(series.value).whiteness
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
        figures=[
            curves(label_of(name), each.time, each.value, units[name], points=True)
            for name, each in result.residuals.items()
        ],
        folded=True,
    )


def sensors_section(evidence: Evidence) -> Section:
    """Return the section that compares the samples of every sensor with the assumed noise."""
    result, rows = evidence.result, []
    for name, samples in evidence.log.items():
        if not len(samples):
            continue
        step = f"{1e3 * np.median(np.diff(samples.time)):.4g}" if len(samples) > 1 else ""
        sigma, left = "", result.residuals.get(name)
        if result.sensors is not None and name in result.sensors.present():
            sigma = ", ".join(f"{value:.2g}" for value in np.unique(result.sensors.sigmas(name)))
        row = [SENSORS[name].quantity, str(len(samples)), step, str(result.rejected.get(name, 0))]
        row += [sigma, SENSORS[name].unit if sigma else ""]
        rows.append([*row, "" if left is None else f"{np.mean(left.value**2):.3f}"])
    if result.sensors is None:
        text = "No noise was assumed: all complete samples have the same weight."
    else:
        whose = "given" if evidence.inputs.sensors is not None else "estimated from the log"
        text = f"The noise of the sensors was {whose}."
    heads = ["", "samples", "every [ms]", "not used", "σ assumed", "unit", "χ² per reading"]
    note = "χ² per reading is 1 if the samples scatter as much as assumed."
    return Section("Sensors", texts=[text], tables=[Table(heads, rows, note=note)], folded=True)


def base_motion_section(measurements: Log) -> Section:
    """Return the section with the measured motion of the base."""
    text = (
        "Measured motion of the base, not filtered. Rotation and displacement are relative to the "
        "first sample. Of many samples, the figures show an even selection."
    )
    figures = motion_figures(measurements.thinned())
    return Section("Base motion", texts=[text], figures=figures, folded=True)
