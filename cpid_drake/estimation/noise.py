"""The noise of each sensor, of the largest evidence of all samples of a log.

Residuals alone say of which sensors the noise may not be as declared, and where its process is
sought; from there, quasi-Newton steps climb the evidence of all these sensors together. A process
stays if its evidence is much larger than that of white noise of any size. The noise is sought at
the fit with declared noise, and once more at the fit with its own.

Source: Nocedal and Wright 2006, Numerical Optimization, ch. 6.1 (BFGS).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from cpid_drake.array import Array
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.noise_evidence import NoiseEvidence
from cpid_drake.estimation.process import DECLARED, EXACT, Process, proxy
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.unknowns import Model
from cpid_drake.sensors.sensors import SENSORS

TAUS = 0.02 * 8.0 ** np.arange(4)
"""Times of slow noise that are tried first [s]."""

RATIOS = np.array([0.2, 5.0])
"""Variances of slow noise that are tried first, in units of that of the white noise."""

WORTH = 12.0
"""−2 log(evidence) that slow noise must gain; larger white noise, half of it."""

SAME = 0.3
"""Gain of −2 log(evidence) that does not matter."""

FEWEST = 20
"""Residuals that show no more than declared noise."""

MOST_STEPS, FARTHEST, FLATTEST = 12, 1.5, 2.0
"""Steps to the largest evidence, the longest of one entry of `Process.logs`, and the least
curvature."""

Processes = dict[str, Process]


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
    evidence = NoiseEvidence(model, log, rolled, values)
    names, before = rolled.all_residuals(), log.processes
    residuals = {n: [rest[n] for rest in rolled.residuals if n in rest] for n in names}
    series = _series(log, rolled, residuals)
    tried = _guesses(log, series, before)
    if not tried:
        return replace(log, is_known=True)
    search = _Search(evidence, series)
    found, cost = search.climbed(tried)
    if are_near(_topped(found), before):
        return replace(log, is_known=True)
    found = _topped(search.simplified(found, cost))
    return replace(log.with_processes(found), is_known=bool(before))


def cost_of(evidence: NoiseEvidence, processes: Mapping[str, Process]) -> float:
    """Return −2 log(evidence), with the odds of noise and what it must gain if not as declared."""
    return evidence(processes) + sum(_price(p) + _odds(p.logs) for p in processes.values())


def noise_cost(model: Model, log: LogState, rolled: Rolled, values: Values) -> float:
    """Return −2 log(evidence) of a log with the best noise, whatever its noise is now.

    See `with_processes`.
    """
    evidence = NoiseEvidence(model, log, rolled, values)
    series = _series(log, rolled, evidence.means())
    search = _Search(evidence, series)
    found, cost = search.climbed(_guesses(log, series, {}))
    return search.cost(_topped(search.simplified(found, cost)))


def _series(
    log: LogState, rolled: Rolled, residuals: Mapping[str, Sequence[Array]]
) -> dict[str, "_Series"]:
    """Return the series of sensors' residuals (M, d) of the blocks that have samples."""
    found = {}
    for name in residuals.keys() & SENSORS.keys():
        blocks = [k for k, rest in enumerate(rolled.residuals) if name in rest]
        times, near = [], []
        for k, rest in zip(blocks, residuals[name], strict=True):
            is_near = log.weights[k].get(name, np.ones(len(rest))) == 1.0
            times.append(log.blocks[k].samples[name].time[is_near])
            near.append(rest[is_near])
        found[name] = _Series(np.concatenate(times), np.concatenate(near))
    return dict(sorted(found.items()))


def _guesses(log: LogState, series: Mapping[str, "_Series"], before: Processes) -> Processes:
    """Return the processes from which the evidence is climbed."""
    tried = {
        name: each.guess(before.get(name, DECLARED), log.freedom.get(name, 1.0))
        for name, each in series.items()
    }
    tried = {name: process for name, process in tried.items() if process != DECLARED}
    return {name: process for name, process in before.items() if name not in series} | tried


