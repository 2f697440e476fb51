"""The momentum filter in a diagram: every sample once, equal to the estimator on arrays."""

import numpy as np
import pytest
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from cpid_drake import (
    InputError,
    SensorIdentifier,
    SensorSuite,
    SpacecraftSensors,
    identify,
    load_scenario,
    load_sensors,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.estimation.momentum_filter import FILTER_ORDER
from cpid_drake.estimation.online import in_order
from cpid_drake.identification.filter_estimator import (
    identification_of_filter,
    online_estimator,
)
from cpid_drake.sensing.sensors import SENSORS, AttitudeSensor, Gyro, JointSensor, VectorSensor
from cpid_drake.systems.sensor_identifier import FILTER_DIAGNOSTICS
from cpid_drake.systems.spacecraft_sensors import log_samples, measurements_from_logs

DURATION = 3.5


def scenario_with(suite: str, duration: float = DURATION):
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    scenario.sensors.suite, scenario.sensors.seed = suite, 5
    scenario.identification.estimator = "momentum_filter"
    scenario.simulation.duration = duration
    scenario.simulation.simulator.accuracy = 1e-6
    return scenario


@pytest.fixture(scope="module")
def simulation(skewed_target):
    """Return the exciting motion with the flight suite and a target that no file knows."""
    return make_simulation(scenario_with("flight"), target=skewed_target)


@pytest.fixture(scope="module")
def finished(simulation):
    """Return the root Context after a run."""
    return simulation.run()


@pytest.fixture
def flight(servicer) -> SensorIdentifier:
    return SensorIdentifier(servicer, load_sensors("flight"))


def give(identifier, context, **samples) -> None:
    """Let the identifier take what its inputs show: stamped samples by name, NaN for the others."""
    for name in FILTER_ORDER:
        if identifier.HasInputPort(name):
            port = identifier.GetInputPort(name)
            port.FixValue(context, samples.get(name, np.full(port.size(), np.nan)))
    identifier.ExecuteForcedEvents(context)


def diagnostics(identifier, context) -> dict:
    values = identifier.GetOutputPort("filter_diagnostics").Eval(context)
    return dict(zip(FILTER_DIAGNOSTICS, values, strict=True))


def packed(identifier, context) -> np.ndarray:
    return identifier.online_state(context).filter.pack()


# -- ports ---------------------------------------------------------------------------------------


def test_ports_are_as_documented(servicer):
    everything = SensorSuite(
        attitude=AttitudeSensor(),
        gyro=Gyro(),
        position=VectorSensor(),
        velocity=VectorSensor(),
        encoders=JointSensor(),
        joint_rates=JointSensor(),
    )
    identifier = SensorIdentifier(servicer, everything)
    inputs = {"gyro": 4, "attitude": 5, "encoders": 13, "position": 4, "velocity": 4}
    assert identifier.num_input_ports() == len(inputs)
    for name, size in inputs.items():
        assert identifier.GetInputPort(name).size() == size
    outputs = {"parameters": 10, "covariance": 100, "diagnostics": 4, "filter_diagnostics": 14}
    for name, size in outputs.items():
        assert identifier.GetOutputPort(name).size() == size
    assert len(FILTER_DIAGNOSTICS) == 14
    inertia = identifier.GetOutputPort("spatial_inertia").Allocate().get_value()
    assert isinstance(inertia, SpatialInertia)


def test_there_are_inputs_for_what_is_there_only(flight):
    names = [flight.get_input_port(k).get_name() for k in range(flight.num_input_ports())]
    assert names == ["gyro", "attitude", "encoders", "position"]


def test_outputs_need_no_input(flight):
    assert not flight.HasAnyDirectFeedthrough()


def test_before_the_first_estimate_there_is_none(flight):
    context = flight.CreateDefaultContext()
    assert np.isnan(flight.GetOutputPort("parameters").Eval(context)).all()
    assert np.isnan(flight.GetOutputPort("covariance").Eval(context)).all()
    assert flight.GetOutputPort("spatial_inertia").Eval(context).IsNaN()
    samples, rank, condition, residual = flight.GetOutputPort("diagnostics").Eval(context)
    assert (samples, rank, condition) == (0, 0, np.inf)
    assert np.isnan(residual)
    *counts, time = flight.GetOutputPort("filter_diagnostics").Eval(context)
    assert not any(counts)
    assert np.isnan(time)
    assert "0 samples determine 0 of 10" in flight.identification(context).explain()


# -- samples -------------------------------------------------------------------------------------


def test_a_sample_is_taken_once_however_long_it_is_held(flight):
    context = flight.CreateDefaultContext()
    attitude, encoders = [0.0, 1.0, 0.0, 0.0, 0.0], np.zeros(13)
    give(flight, context)
    for _ in range(3):
        give(flight, context, attitude=attitude, encoders=encoders)
    counts = diagnostics(flight, context)
    assert (counts["attitude_used"], counts["encoders_used"]) == (1, 1)
    give(flight, context, attitude=attitude, encoders=encoders + 0.01 * np.eye(13)[0])
    counts = diagnostics(flight, context)
    assert (counts["attitude_used"], counts["encoders_used"]) == (1, 2)
    assert counts["gyro_used"] == counts["position_used"] == counts["velocity_used"] == 0


@pytest.mark.parametrize(
    "bad",
    [
        [0.1, np.nan, 0.0, 0.0, 0.0],
        [0.1, 3.0, 0.0, 0.0, 0.0],
        [-0.5, 1.0, 0.0, 0.0, 0.0],
        [np.inf, 1.0, 0.0, 0.0, 0.0],
    ],
    ids=["not finite", "no attitude", "from before", "no time"],
)
def test_a_bad_sample_is_counted_once_and_does_no_harm(flight, bad):
    context = flight.CreateDefaultContext()
    give(flight, context, attitude=[0.0, 1.0, 0.0, 0.0, 0.0])
    for _ in range(3):
        give(flight, context, attitude=bad)
    give(flight, context, attitude=[0.2, 1.0, 0.0, 0.0, 0.0])
    counts = diagnostics(flight, context)
    assert (counts["attitude_used"], counts["attitude_rejected"]) == (2, 1)


@pytest.fixture
def uneven() -> SensorSuite:
    """Return sensors whose instants fall together now and then, but for rounding."""
    return SensorSuite(
        attitude=AttitudeSensor(rate=3.0),
        gyro=Gyro(rate=30.0),
        position=VectorSensor(rate=7.0),
        velocity=VectorSensor(rate=29.97),
        encoders=JointSensor(rate=10.0),
        joint_rates=JointSensor(rate=60.0),
    )


@pytest.fixture
def recorded(servicer, uneven, monkeypatch):
    """Return a function (period) -> what an identifier takes of still sensors, and what they gave.

    The instants in the first are (when [s], sensor, stamp [s]).
    """

    def run(period=None, stop=2.0):
        builder = DiagramBuilder()
        state = np.zeros(servicer.plant.num_multibody_states())
        state[servicer.quaternion_columns[0]] = 1.0
        source = builder.AddSystem(ConstantVectorSource(state))
        sensors = SpacecraftSensors.AddToBuilder(
            builder, servicer, spacecraft_state=source.get_output_port(), suite=uneven
        )
        identifier = SensorIdentifier.AddToBuilder(
            builder, servicer, samples=sensors.sample_ports(), suite=uneven, period=period
        )
        logs = log_samples(builder, sensors)
        simulator, taken = Simulator(builder.Build()), []
        root_context = simulator.get_mutable_context()

        def process(state, name, stamp, value):
            taken.append((root_context.get_time(), name, stamp))

        monkeypatch.setattr(identifier._estimator, "process", process)
        simulator.AdvanceTo(stop)
        simulator.AdvancePendingEvents()
        early = len(taken)
        identifier.ExecuteForcedEvents(identifier.GetMyMutableContextFromRoot(root_context))
        return taken, early, measurements_from_logs(sensors, logs, root_context)

    return run


@pytest.mark.parametrize("period", [None, 1 / 30, 0.02, 0.0037])
def test_no_sample_is_lost_and_all_come_in_order(recorded, period):
    """Those of one instant in `FILTER_ORDER`, whatever rounding does to the instants."""
    taken, _, measurements = recorded(period)
    expected = [(name, time) for name, time, _ in in_order(measurements)]
    assert len(expected) == 61 + 7 + 15 + 60 + 21
    assert [sample[1:] for sample in taken] == expected


def test_a_sample_is_seen_one_period_later_at_most(recorded):
    taken, early, _ = recorded()
    delays = [now - stamp for now, _, stamp in taken[:early]]
    assert min(delays) > 0
    assert max(delays) < 1 / 30 + 1e-9
    assert all(stamp > 2 - 1 / 30 - 1e-9 for _, _, stamp in taken[early:])
    assert {name for _, name, _ in taken[early:]} >= {"gyro", "attitude", "encoders", "position"}


def test_sensors_that_stamp_the_very_instant_are_not_lost(servicer, monkeypatch):
    """A source whose stamp is always now, read at that instant: its samples wait one period."""

    class Clock(LeafSystem):
        def __init__(self):
            super().__init__()
            self.set_name("clock")
            self.DeclareVectorOutputPort(
                "encoders",
                13,
                lambda context, output: output.SetFromVector([context.get_time(), *np.zeros(12)]),
            )

    builder, suite = DiagramBuilder(), SensorSuite(encoders=JointSensor(rate=10.0))
    clock = builder.AddSystem(Clock())
    identifier = SensorIdentifier.AddToBuilder(
        builder, servicer, samples={"encoders": clock.get_output_port()}, suite=suite
    )
    stamps = []
    monkeypatch.setattr(
        identifier._estimator, "process", lambda state, name, stamp, value: stamps.append(stamp)
    )
    Simulator(builder.Build()).AdvanceTo(1.05)
    np.testing.assert_allclose(stamps, np.arange(10) / 10, atol=1e-12)


# -- in a full simulation ------------------------------------------------------------------------


def test_it_equals_the_estimator_on_the_logged_samples(simulation, finished):
    """Every sample of the run, those of its very end too; the filter goes on alone by then."""
    identifier, measurements = simulation.identifier, simulation.measurements(finished)
    context = identifier.GetMyContextFromRoot(finished)
    online = online_estimator(simulation.spacecraft, simulation.sensors.suite)
    state = online.run(measurements)
    assert not state.initializing
    expected, found = identification_of_filter(online, state), identifier.identification(context)
    np.testing.assert_allclose(found.parameters, expected.parameters, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-9)
    np.testing.assert_allclose(packed(identifier, context), state.filter.pack(), rtol=1e-9)
    assert found.sample_count == sum(len(getattr(measurements, name)) for name in SENSORS)
    batch = identify(
        simulation.spacecraft,
        measurements,
        sensors=simulation.sensors.suite,
        estimator="momentum_filter",
    )
    np.testing.assert_allclose(found.parameters, batch.parameters, rtol=1e-9)


def test_until_the_end_it_has_taken_all_but_the_last_samples(simulation):
    """After `AdvanceTo` what is due at that instant is pending, and the last period's unseen."""
    simulator = simulation.make_simulator()
    simulator.AdvanceTo(2.0)
    root_context = simulator.get_context()
    identifier = simulation.identifier
    context = identifier.GetMyContextFromRoot(root_context)
    measurements = simulation.measurements(root_context)
    assert measurements.encoders.time[-1] == 1.99
    online = online_estimator(simulation.spacecraft, simulation.sensors.suite)
    state = online.run(measurements.between(0.0, 1.985))
    np.testing.assert_allclose(packed(identifier, context), state.filter.pack(), rtol=1e-9)


def test_it_identifies_the_target_in_the_plant(simulation, finished, skewed_target):
    """A target that no file knows: within 5 σ, feasible, and the momentum stays what it is."""
    identifier = simulation.identifier
    context = identifier.GetMyContextFromRoot(finished)
    parameters = identifier.GetOutputPort("parameters").Eval(context)
    covariance = identifier.GetOutputPort("covariance").Eval(context).reshape(10, 10)
    sigma = np.sqrt(np.diag(covariance))
    error = parameters - skewed_target.to_vector()
    assert (np.abs(error) < 5 * sigma).all()
    assert (sigma < 0.01).all()
    inertia = identifier.GetOutputPort("spatial_inertia").Eval(context)
    assert inertia.IsPhysicallyValid()
    assert inertia.get_mass() == pytest.approx(60.0, abs=0.01)
    counts = diagnostics(identifier, context)
    assert counts["gyro_used"] == counts["encoders_used"] == 351
    assert counts["agreement_used"] > 50
    assert counts["momentum_changes"] == 0
    assert not any(value for name, value in counts.items() if name.endswith("rejected"))


@pytest.mark.parametrize(("time", "initializing"), [(0.9, True), (1.5, False)])
def test_clones_run_on_by_themselves(simulation, time, initializing):
    """Cloned while it still fits and while it filters: the copies run alike and touch no other."""
    identifier = simulation.identifier
    simulator = simulation.make_simulator()
    simulator.AdvanceTo(time)
    context = identifier.GetMyContextFromRoot(simulator.get_context())
    assert identifier.online_state(context).initializing is initializing
    before = packed(identifier, context)
    copies = [Simulator(simulation.diagram, simulator.get_context().Clone()) for _ in range(2)]
    for stop in (time + 0.15, time + 0.3):
        for copy in copies:
            copy.get_mutable_integrator().set_target_accuracy(1e-6)
            copy.AdvanceTo(stop)
    one, other = (
        packed(identifier, identifier.GetMyContextFromRoot(copy.get_context())) for copy in copies
    )
    np.testing.assert_array_equal(one, other)
    assert not np.array_equal(one, before, equal_nan=True)
    np.testing.assert_array_equal(packed(identifier, context), before)
    simulator.AdvanceTo(time + 0.3)
    counts = diagnostics(identifier, context)
    last = identifier.GetMyContextFromRoot(copies[0].get_context())
    assert counts == pytest.approx(diagnostics(identifier, last), nan_ok=True)


def test_a_clone_is_a_copy_and_an_update_changes_only_its_own(flight):
    one = flight.CreateDefaultContext()
    give(flight, one, attitude=[0.0, 1.0, 0.0, 0.0, 0.0], encoders=np.zeros(13))
    other = one.Clone()
    before = flight.online_state(other)
    for k in range(1, 4):
        give(flight, one, encoders=np.concatenate([[0.01 * k], np.full(12, 0.001 * k)]))
    after = flight.online_state(other)
    np.testing.assert_array_equal(after.filter.pack(), before.filter.pack())
    assert len(after.samples) == len(before.samples) == 2
    assert len(flight.online_state(one).samples) == 5
    give(flight, other, encoders=np.concatenate([[0.01], np.full(12, 0.001)]))
    assert len(flight.online_state(other).samples) == 3
    assert len(flight.online_state(one).samples) == 5


def test_an_update_that_is_not_kept_leaves_the_context_as_it_was(flight):
    """Drake may calculate an update and discard it; the same update must then be due again."""
    context = flight.CreateDefaultContext()
    give(flight, context)
    for name, sample in {"attitude": [0.0, 1.0, 0, 0, 0], "encoders": np.zeros(13)}.items():
        flight.GetInputPort(name).FixValue(context, sample)
    for _ in range(2):
        flight.CalcForcedUnrestrictedUpdate(context, context.Clone().get_mutable_state())
        assert flight.online_state(context).filter.used.sum() == 0
    flight.ExecuteForcedEvents(context)
    assert flight.online_state(context).filter.used.sum() == 2


def test_the_state_that_is_handed_out_is_a_copy(flight):
    context = flight.CreateDefaultContext()
    state = flight.online_state(context)
    state.filter.psi[:] = 0.0
    state.samples.append(None)
    assert flight.online_state(context).filter.psi.any()
    assert not flight.online_state(context).samples


def test_the_identifier_knows_no_target(flight):
    """No truth leaks in: what it knows has the spacecraft's mass, and the model's bodies only."""
    tree = flight._estimator.tree
    assert tree.mass == pytest.approx(1031.0)
    prior = flight._estimator.filter.prior
    assert prior.psi_sigma[0] > 3 * prior.psi[0]
    assert not prior.psi[1:4].any()


def test_an_unknown_momentum_is_estimated_along(skewed_target):
    """Within 5 σ of the target, with a momentum that nobody tells it."""
    scenario = scenario_with("flight", duration=5.0)
    scenario.simulation.momentum_W = np.array([3.0, -2.0, 2.5, 2.0, 1.0, -1.5])
    scenario.identification.unknown_momentum = True
    simulation = make_simulation(scenario, target=skewed_target)
    root_context = simulation.run()
    result = simulation.identifier.identification(
        simulation.identifier.GetMyContextFromRoot(root_context)
    )
    sigma = np.sqrt(np.diag(result.covariance))
    assert (np.abs(result.parameters - skewed_target.to_vector()) < 5 * sigma).all()
    assert (sigma < 0.1).all()


# -- what cannot be ------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan, np.inf, 0.011, "fast"])
def test_a_period_that_would_lose_samples_is_refused(servicer, period):
    with pytest.raises(InputError, match=r"at most 0\.01 s"):
        SensorIdentifier(servicer, load_sensors("flight"), period=period)


def test_sensors_that_cannot_be_are_refused(servicer):
    with pytest.raises(InputError, match="encoders are missing"):
        SensorIdentifier(servicer, SensorSuite(gyro=Gyro()))


def test_wiring_other_sensors_is_refused(servicer):
    builder, flight = DiagramBuilder(), load_sensors("flight")
    sensors = builder.AddSystem(SpacecraftSensors(servicer, SensorSuite(encoders=JointSensor())))
    with pytest.raises(InputError, match="no output port is given for the samples of 'gyro'"):
        SensorIdentifier.AddToBuilder(
            builder, servicer, samples=sensors.sample_ports(), suite=flight
        )


def test_wiring_a_port_of_another_size_is_refused(servicer):
    class Few(LeafSystem):
        def __init__(self):
            super().__init__()
            self.DeclareVectorOutputPort("encoders", 7, lambda context, output: None)

    builder = DiagramBuilder()
    few = builder.AddSystem(Few())
    with pytest.raises(InputError, match="'encoders' has 7 entries"):
        SensorIdentifier.AddToBuilder(
            builder,
            servicer,
            samples={"encoders": few.get_output_port()},
            suite=SensorSuite(encoders=JointSensor()),
        )
