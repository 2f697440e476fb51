"""The fit: maximum likelihood of all unknowns from all samples of one log or of many.

Levenberg-Marquardt on the sum of all logs' sweeps: target, hardware, momenta and forces, starts,
biases and joint motion move together. Samples that are far off weigh less, and each sensor has a
noise factor of 1 or more; both come from the residuals, once steps are small. A prior, or
another result, is one more Gaussian in the sum.

Sources: Nocedal and Wright 2006, ch. 10; Nielsen 1999 (damping); Huber 1964 (weights).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from cpid_drake.errors import InputError
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.joints import DECLARED, FAR
from cpid_drake.estimation.likelihood.constants import BIAS
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values, roll
from cpid_drake.estimation.start import start_of
from cpid_drake.estimation.sweep import Swept, back, sweep
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model, undetermined
from cpid_drake.estimation.whiteness import MOST_CORRELATED
from cpid_drake.sensors.sensors import SENSORS

CLOSE = 1e-2
"""The fit ends when a step would reduce χ² by less than this: a tenth of σ along one direction."""

SETTLED = 0.1
"""Weights and noise come from the residuals once a step reduces χ² by less than this share, or
by less than this for each residual: what values far from the minimum do not explain is no noise.
`about` needs no step with a smaller χ²."""

MOST_SWEEPS = 30
"""The fit ends without an answer after so many sweeps."""

MOST_LOST = 0.9
"""Share of a sensor's residuals that unknowns absorb at most: else none would show the noise."""

_REJECTED = 12  # steps in a row


@dataclass(frozen=True, eq=False)
class Fit:
    """The values that explain all logs best, and how well they are known.

    Attributes:
        model: the unknowns.
        values: of all logs', the hardware's and the target's unknowns.
        logs: with the values of everything else.
        rolled: the logs, predicted at these values.
        gaussian: of x − values.
        swept: the logs, linearized about these values, if a step from there may follow.
        cost: χ² of all rows.
        sweeps: number of linearizations.
        converged: whether no step would reduce χ² by more than `CLOSE`.

    """

    model: Model
    values: Values
    logs: list[LogState]
    rolled: list[Rolled]
    gaussian: Gaussian
    swept: list[Swept] = field(default_factory=list)
    cost: float = 0.0
    sweeps: int = 0
    converged: bool = False


