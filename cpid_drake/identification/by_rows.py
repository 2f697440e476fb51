"""Least squares on the momentum rows of complete or smoothed samples, of one log or many.

Every log is a Gaussian of the target and of its own momentum (`estimation.rows_fit`). Exact states
show whether the momentum is zero. Several logs, and a prior, are the sum of their Gaussians.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cpid_drake.array import Array
from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.dynamics.rows import STANDARD_ROWS, RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.gaussian import Gaussian, LeastSquaresSolution, solution_of
from cpid_drake.estimation.least_squares import INTEGRATION, KNOWN
from cpid_drake.estimation.rows_fit import TARGET, LogRows
from cpid_drake.estimation.smoothing import smooth_windows
from cpid_drake.estimation.unknowns import PSI, Model
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.checks import Check, momentum_words
from cpid_drake.identification.log_sensors import suites_of
from cpid_drake.identification.result import Identification
from cpid_drake.identification.row_checks import (
    LEAST_SQUARES,
    bias_check,
    conservation_check,
    part_checks,
)
from cpid_drake.identification.together import with_sources
from cpid_drake.logs.log import Log
from cpid_drake.logs.noise_estimation import has_noise, sample_sigmas
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

_FORCES = (
    "the sensors' file declares forces, and rows assume a constant momentum: identify with "
    "--estimator trajectory_fit"
)
_SOME = 100  # samples of a log that show its noise
_MOMENTA = ("zero", "known", "unknown")


@dataclass(frozen=True, eq=False)
class _LogPart:
    """What the rows of one log say; `fields` are those of an identification from this log alone."""

    target: Gaussian
    row_count: int
    has_noise: bool
    sample_count: int
    momentum: str
    sensors: SensorSuite | None
    warnings: tuple[str, ...]
    checks: tuple[Check, ...]
    fields: Mapping[str, Any]


def estimate(
    arguments: Arguments,
    logs: Mapping[str, CheckedLog],
    progress: Callable[[str], object] = lambda step: None,
) -> Identification:
    """Identify a target by least squares on momentum rows.

    Exact states and complete samples without declared sensors are used as they are; other samples
    are smoothed to common times first.

    See `estimators.Estimator`.
    """
    craft, family = arguments.spacecraft, arguments.family
    assert family is not None
    parts = {name: _summarize(arguments, log) for name, log in logs.items()}
    # Least squares: the sum of |A x − b|² over all logs, each with its own momentum eliminated.
    sources = {name: part.target for name, part in parts.items()}
    form = family.parameterization(craft.mass)
    row_count = sum(part.row_count for part in parts.values())
    solution, prior = _solved(arguments, form, reduce(Gaussian.add, sources.values()), row_count)
    if not all(part.has_noise for part in parts.values()):
        solution = replace(solution, has_noise=False)
    counts = {name: part.sample_count for name, part in parts.items()}
    [first, *others] = parts.values()
    result = Identification.of_solution(
        form,
        solution,
        sensors=first.sensors,
        sample_count=sum(counts.values()),
        estimator=LEAST_SQUARES,
        rows=family.name,
        momentum=max((part.momentum for part in parts.values()), key=_MOMENTA.index),
        warnings=tuple(text for part in parts.values() for text in part.warnings),
        checks=tuple(check for part in parts.values() for check in part.checks),
        **({} if others else first.fields),
    )
    if not others and prior is None:
        return result
    if arguments.prior is not None and prior is not None:
        sources[arguments.prior.name] = prior
    unit = solution.unit
    return with_sources(
        result,
        Gaussian({TARGET: slice(0, 10)}, np.diag(1 / unit), solution.values / unit),
        sources,
        TARGET,
        lambda gaussian: solution_of(gaussian, solution.values, solution.unit),
        counts,
        arguments.prior,
    )


def _solved(
    arguments: Arguments, form: Parameterization, logs: Gaussian, row_count: int = 0
) -> tuple[LeastSquaresSolution, Gaussian | None]:
    """Return the target's unknowns by logs and prior, and the prior's part, if there is one."""
    x, scale = plausible(arguments.spacecraft, form, logs)
    if arguments.prior is None:
        return solution_of(logs, x, scale, row_count=row_count), None
    x = arguments.prior.moved(form, x)
    for _ in range(4):  # each squares the error of linearizing it about the joint estimate
        prior = arguments.prior.gaussian(TARGET, form, x, scale)
        # What only the prior determines is determined, however vague the prior is.
        largest = max(KNOWN, 1.5 / float(prior.singular_parts(scale)[1].min()))
        solution = solution_of(logs.add(prior), x, scale, largest=largest, row_count=row_count)
        x = solution.values
    return solution, prior


def plausible(
    spacecraft: Spacecraft, form: Parameterization, target: Gaussian
) -> tuple[Array, Array]:
    """Return a plausible target's unknowns (10,), and their plausible sizes.

    1/m of a light target has no plausible size: it is that of the target's own estimate.
    """
    model = Model(spacecraft.tree, SensorSuite())
    psi, size = model.unknown(PSI).mean, model.plausible
    if form.name == "relative":
        return psi, size
    inertia = np.full(3, psi[4])
    x = form.from_parameters(np.concatenate([psi[:1], np.zeros(3), inertia, np.zeros(3)]))
    if form.name == "eq18":
        inverse = abs(target.solve()[:1])
        # (1/m, c, I_C) in place of (μ, μc, I_*)
        return x, np.concatenate([inverse, size[1:4] / size[0], size[4:]])
    return x, size * np.repeat([2.0, 1.0], [4, 6])


def needs_of_rows(family: RowFamily, momentum: TotalMomentum) -> tuple[tuple[str, ...], ...]:
    """Return the sensors that rows need: at least one sensor of each entry."""
    if not family.uses_base_position:
        # A zero angular momentum is zero in any frame, so a gyro is enough and no attitude in W is
        # needed.
        attitude = ("attitude",) if not momentum.is_zero else ("attitude", "gyro")
        return (("encoders",), attitude)
    # The position matters only for an unknown linear momentum, because its moment about C depends
    # on it.
    place = ("position",) if momentum.is_unknown else ("velocity", "position")
    return (("encoders",), ("attitude",), place)


def is_measured(log: CheckedLog, tree: KinematicTree, family: RowFamily) -> bool:
    """Return whether a log has samples of sensors, which a fit can use.

    Exact states are given as such, or show no noise, or have a momentum that is constant to
    `INTEGRATION` for some target: no sensors are so good.
    """
    samples = log.measurements
    if log.states is not None or not len(samples.attitude):
        return False
    motion = complete_samples(samples, family)
    if motion is None:
        return True
    if not has_noise(samples):
        return False
    rows = LogRows(tree, family, TotalMomentum.unknown())
    some = motion.select(slice(None, None, -(-len(motion) // _SOME)))
    rows.add(some, np.zeros((1, 0, 0)))
    return rows.misfit(rows.best())[1] > INTEGRATION


def common_times(measurements: Log, family: RowFamily) -> Array | None:
    """Return the times at which all quantities of the rows were sampled; None if there are too few.

    The times are too few if they are fewer than half of the times of the slowest sensor.
    """
    samples = [measurements[name].time for name in _needed(measurements, family)]
    common = reduce(np.intersect1d, samples)
    return common if len(common) and len(common) >= min(map(len, samples)) / 2 else None


def _needed(measurements: Log, family: RowFamily) -> list[str]:
    """Return the sensors whose samples the rows of a complete log use."""
    needed = ["gyro", "encoders", "joint_rates"]
    if len(measurements.attitude):
        needed.append("attitude")
    if family.uses_base_position:
        needed += ["velocity", "position"] if len(measurements.position) else ["velocity"]
    return needed


def complete_samples(measurements: Log, family: RowFamily) -> Motion | None:
    """Return the motion at the common times of a log; None if they are too few.

    What was not logged, and `needs_of_rows` does not require, is zero.
    """
    common = common_times(measurements, family)
    if common is None:
        return None
    none = np.zeros((len(common), 3))
    values = {"attitude": none[:, :1] + [1.0, 0.0, 0.0, 0.0], "position": none, "velocity": none}
    for name in _needed(measurements, family):
        samples = measurements[name]
        values[name] = samples.value[np.searchsorted(samples.time, common)]
    R_WB = Rotation.from_quat(values["attitude"], scalar_first=True)
    return Motion(
        measurements.joint_names,
        common,
        quaternion_WB=values["attitude"],
        p_WB=values["position"],
        w_WB=R_WB.apply(values["gyro"]),
        v_WB=values["velocity"],
        q=values["encoders"],
        qdot=values["joint_rates"],
    )


def _motion(
    log: CheckedLog, tree: KinematicTree, family: RowFamily, suite: SensorSuite | None
) -> Iterator[tuple[Motion, Array]]:
    """Yield parts of a log's motion, smoothed if a suite is given, and their errors."""
    if log.states is not None:
        yield log.states, np.diag(sample_sigmas(log.states) ** 2)[None]
    elif suite is None:
        covariance = np.diag(sample_sigmas(log.measurements) ** 2)[None]
        for chunk in log.measurements.blocks():
            samples = complete_samples(chunk, family)
            if samples is not None:
                yield samples, covariance
    else:
        position, normal_B = family.uses_base_position, tree.normal_B
        yield from smooth_windows(
            log.measurements, suite, with_position=position, normal_B=normal_B
        )


