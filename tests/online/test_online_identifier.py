"""Samples of a robot's own loop: in any order, repeated, lost or late, they give one target."""

import pickle
import threading

import numpy as np
import pytest

from cpid_drake import (
    InputError,
    OnlineIdentifier,
    identify,
    load_scenario,
    load_sensors,
    make_simulation,
    shipped_scenario,
)
from cpid_drake.logs.log import Log

SENSORS = load_sensors("flight", unstated="exact")


def log_of(duration: float) -> Log:
    """Return the samples of a simulated motion."""
    scenario = load_scenario(shipped_scenario("exciting_motion"))
    scenario.sensors.suite, scenario.sensors.seed = "flight", 5
    scenario.simulation.duration = duration
    scenario.simulation.simulator.accuracy = 1e-6
    simulation = make_simulation(scenario)
    return simulation.log(simulation.run())


@pytest.fixture(scope="module")
def log() -> Log:
    return log_of(6.0)


def messages(log: Log) -> list[tuple]:
    """Return all samples in the order of their stamps."""
    rows = [(t, name, v) for name, s in log.items() for t, v in zip(s.time, s.value, strict=True)]
    return sorted(rows, key=lambda row: row[:2])


def fed(identifier: OnlineIdentifier, rows) -> OnlineIdentifier:
    for time, name, value in rows:
        identifier.add(name, time, value)
    return identifier


def shuffled(rows, by: float, seed: int = 1) -> list[tuple]:
    """Return messages, each delayed by up to `by` [s]."""
    late = np.random.default_rng(seed).uniform(0, by, len(rows))
    order = np.argsort([row[0] + each for row, each in zip(rows, late, strict=True)])
    return [rows[k] for k in order]


def assert_same(one, other, sigma: float):
    """Assert that two estimates differ by less than a share of σ, and that σ are the same."""
    size = np.sqrt(np.diag(other.covariance))
    assert np.abs((one.parameters - other.parameters) / size).max() < sigma
    np.testing.assert_allclose(np.sqrt(np.diag(one.covariance)) / size, 1, atol=0.02)


@pytest.fixture(scope="module")
def in_order(servicer, log):
    return fed(OnlineIdentifier(servicer, SENSORS), messages(log)).finish()


def test_it_is_the_fit_of_all_samples(servicer, log, in_order):
    """To 0.1 σ with the default window, to 0.01 σ with one as long as the log."""
    whole = identify(servicer, log, sensors=SENSORS, momentum="zero")
    assert_same(in_order, whole, 0.1)
    wide = fed(OnlineIdentifier(servicer, SENSORS, window=np.inf), messages(log)).finish()
    assert_same(wide, whole, 0.01)
    assert in_order.passed


def test_the_residuals_are_those_of_the_last_blocks_as_large_as_declared(in_order, log):
    assert in_order.residuals.keys() == {*SENSORS.present()} - {"encoders", "joint_rates"}
    for name, rest in in_order.residuals.items():
        assert 3.0 < rest.time[0] < rest.last_time <= 6.0
        assert 0.6 < np.sqrt(np.mean(rest.value**2)) < 1.4, name


def test_messages_in_any_order_within_the_lateness_give_the_same(servicer, log, in_order):
    rows = messages(log)
    for by in (0.05, 0.45):
        found = fed(OnlineIdentifier(servicer, SENSORS), shuffled(rows, by)).finish()
        np.testing.assert_allclose(found.parameters, in_order.parameters, rtol=1e-9)
        assert sum(found.rejected.values()) == sum(in_order.rejected.values())


def test_repeated_messages_are_rejected_and_do_no_harm(servicer, log, in_order):
    rows = messages(log)
    twice = sorted([*rows, *rows[::10]], key=lambda row: row[:2])
    found = fed(OnlineIdentifier(servicer, SENSORS), twice).finish()
    np.testing.assert_allclose(found.parameters, in_order.parameters, rtol=1e-9)
    assert sum(found.rejected.values()) - sum(in_order.rejected.values()) == len(rows[::10])


@pytest.mark.parametrize("in_order", [True, False])
def test_the_zero_of_the_stamps_does_not_matter(servicer, log, in_order):
    """Seconds since 1970 are as good as those from the start, to the digits of numbers."""
    rows = messages(log)
    zero = 1.7e9
    given = [(zero + time, name, value) for time, name, value in rows]
    rounded = [(time - zero, name, value) for time, name, value in given]
    since = fed(OnlineIdentifier(servicer, SENSORS, in_order=in_order), given).finish()
    other = fed(OnlineIdentifier(servicer, SENSORS, in_order=in_order), rounded).finish()
    assert_same(since, other, 1e-3)
    assert since.sample_count == other.sample_count


def test_lost_messages_cost_their_information_only(servicer, log, in_order):
    kept = [row for k, row in enumerate(messages(log)) if k % 5]
    found = fed(OnlineIdentifier(servicer, SENSORS), kept).finish()
    size = np.sqrt(np.diag(found.covariance))
    assert np.abs((found.parameters - in_order.parameters) / size).max() < 2
    assert found.passed


