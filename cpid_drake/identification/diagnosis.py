"""Names the most likely cause if a log contradicts its model of the spacecraft or of the sensors.

Every hypothesis of `estimation.hypotheses` is fitted to the smoothed motion, one at a time. The
cause is the simplest hypothesis that explains the motion clearly better than all others.
"""

from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from cpid_drake.dynamics.rotations import skew
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.estimation.hypotheses import hypotheses
from cpid_drake.estimation.momentum_balance import Fit, MomentumBalance
from cpid_drake.identification.checked_log import CheckedLog
from cpid_drake.identification.rate_conventions import other_convention
from cpid_drake.identification.result import Identification
from cpid_drake.identification.sudden_changes import sudden_change
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.noise_estimation import estimate_suite
from cpid_drake.sensing.sensors import SENSORS
from cpid_drake.sensing.smoothing import smooth
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft

LONGEST = 60.0
"""Length of the part of a log that is examined [s]."""

_MOST_SAMPLES = 120
_MOST_OF_A_KIND = 4
_CLEARLY = 2.5
"""Ratio of misfits from which a hypothesis explains the motion clearly better."""

_LATEST = 0.8
"""Largest delay of a sensor that is considered [s]."""

_EXPLAINED = 2.0
"""Misfit of a hypothesis that explains the motion."""

_MUCH = 4.0
"""Ratio of misfits from which a hypothesis that does not explain all explains the largest part."""

_EQUAL = 1.5
"""Ratio of misfits up to which the simplest hypothesis is preferred."""

_SHORTEST_TURN = 0.5  # s
_MARGIN = 0.1  # s
_INTEGRATION = 1e-4
"""Error of an integrated turn, as a share of the turn; the noise of an exact log is smaller."""

_STUCK_SHARE = 0.2
_WHOLE = 0.05
"""Largest difference from a whole number of steps in a column of rounded values."""

_FEW = 10
_REWEIGHTINGS = 3
_FIRST_STEPS = 2
"""Steps of the fit of every hypothesis; the best ones then get more."""


@dataclass(frozen=True, eq=False)
class Examined:
    """The part of a log that is examined.

    Attributes:
        balance: the momentum balance of the smoothed motion.
        whole: the motion with samples before and after those of the balance.

    """

    balance: MomentumBalance
    whole: Telemetry

    @property
    def misfit(self) -> float:
        """Residuals of the momentum balance in units of their errors: about 1 for a good log."""
        return self.balance.expected.misfit


def with_cause(
    spacecraft: Spacecraft,
    log: CheckedLog,
    sensors: SensorSuite | None,
    found: Identification,
    *,
    is_connected: bool = True,
) -> Identification:
    """Return an identification whose first doubt names the most likely cause, if one stands out.

    Args:
        spacecraft: the known spacecraft.
        log: the log; its first minute is examined.
        sensors: the sensors' errors; None if they are not known.
        found: the identification with its doubts.
        is_connected: whether the samples belong to one continuous motion.

    """
    cause = ""
    if found.doubts:
        cause = likely_cause(spacecraft, log, sensors, is_connected=is_connected)
    if not cause:
        return found
    first, *rest = found.doubts
    return replace(found, doubts=(f"{first}; most likely, {cause}", *rest))


def likely_cause(
    spacecraft: Spacecraft,
    log: CheckedLog,
    sensors: SensorSuite | None,
    *,
    is_connected: bool = True,
) -> str:
    """Return the most likely cause in words; empty if no hypothesis stands out.

    Args:
        spacecraft: the known spacecraft.
        log: the log; its first minute is examined.
        sensors: the sensors' errors; None if they are not known.
        is_connected: whether the samples belong to one continuous motion.

    """
    measurements = first_part(log)
    found = _stuck(measurements) if is_connected else ""
    if found:
        return found
    if spacecraft.tree.normal_B is not None:  # the hypotheses use all six equations
        return ""
    found = other_convention(spacecraft.tree, measurements)
    found = found or sudden_change(spacecraft.tree, measurements)
    if found or not is_connected:
        return found
    try:
        examined = examine(spacecraft, measurements, sensors)
        if not examined.misfit > _CLEARLY:
            return ""
        suite = sensors or estimate_suite(measurements)
        return _of_gyro(measurements, suite) or _of_balance(examined)
    except (InputError, np.linalg.LinAlgError, ValueError):
        return ""  # too few samples, or samples that cannot be smoothed


