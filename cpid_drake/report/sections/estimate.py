"""The sections with what was estimated: parameters, effects, separate logs, identifiability."""

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.files.digits import decimals_of, rounded_pair, significant, with_half_width
from cpid_drake.identification.description import agreement_words, consistency_words
from cpid_drake.identification.effect_estimates import EffectEstimate, with_sensors_of
from cpid_drake.identification.figure import parameter_bars
from cpid_drake.identification.result import Identification
from cpid_drake.report.figures import singular_value_figure
from cpid_drake.report.page import Section, Table


def parameters_section(result: Identification, truth: InertialParameters | None) -> Section:
    """Return the section with the estimate and its 95 % intervals as bars."""
    bars = parameter_bars(result, truth)
    return Section("Parameters", figures=[bars], columns=1, half=True)


def numbers_section(result: Identification, truth: InertialParameters | None) -> Section:
    """Return the section with the digits: intervals, the nearest rigid body, the truth."""
    words = consistency_words(result)
    texts = [f"{words[0].upper()}{words[1:]}."]
    return Section("Numbers", texts=texts, tables=[_parameters(result, truth)], folded=True)


def _parameters(result: Identification, truth: InertialParameters | None) -> Table:
    nearest = np.full(10, np.nan) if result.consistent is None else result.consistent.to_vector()
    intervals, bodies = result.intervals, result.shown_intervals
    if not result.is_consistent:
        intervals = np.full((10, 2), np.nan)  # no rigid body agrees with the estimate
    places = [decimals_of(*ends) for ends in intervals]
    columns: dict[str, list[str]] = {
        "": [*PARAMETER_NAMES],
        "estimate": [
            _number(value, digits) or "not identifiable"
            for value, digits in zip(result.parameters, places)
        ],
        "95 % interval": [_range(ends) for ends in intervals],
        "consistent": [_number(value, digits) for value, digits in zip(nearest, places)],
        "rigid bodies": [_range(ends) for ends in bodies],
    }
    note = (
        "m: mass. c: centre of mass, from the origin of the capture frame C, in its axes. I: "
        "inertia about the centre of mass, in the same axes; Ixy = −∫xy dm."
    )
    if columns["consistent"] in (columns["estimate"], 10 * [""]):
        del columns["consistent"]
    else:
        note += " Consistent: the nearest values of a rigid body."
    if columns["rigid bodies"] == columns["95 % interval"]:
        del columns["rigid bodies"]
    else:
        note += (
            " Rigid bodies: the part of the interval that a rigid body can have; of what is not "
            "identifiable, bounds of a target about as heavy and as large as the spacecraft (1 σ)."
        )
    columns["unit"] = [*PARAMETER_UNITS]
    if truth is not None:
        true = truth.to_vector()
        scores = (result.parameters - true) / np.sqrt(np.diag(result.covariance))
        columns["truth"] = [_number(value, digits) for value, digits in zip(true, places)]
        columns["error / σ"] = [f"{x:+z.1f}" if np.isfinite(x) else "" for x in scores]
        note += " σ: standard deviation of the estimate."
    return Table([*columns], [*zip(*columns.values())], note=note)


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
    return Section("Logs", tables=[Table(["", *parts, "unit"], rows, note=note)], folded=True)


def _effect_name(effect: EffectEstimate) -> str:
    """Return the name of an effect, with its log or the sensors that have it."""
    during = f" during {effect.log}" if effect.log else ""
    return effect.name + during + (with_sensors_of(effect.hardware) if effect.hardware else "")


def effects_section(result: Identification) -> Section:
    """Return the section with a row for every entry of every estimated effect."""
    factor = quantile_95()
    rows = [
        [
            _effect_name(effect) if i == 0 else "",
            *rounded_pair(value, factor * sigma),
            significant(factor * effect.prior_sigma),
            effect.unit,
        ]
        for effect in result.effects
        for i, (value, sigma) in enumerate(zip(effect.value, effect.sigma))
    ]
    text = (
        "These unknown constants were estimated as well, with the σ that the sensors' file states, "
        "or with a plausible one."
    )
    heads = ["", "estimate", "± 95 %", "± 95 % before", "unit"]
    table = Table(heads, rows)
    return Section("Estimated errors and forces", texts=[text], tables=[table], folded=True)


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
    return Section("Error budget", tables=[Table(heads, rows, note=note)], folded=True)


def identifiability_section(result: Identification) -> Section:
    """Return the section with the singular values."""
    values, texts = result.singular_values, []
    if result.condition is not None:
        texts.append(
            "The singular values measure how strongly the motion excites ten independent "
            f"combinations of the parameters. The largest is {result.condition:.3g} times the "
            "smallest."
        )
    figures = [] if np.isnan(values).any() else [singular_value_figure(values)]
    return Section("Identifiability", texts=texts, figures=figures, folded=True)
