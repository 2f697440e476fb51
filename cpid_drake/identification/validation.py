"""Validation of an identified target: it agrees with a log that was not used to identify it.

The log is identified on its own. Its estimate and the given one differ as their covariances say if
the target is right: a χ² test of ten degrees of freedom at most, which loses no power to hundreds
of samples. For the reader, the base's motion is also predicted with the given target: all else is
fitted to the beginning of the log.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import chdtrc, chdtri, chndtrinc

from cpid_drake.array import Array
from cpid_drake.dynamics.parameterizations import relative_parameterization
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.estimation.fit import fit
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, roll
from cpid_drake.estimation.sweep import EXACT
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.files.errors import InputError
from cpid_drake.files.one_thread import one_thread
from cpid_drake.identification.agreement import Sources
from cpid_drake.identification.arguments import Arguments, PathLike, resolve_logs
from cpid_drake.identification.checked_log import check_logs
from cpid_drake.identification.fitted import TRAJECTORY_FIT
from cpid_drake.identification.identify import identify
from cpid_drake.identification.log_sensors import model_of
from cpid_drake.identification.prior import TargetPrior
from cpid_drake.identification.result import Identification
from cpid_drake.logs.column_map import scale_of
from cpid_drake.logs.log import Log
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

FALSE_ALARM = 0.01
"""Probability that the test fails a right target: a user who validates wants its power."""

POWER = 0.9
"""Probability with which a target that is said to be noticed is noticed."""

_SHOWN = {"rad": "deg", "m": "mm", "m/s": "mm/s", "rad/s": "deg/s"}


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
        in_sigma: root mean square of the residuals of the whole log in σ, with the target that
            explains it best: about 1 if the model is right.

    """

    sensor: str
    unit: str
    samples: int
    rms: float
    largest: float
    noise: float
    in_sigma: float


@dataclass(frozen=True)
class Validation:
    """The test of a target, and the errors of the prediction of a log.

    Attributes:
        start, end: first and last time of the prediction [s].
        momentum: the total momentum that was assumed: "zero", "unknown" or "known".
        errors: of each sensor of the base.
        chi_squared: of the difference of the target from the log's own estimate; infinite if no
            target explains the log.
        freedom: number of combinations of parameters that the samples determine.
        heavier: how much heavier than this target another one must be to be noticed with
            probability `POWER`, whatever its other parameters, as a share of the mass.
        warnings: sentences for the reader.

    """

    start: float
    end: float
    momentum: str
    errors: tuple[SensorError, ...]
    chi_squared: float
    freedom: int
    heavier: float
    warnings: tuple[str, ...] = ()

    @property
    def in_sigma(self) -> float:
        """Largest residual of a sensor in σ, with the target that explains the log best."""
        return max(error.in_sigma for error in self.errors)

    @property
    def probability(self) -> float:
        """Probability of so large a χ² with the right target."""
        return float(chdtrc(self.freedom, self.chi_squared)) if self.freedom else 1.0

    @property
    def is_target_right(self) -> bool:
        """Whether the samples agree with the target."""
        return self.probability >= FALSE_ALARM


