"""Validation of an identified target: it predicts a log that was not used to identify it.

The log is fitted with a free target. Its own estimate and the given one differ as their covariances
say if the target is right: a χ² test of ten degrees of freedom at most, which loses no power to the
hundreds of samples. For the reader, the base's motion is also predicted with the given target: all
else is fitted to the beginning of the log.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, chndtrinc

from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.estimation.evidence import compare
from cpid_drake.estimation.fit import Fit, fit
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, roll
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model, Unknown
from cpid_drake.identification.checked_log import check_log
from cpid_drake.identification.estimate import IN_PLANE, at_momentum
from cpid_drake.identification.problem import NOISE_ESTIMATED
from cpid_drake.identification.target_prior import TargetPrior
from cpid_drake.processes import one_thread
from cpid_drake.sensing.measurement_stream import MeasurementStream
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

_SMALL = 1e-6  # share of a plausible target that stands for no target, or of a σ for a known value
_SEEN = 0.5  # variance in plausible targets below which a log determines a combination

_UNITS = {
    "rad": (180 / np.pi, "deg"),
    "m": (1e3, "mm"),
    "m/s": (1e3, "mm/s"),
    "rad/s": (180 / np.pi, "deg/s"),
}


@dataclass(frozen=True)
class TargetTest:
    """The χ² test of the difference of a given target from the log's own estimate.

    Attributes:
        chi_squared: of the difference; infinite if no target explains the log.
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
        noise: root mean square of the sensor's noise alone.
        without_target: root mean square of the error of a prediction without a target.
        in_sigma: root mean square of the residuals of the whole log in σ, with the target that
            explains it best: about 1 if the model is right.

    """

    sensor: str
    unit: str
    samples: int
    rms: float
    largest: float
    noise: float
    without_target: float
    in_sigma: float


@dataclass(frozen=True)
class Validation:
    """The test of a target, and the errors of the prediction of a log.

    Attributes:
        start, end: first and last time of the prediction [s].
        momentum: the total momentum that was assumed: "zero", "unknown" or "known".
        errors: of each sensor of the base.
        test: of the target.
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
        """Largest residual of a sensor in σ, with the target that explains the log best."""
        return max(error.in_sigma for error in self.errors)

    @property
    def probability(self) -> float:
        """Probability of so unlikely a test with the right target."""
        return self.test.probability

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
    """Test an identified target with a log that was not used to identify it, and predict this log.

    Args:
        spacecraft: the known spacecraft.
        target: the identified target with its uncertainty.
        data: the log.
        sensors: the sensors' errors; default: estimated from the log.
        momentum: the total momentum; default: that of the largest evidence, and the average over
            zero and unknown in the test of the target.
        known_bodies: uncertainty of the spacecraft; default: none.
        planar: whether the spacecraft floats on a table; see `identify`.
        beginning: share of the log to which start, momentum and biases are fitted for the
            prediction.

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
    model = Model(spacecraft.tree, sensors, known_bodies)
    samples = LogState.of(model, log.stream)
    first = _first_predicted(samples, beginning)

    whole = fit(model, [samples])
    given = _given(model, target)
    test, used = _test(model, whole, given, target, momentum)
    if not used.is_unknown:
        value = np.concatenate([used.L_WScm_W, used.v_WScm_W])
        model = model.with_prior(MOMENTUM, value, _SMALL * _unknown(model, MOMENTUM).sigma)
    names = whole.rolled[0].all_residuals()
    psi = _unknown(model, PSI)
    nothing = model.with_prior(PSI, _SMALL * psi.mean, _SMALL * model.plausible)
    predicted = _predicted(model, samples, names, first, given)
    alone = _predicted(nothing, samples, names, first, None)
    errors = []
    for name, rest in names.items():
        sigmas = next(m.sensors[name].scale for m in predicted.models if name in m.sensors)
        found, other = (_sizes(each, name, first) for each in (predicted, alone))
        if not len(found):
            continue
        factor, unit = _unit(name)
        errors.append(
            SensorError(
                name,
                unit,
                len(found),
                factor * _rms(found),
                factor * float(found.max()),
                factor * float(np.linalg.norm(sigmas)),
                factor * _rms(other),
                float(np.sqrt(np.mean(rest**2))),
            )
        )
    start, end = samples.blocks[first].start, samples.blocks[-1].end
    return Validation(start, end, used.name, tuple(errors), test, tuple(warnings))


def _unknown(model: Model, name: str) -> Unknown:
    return next(unknown for unknown in model.table if unknown.name == name)


def _first_predicted(log: LogState, beginning: float) -> int:
    """Return the first block after the beginning of a log.

    Raises:
        InputError: the beginning, or the rest, has no block.

    """
    start, end = log.blocks[0].start, log.blocks[-1].end
    until = start + beginning * (end - start)
    first = sum(block.end <= until for block in log.blocks)
    if not 0 < first < len(log.blocks):
        raise InputError(
            "the log is too short to predict a part of it from its beginning; give a log of at "
            "least a few seconds"
        )
    return first


def _given(model: Model, target: TargetPrior) -> Gaussian:
    """Return the given target's ψ, as vague as before the first sample where it says nothing."""
    form, psi = relative_parameterization(model.mass), _unknown(model, PSI)
    rows = target.rows(form, target.moved(form, psi.mean), model.plausible)
    vague = np.column_stack([np.diag(1 / psi.sigma), psi.mean / psi.sigma])
    return Gaussian.of_rows({PSI: 10}, np.vstack([np.column_stack([rows.A, rows.b]), vague]))


