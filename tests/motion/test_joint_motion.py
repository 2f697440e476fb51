"""The half-cosine motion of Fig. 5."""

import numpy as np
import pytest

from cpid_drake import HalfCosine, InputError


@pytest.fixture
def motion():
    return HalfCosine([0.0, 1.0, -0.5], [2.0, 1.0, 0.5], duration=10.0)


def test_it_starts_and_ends_at_rest_where_it_should(motion):
    start, end = motion.evaluate(0.0), motion.evaluate(10.0)
    np.testing.assert_allclose(start[0], motion.q_initial)
    np.testing.assert_allclose(end[0], motion.q_final)
    np.testing.assert_allclose([start[1], end[1]], 0.0, atol=1e-15)


def test_it_is_the_papers_formula(motion):
    """Errata 9: q(t) = q0 + Δ/2 (1 − cos(π t/T))."""
    t = np.linspace(0, 10, 41)
    expected = motion.q_initial + (motion.q_final - motion.q_initial) / 2 * (
        1 - np.cos(np.pi * t / 10)
    ).reshape(-1, 1)
    np.testing.assert_allclose(motion.evaluate(t)[:, 0], expected, atol=1e-14)


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


def test_peak_rates_are_reached_half_way(motion):
    np.testing.assert_allclose(np.abs(motion.evaluate(5.0)[1]), motion.peak_rates())
    rates = np.abs(motion.evaluate(np.linspace(0, 10, 1001))[:, 1])
    assert (rates <= motion.peak_rates() + 1e-15).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0], [1.0, 2.0], 1.0), "equal length"),
        (([[0.0]], [[1.0]], 1.0), "equal length"),
        (([0.0], [np.nan], 1.0), "finite"),
        (([0.0], [1.0], 0.0), "> 0"),
        (([0.0], [1.0], -1.0), "> 0"),
        (([0.0], [1.0], np.inf), "> 0"),
    ],
)
def test_bad_motions_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        HalfCosine(*arguments)
