"""Families of motions: their ends, their linearity and their limits."""

import numpy as np
import pytest

from cpid_drake import InputError
from cpid_drake.planning.motion_family import MotionFamily

NAMES = ("shoulder", "elbow", "wrist")
START, END = np.array([0.1, -0.4, 0.0]), np.array([0.5, -0.4, -0.3])
UPPER = np.array([[1.0, 1.0, 1.0], [0.8, 0.8, 0.8], [np.inf, 2.0, 2.0]])
LOWER = np.array([[-1.5, -1.5, -1.5], -UPPER[1], -UPPER[2]])


def make_family(lower=LOWER, upper=UPPER, frequency=0.5) -> MotionFamily:
    moving, bounds = np.array([0, 2]), np.stack([lower, upper])
    return MotionFamily(NAMES, START, END, moving, 8.0, bounds, frequency)


def random_parameters(family, *shape) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(*shape, *family.shape))


def test_every_motion_starts_and_ends_as_required():
    family = make_family()
    start, end = family.make(random_parameters(family)).evaluate([0.0, family.duration])
    np.testing.assert_allclose(start[0], START, atol=1e-12)
    np.testing.assert_allclose(end[0], END, atol=1e-12)
    np.testing.assert_allclose([start[1:], end[1:]], 0.0, atol=1e-12)


def test_samples_are_those_of_the_motions_and_a_motion_of_the_family_is_fitted_exactly():
    family, times = make_family(), np.linspace(0.0, 8.0, 23)
    x = random_parameters(family, 3)
    expected = np.stack([family.make(each).evaluate(times)[:, :2] for each in x], axis=1)
    np.testing.assert_allclose(family.samples(x, times), expected, atol=1e-12)
    moved = family.functions(family.times)[:, 0] @ x[0]
    np.testing.assert_allclose(family.fitted(moved), x[0], atol=1e-9)


@pytest.mark.parametrize("frequency", [0.0, 1e-3, 1e3])
def test_a_frequency_that_gives_no_functions_or_too_many_is_refused(frequency):
    with pytest.raises(InputError, match="give a highest frequency"):
        make_family(frequency=frequency)


def test_a_motion_that_uses_all_its_room_touches_a_limit():
    family = make_family()
    x = random_parameters(family, 5)
    x /= family.usage(x)[:, None]
    A, b = family.inequalities()
    for each in x:
        motion = family.make(each)
        values = motion.evaluate(np.linspace(0, 8, 2001))
        assert (values - UPPER).max() < 0.01
        assert (LOWER - values).max() < 0.01
        np.testing.assert_allclose(
            family.usage_of(motion)[:, family.moving].max(axis=0), 1.0, rtol=0.01
        )
        assert (A @ each.ravel() - b).max() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        (LOWER, UPPER * [[1], [0.05], [1]], r"shoulder: .* exceeds the limit of its rate"),
        (LOWER * [[0.2], [1], [1]], UPPER, r"elbow: .* exceeds the limit of its position"),
    ],
)
def test_a_known_part_beyond_a_limit_is_refused(lower, upper, message):
    with pytest.raises(InputError, match=message):
        make_family(lower, upper)
