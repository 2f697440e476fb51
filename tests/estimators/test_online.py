"""The online estimator: from a vague prior to the end of a motion."""

import numpy as np
import pytest
from test_momentum_filter import (
    FIRING,
    NAMES,
    Truth,
    changed,
    check,
    count,
    flight,
    place,
    spike,
    testbed,
    with_value,
)

from cpid_drake.sensor_identification import identification_of_filter, online_estimator

EARLY = 0.5  # while there are fits to make
MOMENTUM = np.array([30.0, -20.0, 25.0, 4.0, 2.0, -3.0])


@pytest.fixture(scope="session")
def truth() -> Truth:
    return Truth()


def run(truth, suite, samples, unknown_momentum=False):
    """Return the state after all samples, and when the filter took over."""
    online = online_estimator(truth.spacecraft, suite, unknown_momentum=unknown_momentum)
    state, handed_over = online.start(), np.nan
    for name, time, value in samples:
        online.take(state, name, time, value)
        if np.isnan(handed_over) and not state.acquiring:
            handed_over = time
    check(state.filter)
    return state.filter, handed_over


# -- consistency ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("suite", "seeds", "duration", "momentum"),
    [(flight, 15, 3.0, None), (testbed, 5, 3.0, None), (flight, 6, 3.0, MOMENTUM)],
    ids=["flight", "no gyro", "unknown momentum"],
)
def test_errors_are_as_large_as_they_are_said_to_be(truth, suite, seeds, duration, momentum):
    errors, nees = [], []
    for seed in range(seeds):
        samples = truth.samples(suite, seed, duration, momentum=momentum)
        state, handed_over = run(truth, suite, samples, momentum is not None)
        assert handed_over < duration
        assert state.momentum_changes == 0
        in_sigma, square = truth.error(state)
        errors.append(in_sigma)
        nees.append(square)
    spread = np.sqrt(20 / seeds)  # of the mean of χ² of 10
    assert 10 - 4 * spread < np.mean(nees) < 10 + 4 * spread
    assert (np.abs(errors) < 4.5).all()


def test_the_same_samples_give_the_same_state(truth):
    samples = truth.samples(flight, 3, 1.5)
    one, other = (run(truth, flight, samples)[0].pack() for _ in range(2))
    np.testing.assert_array_equal(one, other)


# -- firing --------------------------------------------------------------------------------------


@pytest.mark.parametrize("unknown_momentum", [False, True])
def test_a_firing_before_the_filter_runs_alone_begins_anew(truth, unknown_momentum):
    momentum = MOMENTUM if unknown_momentum else None
    samples = truth.samples(flight, 1, 4.0, momentum=momentum, change=FIRING / 10, at=EARLY)
    state, handed_over = run(truth, flight, samples, unknown_momentum)
    assert state.momentum_changes == 1
    assert EARLY < state.momentum_change_time < EARLY + 1.0
    assert handed_over > EARLY + 1.0
    assert (np.abs(truth.error(state)[0]) < 4).all()


def test_a_firing_is_flagged_without_a_gyro(truth):
    samples = truth.samples(testbed, 1, 4.6, change=FIRING, at=3.2)
    state, handed_over = run(truth, testbed, samples)
    assert handed_over < 3.2
    assert state.momentum_changes >= 1
    assert 3.2 < state.momentum_change_time < 4.2
    assert (np.abs(truth.error(state)[0]) < 4).all()


# -- faults while there are fits to make ---------------------------------------------------------


def expect_good(truth, samples, latest=2.5):
    state, handed_over = run(truth, flight, samples)
    assert handed_over < latest
    assert state.momentum_changes == 0
    assert (np.abs(truth.error(state)[0]) < 4.5).all()
    return state


@pytest.fixture(scope="session")
def samples(truth):
    return truth.samples(flight, 1, 2.6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("sigmas", [100, 1e4, 1e17])
def test_spikes(truth, samples, name, sigmas):
    state = expect_good(truth, with_value(samples, name, spike(name, sigmas), EARLY))
    assert count(state, name) >= 1


@pytest.mark.parametrize("name", NAMES)
def test_a_spike_first_of_all(truth, samples, name):
    state = expect_good(truth, with_value(samples, name, spike(name, 1e5), 0.0))
    assert count(state, name) >= 1


@pytest.mark.parametrize("name", NAMES)
def test_bad_values_and_stamps_at_once(truth, samples, name):
    """Not finite, twice the same stamp, out of order, far ahead."""
    at = place(samples, name, EARLY)

    def bad(k, sample):
        _, time, value = sample
        if k == at:
            worse = [(name, time + 1e-3, value * np.nan), (name, time, value)]
            return [sample, *worse, (name, time - 0.2, value), (name, time + 1e4, value)]
        return [sample]

    state = expect_good(truth, changed(samples, name, bad))
    assert count(state, name) == 4


@pytest.mark.parametrize("name", ["gyro", "attitude", "encoders", "all"])
def test_dropouts(truth, samples, name):
    expect_good(
        truth,
        [s for s in samples if not (EARLY < s[1] < EARLY + 0.4 and name in (s[0], "all"))],
    )


@pytest.mark.parametrize("name", ["gyro", "position"])
def test_a_stuck_sensor(truth, samples, name):
    held = next(s[2] for s in samples if s[0] == name and s[1] > EARLY - 1e-9)
    stuck = [
        (n, t, held.copy()) if n == name and EARLY <= t <= EARLY + 0.5 else (n, t, v)
        for n, t, v in samples
    ]
    assert count(expect_good(truth, stuck), name) >= 4


@pytest.mark.parametrize("name", ["gyro", "attitude", "position", "encoders"])
def test_a_sensor_whose_samples_come_late(truth, samples, name):
    """Their stamps are right, but the other sensors are ahead of them."""
    late = sorted(samples, key=lambda s: s[1] + 0.4 * (s[0] == name))
    state, _ = run(truth, flight, late)
    assert state.momentum_changes == 0
    assert (np.abs(truth.error(state)[0]) < 5).all()


@pytest.mark.parametrize("name", ["attitude", "position"])
def test_a_sensor_that_starts_late(truth, samples, name):
    expect_good(truth, [s for s in samples if s[0] != name or s[1] > 1.1])


def test_without_an_attitude_it_keeps_waiting(truth, samples):
    state, handed_over = run(truth, flight, [s for s in samples if s[0] != "attitude"])
    assert np.isnan(handed_over)
    assert not state.rejected.any()


def test_before_the_first_fit_nothing_is_claimed(truth, samples):
    online = online_estimator(truth.spacecraft, flight)
    state = online.start()
    for sample in samples:
        if sample[1] < EARLY:
            online.take(state, *sample)
    result = identification_of_filter(online, state)
    assert state.acquiring
    assert result.solution.rank == 0
    assert np.isnan(result.parameters).all()
    assert result.spatial_inertia().IsNaN()
