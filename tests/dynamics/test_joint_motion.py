"""The half-cosine motion of Fig. 5, and sums of sines."""

import numpy as np
import pytest

from cpid_drake import HalfCosine, InputError, MultiSine


@pytest.fixture
def motion():
    return HalfCosine([0.0, 1.0, -0.5], [2.0, 1.0, 0.5], duration=10.0)


def test_it_starts_and_ends_at_rest_where_it_should(motion):
    start, end = motion.evaluate(0.0), motion.evaluate(10.0)
    np.testing.assert_allclose(start[0], motion.q_initial)
    np.testing.assert_allclose(end[0], motion.q_final)
    np.testing.assert_allclose([start[1], end[1]], 0.0, atol=1e-15)


def test_rates_and_accelerations_are_derivatives(motion):
    t, h = np.linspace(0.5, 9.5, 19), 1e-5
    ahead, now, behind = (motion.evaluate(t + d) for d in (h, 0.0, -h))
    np.testing.assert_allclose((ahead[:, 0] - behind[:, 0]) / (2 * h), now[:, 1], atol=1e-9)
    np.testing.assert_allclose((ahead[:, 1] - behind[:, 1]) / (2 * h), now[:, 2], atol=1e-9)


def test_it_holds_still_before_and_after(motion):
    before, after = motion.evaluate([-1.0, 12.0])
    np.testing.assert_allclose(before[0], motion.q_initial)
    np.testing.assert_allclose(after[0], motion.q_final)
    assert not before[1:].any()
    assert not after[1:].any()


def largest_rates(motion) -> np.ndarray:
    return np.abs(motion.evaluate(motion.instants())[:, 1]).max(axis=0)


def test_the_largest_rates_are_at_an_instant(motion):
    np.testing.assert_allclose(np.abs(motion.evaluate(5.0)[1]), largest_rates(motion))
    rates = np.abs(motion.evaluate(np.linspace(0, 10, 1001))[:, 1])
    assert (rates <= largest_rates(motion) + 1e-15).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0], [1.0, 2.0], 1.0), "equal length"),
        (([0.0], [np.nan], 1.0), "finite"),
        (([0.0], [1.0], 0.0), "> 0"),
    ],
)
def test_bad_motions_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        HalfCosine(*arguments)


# -- sums of sines -------------------------------------------------------------------------------


def make_multi_sine(**changes) -> MultiSine:
    arguments = {
        "centre": [0.3, -1.0, 0.0],
        "amplitudes": [[0.5, 0.0, -0.2], [0.1, 0.0, 0.3]],
        "frequencies": [0.1, 0.3],
        "phases": [[0.4, 0.0, -1.0], [2.0, 0.0, 0.0]],
        "ramp": 2.0,
        "duration": 10.0,
    }
    return MultiSine(**arguments | changes)


@pytest.fixture(params=[0.5, 2.0, 5.0], ids=lambda ramp: f"ramp {ramp}")
def multi_sine(request):
    return make_multi_sine(ramp=request.param)


def test_sines_are_the_formula_between_the_ramps():
    t = np.linspace(2.0, 8.0, 25)[:, None]
    first = np.array([0.5, 0.0, -0.2]) * np.sin(2 * np.pi * 0.1 * t + [0.4, 0.0, -1.0])
    second = np.array([0.1, 0.0, 0.3]) * np.sin(2 * np.pi * 0.3 * t + [2.0, 0.0, 0.0])
    q = make_multi_sine().evaluate(t[:, 0])[:, 0]
    np.testing.assert_allclose(q, [0.3, -1.0, 0.0] + first + second, atol=1e-14)


def test_sines_start_and_end_at_rest_smoothly(multi_sine):
    """Position, rate and acceleration are continuous, also where the joints are held."""
    motion = multi_sine.evaluate([-1.0, 0.0, 10.0, 12.0, np.inf])
    np.testing.assert_allclose(motion[:, 0], np.tile(multi_sine.centre, (5, 1)), atol=1e-15)
    np.testing.assert_allclose(motion[:, 1:], 0.0, atol=1e-12)
    h = 1e-6
    for time in (0.0, multi_sine.ramp, 10.0 - multi_sine.ramp, 10.0):
        before, after = multi_sine.evaluate([time - h, time + h])
        np.testing.assert_allclose(before, after, atol=1e-3 * multi_sine.ramp**-3 + 1e-5)


def test_rates_and_accelerations_of_sines_are_derivatives(multi_sine):
    t, h = np.linspace(0.05, 9.95, 100), 1e-5
    ahead, now, behind = (multi_sine.evaluate(t + d) for d in (h, 0.0, -h))
    np.testing.assert_allclose((ahead[:, 0] - behind[:, 0]) / (2 * h), now[:, 1], atol=1e-8)
    np.testing.assert_allclose((ahead[:, 1] - behind[:, 1]) / (2 * h), now[:, 2], atol=1e-7)


def test_sines_stay_within_their_bounds_and_reach_them_at_the_instants(multi_sine):
    q, qdot, _ = np.moveaxis(multi_sine.evaluate(np.linspace(0, 10, 100_001)), 1, 0)
    instants = multi_sine.instants()
    assert instants[0] == 0.0
    assert instants[-1] == multi_sine.duration
    positions = multi_sine.evaluate(instants)[:, 0]
    low, high = positions.min(axis=0), positions.max(axis=0)
    np.testing.assert_allclose(low, q.min(axis=0), atol=1e-3)
    np.testing.assert_allclose(high, q.max(axis=0), atol=1e-3)
    np.testing.assert_allclose(largest_rates(multi_sine), np.abs(qdot).max(axis=0), rtol=1e-3)
    reach = np.abs(multi_sine.amplitudes).sum(axis=0)
    assert (low >= multi_sine.centre - reach).all()
    assert (high <= multi_sine.centre + reach).all()
    assert largest_rates(multi_sine)[1] == 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"centre": 0.0}, "centre must be"),
        ({"amplitudes": [[0.1, 0.2, 0.3]]}, r"not \(1, 3\)"),
        ({"phases": np.full((2, 3), np.inf)}, "phases must be finite"),
        ({"frequencies": [0.1, -0.3]}, "frequencies must be > 0"),
        ({"frequencies": [0.1, 1e9]}, "more than 1000 cycles"),
        ({"duration": np.inf}, "duration must be > 0"),
        ({"ramp": 5.1}, "at most half the duration"),
    ],
)
def test_bad_sums_of_sines_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        make_multi_sine(**changes)
