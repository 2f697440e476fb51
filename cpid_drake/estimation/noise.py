"""The noise of each sensor, of the largest evidence of all samples of a log.

The evidence of a process is that of the linear fit: all unknowns are integrated, so that what they
absorb of the noise is no loss (Patterson and Thompson 1971, likelihood of residuals). One sweep
gives it: it is the χ² of the fit, and the determinants of what is eliminated. Where it is the
largest is sought from a guess that residuals alone give. The noise changes only if its evidence
grows, so that there is a fixed point.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block_rows import BlockRows
from cpid_drake.estimation.least_squares import updated_information
from cpid_drake.estimation.likelihood.model import SLOW
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.unknowns_prior import prior_of
from cpid_drake.estimation.process import DECLARED, Process, proxy
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.sweep import (
    change_at_end,
    changed,
    derivatives,
    eliminated,
    known_at_start,
)
from cpid_drake.estimation.unknowns import Model
from cpid_drake.sensors.sensors import SENSORS

TAUS = 0.02 * 3.0 ** np.arange(7)
"""Times of slow noise that are tried first [s]."""

RATIOS = np.array([0.1, 1.0, 10.0, 100.0])
"""Variances of slow noise that are tried first, in units of that of the white noise."""

WORTH = 12.0
"""−2 log(evidence) that noise which is not as declared must gain."""

LEAST = 1e-3, 1e-4, 0.005
MOST = 1e4, 1e4, 100.0
"""Limits of variances and of time [s]."""

SAME = 0.3
"""Gain of −2 log(evidence) that does not matter."""

FEWEST = 20
"""Residuals that show no more than declared noise."""

STEPS, FARTHEST, FLATTEST, RIDGE = 4, 1.5, 2.0, 3.0
"""Newton steps to the largest evidence, the longest of one parameter's log, the smallest curvature,
and the factor of times that are tried before."""


def with_processes(model: Model, log: LogState, rolled: Rolled, values: Values) -> LogState:
    """Return a log with the noise of its sensors that its samples show.

    Args:
        model: the unknowns.
        log: a log.
        rolled: its prediction at the values.
        values: of all unknowns.

    """
    if log.is_known:
        return log
    guesses, before = dict[str, tuple[float, Process]](), log.processes
    for name in [n for n in rolled.all_residuals() if n in SENSORS]:
        series = _Series.of(log, rolled, name)
        now = log.processes.get(name)
        if now is not None:
            guesses[name] = np.inf, now
        elif (guess := series.guess()) is not None:
            guesses[name] = guess
    for name, (_, guess) in sorted(guesses.items(), key=lambda each: -each[1][0]):
        series = _Series.of(log, rolled, name)
        evidence = Evidence(model, log, rolled, values, name, guess.channels)
        found = _best(evidence, series, log.processes.get(name, DECLARED), guess)
        processes = {n: p for n, p in log.processes.items() if n != name}
        if found != DECLARED:
            processes[name] = found
        log = log.with_processes(dict(sorted(processes.items())))
    return replace(log, is_known=are_near(before, log.processes))


@dataclass(frozen=True, eq=False)
class _Series:
    """Residuals of a sensor that are not far off: what they show if unknowns are exact."""

    times: Array
    rest: Array

    @classmethod
    def of(cls, log: LogState, rolled: Rolled, name: str) -> "_Series":
        times, rest = [], []
        for k, block in enumerate(rolled.residuals):
            if name in block:
                near = log.weights[k].get(name, np.ones(len(block[name]))) == 1.0
                times.append(log.blocks[k].samples[name].time[near])
                rest.append(block[name][near])
        return cls(np.concatenate(times), np.concatenate(rest))

    def value(self, process: Process) -> float:
        """Return −2 log(likelihood)."""
        return proxy(self.times, self.rest, process)

    def guess(self) -> tuple[float, Process] | None:
        """Return the gain of the best process of a grid, and the process; None if small."""
        size, d = self.rest.size, self.rest.shape[1]
        if size < FEWEST:
            return None
        square = float(np.mean(self.rest**2))
        declared, best = self.value(DECLARED), Process(max(square, 1.0), channels=d)
        least = self.value(best)
        for tau in TAUS:
            for ratio in RATIOS:
                white = square / (1 + ratio)
                each = Process(white, ratio * white, float(tau), d)
                value = self.value(each)
                if value < least - (0.0 if best.slow else WORTH / 2):
                    best, least = each, value
        gain = declared - least
        return (gain, best) if gain > WORTH / 2 else None

    def curvature(self, make: Callable[[Array], Process], x: Array) -> Array:
        """Return the second derivatives of −2 log(likelihood) by parameters x, made positive."""
        h, n = 0.2, len(x)
        step = h * np.eye(n)
        at = lambda x: self.value(make(x))
        middle, up = at(x), [at(x + e) for e in step]
        H = np.empty((n, n))
        for i in range(n):
            H[i, i] = (up[i] + at(x - step[i]) - 2 * middle) / h**2
            for j in range(i):
                H[i, j] = H[j, i] = (at(x + step[i] + step[j]) - up[i] - up[j] + middle) / h**2
        w, V = np.linalg.eigh(H)
        return np.asarray(V * np.maximum(np.abs(w), FLATTEST) @ V.T)


def _best(evidence: "Evidence", series: _Series, now: Process, guess: Process) -> Process:
    """Return the process with the largest evidence near a guess, or one that is as good."""
    d, before = guess.channels, evidence(now)
    if guess.slow:  # v/τ, the intensity of what is slow, is known better than both
        x = np.log([guess.white, guess.slow / guess.tau, guess.tau])
        least, most = np.log([LEAST[0], 1e-9, LEAST[2]]), np.log([MOST[0], 1e9, MOST[2]])
    else:
        x, least, most = np.array([np.log(guess.white)]), np.zeros(1), np.log(MOST[:1])

    def make(x: Array) -> Process:
        white, *slow = np.exp(np.clip(x, least, most)).tolist()
        if not slow:
            return Process(white, channels=d)
        return Process(white, slow[0] * slow[1], slow[1], d)

    value = before if guess == now else evidence(make(x))
    for factor in (1 / RIDGE, RIDGE) if guess.slow else ():  # along the ridge
        while (tried := evidence(make(there := x + [0, 0, np.log(factor)]))) < value:
            x, value = there, tried
    for _ in range(STEPS):
        H = series.curvature(make, x)
        h = 0.2 * np.eye(len(x))
        slope = np.array([evidence(make(x + e)) - value for e in h]) / 0.2 - 0.1 * np.diag(H)
        step = -np.linalg.solve(H, slope)
        if -0.5 * float(slope @ step) < SAME:
            break
        step *= min(1.0, FARTHEST / float(np.max(np.abs(step))))
        for share in (1.0, 0.3):
            there = np.clip(x + share * step, least, most)
            tried = evidence(make(there))
            if tried < value:
                break
        else:
            break
        gain, x, value = value - tried, there, tried
        if gain < SAME:
            break
    found = make(x)
    if found.slow and not now.slow:  # white noise that is smaller is as declared
        smaller = (Process(white, channels=d) for white in (found.white, found.total))
        if value > min(map(evidence, smaller)) - WORTH:
            return now
    costs = {now: before + _price(now), found: value + _price(found)}
    if found.slow and now.slow:
        for simple in (DECLARED, Process(max(found.white, 1.0), channels=d)):
            costs[simple] = evidence(simple) + _price(simple)
    best = min(costs, key=lambda each: costs[each])
    return now if costs[now] < costs[best] + SAME else best


def _price(process: Process) -> float:
    """Return what −2 log(evidence) must gain for a process that is not as declared."""
    return (WORTH if process.slow else WORTH / 2) if process.white != 1 or process.slow else 0.0


def _odds(process: Process) -> float:
    """Return −2 log(prior) of slow noise: a few σ, in a few seconds or tenths of one."""
    if not process.slow:
        return 0.0
    return float(np.log([process.slow, process.tau]) @ np.log([process.slow, process.tau])) / 4


class Evidence:
    """−2 log(evidence) of the noise of one sensor of a log; see `with_processes`.

    Args:
        model, log, rolled, values: see `with_processes`.
        name: of the sensor.
        channels: number of entries of its samples.

    """

    def __init__(
        self,
        model: Model,
        log: LogState,
        rolled: Rolled,
        values: Values,
        name: str,
        channels: int,
    ) -> None:
        self._model, self._log, self._rolled, self._values = model, log, rolled, values
        self._name, self._channels, self.calls = name, channels, 0
        self._prior = prior_of(model, [log], values)
        self._layouts = dict[bool, list[tuple[BlockRows, Array]]]()

    def _layout(self, log: LogState) -> list[tuple[BlockRows, Array]]:
        """Return the rows of all blocks but those of the sensor, and those."""
        found, name, rolled = [], self._name, self._rolled
        for k, linear in enumerate(derivatives(self._model, log, rolled, self._values)):
            part = rolled.models[k].with_slow(log.slow_size)
            rest, (J, end) = rolled.residuals[k], linear
            sizes = [each.size for each in rest.values()]
            first = sum(sizes[: list(rest).index(name)]) if name in rest else 0
            own = slice(first, first + (rest[name].size if name in rest else 0))
            whitening = log.whitenings(k, rest)
            others = {n: each for n, each in whitening.items() if n != name}
            left = {n: each for n, each in rest.items() if n != name}
            linear = np.delete(J, own, axis=0), end
            rows = BlockRows.of(part, linear, left, others, log.slow, log.slow_at(k))
            raw = np.zeros((own.stop - own.start, len(rows.order) + 1))
            raw[:, np.argsort(rows.order)[part.without_slow]] = J[own]
            if name in rest:
                raw[:, -1] = rest[name].ravel()
            found.append((rows, raw.reshape(-1, self._channels, raw.shape[1])))
        return found

    def __call__(self, process: Process) -> float:
        """Return −2 log(evidence), up to a constant."""
        self.calls += 1
        name, model = self._name, self._model.of_log(self._log.name)
        log = self._log.with_processes({**self._log.processes, name: process})
        key = bool(process.slow)
        if key not in self._layouts:
            self._layouts[key] = self._layout(log)
        known, volume = known_at_start(model, log, self._values), 0.0
        if log.past is None:
            volume += 2 * float(np.sum(np.log(log.slow_sigma)))
        place = log.slow.get(name)
        for k, (others, raw) in enumerate(self._layouts[key]):
            part = self._rolled.models[k].with_slow(log.slow_size)
            white = log.whitening(k, name, len(raw))
            z, slow = white(raw), log.slow_at(k)
            if place is not None:
                columns = np.argsort(others.order)[part.columns[SLOW]].reshape(2, -1)
                for i, j in enumerate(range(place.start, place.stop)):
                    z[:, i, columns[:, j]] -= white.edges
                z[:, :, -1] += white.edges @ slow[:, place]
            rows = np.asfortranarray(z.reshape(-1, z.shape[2]))
            own = replace(others, T=updated_information(others.T, rows) if len(rows) else others.T)
            known, _ = eliminated(part, own, known)
            volume += self._channels * white.volume
            volume += sum(w.process.channels * w.volume for w in others.whitening.values() if w.extra)
            if change := change_at_end(model, log, self._rolled, k):
                known, _ = changed(known, *change)
        total = known.add(self._prior)
        volume += 2 * known.volume + 2 * float(np.sum(np.log(np.abs(np.diag(total.R)))))
        return total.rho2 + volume + _odds(process)


def are_near(some: Mapping[str, Process], others: Mapping[str, Process]) -> bool:
    """Return whether processes by sensor differ by less than a twentieth of their variance."""
    for name in {*some, *others}:
        a, b = some.get(name, DECLARED), others.get(name, DECLARED)
        if max(abs(a.white - b.white), abs(a.slow - b.slow)) > 0.05 * b.total:
            return False
    return True
