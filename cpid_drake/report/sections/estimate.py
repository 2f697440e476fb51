"""The sections with what was estimated: parameters, effects, separate logs, identifiability."""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.files.digits import decimals_of, rounded_pair, significant, with_half_width
from cpid_drake.identification.description import agreement_words, consistency_words, gap
from cpid_drake.identification.result import Identification
from cpid_drake.report.figures import singular_value_picture
from cpid_drake.report.page import Section, Table


def result_section(result: Identification, truth: InertialParameters | None) -> Section:
    """Return the section with the estimate, its 95 % intervals and, if it is known, the truth."""
    words = consistency_words(result)
    texts = [f"{words[0].upper()}{words[1:]}."]
    if not result.is_identifiable:
        known = f"The log determines {result.rank} of ten combinations of the parameters."
        texts = [known, *gap(result)]
    return Section(
        "Result",
        texts=texts,
        warnings=[f"Failed check: {failure}." for failure in result.failures],
        tables=[_parameters(result, truth)],
    )


def _parameters(result: Identification, truth: InertialParameters | None) -> Table:
    has_bodies = result.consistent_intervals is not None
    heads = ["", "estimate", "95 % interval", "consistent", *["rigid bodies"] * has_bodies, "unit"]
    heads += [] if truth is None else ["truth", "error / σ"]
    sigma = np.sqrt(np.diag(result.covariance))
    nearest = np.full(10, np.nan) if result.consistent is None else result.consistent.to_vector()
    intervals = result.intervals
    if not result.is_consistent:
        intervals = np.full((10, 2), np.nan)  # no rigid body agrees with the estimate
    rows = []
    for i, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS)):
        places = decimals_of(*intervals[i])
        estimate, body = (_number(x[i], places) for x in (result.parameters, nearest))
        row = [name, estimate or "not identifiable", _range(intervals[i]), body]
        row += [_range(result.shown_intervals[i])] * has_bodies
        row.append(unit)
        if truth is not None:
            true = truth.to_vector()[i]
            score = (result.parameters[i] - true) / sigma[i]
            row += [_number(true, places), f"{score:+z.1f}" if np.isfinite(score) else ""]
        rows.append(row)
    note = (
        "m: mass. c: centre of mass, from the origin of the capture frame C, in its axes. I: "
        "inertia about the centre of mass, in the same axes; Ixy = −∫xy dm. Consistent: the "
        "nearest values of a rigid body. Rigid bodies: the part of the interval that a rigid body "
        "can have; of what is not identifiable, bounds of a target about as heavy and as large as "
        "the spacecraft (1 σ). σ: standard deviation of the estimate."
    )
    return Table(heads, rows, note=note)


def _number(value: float, places: int) -> str:
    return f"{round(value, places) + 0.0:.{places}f}" if np.isfinite(value) else ""


def _range(ends: Array) -> str:
    low, high = ends
    if np.isnan(ends).all():
        return ""
    places = decimals_of(low, high)
    return f"{_number(low, places) or '?'} to {_number(high, places) or '?'}"


def logs_section(result: Identification) -> Section:
    """Return the section with the separate estimates of logs and prior beside the joint one."""
    parts = {"together": result, **result.logs}
    rows = [
        ["samples", *(str(part.sample_count) for part in parts.values()), ""],
        ["rank", *(str(part.rank) for part in parts.values()), ""],
        ["agreement", *(agreement_words(part) for part in parts.values()), ""],
        ["failed checks", *("; ".join(part.failures) or "none" for part in parts.values()), ""],
    ]
    for i, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS)):
        cells = []
        for part in parts.values():
            value, half = part.parameters[i], np.diff(part.intervals[i])[0] / 2
            cells.append(with_half_width(value, half) if np.isfinite(value) else "not identifiable")
        rows.append([name, *cells, unit])
    note = (
        "Estimates with 95 % intervals; each log has its own start, momentum and biases. "
        "Agreement: χ² of the difference from all others, for the same target."
    )
    return Section("Logs", tables=[Table(["", *parts, "unit"], rows, note=note)])


def effects_section(result: Identification) -> Section:
    """Return the section with a row for every entry of every estimated effect."""
    factor = quantile_95()
    rows = [
        [
            effect.name if i == 0 else "",
            *rounded_pair(value, factor * sigma),
            significant(factor * effect.prior_sigma),
            effect.unit,
        ]
        for effect in result.effects
        for i, (value, sigma) in enumerate(zip(effect.value, effect.sigma))
    ]
    texts = [effect.describe() for effect in result.effects]
    note = " ".join(f"{text[0].upper()}{text[1:]}." for text in texts)
    text = (
        "These unknown constants were estimated as well, with the σ that the sensors' file states, "
        "or with a plausible one."
    )
    heads = ["", "estimate", "± 95 %", "± 95 % before", "unit"]
    return Section(
        "Estimated errors and forces", texts=[text], tables=[Table(heads, rows, note=note)]
    )


def budget_section(result: Identification) -> Section:
    """Return the section with what the variance of each parameter comes from."""
    rows = []
    for row in result.budget:
        shares = [f"{100 * share:.0f}" if np.isfinite(share) else "" for share in row.shares]
        numbers = ["", "", ""]
        if row.value is not None and row.sigma is not None and row.matters is not None:
            half = quantile_95() * row.sigma
            numbers = [with_half_width(row.value, half), significant(row.matters), row.unit]
        rows.append([row.name, *shares, *numbers])
    note = (
        "Share [%] of the variance of each parameter that would go if this error were exact. They "
        "overlap, and do not add up. Half of a share goes if the error is known to the σ of the "
        "last but one column: state it in the sensors' file, or with --known-bodies. Errors with "
        "less than 1 % of every parameter are left out."
    )
    heads = ["", *PARAMETER_NAMES, "estimate ± 95 %", "half goes at σ", "unit"]
    return Section("Error budget", tables=[Table(heads, rows, note=note)])


def identifiability_section(result: Identification) -> Section:
    """Return the section with the singular values."""
    values, texts = result.singular_values, []
    if result.condition is not None:
        texts.append(
            "The singular values measure how strongly the motion excites ten independent "
            f"combinations of the parameters. The largest is {result.condition:.3g} times the "
            "smallest."
        )
    pictures = [] if np.isnan(values).any() else [singular_value_picture(values)]
    return Section("Identifiability", texts=texts, pictures=pictures)
