"""Identification of samples as they arrive, in plain Python: for a robot's own loop."""

import threading
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.files.errors import InputError, choose_from
from cpid_drake.files.one_thread import one_thread
from cpid_drake.identification.arguments import PathLike
from cpid_drake.identification.result import Identification
from cpid_drake.online.stream import Stream, StreamState
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.spacecraft.spacecraft import Spacecraft


class OnlineIdentifier:
    """Identifies the target's ten inertial parameters from samples as they arrive.

    It is the fit of `SensorIdentifier` without a Diagram. Samples may come in any order within
    `lateness`; later ones, and those that repeat a stamp, are rejected and counted. Memory and the
    work of a call are bounded: most calls of `add` store a sample, and one in about a second solves
    the last blocks. All methods may be called from several threads; one at a time works.

    Args:
        spacecraft: the spacecraft model.
        sensors: its sensors' errors: a suite, the name of a preset, or a file.
        **options: the options of `online.stream.Stream`, by name; `has_budget`: whether estimates
            have their error budget.

    Attributes:
        stream: how the samples are solved.

    Raises:
        InputError: see `Stream`.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        sensors: SensorSuite | PathLike,
        *,
        has_budget: bool = False,
        **options: Any,
    ) -> None:
        self._has_budget = has_budget
        self._begin(stream := Stream(spacecraft, sensors, **options), stream.start())

    def _begin(self, stream: Stream, state: StreamState) -> None:
        """Continue a stream from a state."""
        self.stream, self._lock = stream, threading.RLock()
        self._state, self._waiting = state, list(state.waiting)
        self._newest, self._due = -np.inf, np.nan
        self._estimate: Identification | None = None

    def _process(self, state: StreamState) -> None:
        """Continue from the state after some blocks."""
        if state.online is not self._state.online:
            self._estimate = None
        self._state, self._waiting = state, list(state.waiting)
        self._due = self.stream.due(state, self._newest)

    def add(self, sensor: str, time: float, value: ArrayLike) -> None:
        """Add a sample.

        Args:
            sensor: "attitude" (quaternion w, x, y, z of R_WB), "gyro", "position", "velocity",
                "encoders" or "joint_rates" (J,), or "thrust": force and torque.
            time: stamp of the sample [s], of any zero that all sensors share.
            value: in SI units and radians, as in a log; NaN entries make it unusable.

        Raises:
            InputError: the suite has no such sensor, or time or value are no numbers of its shape.

        """
        widths = self.stream.widths
        if sensor not in widths:
            raise InputError(f"no sensor '{sensor}'; {choose_from(sensor, tuple(widths))}")
        try:
            row = np.concatenate([[float(time)], np.array(value, dtype=float).ravel()])
        except (TypeError, ValueError) as error:
            raise InputError(f"{sensor}: a sample is a time and numbers: {error}") from error
        if len(row) != 1 + widths[sensor]:
            raise InputError(f"{sensor}: a sample has {widths[sensor]} entries, not {len(row) - 1}")
        if not np.isfinite(row[0]):
            raise InputError(f"{sensor}: the time {row[0]} is no stamp")
        with self._lock:
            self._waiting.append((sensor, row))
            self._newest = max(self._newest, float(row[0]))
            if np.isnan(self._due):
                self._due = self.stream.due(self._state, self._newest)
            if self._newest >= self._due:
                with one_thread:
                    self._process(self.stream.processed(self.state))

    @one_thread
    def estimate(self) -> Identification:
        """Return the target as the blocks that are complete show it."""
        with self._lock:
            if self._estimate is None:
                self._estimate = self.stream.identification(
                    self._state, has_budget=self._has_budget
                )
            return self.stream.counted(self._estimate, self._state)

    @one_thread
    def finish(self) -> Identification:
        """Solve all samples, those of the incomplete block included; return the target."""
        with self._lock:
            self._process(self.stream.finished(self.state))
            return self.estimate()

    @property
    def known_until(self) -> float:
        """Stamp until which samples are in the estimate [s]; NaN before the first block."""
        with self._lock:
            return self._state.zero + self._state.queue.edge

    @property
    def state(self) -> StreamState:
        """All that is known: a value that is never changed, and can be pickled.

        Setting it continues from there.
        """
        with self._lock:
            return replace(self._state, waiting=tuple(self._waiting))

    @state.setter
    def state(self, state: StreamState) -> None:
        with self._lock:
            self._begin(self.stream, state)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: no lock."""
        return {"stream": self.stream, "state": self.state, "has_budget": self._has_budget}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        """Continue from what was pickled."""
        self._has_budget = saved["has_budget"]
        self._begin(saved["stream"], saved["state"])
