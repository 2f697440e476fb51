"""The samples of the joints' own sensors in one block, as rows of the coefficients of splines."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.least_squares import triangles
from cpid_drake.estimation.likelihood.joint_model import JointPart, jerk_rows, spline_basis
from cpid_drake.estimation.process import DECLARED, Alone, Process
from cpid_drake.logs.log import Samples
from cpid_drake.sensors.suite import SensorSuite

_NAMES = "encoders", "joint_rates"


@dataclass(frozen=True, eq=False)
class Smoothness:
    """How smooth the joints of a log are, and how noisy their sensors.

    Attributes:
        rate: pieces of the splines in a second.
        jerk: (J,) usual size s of the jerk's white noise [rad/s³·√s or m/s³·√s].
        roughness: (J,) that of the roughest block, as a multiple of it; 1 or more.
        noise: (J,) factor f of the sensors' declared σ; 1 if they are better than declared.
        processes: shapes of their noise, of variance 1, by sensor; none if it is white.

    """

    rate: float
    jerk: Array
    roughness: Array
    noise: Array
    processes: Mapping[str, Process] = field(default_factory=dict)


class JointSamples:
    """The samples of the joints' sensors in one block.

    Attributes:
        start, end: [s].
        values: (N, J) all samples in units of σ.
        stepped: the rows of sensors that have steps, by name.

    """

    def __init__(self, block: Block, suite: SensorSuite) -> None:
        self.start, self.end = block.start, block.end
        self._parts: list[tuple[Samples, int, float]] = []
        self._white = dict[str, tuple[slice, Alone]]()
        for derivative, name in enumerate(_NAMES):
            own = block.samples[name]
            if name in suite.present() and len(own):
                before = sum(len(each) for each, _, _ in self._parts)
                self._parts.append((own, derivative, float(suite.sigmas(name)[0])))
                place = slice(before, before + len(own))
                self._white[name] = place, Alone(own.time)
        self.stepped, first = dict[str, slice](), 0
        for name in _NAMES:
            count = len(block.samples[name]) if name in suite.present() else 0
            if count and suite.step(name) > 0:
                self.stepped[name] = slice(first, first + count)
            first += count
        values = [samples.value / sigma for samples, _, sigma in self._parts]
        nothing = np.empty((0, len(block.samples.joint_names)))
        self.values = np.concatenate([nothing, *values])

    @property
    def length(self) -> float:
        """Length of the block [s]."""
        return round(self.end - self.start, 9)

    @property
    def positions(self) -> int:
        """Number of samples of the encoders."""
        return sum(len(samples) for samples, derivative, _ in self._parts if not derivative)

    def pieces(self, rate: float) -> int:
        """Return the number of pieces at this rate [1/s]; no more than samples, as in a gap."""
        return max(1, min(round(rate * (self.end - self.start)), len(self.values)))

    def design(self, pieces: int) -> Array:
        """Return A (N, K) of the samples in units of σ."""
        times = [(np.empty(0), 0, 1.0), *((s.time, d, sigma) for s, d, sigma in self._parts)]
        return np.concatenate([self.basis(pieces, t, d) / sigma for t, d, sigma in times])

    def basis(self, pieces: int, times: Array, derivative: int) -> Array:
        """See `spline_basis`."""
        return spline_basis(self.start, self.end, pieces, times, derivative)

    def with_processes(self, processes: Mapping[str, Process]) -> "JointSamples":
        """Return the samples with other noise."""
        other = copy(self)
        other._white = {
            name: (place, Alone(white.times, processes.get(name, DECLARED)))
            for name, (place, white) in self._white.items()
        }
        return other

    @property
    def times(self) -> dict[str, Array]:
        """Times of the samples of sensors without steps [s], by name."""
        return {n: white.times for n, (_, white) in self._white.items() if n not in self.stepped}

    def white(self, values: Array) -> Array:
        """Return whitened values (N, ...) of all samples."""
        whitened = np.empty(values.shape)
        for place, white in self._white.values():
            whitened[place] = white(values[place])
        return whitened

    @property
    def volume(self) -> float:
        """The log of the determinant of the covariance of all samples of a joint."""
        return sum(white.volume for _, white in self._white.values())

    def part(self, smoothness: Smoothness, weights: Array) -> JointPart:
        """Return what samples of weights (N, J) and the jerk tell, about a motion of zero."""
        pieces = self.pieces(smoothness.rate)
        P, A = jerk_rows(self.length, pieces), self.design(pieces)
        size = smoothness.jerk * smoothness.roughness
        jerk = np.column_stack([P, np.zeros(len(P))]) / size[:, None, None]
        rows = np.dstack([weights[..., None] * A[:, None], weights * self.values])
        data = np.swapaxes(self.white(rows), 0, 1)
        both = np.concatenate([jerk, data / smoothness.noise[:, None, None]], axis=1)
        T, zero = triangles(both), np.zeros((A.shape[1], len(both)))
        return JointPart(self.start, self.end, pieces, zero, T[:, :-1, :-1], T[:, :-1, -1])


def once_weights(samples: Sequence[JointSamples]) -> list[Array]:
    """Return the weights (N, J) by which a value that n successive samples repeat counts once.

    The error of a sensor with steps is that of its step: as long as its value stays, the samples
    tell nothing new. A value that is not repeated has the weight 1, and so have sensors without
    steps.
    """
    weights = [np.ones(each.values.shape) for each in samples]
    for name in _NAMES:
        parts = [
            (w, each) for w, each in zip(weights, samples, strict=True) if name in each.stepped
        ]
        if not parts:
            continue
        value = np.concatenate([each.values[each.stepped[name]] for _, each in parts])
        count = np.ones(value.shape)
        for own, x in zip(count.T, value.T, strict=True):
            edges = np.flatnonzero(np.diff(x, prepend=np.nan, append=np.nan))
            own[:] = np.repeat(np.diff(edges), np.diff(edges))
        ends = np.cumsum([len(each.values[each.stepped[name]]) for _, each in parts])[:-1]
        for (w, each), n in zip(parts, np.split(count, ends), strict=True):
            w[each.stepped[name]] = 1 / np.sqrt(n)
    return weights
