"""Joint motions: rest at both ends, rates that are derivatives, and bounds."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from cpid_drake import HalfCosine, InputError, MultiSine, Spline

RNG = np.random.default_rng(1)


def coefficients(rows: int = 9, equal: int = 3) -> np.ndarray:
    c = RNG.uniform(-1, 1, (rows, 3))
    c[:equal], c[-equal:] = c[0], c[-1]
    return c


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


SINES = {ramp: make_multi_sine(ramp=ramp) for ramp in (0.5, 5.0)}
MOTIONS = {
    "half cosine": HalfCosine([0.0, 1.0, -0.5], [2.0, 1.0, 0.5], duration=10.0),
    **{f"sines, ramp {ramp}": motion for ramp, motion in SINES.items()},
    "sines that end elsewhere": make_multi_sine(displacement=[0.2, 1.0, 0.0]),
    "spline": Spline(coefficients(), 10.0),
}
every = pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
every_sine = pytest.mark.parametrize("motion", SINES.values(), ids=SINES)


@every
def test_rates_and_accelerations_are_derivatives(motion):
    t, h = np.linspace(0.11, 9.95, 97), 1e-5
    ahead, now, behind = (motion.evaluate(t + d) for d in (h, 0.0, -h))
    np.testing.assert_allclose((ahead[:, 0] - behind[:, 0]) / (2 * h), now[:, 1], atol=1e-8)
    np.testing.assert_allclose((ahead[:, 1] - behind[:, 1]) / (2 * h), now[:, 2], atol=1e-7)


@every
def test_the_joints_are_at_rest_at_both_ends_and_stay_there(motion):
    before, start, end, after, never = motion.evaluate([-1.0, 0.0, 10.0, 12.0, np.inf])
    np.testing.assert_allclose([before[0], never[0]], [start[0], end[0]], atol=1e-15)
    np.testing.assert_allclose(after[0], end[0], atol=1e-15)
    np.testing.assert_allclose([start[1], end[1]], 0.0, atol=1e-12)
    np.testing.assert_allclose([before[1:], after[1:]], 0.0, atol=1e-12)


@every
def test_the_largest_values_are_at_the_instants(motion):
    fine = np.abs(motion.evaluate(np.linspace(0, 10, 100_001))[:, :2]).max(axis=0)
    instants = motion.instants()
    assert (instants[0], instants[-1]) == (0.0, 10.0)
    found = np.abs(motion.evaluate(instants)[:, :2]).max(axis=0)
    np.testing.assert_allclose(found, fine, rtol=2e-3, atol=1e-3)


def test_half_a_cosine_is_its_formula():
    t = np.linspace(0.0, 10.0, 21)[:, None]
    expected = [0.0, 1.0, -0.5] + np.array([1.0, 0.0, 0.5]) * (1 - np.cos(np.pi * t / 10.0))
    q = MOTIONS["half cosine"].evaluate(t[:, 0])[:, 0]
    np.testing.assert_allclose(q, expected, atol=1e-14)


# -- sums of sines -------------------------------------------------------------------------------


def test_sines_are_the_formula_also_on_the_ramps():
    """The step s rises with s' = 630 x⁴ (1 − x)⁴: four derivatives vanish at both ends."""
    step = 630 * Polynomial([0, 0, 0, 0, 1, -4, 6, -4, 1]).integ()
    t = np.linspace(0.0, 10.0, 51)[:, None]
    first = np.array([0.5, 0.0, -0.2]) * np.sin(2 * np.pi * 0.1 * t + [0.4, 0.0, -1.0])
    second = np.array([0.1, 0.0, 0.3]) * np.sin(2 * np.pi * 0.3 * t + [2.0, 0.0, 0.0])
    ramp = step(np.minimum(np.minimum(t, 10.0 - t) / 2.0, 1.0))
    expected = [0.3, -1.0, 0.0] + step(t / 10.0) * [0.2, 1.0, 0.0] + ramp * (first + second)
    q = make_multi_sine(displacement=[0.2, 1.0, 0.0]).evaluate(t[:, 0])[:, 0]
    np.testing.assert_allclose(q, expected, atol=1e-12)


@every_sine
def test_sines_are_smooth_where_the_joints_are_held_and_where_a_ramp_ends(motion):
    h = 1e-6
    np.testing.assert_allclose(motion.evaluate([0.0, 10.0])[:, 2], 0.0, atol=1e-12)
    for time in (0.0, motion.ramp, 10.0 - motion.ramp, 10.0):
        before, after = motion.evaluate([time - h, time + h])
        np.testing.assert_allclose(before, after, atol=1e-3 * motion.ramp**-3 + 1e-5)


# -- splines -------------------------------------------------------------------------------------


def test_splines_are_linear_in_their_coefficients_and_stay_between_them():
    t, a, b = np.linspace(0, 8, 33), coefficients(), coefficients()
    both = Spline(a + 2 * b, 8.0).evaluate(t)
    parts = Spline(a, 8.0).evaluate(t) + 2 * Spline(b, 8.0).evaluate(t)
    np.testing.assert_allclose(both, parts, atol=1e-12)
    assert (both[:, 0] >= (a + 2 * b).min(axis=0) - 1e-12).all()
    assert (both[:, 0] <= (a + 2 * b).max(axis=0) + 1e-12).all()


# -- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: HalfCosine([0.0], [1.0, 2.0], 1.0), "equal length"),
        (lambda: HalfCosine([0.0], [np.nan], 1.0), "finite"),
        (lambda: HalfCosine([0.0], [1.0], 0.0), "> 0"),
        (lambda: make_multi_sine(centre=0.0), "centre must be"),
        (lambda: make_multi_sine(amplitudes=[[0.1, 0.2, 0.3]]), r"not \(1, 3\)"),
        (lambda: make_multi_sine(frequencies=[0.1, -0.3]), "frequencies must be > 0"),
        (lambda: make_multi_sine(frequencies=[0.1, 1e9]), "1000 cycles"),
        (lambda: make_multi_sine(ramp=5.1), "at most half the duration"),
        (lambda: make_multi_sine(displacement=[1.0, 2.0]), "of equal length"),
        (lambda: Spline(coefficients(5), 8.0), "at least 6 coefficients"),
        (lambda: Spline(RNG.uniform(size=(9, 3)), 8.0), "start and end at rest"),
        (lambda: Spline(coefficients(), np.inf), "duration must be > 0"),
    ],
)
def test_bad_motions_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
