"""An identifier on an LCM bus knows what it knows when its inputs are connected."""

import numpy as np
import pytest
from drake import lcmt_scope
from pydrake.lcm import DrakeLcm, Subscriber
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from cpid_drake import (
    InputError,
    MomentumIdentifier,
    SensorIdentifier,
    add_lcm,
    identify,
    load_scenario,
    load_sensors,
    read_log,
    shipped_scenario,
)
from cpid_drake.files.resources import models_directory


def scope(values, time=0.0):
    message = lcmt_scope()
    message.utime, message.size = round(1e6 * time), len(values)
    message.value = np.asarray(values, dtype=float).tolist()
    return message.encode()


def test_states_from_messages_are_rows_and_the_estimate_is_a_message(
    servicer, skewed_target, zero_momentum_motion
):
    motion = zero_momentum_motion(skewed_target, 5, seed=8)
    lcm, builder = DrakeLcm("memq://"), DiagramBuilder()
    identifier = add_lcm(
        builder, MomentumIdentifier(servicer, period=1.0), lcm=lcm, channel="ARM", period=0.5
    )
    simulator = Simulator(builder.Build())
    for k, state in enumerate(servicer.to_states(motion)):
        lcm.Publish("ARM_STATE", scope(state, k))
        lcm.HandleSubscriptions(0)
        simulator.AdvanceTo(k + 1.2)
    found = identifier.identification(identifier.GetMyContextFromRoot(simulator.get_context()))
    assert found.sample_count == len(motion)
    truth = skewed_target.to_vector()
    np.testing.assert_allclose(found.parameters, truth, rtol=0, atol=1e-6 * truth[0])
    received = {n: Subscriber(lcm, f"ARM_{n}", lcmt_scope) for n in ("PARAMETERS", "COVARIANCE")}
    simulator.get_system().ForcedPublish(simulator.get_context())
    lcm.HandleSubscriptions(0)
    sent = received["PARAMETERS"].message.value
    np.testing.assert_allclose(sent, found.parameters, rtol=0, atol=1e-6 * truth[0])
    assert received["PARAMETERS"].message.utime == pytest.approx(
        1e6 * simulator.get_context().get_time(), abs=6e5
    )
    assert received["COVARIANCE"].message.size == 100


@pytest.fixture(scope="module")
def flyer():
    """Return a spacecraft, its sensors and their log."""
    folder = models_directory() / "telemetry"
    spacecraft = load_scenario(shipped_scenario("free_flyer_payload")).spacecraft.make()
    suite = load_sensors(folder / "free_flyer_sensors.yaml")
    return spacecraft, suite, read_log(folder / "free_flyer.csv")


def received(flyer, stream) -> tuple[SensorIdentifier, Simulator]:
    """Return an identifier that got samples as messages, each at its time."""
    spacecraft, suite, _ = flyer
    lcm, builder = DrakeLcm("memq://"), DiagramBuilder()
    identifier = add_lcm(builder, SensorIdentifier(spacecraft, suite, period=0.002), lcm=lcm)
    simulator = Simulator(builder.Build())
    for name, time, value in stream:
        if simulator.get_context().get_time() < time:
            lcm.HandleSubscriptions(0)
            simulator.AdvanceTo(time)
        lcm.Publish(f"CPID_{name.upper()}", scope([time, *value], time))
    lcm.HandleSubscriptions(0)
    simulator.AdvanceTo(simulator.get_context().get_time() + 0.02)
    return identifier, simulator


def test_samples_from_messages_are_the_logs(flyer):
    """Each sensor's channel carries its stamp and its value."""
    spacecraft, suite, log = flyer
    identifier, simulator = received(flyer, log.messages())
    found = identifier.Finish(simulator.get_mutable_context())
    expected = identify(spacecraft, log, sensors=suite, estimator="recursive_fit")
    assert found.sample_count == len(log.messages())
    assert found.passed
    sigma = np.sqrt(np.diag(expected.covariance))
    assert (np.abs(found.parameters - expected.parameters) < 0.1 * sigma).all()


def test_a_sensor_that_stops_adds_nothing(flyer):
    """Its stamp says that its sample is the one before."""
    identifier, simulator = received(flyer, flyer[2].between(0.0, 3.0).messages())
    context = identifier.GetMyContextFromRoot(simulator.get_context())
    counts = []
    for _ in range(2):
        simulator.AdvanceTo(simulator.get_context().get_time() + 3.0)
        counts.append(identifier.identification(context).sample_count)
    assert 0 < counts[0] == counts[1] <= 4 * 301


def test_a_state_that_stays_is_not_counted_again(servicer, skewed_target, zero_momentum_motion):
    """The sender stopped after two samples."""
    motion = zero_momentum_motion(skewed_target, 2, seed=8)
    lcm, builder = DrakeLcm("memq://"), DiagramBuilder()
    identifier = add_lcm(builder, MomentumIdentifier(servicer, period=1.0), lcm=lcm)
    simulator = Simulator(builder.Build())
    for k, state in enumerate(servicer.to_states(motion)):
        lcm.Publish("CPID_STATE", scope(state, k))
        lcm.HandleSubscriptions(0)
        simulator.AdvanceTo(k + 1.2)
    with pytest.raises(InputError, match="CPID_STATE: no message has come since the last sample"):
        simulator.AdvanceTo(3.2)
    context = identifier.GetMyContextFromRoot(simulator.get_context())
    assert identifier.identification(context).sample_count == 2


def test_what_does_not_fit_is_refused(servicer):
    with pytest.raises(InputError, match="period"):
        add_lcm(DiagramBuilder(), MomentumIdentifier(servicer), period=0.0)
    builder = DiagramBuilder()
    wrong = builder.AddSystem(ConstantVectorSource(np.zeros(3)))
    with pytest.raises(InputError, match="has 3 entries"):
        add_lcm(
            builder,
            MomentumIdentifier(servicer),
            lcm=DrakeLcm("memq://"),
            state=wrong.get_output_port(),
        )
    lcm, builder = DrakeLcm("memq://"), DiagramBuilder()
    add_lcm(builder, MomentumIdentifier(servicer), lcm=lcm)
    simulator = Simulator(builder.Build())
    lcm.Publish("CPID_STATE", scope([1.0, 2.0]))
    lcm.HandleSubscriptions(0)
    with pytest.raises(InputError, match="CPID_STATE: a message has 2 numbers"):
        simulator.AdvanceTo(1.1)