def examine(
    spacecraft: Spacecraft, measurements: Measurements, sensors: SensorSuite | None
) -> Examined:
    """Return the momentum balance of a log.

    Raises:
        InputError: too few samples of attitude, position or joints.

    """
    motion = smooth(measurements, sensors or estimate_suite(measurements))
    whole = motion.telemetry
    margin = min(_LATEST, (whole.time[-1] - whole.time[0]) / 8)
    inside = (whole.time >= whole.time[0] + margin) & (whole.time <= whole.time[-1] - margin)
    chosen = np.flatnonzero(inside)
    chosen = chosen[np.unique(np.linspace(0, chosen.size - 1, _MOST_SAMPLES).astype(int))]
    covariance = motion.covariance()[chosen]
    balance = MomentumBalance(spacecraft.tree.lumped, whole.select(chosen), covariance)
    return Examined(balance, whole)


def first_part(log: CheckedLog) -> Measurements:
    """Return the first minute of a log."""
    start = min(s.time[0] for _, s in log.head.items() if len(s))
    return log.head.between(start, start + LONGEST)


def ranked(examined: Examined) -> list[Fit]:
    """Return the fits of the best hypotheses, the most likely cause first.

    The simplest hypothesis comes first among those that explain the motion about equally well.
    """
    balance = examined.balance
    causes = hypotheses(balance.tree, balance.motion, examined.whole)
    rough = sorted(
        (balance.fitted(each, steps=_FIRST_STEPS) for each in causes), key=lambda fit: fit.misfit
    )
    chosen: list[Fit] = []
    for freedom in (0, 1, 3, 6, 10):
        alike = (fit for fit in rough if fit.hypothesis.freedom == freedom)
        chosen += islice(alike, _MOST_OF_A_KIND)
    fits = []
    for rough_fit in chosen:
        fit = balance.fitted(rough_fit.hypothesis)
        for _ in range(_REWEIGHTINGS):
            fit = balance.reweighted(fit)
        if fit.is_plausible:
            fits.append(fit)
    best = _EQUAL * max(min(fit.misfit for fit in fits), 1.0)
    good = sorted(
        (fit for fit in fits if fit.misfit <= best), key=lambda f: (f.hypothesis.freedom, f.misfit)
    )
    return good + sorted((fit for fit in fits if fit.misfit > best), key=lambda f: f.misfit)


def _of_balance(examined: Examined) -> str:
    first, *others = ranked(examined)
    explains = first.misfit < _EXPLAINED or examined.misfit > _MUCH * first.misfit
    if not (explains and examined.misfit > _CLEARLY * max(first.misfit, 1.0)):
        return ""
    second = next(fit for fit in others if fit.text != first.text)
    limit = 1.1 * max(first.misfit, 1.0)
    if second.misfit < limit and second.hypothesis.freedom <= first.hypothesis.freedom:
        return f"{first.text}, or {second.text}"
    return first.text


