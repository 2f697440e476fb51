"""The evidence of the noise of a log's sensors, and its slopes.

The evidence is that of the linear fit: all unknowns are integrated, so that what they absorb of the
noise is no loss (Patterson and Thompson 1971, likelihood of residuals). One sweep gives it: the χ²
of the fit, and the determinants of what is eliminated. With the noise θ, all unknowns x and the
samples y,

    ∂/∂θ log p(y | θ) = E[∂/∂θ log p(y, x | θ)],

the mean over x given y (Fisher's identity). log p(y, x | θ) is that of white residuals, block by
block and sensor by sensor: one more pass, backward, that finds mean and covariance of the unknowns
of each block gives the slopes for all sensors together.

Source: Cappé, Moulines and Rydén 2005, Inference in Hidden Markov Models, ch. 10.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.gaussian import Gaussian
from cpid_drake.estimation.likelihood.model import SLOW
from cpid_drake.estimation.links import link_sigma
from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.process import Process
from cpid_drake.estimation.roll import Rolled, Values
from cpid_drake.estimation.sweep import Swept, marginals, sweep
from cpid_drake.estimation.unknowns import Model
from cpid_drake.estimation.unknowns_prior import prior_of
from cpid_drake.estimation.whitening import whitener, whiteners


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """−2 log(evidence) of the noise of a log's sensors, up to a constant.

    Attributes:
        model: the unknowns.
        log: a log.
        rolled: its prediction at the values.
        values: of all unknowns.

    """

    model: Model
    log: LogState
    rolled: Rolled
    values: Values

    @cached_property
    def _prior(self) -> Gaussian:
        """What is known without samples."""
        return prior_of(self.model, [self.log], self.values)

    def __call__(self, processes: Mapping[str, Process]) -> float:
        """Return the value for noise by sensor; all others are as declared."""
        return self._value(self.log.with_processes(processes), with_steps=False)[0]

    def means(self) -> list[dict[str, Array]]:
        """Return the noise (M, d) of each block in the linear fit, if it is as declared."""
        log = self.log.with_processes({})
        _, swept, posterior = self._value(log, with_steps=True)
        noise = list[dict[str, Array]]()
        for k, part, mean, _ in marginals(self.model.of_log(log.name), log, swept, posterior):
            own, first = dict[str, Array](), 0
            predicted = self.rolled.jacobians[self.rolled.models[k]][0] @ mean[part.without_slow]
            for name, each in self.rolled.residuals[k].items():
                own[name] = each - predicted[first : first + each.size].reshape(each.shape)
                first += each.size
            noise.insert(0, own)
        return noise

    def with_slopes(self, processes: Mapping[str, Process]) -> tuple[float, dict[str, Array]]:
        """Return the value, and its derivatives by `Process.coordinates` of each sensor."""
        log = self.log.with_processes(processes)
        value, swept, posterior = self._value(log, with_steps=True)
        slopes = {name: np.zeros(len(each.coordinates)) for name, each in processes.items()}
        for k, part, mean, root in marginals(self.model.of_log(log.name), log, swept, posterior):
            J, _ = self.rolled.jacobians[self.rolled.models[k]]
            rest, first, moments = self.rolled.residuals[k], 0, np.column_stack([mean, root])
            noise = -J @ moments[part.without_slow]
            noise[:, 0] += np.concatenate([np.empty(0), *(each.ravel() for each in rest.values())])
            slow = np.zeros((2, log.noise.slow_size, moments.shape[1]))
            if log.noise.slow_size:
                slow[:] = moments[part.columns[SLOW]].reshape(slow.shape)
                slow[..., 0] += log.slow_at(k)
            for name, each in rest.items():
                if name in processes:
                    own = noise[first : first + each.size].reshape(*each.shape, -1)
                    slopes[name] += self._slopes(log, k, name, own, slow)
                first += each.size
            for name in processes.keys() - rest.keys():
                own = np.zeros((0, processes[name].channels, moments.shape[1]))
                slopes[name] += self._slopes(log, k, name, own, slow)
        return value, slopes

    def _value(self, log: LogState, *, with_steps: bool) -> tuple[float, Swept, Gaussian]:
        """Return the value, the sweep, and all that is known at its end."""
        swept = sweep(self.model, log, self.rolled, self.values, forward_only=not with_steps)
        posterior = swept.end.add(self._prior)
        volume = 2 * swept.end.volume + 2 * float(np.sum(np.log(np.abs(np.diag(posterior.R)))))
        if log.past is None:
            volume += 2 * float(np.sum(np.log(log.noise.slow_sigma)))
        for k in range(len(self.rolled.jumps)):
            volume += 2 * float(np.sum(np.log(link_sigma(self.model, log.links[k]))))
        for k, rest in enumerate(self.rolled.residuals):
            for name, white in whiteners(log, k, rest).items():
                count = rest[name].shape[1] if name in rest else white.process.channels
                volume += count * white.volume
        return posterior.rho2 + volume, swept, posterior

    def _slopes(self, log: LogState, k: int, name: str, noise: Array, slow: Array) -> Array:
        """Return what a sensor in a block adds to its slopes.

        Args:
            log: with its process.
            k: number of the block.
            name: of the sensor.
            noise: (M, d, 1 + c) mean and root of the covariance of its noise.
            slow: (2, s, 1 + c) those of all slow noise at both edges.

        """
        process, place = log.noise.processes[name], log.noise.slow_places.get(name, slice(0))
        own = slow[:, place]
        slopes = whitener(log, k, name, len(noise)).slopes(noise, own)
        if process.slow and k == 0 and (log.past is None or name not in log.past.slow):
            slopes[1:] += noise.shape[1] - float(np.sum(own[0] ** 2)) / process.slow
        return slopes
