"""An identifier on LCM: what it receives is what it identifies from, and it sends what it knows."""

import numpy as np
import pytest
from drake import lcmt_scope
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from cpid_drake import (
    InputError,
    MomentumIdentifier,
    OnlineIdentifier,
    SensorIdentifier,
    add_lcm,
    load_scenario,
    load_sensors,
    make_simulation,
    shipped_scenario,
)

SENSORS = load_sensors("flight", unstated="exact")
PERIOD = 0.005


@pytest.fixture(scope="module")
def stream() -> list[tuple]:
    """Return the samples of a simulated motion in the order of their stamps."""
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    scenario.sensors.suite, scenario.sensors.seed = "flight", 5
    scenario.simulation.duration = 3.5
    scenario.simulation.simulator.accuracy = 1e-6
    simulation = make_simulation(scenario)
    return simulation.log(simulation.run()).messages()


class Robot:
    """A sender on a bus of its own, and a receiver of what the identifier sends."""

    def __init__(self, identifier, **options):
        self.bus, self.seen, builder = DrakeLcm("memq://"), {}, DiagramBuilder()
        add_lcm(builder, identifier, lcm=self.bus, **options)
        self.identifier, self.simulator = identifier, Simulator(builder.Build())

    def listen(self, channel: str) -> None:
        def take(data: bytes) -> None:
            message = lcmt_scope.decode(data)
            rows = self.seen.setdefault(channel, [])
            rows.append((1e-6 * message.utime, np.array(message.value)))

        self.bus.Subscribe(channel, take)

    def send(self, channel: str, stamp: float, value) -> None:
        message = lcmt_scope()
        message.utime, message.value = round(1e6 * stamp), list(value)
        message.size = len(message.value)
        self.bus.Publish(channel, message.encode())

    def run(self, stream, zero: float = 0.0, prefix: str = "CPID_") -> None:
        """Send every sample at its time by the diagram's clock, with a stamp from another zero."""
        for name, stamp, value in stream:
            self.simulator.AdvanceTo(max(stamp, self.now))
            self.send(prefix + name, zero + stamp, value)
        self.simulator.AdvanceTo(self.now + 4 * PERIOD)

    @property
    def now(self) -> float:
        return self.simulator.get_context().get_time()


def identifier_of(servicer) -> SensorIdentifier:
    return SensorIdentifier(servicer, SENSORS, period=PERIOD)


@pytest.mark.parametrize("zero", [0.0, 1.7e9])
def test_it_identifies_from_the_messages(servicer, stream, zero):
    """Also with stamps since 1970; no message is lost, and those that follow change nothing."""
    robot = Robot(identifier_of(servicer))
    robot.run(stream, zero)
    found = robot.identifier.Finish(robot.simulator.get_mutable_context())
    online = OnlineIdentifier(servicer, SENSORS, in_order=True)
    for name, stamp, value in stream:
        online.add(name, stamp, value)
    expected = online.finish()
    sigma = np.sqrt(np.diag(expected.covariance))
    assert found.sample_count == expected.sample_count
    assert np.abs((found.parameters - expected.parameters) / sigma).max() < 0.02
    assert found.passed


def test_it_sends_what_it_knows(servicer, stream):
    robot = Robot(identifier_of(servicer), prefix="ARM_", period=0.5)
    outputs = {"parameters": 10, "covariance": 100, "diagnostics": 4, "checks_passed": 1}
    for name in outputs:
        robot.listen(f"ARM_{name}")
    robot.run(stream, prefix="ARM_")
    robot.bus.HandleSubscriptions(0)
    context = robot.identifier.GetMyContextFromRoot(robot.simulator.get_context())
    found = robot.identifier.identification(context)
    for name, size in outputs.items():
        times, values = zip(*robot.seen[f"ARM_{name}"], strict=True)
        np.testing.assert_allclose(np.diff(times), 0.5)
        assert {each.shape for each in values} == {(size,)}
    last = {name: robot.seen[f"ARM_{name}"][-1][1] for name in outputs}
    np.testing.assert_array_equal(last["parameters"], found.parameters)
    np.testing.assert_array_equal(last["covariance"], found.covariance.ravel())
    assert last["diagnostics"][:2].tolist() == [found.sample_count, 10]
    assert last["checks_passed"] == [1.0]
    assert np.isnan(robot.seen["ARM_parameters"][0][1]).all()


def test_a_sender_that_stops_adds_nothing(servicer, stream):
    robot = Robot(identifier_of(servicer))
    robot.run(stream[: len(stream) // 2])
    context = robot.identifier.GetMyContextFromRoot(robot.simulator.get_context())
    robot.simulator.AdvanceTo(robot.now + 2.0)
    before = robot.identifier.identification(context).sample_count
    robot.simulator.AdvanceTo(robot.now + 5.0)
    assert robot.identifier.identification(context).sample_count == before


def test_a_message_of_another_size_is_refused(servicer):
    robot = Robot(identifier_of(servicer))
    robot.send("CPID_gyro", 0.0, [0.0, 0.0])
    with pytest.raises(InputError, match="channel CPID_gyro: a sample has 3 entries, not 2"):
        robot.simulator.AdvanceTo(0.1)


def test_the_outputs_of_an_identifier_in_a_diagram_are_sent(servicer):
    """Its state comes from the diagram."""
    bus, builder = DrakeLcm("memq://"), DiagramBuilder()
    state = builder.AddSystem(
        ConstantVectorSource(
            servicer.plant.GetPositionsAndVelocities(servicer.plant.CreateDefaultContext())
        )
    )
    identifier = MomentumIdentifier.AddToBuilder(builder, servicer, state=state.get_output_port())
    add_lcm(builder, identifier, lcm=bus)
    seen = []
    bus.Subscribe("CPID_diagnostics", lambda data: seen.append(lcmt_scope.decode(data).value))
    Simulator(builder.Build()).AdvanceTo(3.0)
    bus.HandleSubscriptions(0)
    assert [row[0] for row in seen] == [0, 1, 2, 3] or [row[0] for row in seen] == [0, 0, 1, 2]


def test_a_state_without_stamps_is_refused(servicer):
    with pytest.raises(InputError, match="does not see when a sender stops"):
        add_lcm(DiagramBuilder(), MomentumIdentifier(servicer), lcm=DrakeLcm("memq://"))


@pytest.mark.parametrize("period", [0.0, -1.0, np.inf, np.nan])
def test_a_period_that_means_nothing_is_refused(servicer, period):
    with pytest.raises(InputError, match="period of messages"):
        add_lcm(DiagramBuilder(), identifier_of(servicer), period=period)


def test_what_is_no_identifier_is_refused():
    with pytest.raises(InputError, match="must be a SensorIdentifier, not OnlineIdentifier"):
        add_lcm(DiagramBuilder(), OnlineIdentifier.__new__(OnlineIdentifier))