@one_thread
def validate(
    spacecraft: Spacecraft,
    target: TargetPrior | Identification | PathLike,
    data: Log | PathLike,
    *,
    sensors: SensorSuite | PathLike | None = None,
    momentum: TotalMomentum | str | None = None,
    known_bodies: BodyUncertainty | PathLike | None = None,
    planar: bool | None = None,
    beginning: float = 0.3,
) -> Validation:
    """Test an identified target with a log that was not used to identify it, and predict this log.

    Args:
        spacecraft, planar: see `identify`.
        target: the identified target with its uncertainty, such as the result of `identify`.
        data: the log.
        sensors: the sensors' errors; default: estimated from the log.
        momentum: the total momentum; default: that of the largest evidence, and the average over
            zero and unknown in the test of the target.
        known_bodies: uncertainty of the spacecraft; default: none.
        beginning: share of the log, or of its longest part without a gap, to which start, momentum
            and biases are fitted for the prediction.

    Raises:
        InputError: an argument is of another type; the log cannot be used (see `check_log`), is too
            short or lacks attitude or encoders; the target does not determine the relative
            unknowns; the share is not between 0 and 1.

    """
    if not 0 < beginning < 1:
        raise InputError(f"the beginning must be a share between 0 and 1, not {beginning:g}")
    options = Arguments.of(
        spacecraft, sensors=sensors, momentum=momentum, known_bodies=known_bodies, prior=target
    )
    given = resolve_logs(data, spacecraft)
    if len(given) > 1:
        raise InputError(f"validate takes one log, not {len(given)}")
    if options.prior is None:
        raise InputError("there is no target to validate")
    suites = dict.fromkeys(given, options.sensors)
    spacecraft, logs = check_logs(spacecraft, given, suites, planar, lambda step: None)
    [log] = logs.values()
    for name in ("attitude", "encoders"):
        if not log.counts.get(name):
            raise InputError(f"the log has no samples of {SENSORS[name].quantity}")
    model, warnings = model_of(spacecraft.tree, logs, options.known_bodies)
    own = identify(
        spacecraft,
        given,
        estimator=TRAJECTORY_FIT,
        sensors=model.suite,
        momentum=options.momentum,
        known_bodies=options.known_bodies,
        planar=planar,
    )
    whole = LogState.of(model, log.measurements)
    samples = _longest_part(model, whole)
    start, end = samples.blocks[0].start, samples.blocks[-1].end
    first = sum(block.end <= start + beginning * (end - start) for block in samples.blocks)
    if not 0 < first < len(samples.blocks):
        raise InputError(
            "the log is too short to predict a part of it from its beginning; give a log of at "
            "least a few seconds"
        )
    if own.momentum != "unknown" and samples.blocks[0] is whole.blocks[0]:
        used = options.momentum or TotalMomentum.zero()
        value = np.concatenate([used.L_WScm_W, used.v_WScm_W])
        model = model.with_prior(MOMENTUM, value, EXACT * model.unknown(MOMENTUM).sigma)
    predicted = _predicted(model, samples, own.residuals, first, options.prior.of_psi(model))
    errors = []
    for name, rest in own.residuals.items():
        parts = zip(predicted.models[first:], predicted.residuals[first:], strict=True)
        sizes = [
            np.linalg.norm(residuals[name] * part.scale_of(name), axis=1)
            for part, residuals in parts
            if name in residuals
        ]
        if not sizes:
            continue
        size = np.concatenate(sizes)
        sigmas = next(m.scale_of(name) for m in predicted.models if name in m.sensors)
        unit = _SHOWN[SENSORS[name].unit]
        factor = 1 / scale_of(unit)
        rms, largest = factor * _rms(size), factor * float(size.max())
        noise = factor * float(np.linalg.norm(sigmas))
        errors.append(SensorError(name, unit, len(size), rms, largest, noise, _rms(rest.value)))
    warnings = (*own.failures, *warnings, *own.warnings)
    start = samples.blocks[first].start
    return Validation(
        start, end, own.momentum, tuple(errors), *_test(model, own, options.prior), warnings
    )


def _longest_part(model: Model, log: LogState) -> LogState:
    """Return the longest part of a log without a gap, behind which all begins anew."""
    begins = (k for k, link in enumerate(log.links, 1) if link.gap)
    parts = pairwise([0, *begins, len(log.blocks)])
    first, end = max(parts, key=lambda part: part[1] - part[0])
    if end - first == len(log.blocks):
        return log
    return LogState.of_blocks(model, log.blocks[first:end], log.name)


def _test(model: Model, own: Identification, target: TargetPrior) -> tuple[float, int, float]:
    """Return χ², freedom and `heavier` of the test of a target by a log's own estimate."""
    if not own.converged:
        return np.inf, 10, np.inf
    form, solution = relative_parameterization(model.mass), own.solution
    assert solution is not None
    both = [target.of_psi(model), solution.determined]
    psi = model.cone.most_probable(both[0])
    prior = model.cone.prior(PSI, psi)
    sources = {"target": both[0], "log": both[1]}
    of_both = Sources(prior.minus(-psi), sources, PSI, model.sizes(psi))
    chi_squared, freedom = of_both.difference(["target"], ["log"])
    if not freedom:
        return 0.0, 0, np.inf
    # var(δm / m) = j (P_target + P_log) jᵀ, j = ∂m/∂ψ / m
    mass = form.jacobian(psi)[0] / form.to_parameters(psi)[0]
    variance = sum(mass @ each.add(prior).covariance() @ mass for each in both)
    # A target heavier by δ has the noncentral χ² with λ = δ² / var.
    needed = chndtrinc(chdtri(freedom, FALSE_ALARM), freedom, 1 - POWER)
    return chi_squared, freedom, float(np.sqrt(needed * variance))


def _predicted(
    model: Model, log: LogState, names: Collection[str], first: int, target: Gaussian
) -> Rolled:
    """Return a log as predicted, from a block on, from the samples of some sensors before it."""
    blocks = [
        replace(
            block,
            samples=block.samples.updated(
                {n: block.samples[n].where(slice(None if k < first else 0)) for n in names}
            ),
        )
        for k, block in enumerate(log.blocks)
    ]
    cut = log.with_each(block=blocks)
    model = replace(model, rows=(target,))
    beginning = fit(model, [cut])
    return roll(model, beginning.logs[0].with_each(block=log.blocks), beginning.values)


def _rms(sizes: Array) -> float:
    return float(np.sqrt(np.mean(sizes**2)))
