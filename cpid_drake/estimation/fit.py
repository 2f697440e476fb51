"""The fit: maximum likelihood of all unknowns from all samples of one log or of many.

Levenberg-Marquardt on the sum of all logs' sweeps: target, hardware, momenta and forces, starts,
biases and joint motion move together. Samples that are far off weigh less, and each sensor has a
noise factor of 1 or more; both come from the residuals, once steps are small. A prior, or
another result, is one more Gaussian in the sum.

Sources: Nocedal and Wright 2006, ch. 10; Nielsen 1999 (damping); Huber 1964 (weights).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cpid_drake.errors import InputError
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.joints import DECLARED, FAR
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values, roll
from cpid_drake.estimation.start import start_of
from cpid_drake.estimation.sweep import Swept, back, sweep
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model, undetermined
from cpid_drake.estimation.whiteness import whiteness
from cpid_drake.sensors.sensors import SENSORS

CLOSE = 1e-2
"""The fit ends when a step would reduce χ² by less than this: a tenth of σ along one direction."""

SETTLED = 0.1
"""Weights and noise come from the residuals once a step reduces χ² by less than this share, or
by less than this for each residual: what values far from the minimum do not explain is no noise."""

MOST_SWEEPS = 30
"""The fit ends without an answer after so many sweeps."""

_SMALLEST_GAIN = 1e-3  # share of the expected fall of χ² for which a step is accepted
_REJECTED = 12  # steps in a row
_FIRST_DAMPING = 1.0  # information that a step is zero, as a share of the prior's


@dataclass(frozen=True, eq=False)
class Fit:
    """The values that explain all logs best, and how well they are known.

    Attributes:
        model: the unknowns.
        values: of all logs', the hardware's and the target's unknowns.
        logs: with the values of everything else.
        rolled: the logs, predicted at these values.
        gaussian: of x − values.
        cost: χ² of all rows.
        sweeps: number of linearizations.
        converged: whether no step would reduce χ² by more than `CLOSE`.

    """

    model: Model
    values: Values
    logs: list[LogState]
    rolled: list[Rolled]
    gaussian: Gaussian
    cost: float
    sweeps: int
    converged: bool


@dataclass(frozen=True, eq=False)
class _Point:
    """Values, and the sum of squares there."""

    values: Values
    logs: list[LogState]
    rolled: list[Rolled]
    cost: float


def fit(
    model: Model,
    logs: Sequence[LogState],
    *,
    rows: Sequence[Gaussian] = (),
    values: Values | None = None,
    progress: Callable[[str], object] = lambda step: None,
) -> Fit:
    """Fit all unknowns to all samples of some logs.

    Args:
        model: the unknowns and their priors.
        logs: of the same hardware and target; they get a start if they have none.
        rows: further information about unknowns, each by its values.
        values: of all unknowns, at which logs that have a start are continued; default: from
            linear least squares.
        progress: called before every sweep but the first with a description; if it returns False,
            the fit ends without having converged.

    Raises:
        InputError: no motion can be predicted for the start.

    """
    logs = list(logs)
    if values is None or any(log.start is None for log in logs):
        values, logs = start_of(model, logs, values)
    now = _point(model, logs, values, rows, values)
    damping, growth, converged, settled, sweeps = _FIRST_DAMPING, 2.0, False, False, 0
    total, swept = prior_of(model, logs, values, rows), list[Swept]()
    sigmas = {u.key(log.name): u.sigma for u in model.table for log in logs}
    while sweeps < MOST_SWEEPS and not converged:
        if sweeps and progress(f"fitting: sweep {sweeps + 1}, χ² {now.cost:.6g}") is False:
            break
        if settled:
            parts = zip(now.logs, now.rolled, swept, strict=True)
            now = replace(now, logs=[reweighted(model, log, r, s.absorbed) for log, r, s in parts])
            swept.clear()  # a long log has room for one sweep
        cost = _cost(model, now.logs, now.rolled, now.values, rows, now.values)
        now = replace(now, cost=cost)
        swept = [
            sweep(model, log, r, now.values) for log, r in zip(now.logs, now.rolled, strict=True)
        ]
        sweeps += 1
        total = prior_of(model, now.logs, now.values, rows)
        for each in swept:
            total = total.add(each.gaussian)
        sigma = np.concatenate([sigmas[name] for name in total.places])
        held = {PSI: undetermined(model, now.values[PSI], total)[0]}
        for _ in range(_REJECTED):
            step = total.solve(np.sqrt(damping) / sigma, held)
            fall = now.cost - total.cost(step)
            tried = _stepped(model, now, swept, total, step, rows)
            gain = -1.0 if tried is None else (now.cost - tried.cost) / max(fall, 1e-300)
            is_close = tried is not None and fall < CLOSE and tried.cost < now.cost + CLOSE
            if tried is not None and (gain > _SMALLEST_GAIN or is_close):
                break
            damping, growth = max(damping, 1e-6) * growth, 2 * growth
        else:
            break
        damping, growth = damping * max(0.1, 1 - (2 * float(np.clip(gain, 0, 1)) - 1) ** 3), 2.0
        damping = max(damping, 1e-12)
        left = now.cost - total.cost(total.solve(held=held))  # a damped step may be small anywhere
        converged = settled and left < CLOSE  # with weights that are those of the residuals
        settled = fall < SETTLED * max(now.cost, sum(r.count for r in now.rolled))
        now, total = tried, total.moved(step)
    return Fit(model, now.values, now.logs, now.rolled, total, now.cost, sweeps, converged)


def reweighted(model: Model, log: LogState, rolled: Rolled, absorbed: dict[str, float]) -> LogState:
    """Return a log with the weights and noise factors that its residuals show.

    Args:
        model: the unknowns.
        log: before.
        rolled: its prediction.
        absorbed: see `Swept`.

    """
    weights, noise = [dict(each) for each in log.weights], dict(log.noise)
    residuals = rolled.all_residuals()
    count = sum(rest.size for rest in residuals.values())
    free = 12 + 10 + 3 * len(model.gyros)
    for name, rest in residuals.items():
        w = weights_of(rest) if name in SENSORS else np.ones(len(rest))  # a force is no outlier
        near = rest[w == 1.0]  # what is far off says nothing about the noise
        tau = _correlation(near) if name in SENSORS else 1.0  # means of a force are smooth
        lost = free / count + absorbed.get(name, 0.0) / rest.size
        freedom = near.size * max(1 - lost, 0.1) / tau
        square = (DECLARED + float(np.sum(near**2)) / tau) / (DECLARED + freedom)
        noise[name] = max(1.0, float(np.sqrt(square * tau)))
        ends = np.cumsum([len(block[name]) for block in rolled.residuals if name in block])[:-1]
        parts = iter(np.split(w, ends))
        for k, block in enumerate(rolled.residuals):
            if name in block:
                weights[k][name] = next(parts)
    return replace(log, weights=tuple(weights), noise=noise)


def _correlation(rest: NDArray[np.float64]) -> float:
    """Return the correlation time of noise of which residuals, if they are small, are a part."""
    part = min(1.0, float(np.mean(rest**2))) if rest.size else 0.0
    return 1 + part * (whiteness(rest).correlation_time - 1)


def weights_of(rest: NDArray[np.float64], noise: float = 1.0) -> NDArray[np.float64]:
    """Return the weights (M,) that residuals (M, d) show; samples that are far off weigh less.

    Args:
        rest: in units of the declared σ.
        noise: factor of this σ.

    """
    size = np.sqrt(np.mean(rest**2, axis=1))
    return np.asarray(
        np.minimum(1.0, FAR * max(spread(rest), noise) / np.maximum(size, 1e-12)) ** 2
    )


def spread(rest: NDArray[np.float64]) -> float:
    """Return the σ of residuals (M, d), whatever less than half of them are; 0 without any."""
    square = np.sum(rest**2, axis=1)
    return float(np.sqrt(np.median(square) / chdtri(rest.shape[1], 0.5))) if len(square) else 0.0


def prior_of(
    model: Model,
    logs: Sequence[LogState],
    values: Values,
    rows: Sequence[Gaussian],
    weighed_at: Values | None = None,
) -> Gaussian:
    """Return what is known without samples, about the present values.

    Args:
        model, logs, values, rows: see `fit`.
        weighed_at: values from which priors with heavy tails get their weights, which stay during
            a step as those of the samples do; default: the present values.

    """
    weighed_at = values if weighed_at is None else weighed_at
    sizes, R, z = {}, [], []
    for unknown in model.table:
        if unknown.walk:  # its prior is that of its first value: in the sweep
            continue
        for name in dict.fromkeys(unknown.key(log.name) for log in logs):
            sizes[name], sigma = unknown.size, unknown.sigma
            if unknown.may_fail:
                sigma = sigma * np.maximum(1.0, np.abs(weighed_at[name]) / FAR)
            R.append(1 / sigma)
            z.append((unknown.mean - values[name]) / sigma)
    diagonal = np.concatenate([np.empty(0), *R])
    right = np.concatenate([np.empty(0), *z])
    prior = Gaussian.of_rows(sizes, np.column_stack([np.diag(diagonal), right]))
    for row in rows:
        prior = prior.add(row.moved(_joined(row, values)))
    return prior


def _cost(
    model: Model,
    logs: Sequence[LogState],
    rolled: Sequence[Rolled],
    values: Values,
    rows: Sequence[Gaussian],
    weighed_at: Values,
) -> float:
    """Return the sum of squares of all rows at the present values."""
    prior = prior_of(model, logs, values, rows, weighed_at)
    step = values[PSI] - weighed_at[PSI]
    samples = sum(r.cost(log, step) for log, r in zip(logs, rolled, strict=True))
    return samples + prior.cost(np.zeros(prior.size))


def _point(
    model: Model,
    logs: list[LogState],
    values: Values,
    rows: Sequence[Gaussian],
    weighed_at: Values,
) -> _Point:
    rolled = [roll(model, log, values) for log in logs]
    return _Point(values, logs, rolled, _cost(model, logs, rolled, values, rows, weighed_at))


def _stepped(
    model: Model,
    now: _Point,
    swept: Sequence[Swept],
    total: Gaussian,
    step: NDArray[np.float64],
    rows: Sequence[Gaussian],
) -> _Point | None:
    """Return the point after a step; None if no motion can be predicted there."""
    parts = {name: step[place] for name, place in total.places.items()}
    values = now.values | {name: now.values[name] + part for name, part in parts.items()}
    try:
        logs = [back(model, log, s, parts) for log, s in zip(now.logs, swept, strict=True)]
        for log in logs:
            assert log.start is not None
            values[f"{MOMENTUM}|{log.name}"] = np.concatenate([log.start.L, log.start.v_Wcm])
        point = _point(model, logs, values, rows, now.values)
    except (InputError, np.linalg.LinAlgError):
        return None
    return point if np.isfinite(point.cost) else None


def _joined(row: Gaussian, values: Values) -> NDArray[np.float64]:
    return np.concatenate([values[name] for name in row.places])
