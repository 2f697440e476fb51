"""A spacecraft's sensors as a Drake system."""

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    LeafSystem,
    OutputPort,
)
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from cpid_drake.errors import prefix_errors
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.noise import SensorNoise
from cpid_drake.sensing.sensors import SENSORS
from cpid_drake.sensing.suite import SensorSuite, check_sensors
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.ports import add_connected


class SpacecraftSensors(LeafSystem):
    """Measures a spacecraft's motion, every sensor at its own rate and with its own errors.

    Every sensor takes its sample k at time k / rate and holds it until the next sample. Its error
    depends on the seed and on k only: replays, other Contexts and `noise.add_noise` give the same
    samples. The latest samples are the discrete state.

    .. pydrake_system::

        name: SpacecraftSensors
        input_ports:
        - spacecraft_state
        output_ports:
        - attitude
        - gyro
        - position
        - velocity
        - encoders
        - joint_rates

    - `spacecraft_state`: x = [q; v] of the spacecraft's plant (a target welded on C adds no state).
    - one output (1 + width) for each sensor of the suite: the time [s] of the latest sample, then
      its value as in `Measurements`; NaN before the first. Samples due at the end of a simulation
      need `Simulator.AdvancePendingEvents`.

    Args:
        spacecraft: the known spacecraft.
        suite: its sensors.
        seed: seed of the sensors' random errors, a whole number >= 0.

    Raises:
        InputError: invalid sensors (see `suite.check_sensors`) or an invalid seed; and, when a
            sample is taken, a state that is not finite or without an attitude.

    """

    def __init__(self, spacecraft: Spacecraft, suite: SensorSuite, seed: int = 0) -> None:
        super().__init__()
        self.set_name("spacecraft_sensors")
        check_sensors(suite, "sensors")
        self._spacecraft = spacecraft
        self._noise = SensorNoise(suite, seed)
        self._state_port = self.DeclareVectorInputPort(
            "spacecraft_state", spacecraft.plant.num_multibody_states()
        )
        for name, errors in suite.present().items():
            width = SENSORS[name].width(len(spacecraft.joint_names))
            self._declare_sensor(name, errors.rate, width)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        spacecraft: Spacecraft,
        *,
        spacecraft_state: OutputPort,
        suite: SensorSuite,
        seed: int = 0,
    ) -> "SpacecraftSensors":
        """Add sensors and connect their input.

        Args:
            builder: the diagram's builder.
            spacecraft: the known spacecraft.
            spacecraft_state: x = [q; v], usually `MultibodyPlant.get_state_output_port()`.
            suite: see the constructor.
            seed: see the constructor.

        Raises:
            InputError: the port has the wrong size for this spacecraft; also the errors of the
                constructor.

        """
        system = SpacecraftSensors(spacecraft, suite, seed)
        return add_connected(builder, system, {"spacecraft_state": spacecraft_state})

    def sample_ports(self) -> dict[str, OutputPort]:
        """Return the output ports by sensor, for `SensorIdentifier.AddToBuilder`."""
        return {name: self.GetOutputPort(name) for name in self.suite.present()}

    @property
    def spacecraft(self) -> Spacecraft:
        """The spacecraft that is measured."""
        return self._spacecraft

    @property
    def suite(self) -> SensorSuite:
        """The sensors."""
        return self._noise.suite

    def _declare_sensor(self, name: str, rate: float, width: int) -> None:
        index = self.DeclareDiscreteState(np.full(1 + width, np.nan))

        def update(context: Context, discrete_state: DiscreteValues) -> EventStatus:
            discrete_state.set_value(index, self._sample(name, rate, context))
            return EventStatus.Succeeded()

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(context.get_discrete_state(index).value())

        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=1 / rate, offset_sec=0.0, update=update)
        self.DeclareVectorOutputPort(
            name=name, size=1 + width, calc=calc, prerequisites_of_calc={self.xd_ticket()}
        )

    def _sample(self, name: str, rate: float, context: Context) -> np.ndarray:
        """Return [time, value] of the sample that is due now; its number follows from the time."""
        k = round(context.get_time() * rate)
        state = self._state_port.Eval(context)
        with prefix_errors(f"{self.GetSystemPathname()}: {name} at t = {k / rate:g} s"):
            telemetry = self._spacecraft.to_telemetry(k / rate, state)
        [value] = self._noise.apply(name, SENSORS[name].quantity.ideal(telemetry), first=k)
        return np.concatenate([[k / rate], value])


def log_samples(builder: DiagramBuilder, sensors: SpacecraftSensors) -> dict[str, VectorLogSink]:
    """Log every sensor of a diagram that is being built, each at its own rate.

    Returns:
        The logs by the sensors' names, for `measurements_from_logs`.

    """
    logs = {}
    for name, sensor in sensors.suite.present().items():
        logs[name] = LogVectorOutput(sensors.GetOutputPort(name), builder, 1 / sensor.rate)
        logs[name].set_name(f"{name}_log")
    return logs


def measurements_from_logs(
    sensors: SpacecraftSensors, logs: Mapping[str, VectorLogSink], root_context: Context
) -> Measurements:
    """Return every sample of a run, each once.

    Args:
        sensors: the sensors of the run.
        logs: logs of the sensors' outputs, by name, with at least one entry per sample, as from
            `log_samples`. Sensors without a log have no samples.
        root_context: the diagram's Context after the run. It contains the latest samples, which are
            not in the logs yet.

    """
    context = sensors.GetMyContextFromRoot(root_context)
    samples = {}
    for name, log in logs.items():
        held = sensors.GetOutputPort(name).Eval(context)
        rows = np.hstack([log.FindLog(root_context).data(), held[:, None]]).T
        rows = rows[~np.isnan(rows[:, 0])]
        time, first = np.unique(rows[:, 0], return_index=True)
        samples[name] = Samples(time, rows[first, 1:])
    return Measurements(sensors.spacecraft.joint_names, samples)
