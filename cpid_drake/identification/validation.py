"""Validation of an identified target: it predicts a log that was not used to identify it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, chndtrinc

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.estimation.block import Block, BlockQueue, blocks_of
from cpid_drake.estimation.combination import SourceRows
from cpid_drake.estimation.prediction import ALL, Prediction, SensorPrediction, predicted
from cpid_drake.identification.checked_log import check_log
from cpid_drake.identification.fit_setup import recursive_fit
from cpid_drake.identification.problem import NOISE_ESTIMATED
from cpid_drake.identification.target_prior import TargetPrior
from cpid_drake.processes import one_thread
from cpid_drake.sensing.measurement_stream import MeasurementStream, time_interval
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.noise_estimation import estimate_suite
from cpid_drake.sensing.sensors import SENSORS
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

FALSE_ALARM = 0.01
"""Probability that the test of the target fails though the target is right."""

POWER = 0.9
"""Probability with which a target that is said to be noticed is noticed."""

BEGINNING = 0.3
"""Share of a log to which start, momentum and biases are fitted."""

_MOVING = 0.01
"""Probability of the samples of a momentum of zero below which the momentum is estimated."""

_SMALL = 1e-6
"""Share of a plausible target that stands for no target."""

_UNITS = {
    "rad": (180 / np.pi, "deg"),
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
    "rad/s": (180 / np.pi, "deg/s"),
}


@dataclass(frozen=True)
class TargetTest:
    """The χ² test of the errors of a prediction that another target would not have.

    The errors that remain with the best target for the predicted samples are left out: they are
    many, and hide what a wrong target does. The covariance contains that of the target that was
    given, of start, momentum, biases and joints, and the noise at the beginning of the log.

    Attributes:
        chi_squared: of the errors; infinite if the samples contradict every start.
        freedom: number of combinations of parameters that the samples determine.
        heavier: how much heavier than this target another one must be to be noticed with
            probability `POWER`, whatever its other parameters, as a share of the mass.

    """

    chi_squared: float
    freedom: int
    heavier: float

    @property
    def probability(self) -> float:
        """Probability of so large a χ² with the right target."""
        return float(chdtrc(self.freedom, self.chi_squared)) if self.freedom else 1.0


@dataclass(frozen=True)
class SensorError:
    """The error of the predictions of one sensor's samples, in the unit `unit`.

    Attributes:
        sensor: its name in `SENSORS`.
        unit: deg, deg/s, mm or mm/s.
        samples: number of predicted samples.
        rms: root mean square of the error's magnitude.
        largest: largest error.
        expected: root mean square that noise and the uncertainty of the target explain.
        noise: root mean square of the sensor's noise alone.
        in_sigma: root mean square of the error in σ: about 1 for the right target.
        without_target: root mean square of the error of a prediction without a target.
        independent: number of independent samples with the information of all samples, whose
            noise is correlated as at the beginning.
        test: of the target by this sensor alone.

    """

    sensor: str
    unit: str
    samples: int
    rms: float
    largest: float
    expected: float
    noise: float
    in_sigma: float
    without_target: float
    independent: float
    test: TargetTest


@dataclass(frozen=True)
class Validation:
    """The errors of the prediction of a log.

    Attributes:
        start, end: first and last time of the prediction [s].
        momentum: the total momentum that was assumed: "zero", "unknown" or "known".
        errors: of each sensor of the base.
        test: of the target by all sensors together.
        warnings: sentences for the reader.

    """

    start: float
    end: float
    momentum: str
    errors: tuple[SensorError, ...]
    test: TargetTest
    warnings: tuple[str, ...] = ()

    @property
    def in_sigma(self) -> float:
        """Largest error of a sensor in σ."""
        return max(error.in_sigma for error in self.errors)

    @property
    def probability(self) -> float:
        """Probability of so unlikely a test, of all sensors or of one, with the right target."""
        tests = [self.test, *(error.test for error in self.errors)]
        return min(1.0, len(tests) * min(test.probability for test in tests))

    @property
    def is_target_right(self) -> bool:
        """Whether the samples agree with the target."""
        return self.probability >= FALSE_ALARM


@one_thread
def validate(
    spacecraft: Spacecraft,
    target: TargetPrior,
    data: Measurements | MeasurementStream,
    *,
    sensors: SensorSuite | None = None,
    momentum: TotalMomentum | None = None,
    known_bodies: BodyUncertainty | None = None,
    planar: bool | None = None,
    beginning: float = BEGINNING,
) -> Validation:
    """Predict a log that was not used to identify a target, and return the errors.

    Start, momentum and biases are fitted to the beginning of the log. The rest is predicted from
    the joint motion.

    Args:
        spacecraft: the known spacecraft.
        target: the identified target with its uncertainty.
        data: the log.
        sensors: the sensors' errors; default: estimated from the log.
        momentum: the total momentum; default: zero if the beginning agrees with this, else unknown.
        known_bodies: uncertainty of the spacecraft; default: none.
        planar: whether the spacecraft floats on a table; see `identify`.
        beginning: share of the log to which start, momentum and biases are fitted.

    Raises:
        InputError: the log cannot be used (see `check_log`), is too short or lacks attitude or
            encoders; the target does not determine the relative unknowns; the share is not between
            0 and 1.

    """
    if not 0 < beginning < 1:
        raise InputError(f"the beginning must be a share between 0 and 1, not {beginning:g}")
    log = check_log(spacecraft, data, sensors, planar)
    if log.normal_B is not None:
        spacecraft = spacecraft.on_table(log.normal_B)
    for name in ("attitude", "encoders"):
        if not log.counts.get(name):
            raise InputError(f"the log has no samples of {SENSORS[name].label}")
    warnings = [*log.doubts, *log.warnings, *map("not checked: {}".format, log.unchecked)]
    if sensors is None:
        sensors = estimate_suite(log.head)
        warnings.append(NOISE_ESTIMATED)
    form = relative_parameterization(spacecraft.mass)
    start, end = _interval(log.stream)
    until = start + beginning * (end - start)

    def run(
        momentum: TotalMomentum, psi: NDArray[np.float64], rows: SourceRows, tested: bool = True
    ) -> Prediction:
        fit = recursive_fit(spacecraft, sensors, momentum=momentum, known_bodies=known_bodies)
        blocks: Iterable[Block] = blocks_of(BlockQueue.of(sensors), log.stream)
        return predicted(fit, psi, rows, blocks, until, tested=tested)

    vague = recursive_fit(spacecraft, sensors).prior
    psi = target.moved(form, vague.psi)
    rows = target.rows(form, psi, vague.plausible)
    found = run(momentum or TotalMomentum.zero(), psi, rows)
    used = momentum or TotalMomentum.zero()
    if momentum is None:
        free = run(TotalMomentum.unknown(), psi, rows)
        if found.chi_squared - free.chi_squared > chdtri(6, _MOVING):
            found, used = free, TotalMomentum.unknown()
    # A target without mass has no centre of mass; a small one hardly moves the base.
    nothing = SourceRows(np.diag(1 / (_SMALL * vague.plausible)), np.zeros(10))
    alone = run(used, _SMALL * vague.psi, nothing, tested=False)
    if not found.is_complete:
        warnings.append(
            f"the prediction ends at {found.end:.4g} s, before a gap of the joints' samples"
        )
    count = len(found.target)
    share = form.jacobian(psi)[0] / form.to_parameters(psi)[0]
    tests = {
        name: _test_of(each, psi, rows, vague.plausible, share, FALSE_ALARM / count)
        for name, each in found.target.items()
    }
    errors = tuple(
        _error_of(name, each, alone.sensors.get(name), found, tests)
        for name, each in found.sensors.items()
    )
    return Validation(found.start, found.end, used.name, errors, tests[ALL], tuple(warnings))


def _interval(stream: MeasurementStream) -> tuple[float, float]:
    """Return the times of the first and the last sample of the encoders [s]."""
    intervals = [time_interval(chunk) for chunk in stream]
    known = [each for each in intervals if each is not None]
    return known[0][0], max(last for _, last in known)


def _test_of(
    log: SourceRows | None,
    psi: NDArray[np.float64],
    target: SourceRows,
    plausible: NDArray[np.float64],
    share: NDArray[np.float64],
    level: float,
) -> TargetTest:
    """Return the test of a target with ψ by rows of the predicted samples.

    Args:
        log: these rows, which contain a prior of plausible size about ψ.
        psi: (10,) of the target.
        target: what is known about it.
        plausible: (10,) plausible sizes of ψ.
        share: (10,) derivative by ψ of the share by which a target is heavier.
        level: probability of a false alarm.

    """
    if log is None:
        return TargetTest(np.inf, 10, np.inf)
    U, size, axes = np.linalg.svd(log.A * plausible)
    seen = size**2 > 2  # the samples tell more than the prior of plausible size
    freedom = int(seen.sum())
    if not freedom:
        return TargetTest(0.0, 0, np.inf)
    known = np.linalg.qr(np.vstack([target.A * plausible, np.eye(10)]), mode="r")
    errors = np.linalg.inv(known)  # a root of the covariance of the given ψ, in plausible sizes
    spread = size[seen, None] * (axes[seen] @ errors)
    root = np.linalg.cholesky(spread @ spread.T + np.eye(freedom))
    error = np.linalg.solve(root, U[:, seen].T @ (log.b - log.A @ psi))
    mass = share * plausible @ np.hstack([errors, axes.T / size])
    needed = chndtrinc(chdtri(freedom, level), freedom, 1 - POWER)
    return TargetTest(float(error @ error), freedom, float(np.sqrt(needed * (mass @ mass))))


def _error_of(
    name: str,
    found: SensorPrediction,
    alone: SensorPrediction | None,
    prediction: Prediction,
    tests: dict[str, TargetTest],
) -> SensorError:
    quantity = SENSORS[name].quantity
    factor, unit = _UNITS.get(quantity.unit, (1.0, quantity.unit))
    return SensorError(
        name,
        unit,
        len(found.time),
        factor * found.rms,
        factor * found.largest,
        factor * found.expected_rms,
        factor * float(np.linalg.norm(found.sigmas)),
        found.in_sigma,
        factor * alone.rms if alone is not None else np.nan,
        len(found.time) / prediction.noise[name].correlation_time,
        tests[name],
    )