def _of_gyro(measurements: Measurements, suite: SensorSuite) -> str:
    """Return the cause if the gyro contradicts the attitude.

    Turns between two attitudes, at least half a second apart, are compared with the integral of the
    angular velocity. Its constant error is free.
    """
    attitude, gyro = measurements.attitude, measurements.gyro
    attitude = attitude.where(
        (attitude.time >= gyro.time[0] + _MARGIN) & (attitude.time <= gyro.time[-1] - _MARGIN)
        if len(gyro)
        else slice(0)
    )
    if len(gyro) < _FEW or len(attitude) < _FEW:
        return ""
    path = CubicSpline(gyro.time, gyro.value)
    chosen = [0]
    for k, time in enumerate(attitude.time):
        if time >= attitude.time[chosen[-1]] + _SHORTEST_TURN:
            chosen.append(k)
    R = Rotation.from_quat(attitude.value[chosen], scalar_first=True)
    times = attitude.time[chosen]
    turns = [_turn(path, a, b) for a, b in pairwise(times)]
    error = np.stack([(G.inv() * A.inv() * B).as_rotvec() for A, B, G in zip(R, R[1:], turns)])
    w, change = np.stack([G.as_rotvec() for G in turns]), np.diff(path(times), axis=0)
    elapsed = np.diff(times)
    gyro_sigma = suite.sigmas("gyro")[0] * np.sqrt(elapsed * np.median(np.diff(gyro.time)))
    sigma = np.hypot(np.sqrt(2.0) * suite.sigmas("attitude").max(), gyro_sigma)
    sigma = np.hypot(sigma, _INTEGRATION * np.linalg.norm(w, axis=1).max())
    scale = np.repeat(1 / sigma, 3)
    bias = np.repeat(elapsed, 3)[:, None] * np.tile(np.eye(3), (len(elapsed), 1))
    causes = {
        "none": np.empty((bias.shape[0], 0)),
        "scale": -w.reshape(-1, 1),
        "late": change.reshape(-1, 1),
        "turned": skew(w).reshape(-1, 3),
    }
    fits = {}
    for name, columns in causes.items():
        A, b = np.hstack([columns, bias]) * scale[:, None], error.ravel() * scale
        x, *_ = np.linalg.lstsq(A, b, rcond=None)
        fits[name] = float(np.sqrt(np.mean((b - A @ x) ** 2))), x[: columns.shape[1]]
    before = fits.pop("none")[0]
    name = min(fits, key=lambda each: fits[each][0] * np.sqrt(len(fits[each][1])))
    misfit, x = fits[name]
    if not before > _CLEARLY * max(misfit, 1.0):
        return ""
    if name == "late":
        side = "late" if x[0] > 0 else "early"
        return f"the samples of the gyro are {1e3 * abs(x[0]):.3g} ms {side}"
    if name == "scale":
        return f"the gyro shows {1 + x[0]:.4g} times the angular velocity"
    return f"the gyro's axes are turned by {np.degrees(np.linalg.norm(x)):.2g} deg from the base's"


def _turn(path: CubicSpline, start: float, end: float) -> Rotation:
    """Return the turn from `start` to `end` at an angular velocity in the turning frame."""
    edges = np.linspace(start, end, max(int((end - start) / 0.01), 2) + 1)
    total = Rotation.identity()
    for step in Rotation.from_rotvec(path((edges[1:] + edges[:-1]) / 2) * np.diff(edges)[:, None]):
        total = total * step
    return total


def _is_rounded(value: NDArray[np.float64]) -> bool:
    """Return whether all changes of a value (N,) are multiples of the smallest one."""
    steps = np.abs(np.diff(value))
    units = steps / steps[steps > 0].min()
    return bool(np.abs(units - np.round(units)).max() < _WHOLE)


def _stuck(measurements: Measurements) -> str:
    """Return the cause if a sensor of the base keeps its value.

    Rounded values also stay the same while the base hardly moves. They do not count.
    """
    for name in ("position", "gyro", "attitude"):
        samples = measurements[name]
        for entry, value in enumerate(samples.value.T):
            changes = np.flatnonzero(np.diff(value))
            if changes.size < _FEW or _is_rounded(value):
                continue
            edges = np.concatenate([[-1], changes, [len(value) - 1]])
            longest = int(np.diff(edges).argmax())
            if np.diff(edges)[longest] > max(_FEW, _STUCK_SHARE * len(value)):
                column = SENSORS[name].columns[entry]
                return (
                    f"the {name} is stuck: {column} does not change after "
                    f"{samples.time[edges[longest] + 1]:.3g} s"
                )
    return ""
