"""Least squares on the momentum rows of complete or smoothed samples, of one log or many.

Every log is a Gaussian of the target and of its own momentum (`estimation.rows_fit`). Zero and an
unknown momentum are compared by their evidence, as in a fit, and the target is their average.
Several logs, and a prior, are the sum of their Gaussians.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from cpid_drake.dynamics.parameterizations import Parameterization
from cpid_drake.dynamics.rows import STANDARD_ROWS, RowFamily
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.estimation.evidence import NAMED
from cpid_drake.estimation.gaussian import Gaussian, solution_of
from cpid_drake.estimation.least_squares import KNOWN
from cpid_drake.estimation.rows_fit import (
    TARGET,
    LogRows,
    MomentumComparison,
    RowNoise,
    compare_momentum,
    disagreement,
)
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.estimation.whiteness import MOST_CORRELATED, NEGLIGIBLE, least_white, whiteness
from cpid_drake.identification.checks import momentum_words
from cpid_drake.identification.known import Known, suite_of
from cpid_drake.identification.result import IMPROBABLE, Check, MomentumEstimate
from cpid_drake.identification.solved import ResidualSeries, SolvedIdentification
from cpid_drake.identification.target_prior import TargetPrior
from cpid_drake.identification.together import with_sources
from cpid_drake.logs.log import Measurements
from cpid_drake.logs.noise_estimation import sample_sigmas
from cpid_drake.logs.smoothing import smooth_windows
from cpid_drake.sensors.suite import SensorSuite

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.identification.checked_log import CheckedLog
    from cpid_drake.spacecraft.spacecraft import Spacecraft

SMALL = 1e-3
"""Residuals below this share of the momentum are no misfit: splines leave as much of exact logs."""

INTEGRATION = 1e-5
"""Residuals below this share of the momentum do not contradict zero: integration leaves as much."""

NAME = "least_squares"
"""The estimator's name."""

_CAUSE = "the spacecraft, a frame, a sign or a clock is not as assumed, or forces acted"
DISAGREE = f"two halves of the samples have different targets: {_CAUSE}"
CORRELATED = f"the residuals of the rows are correlated, which noise is not: {_CAUSE}"

_FEW_ROWS = 20  # fewer rows show no correlation in time


def estimate(
    known: Known,
    logs: "Mapping[str, CheckedLog]",
    progress: Callable[[str], None] = lambda step: None,
) -> SolvedIdentification:
    """Identify a target by least squares on momentum rows.

    Exact states and complete samples without declared sensors are used as they are; other samples
    are smoothed to common times first.

    Args:
        known: what is known besides the logs, and the row family.
        logs: by their names.
        progress: is not called.

    Raises:
        InputError: there are too few samples, or the attitude or position for smoothing is missing;
            the prior determines combinations of other unknowns.

    """
    found = {name: _identified(known, log) for name, log in logs.items()}
    if len(found) == 1 and known.prior is None:
        return next(iter(found.values()))[0]
    return _combined(known.spacecraft, found, known.prior)


def _combined(
    spacecraft: "Spacecraft",
    logs: Mapping[str, tuple[SolvedIdentification, Gaussian]],
    prior: TargetPrior | None,
) -> SolvedIdentification:
    """Return the estimate of one target from all logs and the prior, and whether they agree."""
    found, sources = [each for each, _ in logs.values()], {n: g for n, (_, g) in logs.items()}
    form, total = found[0].parameterization, reduce(Gaussian.add, sources.values())
    x, scale = plausible(spacecraft, form)
    count, largest = sum(each.solution.row_count for each in found), KNOWN
    if prior is not None:
        logs_say, x = total, prior.moved(form, x)
        for _ in range(4):  # each squares the error of linearizing it about the joint estimate
            told = prior.gaussian(TARGET, form, x, scale)
            # What only the prior determines is determined, however vague the prior is.
            largest = max(KNOWN, 1.5 / float(told.singular_parts(scale)[1].min()))
            total = logs_say.add(told)
            x = solution_of(total, x, scale, largest=largest).values
        sources[prior.name] = told
    solution = solution_of(total, x, scale, largest=largest, row_count=count)
    common = found[0]
    if len(logs) > 1:  # what belongs to one log is left out
        common = replace(
            common,
            sample_count=sum(each.sample_count for each in found),
            whiteness=least_white(each.whiteness for each in found if each.whiteness),
            residuals={},
            momentum=max((each.momentum for each in found), key=("zero", "known", "unknown").index),
            misfit=1.0,
            momentum_estimate=None,
        )

    def said(what: str) -> list[str]:
        where = {n: f"{n}: " if len(logs) > 1 else "" for n in logs}
        return [where[n] + text for n, (own, _) in logs.items() for text in getattr(own, what)]

    common = replace(
        common,
        solution=solution,
        warnings=tuple(said("warnings")),
        checks=tuple(Check("one log", text) for text in said("failures")),
    )
    return with_sources(
        common,
        Gaussian({TARGET: slice(0, 10)}, np.zeros((10, 10)), np.zeros(10)),
        sources,
        TARGET,
        lambda gaussian: solution_of(gaussian.marginal([TARGET]), x, scale),
        {name: (own.sample_count, own.failures) for name, (own, _) in logs.items()},
        prior,
    )


