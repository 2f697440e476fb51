"""All estimators on the same sensors: who is right, who is biased, and what none can know."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from sensing_cases import (
    MOMENTUM,
    Sines,
    coarse_suite,
    measured,
    momentum_about_com,
    nees,
    true_psi,
)

from cpid_drake import HalfCosine, InertialParameters, Spacecraft, identify
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.identification.fitted import cramer_rao_bound
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.sensors import AttitudeSensor, Gyro, JointSensor, VectorSensor

DURATION = 8.0
OFFLINE = ("eq18", "standard", "trajectory_fit")
"""One of each kind; the same claims about the others are those of the tests of rows and online."""

FAST = {"gyro": Gyro(50.0, 0.005, 1.0, 0.1), "encoders": JointSensor(50.0, 1e-5)}


@pytest.fixture(scope="module")
def motion():
    return Sines.drawn(4, seed=101, duration=DURATION, size=0.6)


@pytest.fixture(scope="module")
def at_rest(craft, motion, skewed_target):
    """What the sensors would give without noise, at zero momentum."""
    return measured(craft, motion, skewed_target, coarse_suite(**FAST))


@pytest.fixture(scope="module")
def tumbling(craft, motion, skewed_target):
    return measured(craft, motion, skewed_target, coarse_suite(**FAST), MOMENTUM)


@pytest.fixture(scope="module")
def scale(skewed_target):
    """What errors are compared with: m, half a metre, tr I."""
    true = skewed_target.to_vector()
    return np.array([true[0], 0.5, 0.5, 0.5, *6 * [true[4:7].sum()]])


# -- the estimators -------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", ["standard", "relative", "trajectory_fit"])
def test_every_estimator_is_near_and_gives_a_rigid_body(
    craft, at_rest, skewed_target, scale, estimator
):
    """Within 0.2 % of m, 0.5 m and tr I on flight-like sensors, and as the covariance says.

    All standard rows contain the errors of the base's velocity, which is the slope of a few
    positions: their estimate is only as near as its covariance says.
    """
    suite, true = coarse_suite(**FAST), skewed_target.to_vector()
    result = identify(craft, add_noise(suite, at_rest, 1), sensors=suite, estimator=estimator)
    assert result.rank == 10
    assert np.isfinite(result.covariance).all()
    assert np.linalg.eigvalsh(result.covariance / np.outer(scale, scale))[0] > 0
    assert result.spatial_inertia().IsPhysicallyValid()
    if estimator in ("trajectory_fit", "relative"):
        assert np.abs((result.parameters - true) / scale).max() < 2e-3
        assert result.spatial_inertia().get_mass() == pytest.approx(true[0], rel=2e-3)
    assert "determine 10 of 10 parameters" in result.explain()
    assert nees(result, skewed_target) < chi2.isf(1e-4, 10)


@pytest.mark.parametrize("estimator", OFFLINE)
@pytest.mark.parametrize("is_known", [True, False])
def test_a_momentum_may_be_known_or_not(
    craft, motion, tumbling, skewed_target, estimator, is_known
):
    """Of Eq. 18, which needs to know it, what is known is right; much is noise."""
    if estimator == "eq18" and not is_known:
        return
    suite, momentum = coarse_suite(**FAST), TotalMomentum.unknown()
    if is_known:
        momentum = momentum_about_com(craft, motion, skewed_target, MOMENTUM)
    samples = add_noise(suite, tumbling, 0 if is_known else 1)
    found = identify(craft, samples, sensors=suite, estimator=estimator, momentum=momentum)
    if estimator == "eq18":
        assert not abs(found.parameters[0] / skewed_target.mass - 1) > 0.02
    else:
        assert chi2.ppf(0.0005, 10) < nees(found, skewed_target) < chi2.ppf(0.9995, 10)


@pytest.mark.parametrize("estimator", ["least_squares", "trajectory_fit"])
def test_bad_samples_are_screened_out(craft, at_rest, skewed_target, scale, estimator):
    """Not a number, a quaternion of no length, a stamp out of turn: left out, not fatal."""
    suite = coarse_suite(**FAST)
    samples = add_noise(suite, at_rest, 2)
    attitude, gyro = samples.attitude.value.copy(), samples.gyro.value.copy()
    attitude[7], gyro[50, 1] = 0.0, np.nan
    time = samples.position.time.copy()
    time[11] = time[9]
    bad = replace(
        samples,
        attitude=Samples(samples.attitude.time, attitude),
        gyro=Samples(samples.gyro.time, gyro),
        position=Samples(time, samples.position.value),
    )
    result = identify(craft, bad, sensors=suite, estimator=estimator)
    assert {"attitude": 1, "gyro": 1, "position": 1}.items() <= result.rejected.items()
    assert np.abs((result.parameters - skewed_target.to_vector()) / scale).max() < 2e-3


# -- what cannot be known -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def planar(tmp_path_factory):
    """Return a spacecraft that moves in the plane z = 0 only, and a target that keeps it there."""

    def link(name, mass, x, inertia):
        return (
            f'<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/><inertia '
            f'ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>"
        )

    def joint(name, parent, child, x):
        return (
            f'<joint name="{name}" type="continuous"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{x} 0.1 0"/><axis xyz="0 0 1"/></joint>'
        )

    text = "".join(
        [
            link("base", 300.0, 0.1, 40.0),
            link("arm", 12.0, 0.4, 1.0),
            link("hand", 6.0, 0.2, 0.5),
            joint("shoulder", "base", "arm", 0.7),
            joint("elbow", "arm", "hand", 0.8),
        ]
    )
    path = tmp_path_factory.mktemp("planar") / "planar.urdf"
    path.write_text(f'<?xml version="1.0"?><robot name="planar">{text}</robot>')
    target = InertialParameters(50.0, [0.4, 0.1, 0.0], [[8, 1, 0], [1, 12, 0], [0, 0, 15]])
    return Spacecraft(path, base="base", capture_frame="hand"), target


@pytest.mark.slow
def test_planar_motion_leaves_the_in_plane_inertia_open(planar):
    """Ixx, Iyy and Ixy never matter; that the base does not tilt tells cz, Ixz and Iyz.

    Whatever the noise: it must not be taken for tilting.
    """
    craft, target = planar
    suite = coarse_suite(**FAST)
    motion = Sines.drawn(2, seed=111, duration=DURATION, size=0.6)
    perfect = measured(craft, motion, target, suite)
    result = identify(craft, add_noise(suite, perfect, 2), sensors=suite)
    assert result.rank == 7
    open_ = np.isnan(result.parameters)
    np.testing.assert_array_equal(np.flatnonzero(open_), [4, 5, 7])  # Ixx, Iyy, Ixy
    known = ~open_
    true = target.to_vector()
    size = np.array([50.0, 0.5, 0.5, 0.5, *6 * [35.0]])
    assert np.abs((result.parameters - true) / size)[known].max() < 5e-3
    text = result.explain()
    assert "determine 7 of 10" in text
    for name in ("I*11", "I*12", "I*22"):
        assert name in text.split("not determined")[0]
    assert np.isnan(result.spatial_inertia().get_mass())
    assert result.consistent is None


@pytest.mark.parametrize("estimator", ["recursive_fit", "trajectory_fit"])
def test_without_motion_nothing_is_known(craft, skewed_target, estimator):
    """No rank, or a little from noise; nothing comes out that looks like an answer."""
    q = np.array([0.2, 0.1, -0.3, 0.4])
    suite = coarse_suite(**FAST)
    perfect = measured(craft, HalfCosine(q, q, 4.0), skewed_target, suite)
    options = {"sensors": suite, "estimator": estimator}
    result = identify(craft, add_noise(suite, perfect, 1), **options)
    assert result.rank < 4
    assert not result.is_observable
    assert np.isnan(result.parameters).any()
    assert np.isnan(result.covariance).all()
    assert np.isnan(result.spatial_inertia().get_mass())


@pytest.mark.slow
def test_spatial_inertias_are_those_of_rigid_bodies(craft, motion):
    """Of a flat target estimates lie beyond what can be; what leaves never does."""
    flat = InertialParameters(60.0, [0.4, 0.1, 0.0], np.diag([10.0, 20.0, 30.0]))
    suite = coarse_suite(position=VectorSensor(5.0, 3e-3))
    perfect = measured(craft, motion, flat, suite)
    beyond = 0
    for seed in range(3):
        samples = add_noise(suite, perfect, seed)
        result = identify(craft, samples, sensors=suite, estimator="least_squares")
        beyond += not result.raw().is_feasible()
        assert result.consistent.is_feasible()
        assert result.spatial_inertia().IsPhysicallyValid()
    assert beyond


# -- the Cramér-Rao bound -------------------------------------------------------------------------


def test_the_bound_is_open_where_the_motion_shows_nothing(craft, motion, skewed_target):
    """A slide that moves alone shows no inertia; half as large a motion has twice the σ."""
    suite, sigmas = coarse_suite(), []
    for size in (0.4, 0.2):
        slide = replace(motion, amplitude=size * motion.amplitude * np.eye(4)[1])
        samples = measured(craft, slide, skewed_target, suite)
        bound = cramer_rao_bound(craft.tree, true_psi(craft, skewed_target), samples, suite)
        sigmas.append(np.sqrt(np.diag(bound)))
        shown = sigmas[-1][[4, 5, 6, 7, 8, 9]]
        assert (np.isnan(shown) | (shown > 5.0)).all()  # kg·m²: as large as the moments
    assert sigmas[1][0] == pytest.approx(2 * sigmas[0][0], rel=0.05)


def assert_tighter(better, worse) -> None:
    """Every combination of the parameters is known at least as well, and one far better."""
    size = 1 / np.sqrt(np.diag(worse))
    difference = (worse - better) * size * size[:, None]
    values = np.linalg.eigvalsh(difference)
    assert values[0] > -1e-5  # rounding
    assert values[-1] > 0.05


def test_more_and_better_sensors_and_longer_data_tighten_the_bound(craft, motion, skewed_target):
    rich = coarse_suite(velocity=VectorSensor(5.0, 2e-4))
    samples = measured(craft, motion, skewed_target, rich)
    psi = true_psi(craft, skewed_target)

    def bound(suite, samples=samples, **options):
        return cramer_rao_bound(craft.tree, psi, samples, suite, **options)

    reference = bound(rich)
    assert_tighter(reference, bound(replace(rich, gyro=None)))
    assert_tighter(bound(replace(rich, gyro=None)), bound(replace(rich, gyro=None, velocity=None)))
    assert_tighter(bound(replace(rich, attitude=AttitudeSensor(5.0, 1.0, 8.0))), reference)
    assert_tighter(bound(replace(rich, encoders=JointSensor(20.0, 1e-7))), reference)
    assert_tighter(reference, bound(rich, samples.between(0.0, 5.0)))
    assert_tighter(reference, bound(rich, momentum=TotalMomentum.unknown()))
