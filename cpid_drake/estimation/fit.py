"""The fit: maximum likelihood of all unknowns from all samples of one log or of many.

Gauss-Newton steps on the sum of all logs' sweeps: target, hardware, momenta and forces, starts,
biases and joint motion move together, and the target stays inside of its cone. A share of a step is
taken if χ² would not fall by all of it. Samples that are far off weigh less; the noise of each
sensor comes from the evidence of the residuals once steps are small. Before, the samples
are no more precise beside the hardware's priors than their residuals are small: else errors of the
hardware would explain, by thousands of their σ, what is wrong with the start. A prior, or another
result, is one more Gaussian in the sum.

Source: Nocedal and Wright 2006, ch. 10.3 (Gauss-Newton) and 17.3 (closed ends).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import Gaussian, indices_of
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.roll import Rolled, Values, roll
from cpid_drake.estimation.start import start_of
from cpid_drake.estimation.sweep import Swept, back, sweep
from cpid_drake.estimation.target import LOG_SIZE, TargetCone
from cpid_drake.estimation.unknowns import MOMENTUM, PSI, Model
from cpid_drake.estimation.unknowns_prior import hardware_prior_of
from cpid_drake.estimation.unknowns_prior import prior_of as prior_of
from cpid_drake.estimation.weights import are_same, reweighted
from cpid_drake.files.errors import InputError

CLOSE = 1e-2
"""The fit ends with a step that changes all that outlives a block by less than this, squared, in σ,
or whose χ² differs by less from that of a linear fit: a tenth of σ along one direction."""

NEAR = 1e-3
"""The noise comes from the residuals once no larger share of their squares than this is left to
explain: what values far from the minimum do not explain is no noise."""

LINEAR = 0.1
"""`about` needs no step with a smaller χ²: a third of σ. Nor does a fit of which no share of a step
reduces χ², or that has errors of first order: these have no derivatives by other unknowns."""

BENT, MOST_KEPT = 3e-4, 100.0
"""Derivatives stay after a step if χ² differs from that of a linear fit by less than this share of
the step, squared, in σ, and the step is not larger: they are wrong by a share of √BENT of it."""

GOOD, POOR = 0.75, 0.25
"""The share of a step that is taken doubles, up to all of it, if it reduces χ² by more than this
part of what a linear fit predicts, and is halved if by less."""

HALF = 0.5
"""So much of derivatives by loads is made anew once χ² does not fall: the loads follow the motion
that is fitted with them, and by all of it two states would take turns."""

MOST_SWEEPS = 30
"""The fit ends after so many sweeps, and has not converged."""

_REJECTED = 12  # steps in a row


@dataclass(frozen=True, eq=False)
class Fit:
    """The values that explain all logs best, and how well they are known.

    Attributes:
        model: the unknowns.
        values: of all logs', the hardware's and the target's unknowns.
        logs: with the values of everything else.
        rolled: the logs, predicted at these values.
        linear_posterior: of x − values, without the target's prior, which is not linear.
        swept: the logs, linearized about these values, if a step from there may follow.
        ends: of each log: what is known at its end, as `Swept.end`, linear since the last step.
        cost: χ² of all rows.
        sweeps: number of linearizations.
        converged: whether no step would change anything by more than `CLOSE` says.
        misfit: size of the residuals in σ, by which the hardware's priors weigh more; 1 at the end.

    """

    model: Model
    values: Values
    logs: list[LogState]
    rolled: list[Rolled]
    linear_posterior: Gaussian
    swept: list[Swept] = field(default_factory=list)
    ends: list[Gaussian] = field(default_factory=list)
    cost: float = 0.0
    sweeps: int = 0
    converged: bool = False
    misfit: float = 1.0

    @cached_property
    def posterior(self) -> Gaussian:
        """Of x − values; the target's prior is linear about them."""
        return self.linear_posterior.add(self.model.cone.prior(PSI, self.values[PSI]))