@dataclass(frozen=True, eq=False)
class _Series:
    """Residuals of a sensor that are not far off: what they show if unknowns are exact."""

    times: Array
    rest: Array

    def value(self, process: Process) -> float:
        """Return −2 log(likelihood)."""
        return proxy(self.times, self.rest, process)

    def guess(self, now: Process, freedom: float) -> Process:
        """Return the process from which the evidence is climbed; as it is now if little differs.

        Unknowns absorb slow noise: residuals that are smaller than they leave declared noise, to a
        share `freedom` of its variance, may hide it.
        """
        d, square = self.rest.shape[1], float(np.mean(self.rest**2)) if self.rest.size else 0.0
        if now.slow or self.rest.size < FEWEST or square < EXACT**4:
            return now
        white, larger = Process(square, channels=d), Process(max(square, 1.0), channels=d)
        shapes = [(square / (1 + ratio), float(tau)) for tau in TAUS for ratio in RATIOS]
        slow = [Process(w, square - w, tau, d) for w, tau in shapes]
        best = min(slow, key=self.value)
        ratio = square / freedom
        is_small = ratio < 1 and self.rest.size * (ratio - 1 - np.log(ratio)) > WORTH / 2
        if is_small or self.value(best) < self.value(white) - WORTH / 2:
            return best
        is_larger = self.value(larger) < self.value(now) - WORTH / 2
        return larger if is_larger else now

    def curvature(self, process: Process) -> Array:
        """Return the second derivatives of −2 log(likelihood) by `Process.logs`, made positive."""
        x, h = process.logs, 0.2
        step = h * np.eye(len(x))

        def at(x: Array) -> float:
            return self.value(process.with_logs(x)) + _odds(x)

        middle, up = at(x), [at(x + e) for e in step]
        H = np.empty((len(x), len(x)))
        for i in range(len(x)):
            H[i, i] = (up[i] + at(x - step[i]) - 2 * middle) / h**2
            for j in range(i):
                H[i, j] = H[j, i] = (at(x + step[i] + step[j]) - up[i] - up[j] + middle) / h**2
        w, V = np.linalg.eigh(H)
        return np.asarray(V * np.maximum(np.abs(w), FLATTEST) @ V.T)


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for the noise of the largest evidence, with the odds of it and its price."""

    evidence: NoiseEvidence
    series: Mapping[str, _Series]

    def cost(self, processes: Processes) -> float:
        """See `cost_of`."""
        return cost_of(self.evidence, processes)

    def _slopes(self, processes: Processes) -> tuple[float, Array]:
        """Return −2 log(evidence) with the odds, and its derivatives by all `Process.logs`."""
        value, slopes = self.evidence.with_slopes(processes)
        parts = [slopes[name] + _by_odds(each.logs) for name, each in processes.items()]
        value += sum(_odds(each.logs) for each in processes.values())
        return value, np.concatenate([np.empty(0), *parts])

    def climbed(self, processes: Processes) -> tuple[Processes, float]:
        """Return the noise of the largest evidence near some, and its cost."""
        if not processes:
            return processes, self.cost(processes)
        H = block_diag(*(self.series[n].curvature(p) for n, p in processes.items()))
        value, slope = self._slopes(processes)
        for _ in range(MOST_STEPS):
            step = -np.linalg.solve(H, slope)
            if -0.5 * float(slope @ step) < SAME:
                break
            step *= min(1.0, FARTHEST / float(np.max(np.abs(step))))
            there, (tried, after) = _moved(processes, step), (value, slope)
            for _ in range(4):
                there = _moved(processes, step)
                tried, after = self._slopes(there)
                if tried < value + SAME:
                    break
                step /= 3
            if tried > value - SAME:  # as good, or no better step was found
                break
            y = after - slope
            if y @ step > 0:
                Hs = H @ step
                H = H + np.outer(y, y) / (y @ step) - np.outer(Hs, Hs) / (step @ Hs)
            processes, value, slope = there, tried, after
        return processes, value + sum(_price(each) for each in processes.values())

    def simplified(self, processes: Processes, cost: float) -> Processes:
        """Return the noise without processes that gain less than they must."""
        for name, each in processes.items():
            others = {n: p for n, p in processes.items() if n != name}
            white = {name: replace(each, white=each.total, slow=0.0)} if each.slow else {}
            if self.cost(others | white) < cost:
                if not white or each.total < 1:  # white noise that is smaller is as declared
                    white = {}
                simple = others | white
                return self.simplified(*self.climbed(simple))
        return processes


def _topped(processes: Processes) -> Processes:
    """Return processes in order, with white noise up to the declared variance."""
    return {
        name: replace(each, white=each.white + max(0.0, 1 - each.total))
        for name, each in sorted(processes.items())
    }


def _moved(processes: Processes, step: Array) -> Processes:
    """Return processes after a step of all their `Process.logs`."""
    ends = np.cumsum([len(each.logs) for each in processes.values()])[:-1]
    parts = zip(processes.items(), np.split(step, ends), strict=True)
    return {name: each.with_logs(each.logs + own) for (name, each), own in parts}


def _price(process: Process) -> float:
    """Return what −2 log(evidence) must gain for a process that is not as declared."""
    return (WORTH if process.slow else WORTH / 2) if process.white != 1 or process.slow else 0.0


def _odds(logs: Array) -> float:
    """Return −2 log(prior) of a process: a few σ, in a few seconds or tenths of one."""
    _, *slow = logs.tolist()
    return (sum(slow) ** 2 + slow[-1] ** 2) / 4 if slow else 0.0


def _by_odds(logs: Array) -> Array:
    """Return the derivatives of the odds."""
    if len(logs) == 1:
        return np.zeros(1)
    _, ratio, tau = logs
    return np.array([0.0, ratio + tau, ratio + 2 * tau]) / 2


def are_near(some: Mapping[str, Process], others: Mapping[str, Process]) -> bool:
    """Return whether processes by sensor differ by less than a twentieth of their variance."""
    for name in {*some, *others}:
        a, b = some.get(name, DECLARED), others.get(name, DECLARED)
        if max(abs(a.white - b.white), abs(a.slow - b.slow)) > 0.05 * b.total:
            return False
    return True
