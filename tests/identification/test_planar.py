"""Identification on a table: four parameters, from what is conserved on a table only."""

from dataclasses import replace

import numpy as np
import pytest
from planar_cases import DURATION, KNOWN, SUITE, TARGET, errors, motion, planar_craft, samples
from scipy.spatial.transform import Rotation
from sensing_cases import measured, true_psi, true_telemetry

from cpid_drake import InputError, identify
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.estimation.cramer_rao import cramer_rao_bound
from cpid_drake.identification.words import PLANAR_ASSUMED, PLANAR_PROPOSED
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.sensors.disturbances import Disturbances

TIMES = np.arange(0.0, DURATION, 0.1)
TRUTH = TARGET.to_vector()[KNOWN]
OTHERS = np.delete(np.arange(10), KNOWN)


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    return planar_craft(tmp_path_factory.mktemp("planar"))


@pytest.fixture(scope="module")
def table(craft):
    return craft.on_table()


@pytest.fixture(scope="module")
def exact(table):
    return true_telemetry(table.tree, table.joint_names, motion(), TARGET, TIMES)


@pytest.mark.parametrize("rows", ["eq18", "standard", "relative"])
def test_exact_motion_shows_four_parameters_and_no_other(table, exact, rows):
    found = identify(table, exact, rows=rows)
    np.testing.assert_allclose(found.parameters[KNOWN], TRUTH, rtol=1e-9)
    assert np.isnan(found.parameters[OTHERS]).all()
    assert found.rank == 4
    assert found.passed


def test_the_equations_of_a_free_base_would_be_wrong(craft, exact):
    found = identify(craft, exact, rows="standard")
    assert found.failures  # the reactions of the table are not in these equations


@pytest.mark.parametrize("rows", ["standard", "relative"])
def test_a_momentum_in_the_plane_is_estimated(table, rows):
    start = np.array([0.0, 0.0, 0.05, 0.2, -0.1, 0.0])
    moving = true_telemetry(table.tree, table.joint_names, motion(), TARGET, TIMES, start)
    found = identify(table, moving, rows=rows, momentum=TotalMomentum.unknown())
    np.testing.assert_allclose(found.parameters[KNOWN], TRUTH, rtol=1e-7)


@pytest.mark.slow
def test_the_fit_reaches_the_bound(craft, table):
    ideal = measured(table, motion(), TARGET, SUITE)
    bound = cramer_rao_bound(table.tree, true_psi(table, TARGET), ideal, SUITE)
    found = identify(table, samples(craft, 1), sensors=SUITE)
    np.testing.assert_allclose(
        np.sqrt(np.diag(found.covariance))[KNOWN], np.sqrt(np.diag(bound))[KNOWN], rtol=0.15
    )


def test_a_table_out_of_level_is_estimated(craft, table):
    """A steady acceleration in the plane; the table holds the one across it."""
    pushed = replace(SUITE, disturbances=Disturbances(acceleration=1e-3))
    push = np.array([8e-4, -5e-4, 0.0])
    log = samples(craft, 4)
    along = 0.5 * log.position.time[:, None] ** 2 * push
    log = log.updated({"position": replace(log.position, value=log.position.value + along)})
    found = identify(table, log, sensors=pushed, momentum=TotalMomentum.unknown())
    [effect] = found.effects
    np.testing.assert_allclose(effect.value[:2], push[:2], atol=4 * effect.sigma[:2].max())
    assert effect.sigma[:2].max() < 1e-4
    assert np.abs(errors(found)).max() < 4
    assert found.passed


def in_three_coordinates(log):
    """Return a log as one of x, y and yaw only: what the table holds is exactly zero."""
    yaw = Rotation.from_quat(log.attitude.value, scalar_first=True).as_euler("ZYX")[:, 0]
    attitude = Rotation.from_euler("z", yaw[:, None]).as_quat(scalar_first=True)
    return log.updated(
        {
            "attitude": replace(log.attitude, value=attitude),
            "position": replace(log.position, value=log.position.value * [1, 1, 0]),
        }
    )


def test_a_log_of_x_y_and_yaw_is_recognized(craft, table):
    log = in_three_coordinates(samples(craft, 1))
    found = identify(craft, log, sensors=SUITE)
    assert PLANAR_ASSUMED in found.warnings
    same = identify(table, samples(craft, 1), sensors=SUITE)
    np.testing.assert_allclose(found.parameters[KNOWN], same.parameters[KNOWN], rtol=1e-4)
    assert found.is_complete
    assert not found.is_identifiable
    assert "larger angles" not in found.explain()


