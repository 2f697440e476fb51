"""Least squares on the momentum rows of complete or smoothed samples, of one log or many.

Every log is a Gaussian of the target and of its own momentum (`estimation.rows_fit`). Zero and an
unknown momentum are compared by their evidence, as in a fit, and the target is their average.
Several logs, and a prior, are the sum of their Gaussians.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from cpid_drake.dynamics.motion import Motion
from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.dynamics.rows import STANDARD_ROWS, RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.evidence import NAMED
from cpid_drake.estimation.gaussian import Gaussian, solution_of
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.rows_fit import (
    FEWEST,
    TARGET,
    LogRows,
    RowNoise,
    compare_momentum,
)
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.identification.checked_log import CheckedLog, Known, suite_of
from cpid_drake.identification.checks import IMPROBABLE, Check, halves_check, momentum_words
from cpid_drake.identification.result import Identification, ResidualSeries
from cpid_drake.identification.together import with_sources
from cpid_drake.logs.log import Log
from cpid_drake.logs.noise_estimation import sample_sigmas
from cpid_drake.logs.smoothing import smooth_windows
from cpid_drake.sensors.disturbances import Disturbances
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

INTEGRATION = 1e-5
"""Residuals below this share of the momentum contradict nothing: integration leaves as much."""

NAME = "least_squares"
"""The estimator's name."""

_FORCES = (
    "the sensors' file declares forces, and rows assume a constant momentum: identify with "
    "--estimator trajectory_fit"
)
_CAUSE = "the spacecraft, a frame, a sign or a clock is not as assumed, or forces acted"
_MOMENTA = ("zero", "known", "unknown")


def estimate(
    known: Known,
    logs: Mapping[str, CheckedLog],
    progress: Callable[[str], object] = lambda step: None,
) -> Identification:
    """Identify a target by least squares on momentum rows.

    Exact states and complete samples without declared sensors are used as they are; other samples
    are smoothed to common times first.

    See `estimators.Estimator`.
    """
    found = {name: _identified(known, log) for name, log in logs.items()}
    if len(found) == 1 and known.prior is None:
        return next(iter(found.values()))[0]
    return _combined(known, found)


def _combined(known: Known, logs: Mapping[str, tuple[Identification, Gaussian]]) -> Identification:
    """Return the estimate of one target from all logs and the prior, and whether they agree."""
    found, sources = (
        {n: each for n, (each, _) in logs.items()},
        {n: g for n, (_, g) in logs.items()},
    )
    first, prior = next(iter(found.values())), known.prior
    form, total = first.form, reduce(Gaussian.add, sources.values())
    assert form is not None
    x, scale = plausible(known.spacecraft, form, total)
    largest = KNOWN
    if prior is not None:
        logs_say, x = total, prior.moved(form, x)
        for _ in range(4):  # each squares the error of linearizing it about the joint estimate
            told = prior.gaussian(TARGET, form, x, scale)
            # What only the prior determines is determined, however vague the prior is.
            largest = max(KNOWN, 1.5 / float(told.singular_parts(scale)[1].min()))
            total = logs_say.add(told)
            x = solution_of(total, x, scale, largest=largest).values
        sources[prior.name] = told
    where = {name: f"{name}: " if len(logs) > 1 else "" for name in logs}
    common: dict[str, Any] = {
        "momentum": max((own.momentum for own in found.values()), key=_MOMENTA.index),
    }
    if len(logs) == 1:  # of several logs, each has its own
        names = ("residuals", "momentum_estimate", "momentum_covariance")
        common |= {name: getattr(first, name) for name in names}
    rows = sum(own.solution.row_count for own in found.values() if own.solution is not None)
    result = Identification.of_solution(
        form,
        solution_of(total, x, scale, largest=largest, row_count=rows),
        sensors=first.sensors,
        sample_count=sum(own.sample_count for own in found.values()),
        estimator=NAME,
        rows=first.rows,
        warnings=tuple(where[n] + text for n, own in found.items() for text in own.warnings),
        checks=tuple(
            replace(each, sentence=where[n] + each.sentence if each.sentence else "")
            for n, own in found.items()
            for each in own.checks
        ),
        **common,
    )
    return with_sources(
        result,
        Gaussian({TARGET: slice(0, 10)}, np.zeros((10, 10)), np.zeros(10)),
        sources,
        TARGET,
        lambda gaussian: solution_of(gaussian.marginal([TARGET]), x, scale),
        {name: own.sample_count for name, own in found.items()},
        prior,
    )


