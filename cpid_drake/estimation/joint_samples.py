"""The samples of the joints' own sensors in one block, as rows of the coefficients of splines."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from cpid_drake.array import Array
from cpid_drake.estimation.block import Block
from cpid_drake.estimation.least_squares import triangles
from cpid_drake.estimation.likelihood.joint_model import JointPart, jerk_rows, spline_basis
from cpid_drake.estimation.process import DECLARED, Alone, Process
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


@dataclass(frozen=True, eq=False)
class _Sensor:
    """One of the joints' sensors: order of the derivative, σ, rows of its samples, their noise."""

    derivative: int
    sigma: float
    rows: slice
    white: Alone


class JointSamples:
    """The samples of the joints' sensors in one block.

    Attributes:
        start, end: [s].
        values: (N, J) all samples in units of σ.
        stepped: the rows of sensors that have steps, by name.

    """

    def __init__(self, block: Block, suite: SensorSuite) -> None:
        self.start, self.end = block.start, block.end
        self._sensors, self.stepped = dict[str, _Sensor](), dict[str, slice]()
        values, first = [np.empty((0, len(block.samples.joint_names)))], 0
        for derivative, name in enumerate(_NAMES):
            samples = block.samples[name]
            if name in suite.present() and len(samples):
                rows, sigma = slice(first, first + len(samples)), float(suite.sigmas(name)[0])
                self._sensors[name] = _Sensor(derivative, sigma, rows, Alone(samples.time))
                values.append(samples.value / sigma)
                first = rows.stop
                if suite.step(name) > 0:
                    self.stepped[name] = rows
        self.values = np.concatenate(values)

    @property
    def length(self) -> float:
        """Length of the block [s]."""
        return round(self.end - self.start, 9)

    @property
    def positions(self) -> int:
        """Number of samples of the encoders."""
        return len(self._sensors[_NAMES[0]].white.times) if _NAMES[0] in self._sensors else 0

    def pieces(self, rate: float) -> int:
        """Return the number of pieces at this rate [1/s]; no more than samples, as in a gap."""
        return max(1, min(round(rate * (self.end - self.start)), len(self.values)))

    def design(self, pieces: int) -> Array:
        """Return A (N, K) of the samples in units of σ."""
        A = [spline_basis(self.start, self.end, pieces, np.empty(0), 0)]
        for sensor in self._sensors.values():
            times, derivative = sensor.white.times, sensor.derivative
            B = spline_basis(self.start, self.end, pieces, times, derivative)
            A.append(B / sensor.sigma)
        return np.concatenate(A)

    def with_processes(self, processes: Mapping[str, Process]) -> "JointSamples":
        """Return the samples with other noise."""
        other = copy(self)
        other._sensors = {
            name: replace(s, white=Alone(s.white.times, processes.get(name, DECLARED)))
            for name, s in self._sensors.items()
        }
        return other

    @property
    def times(self) -> dict[str, Array]:
        """Times of the samples of sensors without steps [s], by name."""
        return {n: s.white.times for n, s in self._sensors.items() if n not in self.stepped}

    def white(self, values: Array) -> Array:
        """Return whitened values (N, ...) of all samples."""
        whitened = np.empty(values.shape)
        for sensor in self._sensors.values():
            whitened[sensor.rows] = sensor.white(values[sensor.rows])
        return whitened

    @property
    def volume(self) -> float:
        """The log of the determinant of the covariance of all samples of a joint."""
        return sum(sensor.white.volume for sensor in self._sensors.values())

    def part(self, smoothness: Smoothness, weights: Array) -> JointPart:
        """Return what samples of weights (N, J) and the jerk tell, about a motion of zero."""
        pieces = self.pieces(smoothness.rate)
        P, A = jerk_rows(self.length, pieces), self.design(pieces)
        size = smoothness.jerk * smoothness.roughness
        # P c = 0 / s
        jerk = np.column_stack([P, np.zeros(len(P))]) / size[:, None, None]
        # w A c = w y / f, of white noise
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
        stepped = [(w, s.stepped[name], s) for w, s in zip(weights, samples) if name in s.stepped]
        if not stepped:
            continue
        value = np.concatenate([each.values[rows] for _, rows, each in stepped])
        for j, x in enumerate(value.T):
            edges = np.flatnonzero(np.diff(x, prepend=np.nan, append=np.nan))
            # n samples that repeat a value: n (1/√n)² = 1
            value[:, j] = 1 / np.sqrt(np.repeat(np.diff(edges), np.diff(edges)))
        first = 0
        for w, rows, _ in stepped:
            count = rows.stop - rows.start
            w[rows] = value[first : first + count]
            first += count
    return weights
