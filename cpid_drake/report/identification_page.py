"""The report of an identification: its sections, and what is said in each."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.identification.convergence import Convergence, converge
from cpid_drake.identification.description import ADVICE, decimals
from cpid_drake.identification.identification import row_family
from cpid_drake.identification.requests import Evidence, identify_file, request_of_result
from cpid_drake.identification.result_files import IdentificationResult, read_result, result_text
from cpid_drake.identification.telemetry_identification import complete_samples, of_spacecraft
from cpid_drake.report.figures import (
    Picture,
    convergence_pictures,
    ellipsoid_pictures,
    motion_pictures,
    residual_pictures,
    residual_unit,
    singular_value_picture,
)
from cpid_drake.report.page import Cell, Report, Section, Table, embedded_json
from cpid_drake.report.replay import replay_html
from cpid_drake.scenario.run_files import versions
from cpid_drake.sensing.noise_estimation import estimate_suite
from cpid_drake.sensing.screening import screen
from cpid_drake.sensing.smoothing import smooth
from cpid_drake.sensing.suite import SENSOR_NAMES

Progress = Callable[[str], None]

PARAMETER_KEYS = ("mass", *(f"com.{i}" for i in range(3)), *(f"inertia.{i}" for i in range(6)))
"""Where a result file has the ten parameters."""

_ESTIMATORS = {
    "least_squares": "least squares on momentum rows",
    "trajectory_fit": "trajectory fit (maximum likelihood)",
    "momentum_filter": "momentum filter",
}
_SENSORS = {
    "attitude": ("attitude", "rad"),
    "gyro": ("gyro", "rad/s"),
    "position": ("position", "m"),
    "velocity": ("velocity", "m/s"),
    "encoders": ("joint positions", "rad or m"),
    "joint_rates": ("joint rates", "rad/s or m/s"),
}


def _nothing(step: str) -> None:
    """Ignore progress."""


@dataclass(frozen=True, eq=False)
class Findings:
    """A result, and what could be read again of where it came from.

    Attributes:
        result: the result whose numbers are shown.
        text: the same as JSON.
        evidence: the log identified again; None if it is not there any more.
        missing: why it is not.
        convergence: from the evidence.
        truth: the true target, of a simulation.
        visual_model: how the target looks, if there is a model of that.

    """

    result: IdentificationResult
    text: str
    evidence: Evidence | None
    missing: str
    convergence: Convergence | None
    truth: InertialParameters | None = None
    visual_model: str | None = None


def findings_of(evidence: Evidence, progress: Progress = _nothing) -> Findings:
    """Return what there is to report of a log that has just been identified."""
    text = result_text(evidence.result, evidence.request.telemetry)
    return Findings(evidence.result, text, evidence, "", converge(evidence, progress))


def findings_of_file(path: str | Path, progress: Progress = _nothing) -> Findings:
    """Return what there is to report of a result file; its log is read again if it is there.

    Raises:
        InputError: as `read_result`.

    """
    result = read_result(path)
    text = result_text(result, str(path))
    try:
        evidence = identify_file(request_of_result(result, str(path)), progress)
    except InputError as error:
        return Findings(result, text, None, str(error), None)
    return Findings(result, text, evidence, "", converge(evidence, progress))


def identification_report(
    findings: Findings,
    *,
    before: Sequence[Section] = (),
    title: str = "",
    progress: Progress = _nothing,
) -> Report:
    """Return the report of an identification.

    Args:
        findings: what is reported.
        before: sections that come first.
        title: of the page; default: what was identified.
        progress: called with a few words before every step.

    """
    result, evidence = findings.result, findings.evidence
    sections: list[Section] = [*before, Asked(findings), Answer(findings), Warnings(findings)]
    if evidence is None:
        reason = f"What needs the log, which could not be read again: {findings.missing}."
        sections += [Observability(result), Missing(reason)]
    else:
        sections += [
            Development(findings),
            Residuals(evidence),
            Observability(result),
            Sensors(evidence),
            BaseMotion(evidence),
        ]
        progress("making the replay")
        try:
            sections.append(replay_section(findings))
        except InputError as error:
            sections.append(Missing(f"The replay: {error}."))
    sections.append(Provenance(findings))
    title = title or f"What {result.spacecraft.capture_frame} holds"
    model = result.spacecraft.model.rsplit("/", 1)[-1]
    known = "All ten parameters" if result.rank == 10 else f"{result.rank} of ten combinations"
    how = _ESTIMATORS.get(result.estimator, result.estimator)
    subtitle = f"{known} identified with {model} by {how}"
    return Report(title, subtitle, sections, {"result": findings.text})


# -- sections -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Asked(Section):
    """What was asked."""

    findings: Findings
    title: ClassVar[str] = "What was asked"
    template: ClassVar[str] = "asked.html.j2"

    @property
    def question(self) -> str:
        """The question in a sentence."""
        return (
            "Mass, centre of mass and inertia of what a free-floating spacecraft holds, from the "
            "way its base reacts to its arms."
        )

    @property
    def facts(self) -> list[tuple[str, str | Cell]]:
        """Names and values."""
        result = self.findings.result
        source = _source(result)
        craft = result.spacecraft
        how = _ESTIMATORS.get(result.estimator, result.estimator)
        facts: list[tuple[str, str | Cell]] = [
            ("Telemetry", str(source.get("telemetry", "not said"))),
        ]
        if _is_number(source.get("from")) and _is_number(source.get("to")):
            facts.append(("Window", f"{source['from']:.6g} to {source['to']:.6g} s"))
        facts += [
            ("Spacecraft", craft.model),
            ("Base body", craft.base),
            ("Capture frame", craft.capture_frame),
            ("Estimator", how + (f" ({result.rows})" if result.rows else "")),
            ("Sensors", str(source.get("sensors") or "not given")),
            (
                "Total momentum",
                "constant, unknown" if source.get("unknown_momentum") else "zero",
            ),
            ("Samples used", _cell(result.samples_used, "samples_used")),
            ("Samples left out", _cell(result.samples_rejected, "samples_rejected")),
        ]
        return facts


@dataclass(frozen=True, eq=False)
class Answer(Section):
    """The ten parameters."""

    findings: Findings
    title: ClassVar[str] = "The answer"
    template: ClassVar[str] = "answer.html.j2"

    @property
    def verdict(self) -> str:
        """The answer in a sentence."""
        result = self.findings.result
        if result.feasible is None:
            known = int(np.isfinite(result.parameters).sum())
            return f"The log determines {known} of the ten parameters; the others stay open."
        problems = _detail(result, "infeasibilities", list) or []
        if problems:
            return (
                f"No rigid body has the estimate as it is ({'; '.join(map(str, problems))}): use "
                "the nearest possible values."
            )
        return "All ten parameters are known, and a rigid body can have them."

    @property
    def meaning(self) -> str:
        """What the rows mean."""
        frame = self.findings.result.spacecraft.capture_frame
        text = (
            f"m: mass. c: centre of mass, from the origin of {frame}, in its axes. I: inertia "
            "about the centre of mass, in the same axes; Ixy = −∫xy dm. ± is half of the 95 % "
            "interval. Possible: the nearest values that a rigid body can have."
        )
        if self.findings.truth is not None:
            text += " Error: estimate minus truth, and the same in standard deviations."
        return text

    @property
    def parameters(self) -> Table:
        """The ten parameters."""
        result, truth = self.findings.result, self.findings.truth
        heads = ["", "estimate", "± 95 %", "possible", "unit"]
        heads += [] if truth is None else ["truth", "error", "error / σ"]
        sigma = np.sqrt(np.diag(result.covariance))
        pairs = _intervals(result)
        half_widths = 1.96 * sigma if pairs is None else (pairs[:, 1] - pairs[:, 0]) / 2
        true = np.full(10, np.nan) if truth is None else truth.to_vector()
        possible = np.full(10, np.nan) if result.feasible is None else result.feasible.to_vector()
        rows = []
        for i, (name, key) in enumerate(zip(PARAMETER_NAMES, PARAMETER_KEYS)):
            value, half = result.parameters[i], half_widths[i]
            digits = decimals(2 * half)
            spread = f"{half:.{digits}f}" if half >= 0.5 * 10.0**-digits else f"{half:.1e}"
            spread = spread if np.isfinite(half) else ""
            row: list[Cell | str] = [
                name,
                _cell(value, key, digits, "not known"),
                Cell(spread)
                if pairs is None
                else Cell(spread, result.details["interval_95"][i], f"interval_95.{i}"),
                "" if result.feasible is None else _cell(possible[i], f"feasible.{key}", digits),
                PARAMETER_UNITS[i],
            ]
            if truth is not None:
                error = value - true[i]
                row += [
                    _cell(true[i], key, digits, data="truth"),
                    Cell(f"{error:+.2g}" if np.isfinite(error) else ""),
                    Cell(f"{error / sigma[i]:+.1f}" if np.isfinite(error / sigma[i]) else ""),
                ]
            rows.append(row)
        return Table(heads, rows)

    @property
    def principal(self) -> Table | None:
        """Principal moments and axes."""
        result = self.findings.result
        moments = _detail(result, "principal_moments", list)
        axes = _detail(result, "principal_axes", list)
        if not (moments and axes):
            return None
        try:
            rows = [
                [
                    Cell(f"{moments[k]:.6g}", moments[k], f"principal_moments.{k}"),
                    *(
                        Cell(f"{axes[i][k]:+.4f}", axes[i][k], f"principal_axes.{i}.{k}")
                        for i in range(3)
                    ),
                ]
                for k in range(3)
            ]
        except (IndexError, KeyError, TypeError, ValueError):  # not as this program writes it
            return None
        return Table(["moment [kg·m²]", "axis x", "axis y", "axis z"], rows)

    @property
    def pictures(self) -> list[Picture]:
        """The ellipsoid, if a rigid body is known that has a mass."""
        feasible = self.findings.result.feasible
        if feasible is None or not feasible.mass > 0:
            return []
        return ellipsoid_pictures(feasible, self.findings.truth)


@dataclass(frozen=True, eq=False)
class Warnings(Section):
    """What a reader is warned of."""

    findings: Findings
    title: ClassVar[str] = "Warnings"
    template: ClassVar[str] = "warnings.html.j2"

    @property
    def texts(self) -> list[str]:
        """Sentences."""
        result, evidence = self.findings.result, self.findings.evidence
        texts = list(result.warnings)
        if evidence is not None:
            sigma = np.sqrt(np.nan_to_num(np.diag(result.covariance)))
            again = evidence.result.parameters
            close = np.abs(again - result.parameters) <= 1e-3 * sigma + 1e-9 * np.abs(again)
            if not np.all(close | (np.isnan(again) & np.isnan(result.parameters))):
                texts.append(
                    "Identified again for this report, the log gave other values than the result "
                    "holds: the figures below are not of this result. Model, sensors or versions "
                    "have changed since."
                )
        return texts


@dataclass(frozen=True, eq=False)
class Development(Section):
    """Convergence."""

    findings: Findings
    title: ClassVar[str] = "Convergence"
    template: ClassVar[str] = "pictures.html.j2"
    table: ClassVar[None] = None

    @property
    def texts(self) -> list[str]:
        """What is seen."""
        if not self.pictures:
            return ["No parameter was known at any time."]
        text = (
            "The estimate from the samples up to each time, with its 95 % band. The scale is that "
            "of the later estimates: earlier ones and wider bands leave the picture. Where nothing "
            "is drawn the parameter was not known yet."
        )
        dashed = " Dashed: the truth." if self.findings.truth is not None else ""
        return [text + dashed]

    @property
    def pictures(self) -> list[Picture]:
        """One a parameter."""
        if np.isnan(self.findings.convergence.parameters).all():
            return []
        return convergence_pictures(self.findings.convergence, self.findings.truth)


@dataclass(frozen=True, eq=False)
class Residuals(Section):
    """What the estimate leaves of the samples."""

    evidence: Evidence
    title: ClassVar[str] = "Residuals"
    template: ClassVar[str] = "pictures.html.j2"

    @property
    def texts(self) -> list[str]:
        """What is seen."""
        found = self.evidence.found
        if not found.leftovers:
            return ["There are none to look at with this estimator, or not all ten are known."]
        if found.estimator == "trajectory_fit":
            text = (
                "What the fit leaves of each sensor's samples, in units of the noise that was "
                "assumed; the band is ±2σ."
            )
        else:
            text = "What the estimate leaves of the momentum balance, in the capture frame."
        whole = found.residuals
        if whole is None:
            text += " The samples were smoothed, so neighbours hang together."
        elif whole.is_white:
            text += " Neighbours do not hang together: what is left is noise."
        else:
            text += (
                f" Neighbours hang together (correlation {whole.lag_one:+.2f}): something beside "
                "noise is left, such as a model that is not quite right, or of a simulation its "
                "integration error."
            )
        return [text]

    @property
    def table(self) -> Table | None:
        """Size and whiteness, kind by kind."""
        found = self.evidence.found
        if not found.leftovers:
            return None
        rows = []
        for name, samples in found.leftovers.items():
            white = whiteness(samples.value)
            size = np.sqrt(np.mean(samples.value**2, axis=0))
            rows.append(
                [
                    name,
                    Cell(str(len(samples))),
                    *(Cell(f"{value:.3g}") for value in size),
                    residual_unit(found, name),
                    Cell(f"{white.lag_one:+.3f} ± {white.band:.3f}"),
                    "yes" if white.is_white else "no",
                ]
            )
        heads = ["", "samples", "rms x", "rms y", "rms z", "unit", "lag-one correlation", "white"]
        if found.residuals is None:  # smoothed samples are not expected to be white
            heads, rows = heads[:-1], [row[:-1] for row in rows]
        return Table(heads, rows)

    @property
    def pictures(self) -> list[Picture]:
        """Against time, and autocorrelation."""
        return residual_pictures(self.evidence.found)


@dataclass(frozen=True, eq=False)
class Observability(Section):
    """How well the log determines what."""

    result: IdentificationResult
    title: ClassVar[str] = "What the motion shows"
    template: ClassVar[str] = "pictures.html.j2"

    @property
    def texts(self) -> list[str]:
        """What is weakly observed."""
        result = self.result
        if result.rank < 10:
            gap = _detail(result, "not_observable", str) or "no motion was seen"
            return [f"Not all ten are known: {gap}.", f"To see the rest: {ADVICE}."]
        texts = []
        if np.isfinite(result.condition):
            texts.append(
                "The smallest singular value is that of the combination that the motion shows "
                f"least, {result.condition:.3g} times less than the one it shows best."
            )
        weakest = weakest_combination(result.parameters, result.covariance)
        if weakest is not None:
            weights, sigma = weakest
            order = np.argsort(-np.abs(weights))
            parts = [f"{PARAMETER_NAMES[i]} ({weights[i]:+.2f})" for i in order]
            shown = [part for part, i in zip(parts, order) if abs(weights[i]) > 0.2]
            which = f"the combination {', '.join(shown)}"
            if len(shown) == 1:
                which = PARAMETER_NAMES[order[0]]
            texts.append(
                f"Known least, for its size, is {which}: σ is "
                f"{100 * sigma:.2g} % of its scale. Scales: m of the mass, the radius of gyration "
                "of c, and their product m r² of the inertia."
            )
        return texts

    @property
    def table(self) -> Table | None:
        """Relative σ of the ten."""
        result = self.result
        scale = parameter_scale(result.parameters)
        if scale is None:
            return None
        share = 100 * np.sqrt(np.diag(result.covariance)) / scale
        if not np.isfinite(share).all():
            return None
        cells = [Cell(f"{value:.2g}") for value in share]
        return Table(["", *PARAMETER_NAMES], [["σ, % of scale", *cells]])

    @property
    def pictures(self) -> list[Picture]:
        """The singular values, if the result holds them."""
        values = _detail(self.result, "singular_values", list) or []
        if len(values) != 10 or not all(_is_number(value) for value in values):
            return []
        return [singular_value_picture(np.array(values, dtype=float))]


@dataclass(frozen=True, eq=False)
class Sensors(Section):
    """How the samples fit the sensors."""

    evidence: Evidence
    title: ClassVar[str] = "Sensors"
    template: ClassVar[str] = "pictures.html.j2"
    pictures: ClassVar[tuple] = ()

    @property
    def texts(self) -> list[str]:
        """Where the noise is from."""
        found = self.evidence.found
        if found.suite is None:
            return ["All complete samples weighed alike: no noise was assumed of any sensor."]
        whose = "given" if self.evidence.suite is not None else "estimated from the log"
        texts = [f"The sensors' noise was {whose}."]
        if found.estimator == "trajectory_fit":
            texts.append("χ² per reading is 1 where samples scatter as much as assumed.")
        return texts

    @property
    def table(self) -> Table:
        """A row a sensor."""
        found = self.evidence.found
        heads = ["", "samples", "every [ms]", "not used", "σ assumed", "unit", "χ² per reading"]
        rows = []
        for name in SENSOR_NAMES:
            samples = getattr(self.evidence.measurements, name)
            if not len(samples):
                continue
            word, unit = _SENSORS[name]
            step = np.median(np.diff(samples.time)) if len(samples) > 1 else np.nan
            sigma = ""
            if found.suite is not None and getattr(found.suite, name) is not None:
                values = np.unique(found.suite.sigmas(name))
                sigma = ", ".join(f"{value:.2g}" for value in values)
            left = found.leftovers.get(name)
            rows.append(
                [
                    word,
                    Cell(str(len(samples))),
                    Cell(f"{1e3 * step:.4g}" if np.isfinite(step) else ""),
                    Cell(str(found.rejected.get(name, 0))),
                    Cell(sigma),
                    unit if sigma else "",
                    Cell("" if left is None else f"{np.mean(left.value**2):.3f}"),
                ]
            )
        if found.estimator != "trajectory_fit":
            heads, rows = heads[:6], [row[:6] for row in rows]
        if found.suite is None:
            heads, rows = heads[:4], [row[:4] for row in rows]
        return Table(heads, rows)


@dataclass(frozen=True, eq=False)
class BaseMotion(Section):
    """How the base moved."""

    evidence: Evidence
    title: ClassVar[str] = "Motion of the base"
    template: ClassVar[str] = "pictures.html.j2"
    table: ClassVar[None] = None

    @property
    def texts(self) -> list[str]:
        """What is seen."""
        if self.pictures:
            return ["As the sensors gave it."]
        return ["No sensor of the base's motion is in the log."]

    @cached_property
    def pictures(self) -> list[Picture]:
        """As far as there are sensors."""
        return motion_pictures(self.evidence.measurements)


@dataclass(frozen=True, eq=False)
class Replay(Section):
    """The motion in three dimensions: a page in the page, loaded when it is asked for."""

    data: Markup
    title: ClassVar[str] = "Replay"
    template: ClassVar[str] = "replay.html.j2"


def replay_section(findings: Findings) -> Replay:
    """Return the replay of a log and of its estimates.

    Raises:
        InputError: the log does not say how the base moved.

    """
    evidence, convergence = findings.evidence, findings.convergence
    page = replay_html(
        evidence.spacecraft,
        motion_of(evidence),
        convergence.estimates,
        truth=findings.truth,
        visual_model=findings.visual_model,
        title=Path(evidence.request.telemetry).name,
    )
    return Replay(embedded_json(json.dumps(page)))


def motion_of(evidence: Evidence) -> Telemetry:
    """Return the motion in a log, as sampled or else smoothed.

    Raises:
        InputError: there is too little in the log.

    """
    measurements, _ = screen(of_spacecraft(evidence.measurements, evidence.spacecraft))
    if len(measurements.attitude):
        for rows in ("standard", "relative"):
            if rows == "relative" and len(measurements.position):
                continue
            complete = complete_samples(measurements, row_family(rows))
            if complete is not None:
                return complete
    suite = evidence.found.suite or estimate_suite(measurements)
    with_position = bool(len(measurements.position))
    return smooth(measurements, suite, with_position=with_position).telemetry


@dataclass(frozen=True, eq=False)
class Missing(Section):
    """Why sections are missing."""

    reason: str
    title: ClassVar[str] = "What is not shown"
    template: ClassVar[str] = "pictures.html.j2"
    table: ClassVar[None] = None
    pictures: ClassVar[tuple] = ()

    @property
    def texts(self) -> list[str]:
        """The reason."""
        return [self.reason]


@dataclass(frozen=True, eq=False)
class Provenance(Section):
    """Where all this comes from."""

    findings: Findings
    title: ClassVar[str] = "Where this comes from"
    template: ClassVar[str] = "provenance.html.j2"

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Names and values."""
        source = _source(self.findings.result)
        used = ", ".join(f"{name} {number}" for name, number in versions().items())
        return [
            ("Telemetry", str(source.get("telemetry", "not said"))),
            ("SHA-256", str(source.get("sha256") or "not said")),
            ("Identified by", f"cpid-drake {source.get('cpid_drake', 'of unknown version')}"),
            ("Report made by", used),
        ]

    @property
    def command(self) -> str:
        """The command line."""
        return str(_source(self.findings.result).get("command", ""))


