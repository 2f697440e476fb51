"""Families of motions: their ends, their linearity, their limits, and their files."""

import numpy as np
import pytest

from cpid_drake import InputError, load_scenario, shipped_scenario
from cpid_drake.planning.families import MotionFamily
from cpid_drake.planning.limits import LimitedFamily, MotionLimits

NAMES = ("shoulder", "elbow", "wrist")
START, END = np.array([0.1, -0.4, 0.0]), np.array([0.5, -0.4, -0.3])


@pytest.fixture
def family() -> MotionFamily:
    return MotionFamily(NAMES, START, END, np.array([0, 2]), 8.0, 0.5)


@pytest.fixture
def limited(family) -> LimitedFamily:
    limits = MotionLimits(
        np.full(3, -1.5), np.full(3, 1.0), np.full(3, 0.8), np.array([np.inf, 2.0, 2.0])
    )
    return LimitedFamily(family, limits)


def random_parameters(family, *shape, seed=1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(*shape, family.count, len(family.moving)))


def test_every_motion_starts_and_ends_as_required(family):
    start, end = family.make(random_parameters(family)).evaluate([0.0, family.duration])
    np.testing.assert_allclose(start[0], START, atol=1e-12)
    np.testing.assert_allclose(end[0], END, atol=1e-12)
    np.testing.assert_allclose([start[1:], end[1:]], 0.0, atol=1e-12)


@pytest.mark.parametrize("frequency", [0.0, 1e-3, 1e3])
def test_a_frequency_that_gives_no_functions_or_too_many_is_refused(frequency):
    with pytest.raises(InputError, match="give a highest frequency"):
        _ = MotionFamily(NAMES, START, END, np.arange(3), 8.0, frequency).count


# -- limits ----------------------------------------------------------------------------------------


def test_a_motion_that_uses_all_its_room_touches_a_limit(limited):
    family = limited.family
    x = random_parameters(family, 5)
    x /= limited.usage(x).max(axis=0)[:, None]
    A, b = limited.inequalities()
    for each in x:
        motion = family.make(each).evaluate(np.linspace(0, 8, 2001))[..., family.moving]
        lower, upper = limited.limits.bounds[..., family.moving]
        assert (motion >= lower).all()
        assert (motion <= upper).all()
        assert (A @ each.ravel() - b).max() == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(limited.usage(each).max(axis=0), 1.0)


def test_a_known_part_beyond_a_limit_is_refused(family):
    slow = MotionLimits(np.full(3, -1.5), np.full(3, 1.0), np.full(3, 0.05), np.full(3, np.inf))
    with pytest.raises(InputError, match=r"shoulder: .* exceeds the limit of its rate"):
        LimitedFamily(family, slow)
    tight = MotionLimits(np.full(3, -0.35), np.full(3, 1.0), np.full(3, 1.0), np.full(3, np.inf))
    with pytest.raises(InputError, match=r"elbow: .* exceeds the limit of its position"):
        LimitedFamily(family, tight)


def test_limits_of_a_model():
    model = load_scenario(shipped_scenario("paper")).spacecraft.make().limits
    limits = MotionLimits.of_model(model, 0.5, 3.0)
    np.testing.assert_allclose(limits.rates, model.rates / 2)
    np.testing.assert_array_equal(limits.bounds[0, 0], model.lowest)
    assert (limits.bounds[1, 2] == 3.0).all()