def plausible(
    spacecraft: Spacecraft, form: Parameterization, target: Gaussian
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
        return x, np.concatenate([inverse, size[1:4] / size[0], 2 * size[4:]])
    return x, 2 * size


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


def best_rows(counts: Sequence[Mapping[str, int]], sensors: SensorSuite | None) -> str:
    """Return "standard", or "relative" if samples must be smoothed or have no velocity.

    An error of the base's velocity enters all standard rows of a sample, and no relative one.
    """
    is_complete = all(count.get("joint_rates") and count.get("velocity") for count in counts)
    return "standard" if is_complete and sensors is None else "relative"


def complete_samples(measurements: Log, family: RowFamily) -> Motion | None:
    """Return the times at which all quantities of the rows were sampled; None if there are too few.

    The times are too few if they are fewer than half of the times of the slowest sensor. Position,
    velocity and attitude that were not logged are set to zero if `needs_of_rows` does not require
    them.
    """
    needed = ["gyro", "encoders", "joint_rates"]
    if len(measurements.attitude):
        needed.append("attitude")
    if family.uses_base_position:
        needed += ["velocity", "position"] if len(measurements.position) else ["velocity"]
    samples = {name: getattr(measurements, name) for name in needed}
    common = reduce(np.intersect1d, (each.time for each in samples.values()))
    if not len(common) or len(common) < min(map(len, samples.values())) / 2:
        return None

    def values(name: str) -> NDArray[np.float64]:
        if name not in samples:
            nothing = [1.0, 0.0, 0.0, 0.0] if name == "attitude" else [0.0, 0.0, 0.0]
            return np.tile(nothing, (len(common), 1))
        return np.asarray(samples[name].value[np.searchsorted(samples[name].time, common)])

    quaternion = values("attitude")
    R_WB = Rotation.from_quat(quaternion, scalar_first=True)
    return Motion(
        measurements.joint_names,
        common,
        quaternion_WB=quaternion,
        p_WB=values("position"),
        w_WB=R_WB.apply(values("gyro")),
        v_WB=values("velocity"),
        q=values("encoders"),
        qdot=values("joint_rates"),
    )


def _motion(
    log: CheckedLog, tree: KinematicTree, family: RowFamily, suite: SensorSuite | None
) -> Iterator[tuple[Motion, NDArray[np.float64]]]:
    """Yield parts of the motion of a log and their errors; smoothed if a suite is given.

    See `LogRows.add`.
    """
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


def _identified(known: Known, log: CheckedLog) -> tuple[Identification, Gaussian]:
    """Return the estimate from one log, and the log's Gaussian of the target."""
    spacecraft, momentum, family = known.spacecraft, known.momentum, known.family
    assert family is not None
    tree, suite, warnings = spacecraft.tree, known.sensors, tuple[str, ...]()
    if log.states is not None:
        suite = None
    elif suite is None and complete_samples(log.measurements, family) is None:
        suite, warnings = suite_of(None, log)
    has_place = bool(len(log.measurements.position))
    has_attitude = bool(len(log.measurements.attitude))
    is_open = momentum is None or momentum.is_zero  # the samples may contradict zero
    is_tested = is_open and has_attitude

    def rows_of(family: RowFamily) -> LogRows:
        is_free = (
            is_tested and family.momentum_size and (has_place or not family.uses_base_position)
        )
        assumed = TotalMomentum.unknown() if is_free else momentum or TotalMomentum.zero()
        rows = LogRows(tree, family, assumed)
        for part in _motion(log, tree, family, suite):
            rows.add(*part)
        return rows

    rows = rows_of(family)
    noise = rows.noise()
    if is_open and noise.scatter is None:  # too few rows for a free momentum
        noise = rows.noise(is_zero=True)
    tester = (rows, noise)
    if is_tested and not family.momentum_size and has_place:
        other = rows_of(STANDARD_ROWS)
        tester = other, other.noise()
    compared = _compared(spacecraft, *tester) if is_open and tester[0].extra else None
    likely = 0.0 if compared is None else compared[0]
    is_zero = is_open and not (likely >= NAMED and rows.extra)
    cannot = "" if rows.extra else family.name
    said, checks = momentum_words(likely, is_given=momentum is not None, cannot=cannot)
    if suite is not None and (suite.disturbances or Disturbances()) != Disturbances():
        checks = (*checks, Check("forces", _FORCES))
    whole, first = rows.gaussians(noise, is_zero=is_zero)
    own = np.zeros(rows.extra) if is_zero else whole.solve()[: rows.extra]
    target, most = whole.marginal([TARGET]), len(tree.unknowns)
    fields = {} if is_zero else _momentum(rows, whole, most)
    if compared is not None and rows.extra and (momentum is None or not is_zero):
        target = compared[1]
    if compared is not None and not is_zero:
        fields = compared[2]
        own = fields["momentum_estimate"]

    form, count = rows.form, rows.row_count
    nominal, scale = plausible(spacecraft, form, target)
    solution = solution_of(
        target, nominal, scale, row_count=count - (rows.extra if own.any() else 0)
    )
    x = np.append(own, solution.values)  # what is not determined must not explain errors
    if noise.scatter is None:
        solution = replace(solution, covariance=np.full((10, 10), np.nan))
    is_shown = solution.rank == most and count > FEWEST
    residuals = _residuals(rows, x, family) if is_shown else {}
    is_judged = solution.rank == most and noise.scatter is not None
    found = Identification.of_solution(
        form,
        solution,
        sensors=suite,
        sample_count=rows.sample_count,
        estimator=NAME,
        rows=family.name,
        residuals=residuals,
        momentum="zero" if is_zero else "unknown" if momentum is None or is_open else momentum.name,
        warnings=(*warnings, *said),
        checks=(
            *checks,
            *_checks(*rows.misfit(x), (first, whole) if is_judged else None, tree),
        ),
        **fields,
    )
    return found, target


def _checks(
    to_errors: float,
    to_rows: float,
    halves: tuple[Gaussian, Gaussian] | None,
    tree: KinematicTree,
) -> Iterator[Check]:
    """Yield the checks of the rows of a log.

    Args:
        to_errors, to_rows: size of the residuals relative to the samples' errors, which are as
            large as the samples of each sensor show, and to the rows.
        halves: what the first half and all samples tell; None if they cannot be judged.
        tree: the known bodies.

    """
    # The errors of a log are at least as many as the axes of a gyro, whose bias is in all samples.
    axes = 3 if tree.normal_B is None else 1
    limit = float(np.sqrt(chdtri(axes, IMPROBABLE) / axes))
    misfit = min(to_errors, to_rows / INTEGRATION)
    text = f"the momentum balance misses the samples by {misfit:.2g} times their errors: {_CAUSE}"
    yield Check.of("misfit", text, misfit, limit)
    if to_rows <= INTEGRATION or halves is None:
        return
    first, all_samples = halves
    yield halves_check(first.marginal([TARGET]), all_samples.marginal([TARGET]), _CAUSE)


def _residuals(
    rows: LogRows, x: NDArray[np.float64], family: RowFamily
) -> dict[str, ResidualSeries]:
    """Return the residuals of the linear and the angular rows at unknowns x."""
    units = {"linear": family.linear_unit, "angular": "N·m·s"}
    return {
        kind: ResidualSeries(shown.time, shown.value, unit)
        for (kind, unit), shown in zip(units.items(), rows.residuals(x), strict=True)
        if shown.value.size
    }


def _compared(
    spacecraft: Spacecraft, rows: LogRows, noise: RowNoise
) -> tuple[float, Gaussian, dict[str, NDArray[np.float64]]] | None:
    """Return the comparison of zero with an unknown momentum; None without need or noise."""
    zero = rows.gaussians(noise, is_zero=True)[0]
    x = np.append(np.zeros(rows.extra), zero.solve())
    if noise.scatter is None or rows.misfit(x)[1] < INTEGRATION:
        return None
    sigma = Model(spacecraft.tree, SensorSuite()).unknown(MOMENTUM).sigma  # of [L; v]
    size = plausible(spacecraft, rows.form, zero)[1]
    return compare_momentum(rows, noise, sigma * np.repeat([1.0, spacecraft.mass], 3), size)


def _momentum(rows: LogRows, whole: Gaussian, most: int) -> dict[str, Any]:
    """Return the fields of an unknown momentum; none if the rows do not determine everything."""
    if not rows.extra or whole.rank < rows.extra + most:
        return {}
    inverse = np.linalg.pinv(whole.R)[: rows.extra]
    return {
        "momentum_estimate": whole.solve()[: rows.extra],
        "momentum_covariance": inverse @ inverse.T,
    }
