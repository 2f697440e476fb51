"""A base on a table: what it can do, what is conserved, and what the rows then contain."""

from dataclasses import replace

import numpy as np
import pytest
from planar_cases import DURATION, TARGET, motion, planar_craft
from scipy.spatial.transform import Rotation
from sensing_cases import true_telemetry

from cpid_drake.dynamics.momentum import system_momentum
from cpid_drake.dynamics.plane import in_plane, mean_normal, tilt

TIMES = np.arange(0.0, DURATION, 0.1)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return planar_craft(tmp_path_factory.mktemp("planar")).on_table()


@pytest.fixture(scope="module")
def truth(table):
    start = np.array([0.0, 0.0, 0.05, 0.2, -0.1, 0.0])
    return true_telemetry(table.tree, table.joint_names, motion(), TARGET, TIMES, start)


def test_the_base_moves_in_the_plane_and_keeps_what_the_table_leaves(table, truth):
    np.testing.assert_allclose(truth.quaternion_WB[:, 1:3], 0, atol=1e-14)
    np.testing.assert_allclose(truth.p_WB[:, 2], 0, atol=1e-14)
    P, L = system_momentum(table.tree, TARGET, truth)
    np.testing.assert_allclose(P[:, :2], np.tile([0.2, -0.1], (len(P), 1)), atol=1e-9)
    np.testing.assert_allclose(L[:, 2], 0.05, atol=1e-7)
    assert np.ptp(L[:, :2], axis=0).min() > 1e-3  # the reactions of the table change the others


def test_the_table_holds_the_height_of_a_base_whose_arm_rises(tmp_path):
    """A wrist turns the target out of the plane: height and tilt stay, P_x, P_y and L_z, too."""
    table, start = (
        planar_craft(tmp_path, wrist_rpy="0.5 0 0").on_table(),
        np.array([0, 0, 0.05, 0.2, -0.1, 0.4]),
    )
    rising = true_telemetry(table.tree, table.joint_names, motion(), TARGET, TIMES, start)
    np.testing.assert_allclose(rising.p_WB[:, 2], 0, atol=1e-14)
    np.testing.assert_allclose(rising.v_WB[:, 2], 0, atol=1e-14)
    P, L = system_momentum(table.tree, TARGET, rising)
    np.testing.assert_allclose(P[:, :2], np.tile([0.2, -0.1], (len(P), 1)), atol=1e-9)
    np.testing.assert_allclose(L[:, 2], 0.05, atol=1e-7)
    assert np.ptp(P[:, 2]) > 1e-2


def test_a_free_base_of_the_same_bodies_would_tilt(table, truth):
    tree = replace(table.tree, normal_B=None)
    free = true_telemetry(tree, table.joint_names, motion(), TARGET, TIMES)
    assert np.abs(free.quaternion_WB[:, 1:3]).max() > 0.05


def test_noise_out_of_the_plane_is_removed_and_the_yaw_is_kept(truth):
    rng = np.random.default_rng(1)
    noise = Rotation.from_rotvec(1e-2 * rng.standard_normal((len(truth), 3)))
    noisy = noise * Rotation.from_quat(truth.quaternion_WB, scalar_first=True)
    level = in_plane(replace(truth, quaternion_WB=noisy.as_quat(scalar_first=True)), np.eye(3)[2])
    np.testing.assert_allclose(tilt(level.quaternion_WB, np.eye(3)[2]), 0, atol=1e-14)
    yaw = noise.as_rotvec()[:, 2]
    np.testing.assert_allclose(
        np.unwrap(level.euler_321[:, 0] - truth.euler_321[:, 0]), yaw, atol=2e-4
    )


def test_the_mean_normal_of_a_base_that_is_mounted_askew(truth):
    askew = Rotation.from_euler("xy", [0.3, -0.2])
    turned = Rotation.from_quat(truth.quaternion_WB, scalar_first=True) * askew
    normal = mean_normal(turned.as_quat(scalar_first=True))
    np.testing.assert_allclose(normal, askew.inv().apply([0, 0, 1]), atol=1e-12)
    np.testing.assert_allclose(tilt(turned.as_quat(scalar_first=True), normal), 0, atol=1e-9)


@pytest.mark.parametrize(
    ("rpy", "axis"), [("0 0 1", 2), ("1.5707963267948966 0 0", 1), ("0 1.5707963267948966 0.4", 0)]
)
def test_the_normal_in_c_does_not_depend_on_the_joints(tmp_path, rpy, axis):
    tree = planar_craft(tmp_path, grip_rpy=rpy).on_table().tree
    assert tree.plane_axis == axis
    assert len(tree.unknowns) == 4
    assert tree.lumped.plane_axis == axis


def test_joints_that_turn_the_target_out_of_the_plane_show_more(tmp_path):
    tree = planar_craft(tmp_path, wrist_rpy="0.5 0 0").on_table().tree
    assert tree.normal_C is None
    assert len(tree.unknowns) == 10