# -- numbers --------------------------------------------------------------------------------------


def parameter_scale(parameters: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return what each of the ten is compared with: m, the radius of gyration r, and m r²."""
    mass, trace = parameters[0], parameters[4:7].sum()
    if not (0 < mass < np.inf and 0 < trace < np.inf):
        return None
    return np.array([mass] + 3 * [np.sqrt(trace / 2 / mass)] + 6 * [trace / 2])


def weakest_combination(
    parameters: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float] | None:
    """Return the scaled combination (10,) of parameters that is known least, and its σ.

    None where not all ten are known, or no rigid body is anywhere near.
    """
    scale = parameter_scale(parameters)
    if scale is None:
        return None
    with np.errstate(all="ignore"):  # numbers of any size may be in a file
        scaled = covariance / scale / scale[:, None]
    try:
        values, axes = np.linalg.eigh((scaled + scaled.T) / 2)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(values).all():
        return None
    weights = axes[:, -1] * np.sign(axes[np.abs(axes[:, -1]).argmax(), -1])
    return weights, float(np.sqrt(max(values[-1], 0.0)))


def _intervals(result: IdentificationResult) -> NDArray[np.float64] | None:
    """Return the 95 % intervals (10, 2) as the file has them; None if it has none like that."""
    try:
        pairs = np.array(_detail(result, "interval_95", list), dtype=float)
    except (TypeError, ValueError):  # a file of another program
        return None
    return pairs if pairs.shape == (10, 2) else None


def _cell(value: float, key: str, digits: int = 0, absent: str = "", data: str = "result") -> Cell:
    if not np.isfinite(value):
        return Cell(absent, None, key, data)
    value = value if isinstance(value, int) else float(value)
    return Cell(f"{round(value, digits) + 0.0:.{digits}f}", value, key, data)


def _source(result: IdentificationResult) -> dict[str, Any]:
    return _detail(result, "source", dict) or {}


def _detail(result: IdentificationResult, key: str, kind: type) -> Any:
    """Return a detail if it is of this kind: details are anybody's."""
    value = result.details.get(key)
    return value if isinstance(value, kind) else None


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