def _summarize(arguments: Arguments, log: CheckedLog) -> _LogPart:
    """Return what the rows of one log say."""
    spacecraft, momentum, family = arguments.spacecraft, arguments.momentum, arguments.family
    assert family is not None
    tree, suite, warnings = spacecraft.tree, log.sensors, tuple[str, ...]()
    if log.states is not None:
        suite = None
    elif suite is None and common_times(log.measurements, family) is None:
        suites, warnings = suites_of({"": log})
        suite = suites[""]
    # Rows of the log; the samples may contradict a momentum of zero, which a tester then shows.
    has_place = bool(len(log.measurements.position)) or not family.uses_base_position
    is_open = momentum is None or momentum.is_zero
    is_tested = is_open and bool(len(log.measurements.attitude)) and has_place
    unknown, zero = TotalMomentum.unknown(), TotalMomentum.zero()
    assumed = unknown if is_tested and family.momentum_size else momentum or zero
    rows = tester = LogRows(tree, family, assumed)
    if is_tested and not family.momentum_size:
        tester = LogRows(tree, STANDARD_ROWS, unknown)
    for motion, covariance in _motion(log, tree, family, suite):
        for each in {rows, tester}:
            each.add(motion, covariance)
    contradicts = is_tested and bool(tester.extra) and _is_moving(tester)
    is_zero = is_open and not (contradicts and rows.extra)
    texts, checks = momentum_words(
        float(contradicts), is_given=momentum is not None, cannot="" if rows.extra else family.name
    )
    # Gaussian of momentum and target, and what its residuals and halves show.
    whole, freedom = rows.gaussian(is_zero=is_zero)
    x, target = rows.best(is_zero=is_zero), whole.marginal([TARGET])
    to_errors, to_rows = rows.misfit(x)
    solution = solution_of(target, *plausible(spacecraft, rows.form, target))
    is_whole = solution.rank == len(tree.unknowns)
    if suite is not None and (suite.disturbances or Disturbances()) != Disturbances():
        checks = (*checks, Check("forces", _FORCES))
    # The errors of a log are at least as many as the axes of a gyro, whose bias is in all samples.
    axes = 3 if tree.normal_B is None else 1
    checks = (*checks, conservation_check(to_rows, to_errors, axes))
    fields: dict[str, Any] = {}
    if is_whole and freedom > 0:  # residuals show the errors
        residuals = zip(("linear", "angular"), rows.residuals(x), strict=True)
        fields["residuals"] = {kind: each for kind, each in residuals if each.value.size}
        first, all_rows = (rows.triangle(is_zero=is_zero, is_half=h) for h in (True, False))
        checks += part_checks(first[-11:, -11:], all_rows[-11:, -11:], freedom)
    if log.states is None and to_rows > INTEGRATION:
        checks = (*checks, bias_check(solution, rows.bias(x, is_zero=is_zero)))
    if rows.extra and not is_zero:
        fields["momentum_estimate"] = x[: rows.extra]
        if whole.rank == rows.extra + len(tree.unknowns):
            # (RᵀR)⁻¹, its part of the momentum
            inverse = np.linalg.pinv(whole.R)[: rows.extra]
            fields["momentum_covariance"] = inverse @ inverse.T
    return _LogPart(
        target,
        row_count=freedom + whole.rank - (0 if is_zero else rows.extra),
        has_noise=freedom > 0,
        sample_count=rows.sample_count,
        momentum="zero" if is_zero else assumed.name,
        sensors=suite,
        warnings=tuple(log.where + text for text in (*warnings, *texts)),
        checks=tuple(
            replace(check, sentence=check.sentence and log.where + check.sentence)
            for check in checks
        ),
        fields=fields,
    )


def _is_moving(rows: LogRows) -> bool:
    """Return whether exact states have a momentum, and not one of zero."""
    # |A x − b| / |b|, without and with columns of a momentum
    zero, free = (rows.misfit(rows.best(is_zero=each))[1] for each in (True, False))
    return free <= INTEGRATION < zero
