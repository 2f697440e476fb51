"""The noise of each sensor and white force, of the largest evidence of all samples of a log.

Residuals alone say of which sensors the noise may not be as declared, and where its process is
sought; from there, Fisher scoring climbs the evidence of all these sensors together. A process
stays if its evidence is much larger than that of white noise of any size. The noise is sought at
the fit with declared noise, and once more at the fit with its own.

Sources: Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter, ch. 3.4.5
(scoring); Whittle 1953, Estimation and information in stationary time series.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import fdtrc

from cpid_drake.array import Array
from cpid_drake.estimation.least_squares import IMPROBABLE
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.noise_evidence import NoiseEvidence
from cpid_drake.estimation.process import DECLARED, EXACT, Process, proxy
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.unknowns import Model
from cpid_drake.estimation.whitening import whitened, whitener
from cpid_drake.sensors.sensors import SENSORS

TAUS = 0.02 * 8.0 ** np.arange(4)
"""Times of slow noise that are tried first [s]."""

USUAL_TAU = float(np.sqrt(TAUS[0] * TAUS[-1]))
"""The middle of their logs [s]."""

RATIOS = np.array([0.2, 5.0])
"""Variances of slow noise that are tried first, in units of that of the white noise."""

WORTH = 12.0
"""−2 log(evidence) that slow noise must gain; larger white noise, half of it."""

SAME = 0.3
"""Gain of −2 log(evidence) that does not matter."""

FEWEST = 20
"""Residuals that show no more than declared noise."""

MOST_STEPS, FARTHEST, FLATTEST = 12, 1.5, 2.0
"""Steps to the largest evidence, the longest of one entry of `Process.coordinates`, and the least
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
    if log.noise.converged:
        return log
    evidence = NoiseEvidence(model, log, rolled, values)
    before, series = log.noise.processes, _series(log, rolled.residuals)
    search = _Search(evidence, series)
    tried = search.with_forces(_guesses(log, series, before))
    if not tried:
        return log.with_noise(converged=True)
    shapes, cost = search.climbed(tried)
    if are_near(shapes, before):
        return log.with_noise(converged=True)
    shapes = search.simplified(shapes, cost)
    converged = bool(before) or are_near(shapes, before)
    return log.with_processes(shapes).with_noise(converged=converged)


def with_best_noise(
    model: Model, log: LogState, rolled: Rolled, values: Values, before: float
) -> tuple[LogState, float]:
    """Return a log with the best noise near its own, and its cost.

    The cost is −2 log(evidence), with the odds of noise and what it must gain if not as declared.
    With changes that are open, it may be another that their samples show, if that costs less than
    without them.

    Args:
        model: the unknowns.
        log: a log.
        rolled: its prediction at the values.
        values: of all unknowns.
        before: the cost with fewer changes.

    """
    evidence, start = NoiseEvidence(model, log, rolled, values), log.noise.processes
    shown = evidence.means() if log.open else rolled.residuals
    search = _Search(evidence, _series(log, shown))
    if log.open:
        guessed = search.with_forces(_guesses(log, search.series, {}))
        start = guessed if search.cost(guessed) < before else start
    shapes, cost = search.climbed(start)
    if shapes == log.noise.processes:
        return log, cost
    shapes = search.simplified(shapes, cost)
    return log.with_processes(shapes), search.cost(shapes)


def is_as_before(
    log: LogState,
    residuals: Sequence[Mapping[str, Array]],
    freedom: Sequence[Mapping[str, float]],
    last: int,
) -> bool:
    """Return whether the residuals of a log's last blocks show the noise of those before.

    No more is asked of noise that is not as declared than that its innovations are as large.

    Args:
        log: with the noise.
        residuals: (M, d) of each block, by sensor.
        freedom: of each block: degrees of freedom of one residual.
        last: number of the last blocks.

    """
    for name, series in _series(log, residuals).items():
        squares, counts, sizes = np.zeros(2), np.zeros(2), np.zeros(2)
        for k, rest in enumerate(residuals):
            if name in rest:
                which = int(k >= len(residuals) - last)
                squares[which] += np.sum(whitened(log, k, name, rest[name]) ** 2)
                counts[which] += rest[name].size * freedom[k].get(name, 1.0)
                sizes[which] += rest[name].size
        now, share = log.noise.processes.get(name, DECLARED), float(counts.sum() / sizes.sum())
        if series.guess(now, share, WORTH) != now:
            return False
        if counts.min() >= FEWEST and squares.max() > EXACT**4:
            before, after = squares / counts
            larger = float(fdtrc(*counts[::-1], after / before))
            if min(larger, 1 - larger) < IMPROBABLE / 2:
                return False
    return True


