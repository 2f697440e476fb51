"""Motions along splines: smooth, bounded, and linear in their parameters."""

import numpy as np
import pytest

from cpid_drake.dynamics.joint_motion import MultiSine
from cpid_drake.dynamics.linear_motion import Spline
from cpid_drake.errors import InputError


def table(rows: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (rows, 3))


def coefficients(rows: int = 9, seed: int = 1, equal: int = 3) -> np.ndarray:
    c = table(rows, seed)
    c[:equal], c[-equal:] = c[0], c[-1]
    return c


@pytest.fixture
def motion() -> Spline:
    return Spline(coefficients(9, 1), 8.0)


def test_they_start_and_end_at_rest_and_stay_there(motion):
    before, start, end, after = motion.evaluate([-1.0, 0.0, 8.0, 9.0])
    np.testing.assert_array_equal(before[0], start[0])
    np.testing.assert_allclose(after[0], end[0], atol=1e-15)
    np.testing.assert_allclose([before[1], start[1], end[1], after[1]], 0.0, atol=1e-12)
    assert not before[2].any()
    assert not after[2].any()


def test_rates_and_accelerations_are_derivatives(motion):
    h = 1e-6
    t = np.linspace(0.11, 7.9, 40)
    ahead, now, behind = (motion.evaluate(t + d) for d in (h, 0.0, -h))
    np.testing.assert_allclose((ahead[:, 0] - behind[:, 0]) / (2 * h), now[:, 1], atol=1e-8)
    np.testing.assert_allclose((ahead[:, 1] - behind[:, 1]) / (2 * h), now[:, 2], atol=1e-7)


def test_they_are_linear_in_their_parameters():
    t = np.linspace(0, 8, 33)
    a, b = coefficients(9, 2), coefficients(9, 3)
    both = Spline(a + 2 * b, 8.0).evaluate(t)
    parts = Spline(a, 8.0).evaluate(t) + 2 * Spline(b, 8.0).evaluate(t)
    np.testing.assert_allclose(both, parts, atol=1e-12)


def test_a_spline_stays_between_its_coefficients():
    motion = Spline(coefficients(), 8.0)
    q = motion.evaluate(np.linspace(0, 8, 1001))[:, 0]
    assert (q >= motion.coefficients.min(axis=0) - 1e-12).all()
    assert (q <= motion.coefficients.max(axis=0) + 1e-12).all()


@pytest.mark.parametrize(("equal", "is_zero"), [(2, False), (3, True)])
def test_three_equal_coefficients_give_zero_accelerations_at_the_ends(equal, is_zero):
    ends = Spline(coefficients(9, equal=equal), 8.0).evaluate([0.0, 8.0])[:, 2]
    assert np.allclose(ends, 0.0, atol=1e-12) == is_zero


def test_sines_may_end_elsewhere():
    """A displacement adds a smooth step; all derivatives up to the fourth are zero at the ends."""
    arguments = ([0.3, -1.0], [[0.5, 0.0]], [0.3], [[0.4, 0.0]], 2.0, 8.0)
    there, back = MultiSine(*arguments, displacement=[0.2, 1.0]), MultiSine(*arguments)
    start, middle, end = there.evaluate([0.0, 4.0, 8.0])
    np.testing.assert_allclose(start[0], [0.3, -1.0])
    np.testing.assert_allclose(end[0], [0.5, 0.0], atol=1e-15)
    np.testing.assert_allclose([start[1:], end[1:]], 0.0, atol=1e-12)
    np.testing.assert_allclose(middle[0] - back.evaluate(4.0)[0], [0.1, 0.5])
    t, h = np.linspace(0.1, 7.9, 40), 1e-5
    ahead, now, behind = (there.evaluate(t + d) for d in (h, 0.0, -h))
    np.testing.assert_allclose((ahead[:, 0] - behind[:, 0]) / (2 * h), now[:, 1], atol=1e-8)
    np.testing.assert_allclose((ahead[:, 1] - behind[:, 1]) / (2 * h), now[:, 2], atol=1e-7)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Spline(coefficients(5), 8.0), "at least 6 coefficients"),
        (lambda: Spline(table(9), 8.0), "start and end at rest"),
        (lambda: Spline(coefficients(), np.inf), "duration must be > 0"),
        (
            lambda: MultiSine([0.0], [[1.0]], [0.1], [[0.0]], 1.0, 8.0, displacement=[1.0, 2.0]),
            "of equal length",
        ),
    ],
)
def test_bad_motions_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
