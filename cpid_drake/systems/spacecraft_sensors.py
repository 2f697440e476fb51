"""A spacecraft's sensors as a Drake system."""

from collections.abc import Mapping
from typing import Self

import numpy as np
from pydrake.systems.framework import (
    Context,
    ContinuousState,
    DiagramBuilder,
    DiscreteStateIndex,
    DiscreteValues,
    EventStatus,
    OutputPort,
)
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from cpid_drake.dynamics.motion import Motion
from cpid_drake.files.errors import InputError, prefix_errors
from cpid_drake.identification.arguments import PathLike, resolve_sensors
from cpid_drake.logs.log import Log, Samples, first_sample
from cpid_drake.logs.simulated_noise import SensorNoise
from cpid_drake.sensors.sensors import SENSORS, SensorErrors
from cpid_drake.sensors.suite import SensorSuite, check_sensors, require_encoders
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.spacecraft.spacecraft_argument import require_spacecraft
from cpid_drake.systems.ports import SpacecraftSystem


class SpacecraftSensors(SpacecraftSystem):
    """Measures a spacecraft's motion, every sensor at its own rate and with its own errors.

    Every sensor takes its sample k at time k / rate and holds it until the next sample that is not
    lost in a dropout. Its error depends on the seed and on k only: replays, other Contexts and
    `simulated_noise.add_noise` give the same samples. The latest samples are the discrete
    state. The stamp of a sample is k / rate by the sensor's clock, which is late and drifts as the
    seed says; it can therefore differ from the time of the Context.

    A gyro that integrates measures the mean of the angular velocity since its sample before. The
    integral of the angular velocity is then continuous state, and the first sample has k = 1.

    .. pydrake_system::

        name: SpacecraftSensors
        input_ports:
        - state
        - efforts
        output_ports:
        - attitude
        - gyro
        - position
        - velocity
        - encoders
        - joint_rates

    - `state`: x = [q; v] of the spacecraft's plant (a target welded on C adds no state).
    - `efforts` (J), if the joints are flexible: of the motors [N·m or N].
    - one output (1 + width) for each sensor of the suite: the stamp [s] of the latest sample, then
      its value as in `Log`; NaN before the first. Samples due at the end of a simulation
      need `Simulator.AdvancePendingEvents`.

    Args:
        spacecraft: the spacecraft model.
        suite: its sensors.
        seed: seed of the sensors' random errors, a whole number >= 0.
        joint_compliance: of all joints, whose encoders are before the spring, on the motor: they
            show the joint plus so much per effort [rad/(N·m) or m/N].

    Attributes:
        spacecraft, suite: as given.
        noise: the errors of the samples, with the values of the constant errors.

    Raises:
        InputError: invalid sensors (see `suite.check_sensors`), no encoders of a spacecraft with
            joints, joint rates of flexible joints, or an invalid seed; and, when a sample is taken,
            a state that is not finite or without an attitude.

    """

    def __init__(
        self,
        spacecraft: Spacecraft,
        suite: SensorSuite | PathLike,
        seed: int = 0,
        joint_compliance: float = 0.0,
    ) -> None:
        super().__init__()
        self.set_name("spacecraft_sensors")
        require_spacecraft(spacecraft)
        suite = resolve_sensors(suite) or SensorSuite()
        check_sensors(suite, "sensors")
        if spacecraft.joint_names:
            require_encoders(suite, "sensors")
        self.spacecraft, self.suite, self.noise = spacecraft, suite, SensorNoise(suite, seed)
        self._state_port = self.DeclareVectorInputPort(
            "state", spacecraft.plant.num_multibody_states()
        )
        self._joint_compliance = joint_compliance
        if joint_compliance:
            if suite.joint_rates is not None:
                raise InputError("sensors: joint_rates of flexible joints cannot be simulated")
            self.DeclareVectorInputPort("efforts", len(spacecraft.joint_names))
        self._is_integrating = any(first_sample(errors) for errors in suite.present().values())
        if self._is_integrating:
            self.DeclareContinuousState(3)  # the integral of w_WB_B [rad]
        for name, errors in suite.present().items():
            width = SENSORS[name].width_of(len(spacecraft.joint_names))
            self._declare_sensor(name, errors, width)

    @classmethod
    def AddToBuilder(
        cls,
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        state: OutputPort,
        suite: SensorSuite | PathLike,
        seed: int = 0,
        efforts: OutputPort | None = None,
        joint_compliance: float = 0.0,
    ) -> Self:
        """Add the sensors to a diagram and connect their input; for the options see the class.

        Raises:
            InputError: `state` is not that of this spacecraft.

        """
        sensors = cls(spacecraft, suite, seed, joint_compliance)
        return sensors.connected(builder, state=state, efforts=efforts)

    def sample_ports(self) -> dict[str, OutputPort]:
        """Return the output ports by sensor, for `SensorIdentifier.AddToBuilder`."""
        return {name: self.GetOutputPort(name) for name in self.suite.present()}

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Set the derivative of the integral of the angular velocity, if a gyro needs it."""
        if self._is_integrating:
            w_WB_B = SENSORS["gyro"].ideal(self._motion(context, context.get_time()))[0]
            derivatives.get_mutable_vector().SetFromVector(w_WB_B)

    def _declare_sensor(self, name: str, errors: SensorErrors, width: int) -> None:
        index = self.DeclareDiscreteState(np.full(1 + width, np.nan))
        integrates, start = bool(first_sample(errors)), DiscreteStateIndex(0)
        if integrates:  # time and integral at the sample before
            start = self.DeclareDiscreteState(np.full(4, np.nan))

        def update(context: Context, discrete_state: DiscreteValues) -> EventStatus:
            k = round(context.get_time() * errors.rate)
            if integrates:
                integral = context.get_continuous_state_vector().CopyToVector()
                before = context.get_discrete_state(start).value()
                discrete_state.set_value(start, np.append(k / errors.rate, integral))
                if np.isnan(before[0]):
                    return EventStatus.Succeeded()
                ideal = (integral - before[1:]) / (k / errors.rate - before[0])
                motion = None
            else:
                motion = self._motion(context, k / errors.rate, name)
                [ideal] = SENSORS[name].ideal(motion)
                if name == "encoders" and self._joint_compliance:
                    efforts = self.GetInputPort("efforts").Eval(context)
                    ideal = ideal + self._joint_compliance * efforts
            if self.noise.is_lost(name, k + 1)[k]:
                return EventStatus.DidNothing()
            [value] = self.noise.apply(name, ideal[None], k, motion)
            stamp = self.noise.constants(name, width).stamp(k / errors.rate)
            discrete_state.set_value(index, np.append(stamp, value))
            return EventStatus.Succeeded()

        self.DeclarePeriodicDiscreteUpdateEvent(
            period_sec=1 / errors.rate, offset_sec=0.0, update=update
        )
        self.DeclareStateOutputPort(name, index)

    def _motion(self, context: Context, time: float, name: str = "motion") -> Motion:
        """Return the true motion of the current state, stamped with a time [s]."""
        state = self._state_port.Eval(context)
        with prefix_errors(f"{self.GetSystemPathname()}: {name} at t = {time:g} s"):
            return self.spacecraft.to_motion(time, state)


def log_samples(builder: DiagramBuilder, sensors: SpacecraftSensors) -> dict[str, VectorLogSink]:
    """Log every sensor of a diagram that is being built, by its name, each at its own rate."""
    logs = {}
    for name, sensor in sensors.suite.present().items():
        logs[name] = LogVectorOutput(sensors.GetOutputPort(name), builder, 1 / sensor.rate)
        logs[name].set_name(f"{name}_log")
    return logs


def measurements_from_logs(
    sensors: SpacecraftSensors, logs: Mapping[str, VectorLogSink], root_context: Context
) -> Log:
    """Return every sample of a run, each once.

    The logs are those of `log_samples`. The diagram's Context after the run has the latest samples,
    which are not in the logs yet.
    """
    context = sensors.GetMyContextFromRoot(root_context)
    samples = {}
    for name, log in logs.items():
        held = sensors.GetOutputPort(name).Eval(context)
        rows = np.hstack([log.FindLog(root_context).data(), held[:, None]]).T
        rows = rows[~np.isnan(rows[:, 0])]
        time, first = np.unique(rows[:, 0], return_index=True)
        samples[name] = Samples(time, rows[first, 1:])
    return Log(sensors.spacecraft.joint_names, samples)