def test_a_log_on_a_table_beside_one_of_all_coordinates_is_refused(craft):
    log = samples(craft, 1)
    logs = {"all": log, "three": in_three_coordinates(log)}
    with pytest.raises(InputError, match="three has x, y and yaw only, as on a table, and all has"):
        identify(craft, logs, sensors=SUITE)


def test_a_log_of_six_coordinates_is_proposed_to_be_planar(craft):
    log = samples(craft, 1)
    found = identify(craft, log, sensors=SUITE, rows="standard")
    assert PLANAR_PROPOSED in found.warnings
    said = identify(craft, log, sensors=SUITE, rows="standard", planar=True)
    assert PLANAR_PROPOSED not in said.warnings
    assert "m, cx, cy and Izz are identifiable" in said.explain()
    denied = identify(craft, log, sensors=SUITE, rows="standard", planar=False)
    assert PLANAR_PROPOSED not in denied.warnings
    assert not denied.is_planar


def test_a_free_spacecraft_that_tilts_is_not_on_a_table(craft):
    free = add_noise(SUITE, measured(craft, motion(), TARGET, SUITE), 1)
    assert PLANAR_PROPOSED not in identify(craft, free, sensors=SUITE, rows="standard").warnings
    found = identify(craft, free, sensors=SUITE, rows="standard", planar=True)
    assert any("the base tilts by up to" in failure for failure in found.failures)


def test_a_frame_c_that_is_turned_has_its_own_four(tmp_path):
    """C's y axis is the normal: m, cx, cz and Iyy."""
    turned = planar_craft(tmp_path, grip_rpy="-1.5707963267948966 0 0")
    level = planar_craft(tmp_path, grip_rpy="0 0 0").on_table()
    motion_of_level = true_telemetry(level.tree, level.joint_names, motion(), TARGET, TIMES)
    found = identify(turned.on_table(), motion_of_level, rows="standard")
    assert "m, cx, cz and Iyy are identifiable" in found.explain()
    values = found.parameters[[0, 1, 3, 5]]
    m, cx, cy, Izz = TRUTH
    np.testing.assert_allclose(values, [m, cx, cy, Izz], rtol=1e-9)


def test_an_oblique_frame_c_has_four_combinations(tmp_path):
    level = planar_craft(tmp_path, grip_rpy="0 0 0").on_table()
    data = true_telemetry(level.tree, level.joint_names, motion(), TARGET, TIMES)
    oblique = planar_craft(tmp_path, grip_rpy="0.5 -0.3 0.2")
    found = identify(oblique, data, rows="standard", planar=True)
    assert np.flatnonzero(np.isfinite(found.parameters)).tolist() == [0]
    assert found.is_complete
    assert found.parameters[0] == pytest.approx(TARGET.mass, rel=1e-9)
    assert "oblique" in found.explain()


def test_logs_with_other_axes_along_the_normal_are_refused(craft):
    """The craft lies on another side in the second log: no one table has both."""
    log = samples(craft, 1)
    tipped = Rotation.from_euler("x", 90.0, degrees=True)
    attitude = Rotation.from_quat(log.attitude.value, scalar_first=True) * tipped
    value = attitude.as_quat(scalar_first=True)
    other = log.updated({"attitude": replace(log.attitude, value=value)})
    with pytest.raises(InputError, match=r"second and first have .*90° apart.* one by one"):
        identify(craft, {"first": log, "second": other}, sensors=SUITE, planar=True)


@pytest.mark.parametrize("rise", [0.0, 0.2])
def test_noise_of_the_height_is_no_sign_of_a_free_base(craft, rise):
    """Samples of 20 mm are those of a table, of any σ; a slow rise of the base is not."""
    coarse = replace(SUITE, position=replace(SUITE.position, sigma=0.02))
    log, rng = samples(craft, 1), np.random.default_rng(2)
    position = log.position
    value = position.value + 0.02 * rng.standard_normal(position.value.shape)
    value[:, 2] += rise * position.time / position.time[-1]
    noisy = log.updated({"position": replace(position, value=value)})
    found = identify(craft, noisy, sensors=coarse, planar=True)
    assert any("height changes" in each for each in found.failures) == (rise > 0)