def plausible(
    spacecraft: "Spacecraft", form: Parameterization
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a plausible target's unknowns (10,), and their plausible sizes."""
    model = Model(spacecraft.tree, SensorSuite())
    psi, size = model.unknown(PSI).mean, model.plausible
    if form.name == "relative":
        return psi, size
    inertia = np.full(3, psi[4])
    x = form.from_parameters(np.concatenate([psi[:1], np.zeros(3), inertia, np.zeros(3)]))
    if form.name == "standard":
        return x, 2 * size
    # 1/m of a light target has no plausible size.
    mass, radius = spacecraft.mass, size[1] / size[0]
    return x, 1e6 * np.concatenate([[1 / mass], 3 * [radius], 6 * [mass * radius**2]])


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


def complete_samples(measurements: Measurements, family: RowFamily) -> Telemetry | None:
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
    rarest = min(samples.values(), key=len)
    common = rarest.time
    for other in samples.values():
        if not np.array_equal(other.time, common):
            common = np.intersect1d(common, other.time)
    if not len(common) or len(common) < len(rarest) / 2:
        return None

    def values(name: str) -> NDArray[np.float64]:
        if name not in samples:
            nothing = [1.0, 0.0, 0.0, 0.0] if name == "attitude" else [0.0, 0.0, 0.0]
            return np.tile(nothing, (len(common), 1))
        time, value = samples[name].time, samples[name].value
        return value if len(time) == len(common) else value[np.searchsorted(time, common)]

    quaternion = values("attitude")
    R_WB = Rotation.from_quat(quaternion, scalar_first=True)
    return Telemetry(
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
    log: "CheckedLog", tree: KinematicTree, family: RowFamily, suite: SensorSuite | None
) -> Iterator[tuple[Telemetry, NDArray[np.float64]]]:
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
        for each in smooth_windows(
            log.measurements, suite, with_position=position, normal_B=normal_B
        ):
            yield each.telemetry, each.covariance()


def _identified(known: Known, log: "CheckedLog") -> tuple[SolvedIdentification, Gaussian]:
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
    free = TotalMomentum.unknown()

    def rows_of(family: RowFamily) -> LogRows:
        is_free = (
            is_tested and family.momentum_size and (has_place or not family.uses_base_position)
        )
        rows = LogRows(tree, family, free if is_free else momentum or TotalMomentum.zero())
        for part in _motion(log, tree, family, suite):
            rows.add(*part)
        return rows

    rows = rows_of(family)
    noise = rows.noise()
    if is_open and not noise.is_known:  # too few rows for a free momentum
        noise = rows.noise(is_zero=True)
    tester = (rows, noise)
    if is_tested and not family.momentum_size and has_place:
        other = rows_of(STANDARD_ROWS)
        tester = other, other.noise()
    compared = _compared(spacecraft, *tester) if is_open and tester[0].extra else None
    likely = 0.0 if compared is None else compared.probability
    is_zero = is_open and not (likely >= NAMED and rows.extra)
    cannot = "" if rows.extra else family.name
    said, checks = momentum_words(likely, is_given=momentum is not None, cannot=cannot)
    whole, *halves = rows.gaussians(noise, is_zero=is_zero)
    own = np.zeros(rows.extra) if is_zero else whole.solve()[: rows.extra]
    target, estimate = whole.marginal([TARGET]), None
    if compared is not None and rows.extra and (momentum is None or not is_zero):
        target = compared.target
    if compared is not None and not is_zero:
        own, estimate = compared.momentum, MomentumEstimate(compared.momentum, compared.covariance)
    elif not is_zero:
        estimate = _momentum(rows, whole)
    found = _estimate(spacecraft, family, rows, noise, (target, *halves), own, suite)
    if momentum is None or is_open:
        momentum = TotalMomentum.zero() if is_zero else free
    found = replace(
        found,
        momentum=momentum.name,
        momentum_estimate=estimate,
        warnings=(*warnings, *said),
        checks=(*checks, *found.checks),
    )
    return found, target


def _compared(
    spacecraft: "Spacecraft", rows: LogRows, noise: RowNoise
) -> MomentumComparison | None:
    """Return the comparison of zero with an unknown momentum; None if the rows show nothing."""
    zero = rows.gaussians(noise, is_zero=True)[0]
    x = np.append(np.zeros(rows.extra), zero.solve()[rows.unknowns])
    if not noise.is_known or rows.misfit(x)[1] < INTEGRATION:
        return None
    sigma = Model(spacecraft.tree, SensorSuite()).unknown(MOMENTUM).sigma  # of [L; v]
    return compare_momentum(rows, noise, sigma * np.repeat([1.0, spacecraft.mass], 3))


def _momentum(rows: LogRows, whole: Gaussian) -> MomentumEstimate | None:
    """Return the estimate of an unknown momentum; None if the rows do not determine everything."""
    places = np.append(np.arange(rows.extra), rows.extra + rows.unknowns)
    if not rows.extra or whole.rank < len(places):
        return None
    inverse = np.linalg.pinv(whole.R[:, places])[: rows.extra]
    return MomentumEstimate(whole.solve()[: rows.extra], inverse @ inverse.T)


def _estimate(
    spacecraft: "Spacecraft",
    family: RowFamily,
    rows: LogRows,
    noise: RowNoise,
    gaussians: Sequence[Gaussian],
    momentum: NDArray[np.float64],
    suite: SensorSuite | None,
) -> SolvedIdentification:
    """Return the estimate of a log.

    Args:
        spacecraft, family, rows, noise, suite: of the log.
        gaussians: of the target by all rows, and of all unknowns by each half.
        momentum: (k,) the momentum.

    """
    target, *halves = gaussians
    form = family.parameterization(spacecraft.mass)
    nominal, scale = plausible(spacecraft, form)
    x = np.append(momentum, target.solve()[spacecraft.tree.unknowns])
    count = rows.row_count
    solution = solution_of(
        target,
        nominal,
        scale,
        residual_sum=rows.residual_sum(x),
        row_count=count - (rows.extra if momentum.any() else 0),
    )
    if not noise.is_known:
        solution = replace(solution, covariance=np.full((10, 10), np.nan))
    to_errors, to_rows = rows.misfit(x)
    is_complete = solution.rank == len(spacecraft.tree.unknowns)
    is_judged = is_complete and noise.is_known and to_rows > SMALL
    checks: tuple[Check, ...] = ()
    if is_judged:
        chi_squared, freedom, chance = disagreement(halves)
        limit = float(chdtri(freedom, IMPROBABLE)) if freedom else None
        checks = (Check.of("halves", DISAGREE, chi_squared, limit, chance >= IMPROBABLE),)
    residuals, white = dict[str, ResidualSeries](), None
    if is_complete and count > _FEW_ROWS:
        names = {"linear": family.linear_unit, "angular": "N·m·s"}
        series = list(zip(names.items(), rows.residuals(x), strict=True))
        residuals = {
            kind: ResidualSeries(shown.time, shown.value, unit, every, first if every > 1 else None)
            for (kind, unit), (shown, every, first) in series
            if shown.value.size
        }
        white = whiteness(np.hstack([each.neighbours for each in residuals.values()]))
    # Other rows contain the slope of a few positions, whose errors are correlated.
    if is_judged and white is not None and not (suite is None or family.uses_base_position):
        fails = white.lag_one > MOST_CORRELATED and to_errors > NEGLIGIBLE
        correlation = white.lag_one, MOST_CORRELATED, not fails
        checks = (*checks, Check.of("correlation", CORRELATED, *correlation))
    return SolvedIdentification(
        form,
        solution,
        sample_count=rows.sample_count,
        estimator=NAME,
        rows=family.name,
        sensors=suite,
        whiteness=white,
        residuals=residuals,
        checks=checks,
        misfit=min(to_errors, to_rows / SMALL),
    )