def _test(
    model: Model,
    whole: Fit,
    given: Gaussian,
    target: TargetPrior,
    momentum: TotalMomentum | None,
) -> tuple[TargetTest, TotalMomentum]:
    """Return the test of a given ψ by a fit with a free target, and the momentum to assume."""
    log = whole.logs[0].name
    name = _unknown(model, MOMENTUM).key(log)
    own = at_momentum(whole.gaussian, whole.values, momentum or TotalMomentum.unknown(), log)
    own = own.moved(-np.concatenate([whole.values[each] for each in own.places]))
    held = sorted({*range(6)}.difference(IN_PLANE)) if model.tree.normal_B is not None else []
    is_open = {name: _unknown(model, MOMENTUM).sigma} if momentum is None else {}
    found = compare(own, is_open, [PSI], {name: held})
    if momentum is None:
        is_moving = found.probability[name] > 1 / 2
        momentum = TotalMomentum.unknown() if is_moving else TotalMomentum.zero()
    if not whole.converged:
        return TargetTest(np.inf, 10, np.inf), momentum

    plausible, form = model.plausible, relative_parameterization(model.mass)
    psi = given.solve()
    P = found.covariance / plausible / plausible[:, None]
    S = P + given.covariance() / plausible / plausible[:, None]
    variances, axes = np.linalg.eigh(P)
    seen = axes[:, variances < _SEEN]
    freedom = seen.shape[1]
    if not freedom:
        return TargetTest(0.0, 0, np.inf), momentum
    error = seen.T @ ((psi - found.mean) / plausible)
    chi_squared = float(error @ np.linalg.solve(seen.T @ S @ seen, error))
    mass = plausible * form.jacobian(psi)[0] / form.to_parameters(psi)[0]
    needed = chndtrinc(chdtri(freedom, FALSE_ALARM), freedom, 1 - POWER)
    return TargetTest(chi_squared, freedom, float(np.sqrt(needed * (mass @ S @ mass)))), momentum


def _predicted(
    model: Model, log: LogState, names: dict, first: int, given: Gaussian | None
) -> Rolled:
    """Return a log as predicted from its first blocks.

    Args:
        model: the unknowns, with what is known about target and momentum.
        log: the log, with joints.
        names: the base's sensors.
        first: number of the first predicted block.
        given: the target; None for that of the model.

    """
    rows = [] if given is None else [given]
    psi = _unknown(model, PSI).mean if given is None else given.solve()
    blocks = [
        block
        if k < first
        else replace(
            block,
            samples=block.samples.updated({n: block.samples[n].where(slice(0)) for n in names}),
        )
        for k, block in enumerate(log.blocks)
    ]
    found = fit(model, [replace(log, blocks=tuple(blocks))], rows=rows, values={PSI: psi})
    return roll(model, replace(found.logs[0], blocks=log.blocks), found.values)


def _sizes(rolled: Rolled, name: str, first: int) -> NDArray[np.float64]:
    """Return the magnitudes (M,) of a sensor's errors from a block on, in its unit."""
    blocks = zip(rolled.models[first:], rolled.residuals[first:], strict=True)
    found = [
        np.linalg.norm(rest[name] * part.sensors[name].scale, axis=1)
        for part, rest in blocks
        if name in rest
    ]
    return np.concatenate([np.empty(0), *found])


def _unit(sensor: str) -> tuple[float, str]:
    """Return the unit in which a sensor's errors are shown, and its size."""
    unit = SENSORS[sensor].quantity.unit
    return _UNITS.get(unit, (1.0, unit))


def _rms(sizes: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(sizes**2)))