def fit(
    model: Model,
    logs: Sequence[LogState],
    *,
    values: Values | None = None,
    progress: Callable[[str], object] = lambda step: None,
) -> Fit:
    """Fit all unknowns to all samples of some logs.

    Args:
        model: the unknowns and their priors.
        logs: of the same hardware and target; they get a start if they have none.
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
    rolled = [roll(model, log, values) for log in logs]
    now = Fit(model, values, logs, rolled, prior_of(model, logs, values))
    # What walks has its place between one block and the next, as joints have: it is not damped.
    pulls = {
        u.key(log.name): 0 * u.sigma if u.walk else 1 / u.sigma for u in model.table for log in logs
    }
    damping, growth, settled = 1.0, 2.0, False
    while now.sweeps < MOST_SWEEPS:
        text = f"fitting: sweep {now.sweeps + 1}, χ² {now.cost:.6g}"
        if now.sweeps and progress(text) is False:
            break
        now = replace(_linear(now), cost=_cost(now, now.values), sweeps=now.sweeps + 1)
        total, cost = now.gaussian, now.cost
        held = {PSI: undetermined(model, now.values[PSI], total)[0]}
        if settled and cost - total.cost(total.solve(held=held)) < CLOSE:
            return replace(now, converged=True)  # with weights that are those of the residuals
        pull = np.concatenate([pulls[name] for name in total.places])
        for _ in range(_REJECTED):
            step = total.solve(np.sqrt(damping) * pull, held)
            fall, tried = cost - total.cost(step), _stepped(now, step)
            gain = -1.0 if tried is None else (cost - tried.cost) / max(fall, 1e-300)
            is_close = tried is not None and fall < CLOSE and tried.cost < cost + CLOSE
            if tried is not None and (gain > 0 or is_close):
                break
            damping, growth = max(damping, 1e-6) * growth, 2 * growth
        else:
            break
        damping, growth = damping * max(0.1, 1 - (2 * float(np.clip(gain, 0, 1)) - 1) ** 3), 2.0
        damping, logs = max(damping, 1e-12), tried.logs
        settled = fall < SETTLED * max(cost, sum(r.count for r in tried.rolled))
        if settled:
            absorbed = [each.absorbed for each in now.swept]
            logs = [
                reweighted(model, *parts)
                for parts in zip(logs, tried.rolled, absorbed, strict=True)
            ]
        now = replace(tried, logs=logs)
    return now


def about(found: Fit, held: Values) -> Fit:
    """Return a fit, linear about the values that are best if some unknowns have given values.

    Where a motion is not seen, what depends on its size seems to be known at values that only noise
    makes.

    Args:
        found: a fit.
        held: the given values, less those of the fit.

    """
    now, held = found, dict(held)
    for _ in range(MOST_SWEEPS):
        total, rest = now.gaussian, now.gaussian.condition(held)
        psi, step = undetermined(now.model, now.values[PSI], rest)[0], np.zeros(total.size)
        step[total.indices(rest.places)] = rest.solve(held={PSI: psi})
        for name, value in held.items():
            step[total.places[name]] = value
        if np.sum((total.R @ step) ** 2) < SETTLED:  # linear within a third of σ
            return replace(now, swept=[])
        moved = _stepped(now if now.swept else _linear(now), step)
        if moved is None:
            break
        now = _linear(moved, forward_only=True)
        held = dict.fromkeys(held, np.zeros(1))
    return replace(found, converged=False)


def _linear(now: Fit, *, forward_only: bool = False) -> Fit:
    """Return a fit with the Gaussian about its values; no step can follow if it is forward only."""
    swept = [
        sweep(now.model, *parts, now.values, forward_only=forward_only)
        for parts in zip(now.logs, now.rolled, strict=True)
    ]
    prior = prior_of(now.model, now.logs, now.values)
    total = reduce(Gaussian.add, [each.gaussian for each in swept], prior)
    return replace(now, gaussian=total, swept=[] if forward_only else swept)


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
    sampled = {f"{name}.{BIAS}" for name in residuals}
    biases = sum(each.size for each in model.table if each.name in sampled)
    free = 12 + 10 + biases
    for name, rest in residuals.items():
        w = weights_of(rest) if name in SENSORS else np.ones(len(rest))  # a force is no outlier
        near = rest[w == 1.0]  # what is far off says nothing about the noise
        lost = min(free / count + absorbed.get(name, 0.0) / rest.size, MOST_LOST)
        time = _correlation_time(near, lost) if name in SENSORS else 1.0  # means of a force: smooth
        freedom = near.size * (1 - lost) / time
        square = (DECLARED + float(np.sum(near**2))) / (DECLARED + freedom)
        noise[name] = max(1.0, float(np.sqrt(square)))
        ends = np.cumsum([len(block[name]) for block in rolled.residuals if name in block])[:-1]
        parts = iter(np.split(w, ends))
        for k, block in enumerate(rolled.residuals):
            if name in block:
                weights[k][name] = next(parts)
    return replace(log, weights=tuple(weights), noise=noise)


def _correlation_time(rest: NDArray[np.float64], lost: float) -> float:
    """Return (1 + ρ)/(1 − ρ), how much stronger first-order Gauss-Markov noise is if it is slow.

    The motion is slow, too: of white noise, it takes the lowest frequencies, the share that is
    `lost`, and leaves residuals whose neighbours have the correlation −sin(π lost)/π/(1 − lost).
    The covariance beyond that is ρ times the noise's variance, of which 1 − lost is in residuals.
    """
    if len(rest) < 2 or not rest.any():
        return 1.0
    seen = np.mean(rest[1:] * rest[:-1]) / np.mean(rest**2)
    of_white = -np.sin(np.pi * lost) / np.pi / (1 - lost)
    rho = np.clip((1 - lost) * (seen - of_white), 0.0, MOST_CORRELATED)  # more is no noise
    return float((1 + rho) / (1 - rho))


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
    weighed_at: Values | None = None,
) -> Gaussian:
    """Return what is known without samples, about the present values.

    Args:
        model, logs, values: see `fit`.
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
    for row in model.rows:
        prior = prior.add(row.moved(np.concatenate([values[name] for name in row.places])))
    return prior


def _cost(found: Fit, weighed_at: Values) -> float:
    """Return the sum of squares of all rows at the values of a fit."""
    prior = prior_of(found.model, found.logs, found.values, weighed_at)
    values = found.values
    step = {} if weighed_at is values else {n: value - weighed_at[n] for n, value in values.items()}
    samples = sum(r.cost(log, step) for log, r in zip(found.logs, found.rolled, strict=True))
    return samples + prior.cost(np.zeros(prior.size))


def _stepped(now: Fit, step: NDArray[np.float64]) -> Fit | None:
    """Return the fit after a step; None if no motion can be predicted there."""
    model, parts = now.model, {name: step[place] for name, place in now.gaussian.places.items()}
    values = now.values | {name: now.values[name] + part for name, part in parts.items()}
    try:
        logs = [back(model, log, s, parts) for log, s in zip(now.logs, now.swept, strict=True)]
        for log in logs:
            assert log.start is not None
            values[f"{MOMENTUM}|{log.name}"] = np.concatenate([log.start.L, log.start.v_Wcm])
        rolled = [roll(model, log, values) for log in logs]
    except (InputError, np.linalg.LinAlgError):
        return None
    total = now.gaussian.moved(step)
    there = replace(now, values=values, logs=logs, rolled=rolled, gaussian=total, swept=[])
    cost = _cost(there, now.values)
    return replace(there, cost=cost) if np.isfinite(cost) else None