def fit(
    model: Model,
    logs: Sequence[LogState],
    *,
    values: Values | None = None,
    before: Rolled | None = None,
    progress: Callable[[str], object] = lambda step: None,
    most: int = MOST_SWEEPS,
) -> Fit:
    """Fit all unknowns to all samples of some logs.

    Args:
        model: the unknowns and their priors.
        logs: of the same target.
        values: of all unknowns; logs with a start are continued there. Default: from the samples.
        before: a prediction of some blocks of the one log at these values; see `roll`.
        progress: called before every sweep but the first with a description; if it returns False,
            the fit ends without having converged.
        most: so does it after so many sweeps.

    Raises:
        InputError: no motion can be predicted for the start.

    """
    logs = list(logs)
    if values is None or not all(log.starts for log in logs):
        values, logs = start_of(model, logs, values)
    rolled = [roll(model, log, values, before) for log in logs]
    now = Fit(model, values, logs, rolled, hardware_prior_of(model, logs, values))
    is_near = all(log.noise.is_estimated for log in logs)
    # What is left of a step of one block stays in the next past.
    is_rough = any(len(model.of_log(log.name).constants.first_order) for log in logs)
    close = LINEAR if _is_one(now) or is_rough else CLOSE
    return _best(now if is_near else _reweighted(now), progress, close=close, most=most)


def about(fitted: Fit, held: Values) -> Fit:
    """Return a fit, linear about the values that are best if some unknowns have given values.

    Where a motion is not seen, what depends on its size seems to be known at values that only noise
    makes.

    Args:
        fitted: a fit.
        held: the given values, less those of the fit.

    """
    step = _Step.of(fitted, held)
    if step.square < LINEAR or not fitted.converged:  # else it has no best values to go to
        return replace(fitted, swept=[])
    now = fitted if fitted.swept else _swept(fitted, HALF)
    moved, none = step.taken(now, 1.0), {name: 0.0 * value for name, value in held.items()}
    if moved is None:
        return replace(fitted, converged=False)
    best = _best(replace(moved, sweeps=0), held=none, close=LINEAR)
    converged = fitted.converged and best.converged
    return replace(best, swept=[], sweeps=fitted.sweeps, converged=converged)


def _best(
    now: Fit,
    progress: Callable[[str], object] = lambda step: None,
    held: Values | None = None,
    close: float = CLOSE,
    most: int = MOST_SWEEPS,
) -> Fit:
    """Return the best fit near one; its weights follow the residuals if nothing is held.

    Near the best values, the noise does so, too; and with both estimated, the fit ends.
    """
    share, misfit, is_one, renewal, last = 1.0, np.inf, _is_one(now), 1.0, np.inf
    is_near = held is not None or all(log.noise.is_estimated for log in now.logs)
    while now.sweeps < most:
        text = f"fitting: sweep {now.sweeps + 1}, χ² {now.cost:.6g}"
        if now.sweeps and progress(text) is False:
            break
        misfit = 1.0 if is_near else min(misfit, _misfit(now))
        now = replace(now, misfit=misfit, sweeps=now.sweeps + 1)
        now = _swept(now, renewal)
        step = _Step.of(now, held)
        renewal = renewal if step.before < last else HALF
        last = step.before
        is_close = step.square < close
        for _ in range(_REJECTED):
            moved = step.taken(now, share)
            gain = -1.0 if moved is None else (step.before - moved.cost) / step.fall(share)
            share = share if is_close else _next(share, gain)
            if moved is not None and (gain > 0 or is_close):
                break
        else:  # errors of the derivatives, if it is so small
            ends = [each.end for each in now.swept]
            return replace(now, ends=ends, converged=is_near and step.square < LINEAR)
        excess = moved.cost - step.least
        if is_one or _is_linear(step.square, excess):
            for rolled, after in zip(now.rolled, moved.rolled, strict=True):
                after.take_derivatives(rolled)
        has_noise = held is not None or all(log.noise.is_estimated for log in moved.logs)
        if is_near and has_noise and is_close:
            return replace(moved, converged=True)
        before = moved.logs
        if held is None:
            left = excess if misfit == 1.0 else step.fall(1.0)  # priors will weigh less
            is_near = left < NEAR * misfit**2 * sum(r.count for r in moved.rolled)
            moved = _reweighted(moved, [each.absorbed for each in now.swept] if is_near else None)
        is_linear = is_near and misfit == 1.0 and abs(excess) < close
        if is_linear and are_same(before, moved.logs):
            return replace(moved, converged=True)
        now = moved
    return now


