"""The online fit in a diagram: every sample once, equal to the estimator on arrays."""

import numpy as np
import pytest

from cpid_drake import (
    InputError,
    SensorIdentifier,
    identify,
    load_scenario,
    load_sensors,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.estimation.unknowns import PSI
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.sensors import (
    SENSORS,
)

DURATION = 3.5


def scenario_with(suite: str, duration: float = DURATION):
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    scenario.sensors.suite, scenario.sensors.seed = suite, 5
    scenario.identification.estimator = "recursive_fit"
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


@pytest.fixture(scope="module")
def samples(simulation, finished) -> Log:
    """Return all samples of the run."""
    return simulation.log(finished)


@pytest.fixture
def flight(servicer) -> SensorIdentifier:
    return SensorIdentifier(servicer, load_sensors("flight", unstated="exact"))


def show(identifier, context, **shown) -> None:
    """Put stamped samples on the inputs by name, NaN on the others."""
    for name in SENSORS:
        if identifier.HasInputPort(name):
            port = identifier.GetInputPort(name)
            port.FixValue(context, shown.get(name, np.full(port.size(), np.nan)))


def collect(identifier, context, time=None, **shown) -> None:
    """Let one period's update collect what the inputs show."""
    show(identifier, context, **shown)
    if time is not None:
        context.SetTime(time)
    new = context.Clone()
    identifier._collect(context, new.get_mutable_state())
    context.SetStateAndParametersFrom(new)


def give(identifier, context, **shown) -> None:
    """Let the identifier process what its inputs show."""
    show(identifier, context, **shown)
    identifier.Finish(context)


def play(identifier, context, measurements, *, delay=None, until=np.inf) -> None:
    """Show samples as `SpacecraftSensors` would, each `delay` [s] of its sensor after its stamp."""
    delay = delay or {}
    queues = {
        name: (s.time + delay.get(name, 0.0), np.column_stack([s.time, s.value]))
        for name, s in measurements.items()
        if len(s)
    }
    start = min(arrivals[0] for arrivals, _ in queues.values())
    end = max(arrivals[-1] for arrivals, _ in queues.values())
    begin = 0.005 + 0.01 * np.floor(context.get_time() / 0.01)
    for now in np.arange(begin, min(end - min(start, 0.0), until) + 0.01, 0.01):
        shown = {}
        for name, (arrivals, rows) in queues.items():
            k = int(np.searchsorted(arrivals, now)) - 1
            if k >= 0:
                shown[name] = rows[k]
        collect(identifier, context, now, **shown)


def diagnostics(identifier, context) -> dict:
    found = identifier.identification(context)
    state = identifier.online_state(context)
    sums = state.all_sums()
    counts = {"momentum_changes": len(found.momentum_changes)}
    for name in SENSORS:
        counts[f"{name}_rejected"] = found.rejected.get(name, 0)
        counts[f"{name}_used"] = sums[name].used if name in sums else 0
    return counts


def known(identifier, context) -> np.ndarray:
    """Return what is known at the end of the last block, as one vector."""
    state = identifier.online_state(context)
    if state.last is None:
        return np.array([len(state.waiting)])
    gaussian = state.last.posterior
    return np.concatenate([state.last.values[PSI], gaussian.z, gaussian.R.ravel()])


# -- samples -------------------------------------------------------------------------------------


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
    give(flight, context, attitude=[0.0, 1.0, 0.0, 0.0, 0.0], encoders=np.zeros(13))
    for _ in range(3):
        give(flight, context, attitude=bad)
    give(flight, context, attitude=[0.2, 1.0, 0.0, 0.0, 0.0])
    counts = diagnostics(flight, context)
    assert counts["attitude_rejected"] == 1
    assert sum(value for name, value in counts.items() if name.endswith("rejected")) == 1


# -- late samples ---------------------------------------------------------------------------------


def test_samples_that_come_late_are_used_as_if_they_were_punctual(flight, samples):
    """Star tracker and relative navigation deliver 0.3 and 0.1 s late: the same estimate."""
    punctual, late = flight.CreateDefaultContext(), flight.CreateDefaultContext()
    play(flight, punctual, samples)
    play(flight, late, samples, delay={"attitude": 0.3, "position": 0.1})
    for context in (punctual, late):
        flight.Finish(context)
    np.testing.assert_array_equal(known(flight, late), known(flight, punctual))
    assert diagnostics(flight, late) == pytest.approx(diagnostics(flight, punctual), nan_ok=True)


# -- in a full simulation ------------------------------------------------------------------------


def test_it_equals_the_estimator_on_the_logged_samples(simulation, finished, samples):
    """Every sample of the run is used, those of its very end too."""
    identifier, suite = simulation.identifier, simulation.sensors.suite
    context = identifier.GetMyContextFromRoot(finished)
    assert identifier.online_state(context).waiting == ()
    found = identifier.identification(context)
    assert found.sample_count == sum(len(samples[name]) for name in SENSORS)
    batch = identify(simulation.spacecraft, samples, sensors=suite, estimator="recursive_fit")
    np.testing.assert_allclose(found.parameters, batch.parameters, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, batch.covariance, rtol=1e-9)
    assert batch.sample_count == found.sample_count


def test_it_identifies_the_target_in_the_plant(simulation, finished, skewed_target):
    """A target in no file: within 5 σ, consistent, and the momentum stays what it is."""
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
    assert identifier.GetOutputPort("checks_passed").Eval(context)[0] == 1.0
    counts = diagnostics(identifier, context)
    assert counts["gyro_used"] == counts["encoders_used"] == 351
    assert counts["momentum_changes"] == 0
    assert not any(value for name, value in counts.items() if name.endswith("rejected"))


def test_a_log_that_contradicts_its_sensors_fails_a_check(flight, samples):
    """A gyro that scatters much more than declared."""
    context = flight.CreateDefaultContext()
    port = flight.GetOutputPort("checks_passed")
    gyro = samples["gyro"]
    noise = 1e-4 * np.random.default_rng(1).normal(size=gyro.value.shape)
    play(flight, context, samples.updated({"gyro": Samples(gyro.time, gyro.value + noise)}))
    assert flight.identification(context).failures
    assert port.Eval(context)[0] == 0.0


# -- the state -----------------------------------------------------------------------------------


def test_an_update_that_is_not_kept_leaves_the_context_as_it_was(flight, samples):
    """Drake may calculate an update and discard it; the same update must then be due again."""
    context = flight.CreateDefaultContext()
    play(flight, context, samples, until=2.5)
    before = known(flight, context)
    for _ in range(2):
        flight.CalcForcedUnrestrictedUpdate(context, context.Clone().get_mutable_state())
        np.testing.assert_array_equal(known(flight, context), before)
    clone = context.Clone()
    flight.Finish(context)
    assert diagnostics(flight, context)["encoders_used"] == 251
    np.testing.assert_array_equal(known(flight, clone), before)


def test_the_estimator_continues_after_its_incomplete_block(flight, samples, skewed_target):
    """Forced events end a block early; the samples that follow begin another one."""
    context = flight.CreateDefaultContext()
    for stop in (1.7, 2.3, 4.0):
        play(flight, context, samples, until=stop)
        flight.Finish(context)
    counts = diagnostics(flight, context)
    assert counts["encoders_used"] == counts["gyro_used"] == 351
    result = flight.identification(context)
    sigma = np.sqrt(np.diag(result.covariance))
    assert (np.abs(result.parameters - skewed_target.to_vector()) < 5 * sigma).all()


# -- what cannot be ------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [0.0, np.nan, 0.011, "fast"])
def test_a_period_that_would_lose_samples_is_refused(servicer, period):
    with pytest.raises(InputError, match=r"at most 0\.01 s"):
        SensorIdentifier(servicer, load_sensors("flight", unstated="exact"), period=period)