def test_messages_beyond_the_lateness_are_counted_and_not_used(servicer, log, in_order):
    rows = messages(log)
    late = [row for row in rows if row[1] == "attitude" and 2.0 < row[0] < 3.0]
    on_time = [row for row in rows if not (row[1] == "attitude" and 2.0 < row[0] < 3.0)]
    identifier = fed(OnlineIdentifier(servicer, SENSORS), on_time)
    found = fed(identifier, late).finish()
    assert found.rejected["attitude"] == len(late) + in_order.rejected.get("attitude", 0)
    without = fed(OnlineIdentifier(servicer, SENSORS), on_time).finish()
    np.testing.assert_allclose(found.parameters, without.parameters, rtol=1e-9)


def test_samples_of_a_block_that_is_solved_are_counted_and_not_used(servicer, log):
    """A tracker that is silent from 2 s on sends a second of it when the others are at 5 s."""
    rows = [row for row in messages(log) if row[1] != "attitude" or row[0] < 3.0]
    late = [row for row in rows if row[1] == "attitude" and row[0] > 2.0]
    on_time = [row for row in rows if row[1] != "attitude" or row[0] <= 2.0]
    first = sum(row[0] < 5.0 for row in on_time)
    given = [*on_time[:first], *late, *on_time[first:]]
    found, without = (
        fed(OnlineIdentifier(servicer, SENSORS), each).finish() for each in (given, on_time)
    )
    assert found.rejected.get("attitude", 0) - without.rejected.get("attitude", 0) == len(late) > 2
    assert found.sample_count == without.sample_count


@pytest.mark.parametrize("how", ["pickled", "state"])
def test_it_continues_from_what_was_saved(servicer, log, in_order, how):
    rows = messages(log)
    half = len(rows) // 2
    before = fed(OnlineIdentifier(servicer, SENSORS), rows[:half])
    if how == "pickled":
        after = pickle.loads(pickle.dumps(before))
    else:
        after = OnlineIdentifier(servicer, SENSORS)
        after.state = pickle.loads(pickle.dumps(before.state))
    found = fed(after, rows[half:]).finish()
    np.testing.assert_allclose(found.parameters, in_order.parameters, rtol=1e-9)
    assert before.estimate().sample_count < found.sample_count


def test_threads_may_share_it(servicer, log, in_order):
    """One thread for each sensor; every half second they wait for each other."""
    identifier, rows = OnlineIdentifier(servicer, SENSORS), messages(log)
    names = [name for name, samples in log.items() if len(samples)]
    gate = threading.Barrier(len(names))

    def feed(name: str) -> None:
        for k in range(16):
            fed(identifier, (r for r in rows if r[1] == name and r[0] // 0.4 == k)).estimate()
            gate.wait(timeout=120)

    threads = [threading.Thread(target=feed, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    found = identifier.finish()
    np.testing.assert_allclose(found.parameters, in_order.parameters, rtol=1e-9, atol=1e-12)


def test_an_estimate_before_the_first_block_knows_nothing(servicer):
    found = OnlineIdentifier(servicer, SENSORS).estimate()
    assert found.sample_count == 0
    assert not found.rank


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("gyroscope", 0.0, [0, 0, 0]), "no sensor 'gyroscope'.*gyro"),
        (("gyro", 0.0, [0, 0]), "a sample has 3 entries, not 2"),
        (("gyro", np.nan, [0, 0, 0]), "is no stamp"),
        (("gyro", "now", [0, 0, 0]), "a time and numbers"),
        (("gyro", 0.0, "fast"), "a time and numbers"),
    ],
)
def test_a_sample_that_is_none_is_refused(servicer, arguments, message):
    with pytest.raises(InputError, match=message):
        OnlineIdentifier(servicer, SENSORS).add(*arguments)


@pytest.mark.parametrize("option", [{"lateness": -1.0}, {"window": 0}, {"most_linearizations": 0}])
def test_options_that_mean_nothing_are_refused(servicer, option):
    with pytest.raises(InputError, match="must be positive"):
        OnlineIdentifier(servicer, SENSORS, **option)


def test_a_value_that_is_not_finite_is_counted(servicer, log):
    identifier = fed(OnlineIdentifier(servicer, SENSORS), messages(log)[:500])
    identifier.add("gyro", 2.7, [np.nan, 0, 0])
    assert identifier.finish().rejected["gyro"] >= 1


@pytest.mark.slow
def test_its_memory_does_not_grow(servicer):
    """The state after 18 s is no larger than after 11 s."""
    identifier, sizes = OnlineIdentifier(servicer, SENSORS), dict[int, int]()
    for row in messages(log_of(18.0)):
        fed(identifier, [row])
        if int(row[0]) not in sizes:
            sizes[int(row[0])] = len(pickle.dumps(identifier.state))
    assert max(sizes[k] for k in (14, 15, 16, 17)) < 1.2 * max(sizes[k] for k in (9, 10, 11))


@pytest.mark.slow
def test_changes_of_the_momentum_have_the_time_of_the_stamps(servicer):
    """A firing of 0.1 s, 2.5 s after the first sample."""
    scenario = load_scenario(shipped_scenario("thruster_firing"))
    scenario.sensors.suite, scenario.sensors.seed = "flight", 5
    scenario.simulation.duration = 5.0
    scenario.simulation.simulator.accuracy = 1e-6
    scenario.simulation.burns[0].time = 2.5
    simulation = make_simulation(scenario)
    rows = messages(simulation.log(simulation.run()))
    given = [(1000.0 + time, name, value) for time, name, value in rows]
    found = fed(OnlineIdentifier(servicer, SENSORS), given).finish()
    assert found.momentum_changes
    assert all(abs(time - 1002.5) < 1.0 for time in found.momentum_changes)