def _is_linear(square: float, excess: float) -> bool:
    """Return whether derivatives before a step hold after it: χ² is as a linear fit predicts."""
    return abs(excess) < BENT * max(square, 1.0) and square < MOST_KEPT


def _is_one(now: Fit) -> bool:
    """Return whether it is of one block behind a past; see `following`."""
    [log, *others] = now.logs
    return log.past is not None and len(log.blocks) == 1 and not others


def _misfit(now: Fit) -> float:
    """Return the root mean square of all residuals in σ, or 1."""
    parts = list(zip(now.rolled, now.logs, strict=True))
    squares = sum(rolled.cost_inside(log) for rolled, log in parts)
    return float(np.sqrt(max(1.0, squares / max(sum(r.count for r, _ in parts), 1))))


def _weighed(prior: Gaussian, factor: float) -> Gaussian:
    """Return a prior whose σ are smaller by a factor."""
    # σ / factor
    return replace(prior, R=factor * prior.R, z=factor * prior.z, rho2=factor**2 * prior.rho2)


def _reweighted(now: Fit, absorbed: Sequence[dict[str, float]] | None = None) -> Fit:
    """Return a fit with weights of its residuals, and their noise if it is known what is lost."""
    lost = absorbed or len(now.logs) * (None,)
    parts = zip(now.logs, now.rolled, lost, strict=True)
    logs = [reweighted(now.model, log, rolled, now.values, by) for log, rolled, by in parts]
    return replace(now, logs=logs)


@dataclass(frozen=True, eq=False)
class _Step:
    """The step that a linear fit proposes; shares of it are tried.

    Attributes:
        step: (n,) of all unknowns that outlive a block.
        square: sum of its squares in σ of what is known.
        before: χ² before the step, with the pulls of closed ends that belong to it.
        least: χ² after the whole step, if all were linear but the target's prior.
        cone: the possible targets.
        psi, psi_step: (10,) the target before the step, and its step.
        logs: after the whole step; empty if they were not swept.

    """

    step: Array
    square: float
    before: float
    least: float
    cone: TargetCone
    psi: Array
    psi_step: Array
    logs: list[LogState]

    def fall(self, share: float) -> float:
        """Return by how much a share of the step should reduce χ².

        Along the step, χ² of the rows is quadratic, that of the target's prior is not; together
        they are least at its end.
        """
        (first, _), (now, _), (last, slope) = (self._prior(part) for part in (0.0, share, 1.0))
        # A quadratic q with q(0) − q(1) = f and q'(1) = −p'(1), p the prior, falls by
        # q(0) − q(s) = s(2 − s) f − s(1 − s) p'(1).
        rows = self.before - first - (self.least - last)
        of_rows = share * (2 - share) * rows - share * (1 - share) * slope
        return max(of_rows + first - now, 1e-300)

    def _prior(self, share: float) -> tuple[float, float]:
        """Return χ² of the target's prior after a share of the step, and its derivative."""
        xi, by = self.cone.log_size(self.psi + share * self.psi_step)
        xi, by = xi / LOG_SIZE, by / LOG_SIZE
        return float(xi @ xi), float(2 * xi @ by @ self.psi_step)

    @classmethod
    def of(cls, now: Fit, held: Values | None) -> "_Step":
        """Return the best step; some unknowns may have given steps."""
        step, least = _best_step(now, held or {})
        # |R step|²
        square, before = float(np.sum((now.posterior.R @ step) ** 2)), np.inf
        logs = _after(now, step) if now.swept else []
        if logs:
            pulled = [_pulled(*each) for each in zip(now.logs, logs, strict=True)]
            before = _cost(now, pulled, now.values)
        psi_step = step[now.posterior.places[PSI]]
        return cls(step, square, before, least, now.model.cone, now.values[PSI], psi_step, logs)

    def taken(self, now: Fit, share: float) -> Fit | None:
        """Return the fit after a share of the step; None if no motion can be predicted there."""
        logs = self.logs if self.logs and share == 1 else _after(now, self.step, share)
        moved = _moved(now, share * self.step, logs)
        if moved is None:
            return None
        parts = {name: self.step[place] for name, place in now.posterior.places.items()}
        ends = [each.end.minus(share * each.step(parts)) for each in now.swept]
        return replace(moved, ends=ends)


