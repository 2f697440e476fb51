"""Sensors in a diagram: the same samples as the array model's, at their times, in the Context."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput
from scipy.spatial.transform import Rotation
from sensing_cases import every_sensor

from cpid_drake import InputError, Motion
from cpid_drake.logs.log import ideal_log, sample_times
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import SENSORS, Gyro
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.systems.spacecraft_sensors import (
    SpacecraftSensors,
    log_samples,
    measurements_from_logs,
)

DURATION = 2.0


@pytest.fixture
def suite() -> SensorSuite:
    return every_sensor()


@pytest.fixture(scope="module")
def motion(servicer):
    """Return a function (times) -> Motion of a base that turns and joints that swing."""

    def make(times) -> Motion:
        t = np.atleast_1d(times)[:, None]
        speeds = 0.1 + 0.05 * np.arange(len(servicer.joint_names))
        attitude = Rotation.from_rotvec(t * [0.2, -0.5, 0.3])
        return Motion(
            servicer.joint_names,
            t[:, 0],
            quaternion_WB=attitude.as_quat(scalar_first=True),
            p_WB=np.sin(t * [0.1, 0.2, -0.3]),
            w_WB=np.tile([0.2, -0.5, 0.3], (t.size, 1)),
            v_WB=np.cos(t * [0.1, 0.2, -0.3]),
            q=np.sin(t * speeds),
            qdot=np.cos(t * speeds) * speeds,
        )

    return make


class Moving(LeafSystem):
    """The state of a prescribed motion."""

    def __init__(self, spacecraft, motion):
        super().__init__()
        self.DeclareVectorOutputPort(
            "state",
            spacecraft.plant.num_multibody_states(),
            lambda context, output: output.SetFromVector(
                spacecraft.to_states(motion(context.get_time()))[0]
            ),
        )


@pytest.fixture
def diagram(servicer, suite, motion):
    """Return a function (seed, per_step) -> (diagram, sensors, logs) of the moving spacecraft."""

    def make(seed=3, per_step=False):
        builder = DiagramBuilder()
        source = builder.AddSystem(Moving(servicer, motion))
        sensors = SpacecraftSensors.AddToBuilder(
            builder, servicer, state=source.get_output_port(), suite=suite, seed=seed
        )
        if per_step:
            ports = {name: sensors.GetOutputPort(name) for name in suite.present()}
            logs = {name: LogVectorOutput(port, builder) for name, port in ports.items()}
        else:
            logs = log_samples(builder, sensors)
        return builder.Build(), sensors, logs

    return make


def run(diagram, duration=DURATION):
    simulator = Simulator(diagram)
    simulator.AdvanceTo(duration)
    simulator.AdvancePendingEvents()
    return simulator.get_context().Clone()


def assert_same(found, expected, atol=1e-12):
    assert found.joint_names == expected.joint_names
    for name in SENSORS:
        one, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_array_equal(one.time, other.time)
        np.testing.assert_allclose(one.value, other.value, rtol=0, atol=atol)


def latest(sensors, context) -> dict:
    return {name: sensors.GetOutputPort(name).Eval(context) for name in sensors.suite.present()}


@pytest.mark.parametrize(("per_step", "digits"), [(False, None), (True, 4)])
def test_samples_are_those_of_the_array_model(servicer, suite, motion, diagram, per_step, digits):
    """In a diagram one by one, or all at once: the same times, the same errors."""
    suite.decimals = digits
    system, sensors, logs = diagram(seed=3, per_step=per_step)
    found = measurements_from_logs(sensors, logs, run(system))
    perfect = ideal_log(suite, servicer.joint_names, motion, DURATION)
    assert_same(found, add_noise(suite, perfect, seed=3))
    for name, sensor in suite.present().items():
        times = getattr(found, name).time
        np.testing.assert_array_equal(times, sample_times(sensor.rate, DURATION))


def test_constant_errors_are_those_of_the_array_model(servicer, suite, motion, diagram):
    """Late and early stamps, lever arms and a gyro that integrates: the same in a diagram."""
    suite.attitude.mounting_arcsec = 100.0
    suite.gyro = Gyro(50.0, 0.07, 1.0, scale_ppm=400.0, misalignment_arcsec=90.0, integrates=True)
    suite.position.lever_arm_mm = suite.velocity.lever_arm_mm = 40.0
    suite.encoders.zero_mrad = 2.0
    suite.position.dropouts = suite.gyro.dropouts = 200.0
    suite.position.dropout_length = suite.gyro.dropout_length = 0.3
    suite.joint_rates = None  # their stamps belong to the clock of the encoders
    for errors in suite.present().values():
        errors.delay_ms = 15.0
    system, sensors, logs = diagram(seed=3)
    found = measurements_from_logs(sensors, logs, run(system))
    ideal = ideal_log(suite, servicer.joint_names, motion, DURATION)
    expected = add_noise(suite, ideal, seed=3)
    assert_same(found, expected, atol=1e-7)
    delays = {name: sensors.noise.constants(name).delay for name in suite.present()}
    assert min(delays.values()) < 0 < max(delays.values())
    assert found.encoders.time[0] == delays["encoders"]
    assert 3 < len(found.position) < 14, "some samples are lost, some are not"
    assert 10 < len(found.gyro) < 99


def test_all_state_is_in_the_context(diagram):
    """Two interleaved runs, and one that goes on from a copy, do not disturb each other."""
    system, sensors, _ = diagram(seed=7)
    whole = latest(sensors, sensors.GetMyContextFromRoot(run(system)))
    one, other = Simulator(system), Simulator(system)
    one.AdvanceTo(0.8)
    copy = Simulator(system, one.get_context().Clone())
    other.AdvanceTo(1.3)
    for simulator in (one, copy):
        simulator.AdvanceTo(DURATION)
        simulator.AdvancePendingEvents()
        found = latest(sensors, sensors.GetMyContextFromRoot(simulator.get_context()))
        for name, value in whole.items():
            np.testing.assert_array_equal(found[name], value)
    interrupted = latest(sensors, sensors.GetMyContextFromRoot(other.get_context()))
    assert interrupted["attitude"][0] == 1.25
    context = sensors.CreateDefaultContext()
    assert context.num_continuous_states() == 0
    assert context.num_discrete_state_groups() == 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ((slice(20, 21), np.nan), "'w_WB' is not finite"),
        ((slice(0, 4), 3.0), "quaternion_WB is not of unit norm"),
    ],
)
def test_a_state_that_means_nothing_is_refused(servicer, suite, motion, change, message):
    state = servicer.to_states(motion(0.0))[0]
    state[change[0]] = change[1]
    builder = DiagramBuilder()
    source = builder.AddSystem(ConstantVectorSource(state))
    SpacecraftSensors.AddToBuilder(builder, servicer, state=source.get_output_port(), suite=suite)
    simulator = Simulator(builder.Build())
    with pytest.raises(InputError, match=rf"spacecraft_sensors: \w+ at t = 0 s: .*{message}"):
        simulator.AdvanceTo(0.1)
