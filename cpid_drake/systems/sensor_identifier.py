"""Identification as a Drake system: from sensors, each at its own rate, by the momentum filter."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    EventStatus,
    OutputPort,
    State,
)

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.errors import InputError
from cpid_drake.estimation.momentum_filter import FILTER_ORDER, FilterState
from cpid_drake.estimation.online import OnlineState
from cpid_drake.identification.filter_estimator import identification_of_filter, online_estimator
from cpid_drake.identification.result import Identification
from cpid_drake.sensing.sensors import SENSORS
from cpid_drake.sensing.suite import SensorSuite, check_sensors
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.identifier import Identifier, is_number
from cpid_drake.systems.ports import add_connected

_COUNTED = (*FILTER_ORDER, "agreement")

FILTER_DIAGNOSTICS = (
    *(f"{name}_used" for name in _COUNTED),
    *(f"{name}_rejected" for name in _COUNTED),
    "momentum_changes",
    "momentum_change_time",
)
"""Entries of the `filter_diagnostics` output.

"agreement" counts updates by the difference of the attitudes by gyro and by momentum.
"""


class SensorIdentifier(Identifier):
    """Identifies the target's ten inertial parameters online, from sensors at their own rates.

    It runs `online.OnlineEstimator`: a trajectory fit until the target is known well enough, then
    the momentum filter. It contains the *known* spacecraft only.

    .. pydrake_system::

        name: SensorIdentifier
        input_ports:
        - gyro
        - attitude
        - encoders
        - position
        - velocity
        output_ports:
        - parameters
        - covariance
        - spatial_inertia
        - diagnostics
        - filter_diagnostics

    - one input (1 + width) for each sensor of the suite, as from `SpacecraftSensors`: the time [s]
      of the latest sample, then its value; NaN before the first. Joint rates are not used, because
      the noise of encoders does not accumulate.
    - `parameters`, `covariance`, `spatial_inertia`, `diagnostics`: as the outputs of
      `MomentumIdentifier`, but the covariance follows from the sensors' noise, and the residual is
      NaN.
    - `filter_diagnostics` (14): samples used and rejected of every sensor, number of detected
      changes of momentum, and time of the latest [s] (NaN for none); see `FILTER_DIAGNOSTICS`.
      Zero for absent sensors.

    In every period it processes all new samples in order of time. Drake systems that update at the
    same instant read each other's state before the update, so a sample of time t is processed one
    period after t. No sample is missed, because no sensor is faster than this period. The samples
    at the end of a simulation are not processed yet; `Simulator.AdvancePendingEvents()` and then
    `SensorIdentifier.ExecuteForcedEvents(context)` process them.

    The state is one abstract value. Clones of a Context have copies of it.

    Args:
        spacecraft: the known spacecraft.
        suite: its sensors.
        momentum: the total momentum, zero (default) or unknown.
        period: time between updates [s]; default: that of the fastest sensor.
        guess: prior estimate of the target; default: none, for a vague prior.
        guess_sigma: relative σ of the guess; see `momentum_filter.guessed_prior`.

    Raises:
        InputError: invalid sensors (see `suite.check_sensors`), a period that is not positive or is
            longer than the fastest sensor's, or an invalid guess (see
            `cpid_drake.identification.filter_estimator.online_estimator`).

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        suite: SensorSuite,
        *,
        momentum: TotalMomentum | None = None,
        period: float | None = None,
        guess: InertialParameters | None = None,
        guess_sigma: float = 0.5,
    ) -> None:
        super().__init__()
        self.set_name("sensor_identifier")
        check_sensors(suite, "sensors")
        present = suite.present()
        sensors = [name for name in FILTER_ORDER if name in present]
        shortest = 1 / max(present[name].rate for name in sensors)
        period = shortest if period is None else period
        if not (is_number(period) and 0 < period <= shortest):
            raise InputError(
                f"identification period must be > 0 s and at most {shortest:g} s, the period of "
                f"the fastest sensor, not {period}"
            )
        self._estimator = online_estimator(
            spacecraft, suite, momentum=momentum, guess=guess, guess_sigma=guess_sigma
        )
        joints = len(spacecraft.joint_names)
        self._sample_ports = {
            name: self.DeclareVectorInputPort(name, 1 + SENSORS[name].width(joints))
            for name in sensors
        }
        self._memory_index = self.DeclareAbstractState(
            Value(_Memory(self._estimator.start(), dict.fromkeys(sensors, np.nan), []))
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=period, offset_sec=0.0, update=self._take_settled
        )
        self.DeclareForcedUnrestrictedUpdateEvent(self._take_all)
        self._declare_outputs(self.xa_ticket())
        self.DeclareVectorOutputPort(
            name="filter_diagnostics",
            size=len(FILTER_DIAGNOSTICS),
            calc=self._calc_filter_diagnostics,
            prerequisites_of_calc={self.xa_ticket()},
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        samples: Mapping[str, OutputPort],
        suite: SensorSuite,
        **options: Any,
    ) -> "SensorIdentifier":
        """Add an identifier and connect its inputs.

        Args:
            builder: the diagram's builder.
            spacecraft: the known spacecraft.
            samples: output ports by sensor, usually `SpacecraftSensors.sample_ports()`; ports of
                sensors that the identifier does not use are left out.
            suite: the sensors.
            options: further arguments of the constructor.

        Raises:
            InputError: a port is missing or has the wrong size; also the errors of the constructor.

        """
        system = SensorIdentifier(spacecraft, suite, **options)
        missing = [name for name in system._sample_ports if name not in samples]
        if missing:
            raise InputError(f"no output port is given for the samples of '{missing[0]}'")
        used = {name: samples[name] for name in system._sample_ports}
        return add_connected(builder, system, used)

    def online_state(self, context: Context) -> OnlineState:
        """Return a copy of the estimator's state in this system's context."""
        return self._memory(context).copy().online

    def _memory(self, context: Context) -> "_Memory":
        return context.get_abstract_state(self._memory_index).get_value()

    def _take_settled(self, context: Context, state: State) -> EventStatus:
        """Process all samples before this instant; those of this instant wait for the next update.

        Samples of one instant must be processed in `FILTER_ORDER`, but one of them may arrive at an
        earlier update because the sensors' times are rounded.
        """
        return self._take(context, state, _nanoseconds(context.get_time()))

    def _take_all(self, context: Context, state: State) -> EventStatus:
        return self._take(context, state, np.nan)

    def _take(self, context: Context, state: State, now: float) -> EventStatus:
        memory = self._memory(context).copy()
        for rank, (name, port) in enumerate(self._sample_ports.items()):
            stamp, *value = port.Eval(context)
            if not np.isnan(stamp) and stamp != memory.seen[name]:
                memory.seen[name] = stamp
                sample = (_nanoseconds(stamp), rank, name, stamp, np.array(value))
                memory.waiting.append(sample)
        for sample in sorted(memory.waiting, key=lambda sample: sample[:2]):
            at, _, name, stamp, value = sample
            if at != now:
                self._estimator.process(memory.online, name, stamp, value)
        memory.waiting = [sample for sample in memory.waiting if sample[0] == now]
        state.get_mutable_abstract_state(self._memory_index).set_value(memory)
        return EventStatus.Succeeded()

    def _solve(self, context: Context) -> Identification:
        return identification_of_filter(self._estimator, self._memory(context).online)

    def _calc_filter_diagnostics(self, context: Context, output: BasicVector) -> None:
        state = self._memory(context).online.filter
        places = [self._estimator.filter.index(name) for name in _COUNTED]
        output.SetFromVector(
            [
                *state.used[places],
                *state.rejected[places],
                state.momentum_changes,
                state.momentum_change_time,
            ]
        )


@dataclass(eq=False)
class _Memory:
    """The abstract state. A value in a Context is replaced, never changed.

    Attributes:
        online: the estimator's state.
        seen: time of the latest sample of every sensor [s].
        waiting: samples to process later: (time [ns], place in the order, name, stamp, value).

    """

    online: OnlineState
    seen: dict[str, float]
    waiting: list[tuple]

    def copy(self) -> "_Memory":
        """Return a copy that shares the samples, which never change."""
        arrays = {name: value.copy() for name, value in vars(self.online.filter).items()}
        online = replace(
            self.online, filter=FilterState(**arrays), samples=list(self.online.samples)
        )
        return _Memory(online, dict(self.seen), list(self.waiting))

    def __deepcopy__(self, memo: dict) -> "_Memory":
        """Return a copy, for Drake: faster than the generic deep copy."""
        return self.copy()


def _nanoseconds(time: float) -> float:
    """Return a time in whole nanoseconds, which is equal for times that differ by rounding."""
    return np.round(time * 1e9)