def _series(log: LogState, residuals: Sequence[Mapping[str, Array]]) -> dict[str, "_Series"]:
    """Return the series of residuals (M, d) of the blocks that have samples, by sensor or force."""
    series = {}
    for name in sorted({name for rest in residuals for name in rest}):
        times, near = [], []
        for k, block in enumerate(residuals):
            if name in block:
                is_near = log.states[k].weights.get(name, np.ones(len(block[name]))) == 1.0
                times.append(whitener(log, k, name, len(is_near)).times[is_near])
                near.append(block[name][is_near])
        series[name] = _Series(np.concatenate(times), np.concatenate(near))
    return series


def _guesses(log: LogState, series: Mapping[str, "_Series"], before: Processes) -> Processes:
    """Return the processes from which the evidence is climbed."""
    tried = {
        name: each.guess(before.get(name, DECLARED), log.noise.freedom.get(name, 1.0))
        for name, each in series.items()
        if name in SENSORS
    }
    tried = {name: process for name, process in tried.items() if process != DECLARED}
    kept = {n: each for n, each in before.items() if n not in series or n not in SENSORS}
    return kept | tried


@dataclass(frozen=True, eq=False)
class _Series:
    """Residuals of a sensor that are not far off: what they show if unknowns are exact."""

    times: Array
    rest: Array

    def value(self, process: Process) -> float:
        """Return −2 log(likelihood)."""
        return proxy(self.times, self.rest, process)

    def guess(self, now: Process, freedom: float, worth: float = WORTH / 2) -> Process:
        """Return the process from which the evidence is climbed; as now if it is worth less.

        Unknowns absorb slow noise: residuals that are smaller than they leave declared noise, to a
        share `freedom` of its variance, may hide it.
        """
        d, square = self.rest.shape[1], float(np.mean(self.rest**2)) if self.rest.size else 0.0
        ratio = square / freedom
        if now.slow or self.rest.size < FEWEST or square < EXACT**4:
            return now
        white, larger = Process(square, channels=d), Process(max(square, 1.0), channels=d)
        shapes = [(ratio, float(tau)) for tau in TAUS for ratio in RATIOS]
        slow = [Process(square / (1 + r), square * r / (1 + r), tau, d) for r, tau in shapes]
        best = min(slow, key=self.value)
        # White noise of r times the variance gains N (r − 1 − log r).
        is_small = ratio < 1 and self.rest.size * (ratio - 1 - np.log(ratio)) > worth
        if is_small or self.value(best) < self.value(white) - worth:
            return best
        is_larger = self.value(larger) < self.value(now) - worth
        return larger if is_larger else now

    def information(self, process: Process) -> Array:
        """Return the Fisher information on `Process.coordinates` of −2 log(likelihood).

        It is Σ ∂log S/∂θ ∂log S/∂θᵀ over all frequencies, with the spectrum S (Whittle 1953).
        """
        N, tau, size = len(self.times), process.tau, len(process.coordinates)
        if N < 2:
            return np.zeros((size, size))
        turn = np.cos(2 * np.pi * np.arange(N) / N)
        dt = (self.times[-1] - self.times[0]) / (N - 1)
        phi = np.exp(-dt / tau)
        # S(ω) = white + slow (1 − φ²)/|1 − φ exp(−iω)|²
        far = 1 + phi**2 - 2 * phi * turn
        slow = process.slow * (1 - phi**2) / far
        # ∂log of the second term/∂φ; and ∂φ/∂log τ = φ dt/τ
        by_phi = -2 * phi / (1 - phi**2) - 2 * (phi - turn) / far
        by_white = np.full(N, process.white_slope)
        by = np.stack([by_white, slow, slow * (1 + by_phi * phi * dt / tau)])
        by = by[:size] / (process.white + slow)
        return np.asarray(process.channels * by @ by.T)


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for the noise of the largest evidence, with the odds of it and its price."""

    evidence: NoiseEvidence
    series: Mapping[str, _Series]

    def cost(self, processes: Processes) -> float:
        """Return −2 log(evidence), with the odds of noise and what it must gain."""
        return self.evidence(processes) + sum(_price(p) + _odds(p) for p in processes.values())

    def with_forces(self, processes: Processes) -> Processes:
        """Return noise from which the evidence is climbed, with that of white forces.

        These are unknowns: their values show less than what the samples say of all their sizes.
        """
        for name in self.series.keys() - SENSORS.keys() - processes.keys():
            d = self.series[name].rest.shape[1]
            tried = [Process(slow=1.0, tau=float(tau), channels=d) for tau in TAUS[1:3]]
            costs = [self.cost(processes | {name: each}) for each in tried]
            if min(costs) < self.cost(processes):
                processes = processes | {name: tried[int(np.argmin(costs))]}
        return processes

    def _slopes(self, processes: Processes) -> tuple[float, Array]:
        """Return −2 log(evidence) with the odds, and its derivatives by all coordinates."""
        value, slopes = self.evidence.with_slopes(processes)
        parts = [slopes[name] + _by_odds(each) for name, each in processes.items()]
        value += sum(_odds(each) for each in processes.values())
        return value, np.concatenate([np.empty(0), *parts])

    def climbed(self, processes: Processes) -> tuple[Processes, float]:
        """Return the noise of the largest evidence near some, and its cost."""
        if not processes:
            return processes, self.cost(processes)
        value, slope = self._slopes(processes)
        H = self._curvature(processes, slope)
        for _ in range(MOST_STEPS):
            # A quadratic falls by ½ gᵀH⁻¹g along −H⁻¹g.
            step = np.asarray(-np.linalg.solve(H, slope))
            if -0.5 * float(slope @ step) < SAME:
                break
            step *= min(1.0, FARTHEST / float(np.max(np.abs(step))))
            ahead, (tried, after) = _moved(processes, step), (value, slope)
            for _ in range(4):
                ahead = _moved(processes, step)
                tried, after = self._slopes(ahead)
                if tried < value + SAME:
                    break
                step /= 3
            if tried > value - SAME:  # as good, or no better step was found
                break
            H = self._curvature(ahead, after)
            s, y = _coordinates(ahead) - _coordinates(processes), after - slope
            if y @ s > 0:  # unknowns absorb most of what samples tell of this direction
                # BFGS: H + y yᵀ/(yᵀs) − H s sᵀH/(sᵀH s)
                Hs = H @ s
                H = H + np.outer(y, y) / (y @ s) - np.outer(Hs, Hs) / (s @ Hs)
            processes, value, slope = ahead, tried, after
        return processes, value + sum(_price(each) for each in processes.values())

    def _curvature(self, processes: Processes, slope: Array) -> Array:
        """Return what samples without unknowns would tell of all `Process.coordinates`.

        Where white noise is least, its slope is zero, and the evidence falls by its square.
        """
        parts, first, silent = list[Array](), 0, _Series(np.empty(0), np.empty((0, 3)))
        for name, each in processes.items():
            H = self.series.get(name, silent).information(each)
            H = H + FLATTEST * np.eye(len(H))
            H[0, 0] += max(0.0, float(slope[first])) * each.white_bend / each.white_slope
            parts.append(H)
            first += len(H)
        return np.asarray(block_diag(*parts))

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


def _coordinates(processes: Processes) -> Array:
    """Return the `Process.coordinates` of all processes."""
    return np.concatenate([each.coordinates for each in processes.values()])


def _moved(processes: Processes, step: Array) -> Processes:
    """Return processes after a step of all their `Process.coordinates`."""
    ends = np.cumsum([len(each.coordinates) for each in processes.values()])[:-1]
    parts = zip(processes.items(), np.split(step, ends), strict=True)
    return {name: each.with_coordinates(each.coordinates + own) for (name, each), own in parts}


def _price(process: Process) -> float:
    """Return what −2 log(evidence) must gain for a process that is not as declared."""
    return (WORTH if process.slow else WORTH / 2) if process.white != 1 or process.slow else 0.0


def _odds(process: Process) -> float:
    """Return −2 log(prior) of a process: a few σ, in a time near the middle of all `TAUS`."""
    if not process.slow:
        return 0.0
    # log slow and log(τ/τ₀) ~ N(0, 2²)
    return float(np.log(process.slow) ** 2 + np.log(process.tau / USUAL_TAU) ** 2) / 4


def _by_odds(process: Process) -> Array:
    """Return the derivatives of the odds by `Process.coordinates`."""
    if not process.slow:
        return np.zeros(1)
    slow, tau = np.log(process.slow), np.log(process.tau / USUAL_TAU)
    return np.array([0.0, slow, slow + tau]) / 2


def are_near(some: Mapping[str, Process], others: Mapping[str, Process]) -> bool:
    """Return whether processes by sensor differ by less than a twentieth of their variance."""
    for name in {*some, *others}:
        a, b = some.get(name, DECLARED), others.get(name, DECLARED)
        if max(abs(a.white - b.white), abs(a.slow - b.slow)) > 0.05 * b.total:
            return False
    return True