def _pulled(log: LogState, after: LogState) -> LogState:
    """Return a log with the pulls of closed ends after a step."""
    pairs = zip(log.links, after.links, strict=True)
    return log.with_links(replace(link, pull=each.pull) for link, each in pairs)


def _next(share: float, gain: float) -> float:
    """Return the share of the next step."""
    if gain > GOOD:
        return min(2 * share, 1.0)
    return share / 2 if gain < POOR else share


def _swept(now: Fit, renewal: float) -> Fit:
    """Return a fit with the Gaussian about its values; see `Rolled.renewed`."""
    model, values, pairs = now.model, now.values, zip(now.logs, now.rolled, strict=True)
    parts = [(log, rolled.renewed(model, log, values, renewal)) for log, rolled in pairs]
    swept = [sweep(model, log, rolled, values) for log, rolled in parts]
    prior = _weighed(hardware_prior_of(model, now.logs, now.values), now.misfit)
    linear_posterior = reduce(Gaussian.add, [each.gaussian for each in swept], prior)
    return replace(
        now, rolled=[rolled for _, rolled in parts], linear_posterior=linear_posterior, swept=swept
    )


def _cost(now: Fit, logs: Sequence[LogState], weighed_at: Values) -> float:
    """Return the sum of squares of all rows at the values of a fit; see `links.link_cost`."""
    model, values = now.model, now.values
    hardware = _weighed(hardware_prior_of(model, now.logs, values, weighed_at), now.misfit)
    sizes = model.cone.prior(PSI, values[PSI])
    step = {} if weighed_at is values else {n: value - weighed_at[n] for n, value in values.items()}
    parts = zip(logs, now.rolled, strict=True)
    samples = sum(r.cost(model, log, step) for log, r in parts)
    priors = hardware.cost(np.zeros(hardware.size)) + sizes.cost(np.zeros(sizes.size))
    return samples + priors


def _best_step(now: Fit, held: Values) -> tuple[Array, float]:
    """Return the best step (n,) of a linear fit, and its χ²; some unknowns may have given steps.

    The samples are linear in ψ, its prior is linear in log-sizes, and the target stays inside of
    the cone: all other unknowns are eliminated, and ten nonlinear ones remain.
    """
    cone, psi, gaussian = now.model.cone, now.values[PSI], now.linear_posterior
    free, step, steps = gaussian.condition(held), np.zeros(gaussian.size), dict(held)
    # ψ = argmin |R ψ − z|² + |ξ₀(ψ)/σ|², the others eliminated; then these for this ψ
    steps[PSI] = cone.most_probable(free.marginal([PSI]).minus(-psi)) - psi
    others = free.condition({PSI: steps[PSI]})
    step[indices_of(gaussian.places, others.places)] = others.solve()
    for name, value in steps.items():
        step[gaussian.places[name]] = value
    prior = cone.log_size(psi + steps[PSI])[0] / LOG_SIZE
    return step, gaussian.cost(step) + float(prior @ prior)


def _after(now: Fit, step: Array, share: float = 1.0) -> list[LogState]:
    """Return the logs after a share of a step."""
    parts = {name: step[place] for name, place in now.posterior.places.items()}
    return [
        back(now.model, log, s, parts, share) for log, s in zip(now.logs, now.swept, strict=True)
    ]


def _moved(now: Fit, step: Array, logs: Sequence[LogState]) -> Fit | None:
    """Return the fit after a step; None if no motion can be predicted there."""
    steps = {n: now.values[n] + step[place] for n, place in now.posterior.places.items()}
    values = now.values | steps
    for log in logs:
        first = log.starts[0]
        if log.past is None:
            values[f"{MOMENTUM}|{log.name}"] = np.concatenate([first.L, first.v_Wcm])
    try:
        pairs = zip(logs, now.rolled, strict=True)
        rolled = [roll(now.model, log, values, near=near) for log, near in pairs]
    except (InputError, np.linalg.LinAlgError):
        return None
    about = now.linear_posterior.minus(step)
    moved = replace(
        now, values=values, logs=list(logs), rolled=rolled, linear_posterior=about, swept=[]
    )
    cost = _cost(moved, logs, now.values)
    return replace(moved, cost=cost) if np.isfinite(cost) else None
