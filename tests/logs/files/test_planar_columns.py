"""Logs whose base has x, y and yaw only: as columns of the package, and through a map."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake import InputError
from cpid_drake.logs.column_map import ColumnMap
from cpid_drake.logs.formats import read_log
from cpid_drake.logs.noise_estimation import sensor_noise

YAW = np.array([0.1, 0.4, -3.0, 3.5])
HEAD = "time,x,y,yaw,vx,vy,wz,q:shoulder"


def write(path, head=HEAD, scale=1.0):
    rows = [
        [k, 0.1 * k, -0.2 * k, scale * yaw, 0.01 * k, 0.02, 0.3, 0.5 * k]
        for k, yaw in enumerate(YAW)
    ]
    text = "\n".join([head, *(",".join(map(repr, map(float, row))) for row in rows)])
    path.write_text(text + "\n")
    return path


def test_yaw_is_the_rotation_about_z_and_what_the_table_holds_is_zero(tmp_path):
    log = read_log(write(tmp_path / "log.csv"))
    expected = Rotation.from_euler("z", YAW[:, None]).as_matrix()
    found = Rotation.from_quat(log.attitude.value, scalar_first=True).as_matrix()
    np.testing.assert_allclose(found, expected, atol=1e-12)
    for samples, held in ((log.position, [2]), (log.velocity, [2]), (log.gyro, [0, 1])):
        assert not samples.value[:, held].any()
    np.testing.assert_allclose(log.gyro.value[:, 2], 0.3)
    np.testing.assert_allclose(log.velocity.value[:, 0], 0.01 * np.arange(4))


def test_an_empty_cell_makes_its_sample_absent(tmp_path):
    path = write(tmp_path / "log.csv")
    lines = path.read_text().splitlines()
    lines[2] = "1.0,,,,0.01,0.02,0.3,0.5"
    path.write_text("\n".join(lines) + "\n")
    log = read_log(path)
    assert len(log.attitude) == len(log.position) == 3
    assert len(log.velocity) == 4


def test_a_map_names_the_angle_its_unit_and_two_coordinates(tmp_path):
    head = "time,mocap_x,mocap_y,heading,u,v,spin,q:shoulder"
    path = write(tmp_path / "log.csv", head, np.degrees(1.0))
    given = ColumnMap()
    given.attitude.order, given.attitude.unit = "yaw", "deg"
    given.attitude.columns, given.position.columns = ["heading"], ["mocap_x", "mocap_y"]
    given.velocity.columns, given.angular_velocity.columns = ["u", "v"], ["spin"]
    mapped = read_log(path, columns=given)
    plain = read_log(write(tmp_path / "plain.csv"))
    for name in ("attitude", "position", "velocity", "gyro", "encoders"):
        np.testing.assert_allclose(mapped[name].value, plain[name].value, atol=1e-12)


def test_a_map_of_joints_alone_still_finds_the_yaw(tmp_path):
    path = write(tmp_path / "log.csv", HEAD.replace("q:shoulder", "arm_1"))
    given = ColumnMap()
    given.joint_positions.columns = {"shoulder": "arm_1"}
    log = read_log(path, columns=given)
    plain = read_log(write(tmp_path / "plain.csv"))
    np.testing.assert_allclose(log.attitude.value, plain.attitude.value)
    assert len(log.position) == 4


def test_without_the_yaw_two_coordinates_are_not_a_position(tmp_path):
    path = write(tmp_path / "log.csv", HEAD.replace("yaw", "heading"))
    with pytest.raises(InputError, match="needs the columns wx, wy, wz"):
        read_log(path)


def test_noise_is_that_of_the_yaw_alone(tmp_path):
    rng = np.random.default_rng(3)
    yaw, xy = 1e-3 * rng.standard_normal(2000), 2e-3 * rng.standard_normal((2000, 2))
    rows = np.column_stack([0.1 * np.arange(2000), xy, yaw, np.zeros(2000)])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=",", header="time,x,y,yaw,q:shoulder", comments="")
    log = read_log(path)
    assert sensor_noise("attitude", log.attitude) == pytest.approx(1e-3, rel=0.1)
    assert sensor_noise("position", log.position) == pytest.approx(2e-3, rel=0.1)
