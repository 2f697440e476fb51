"""Thrust in telemetry files: written and read, sparse or dense, at a point, in other units."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import InputError, from_columns, read_log, write_log
from cpid_drake.logs.formats import FORMATS, table_of
from cpid_drake.logs.log import THRUST, THRUST_COLUMNS, Log, Samples
from cpid_drake.logs.screening import screen
from cpid_drake.sensors.sensors import JointSensor
from cpid_drake.sensors.suite import SensorSuite
from cpid_drake.sensors.thrusters import Thrusters, Valve
from cpid_drake.simulation.burns import Burn, log_of_burns

BURNS = (
    Burn(0.73, 1.1, np.array([1.5, -2.0, 1.0]), torque_B=np.array([0.3, -0.2, 0.4])),
    Burn(1.5, 0.8, np.array([0.0, 1.0, 0.0]), torque_B=np.array([0.0, 0.0, 0.1])),
)
TIMES = np.linspace(0.0, 3.9, 391)


@pytest.fixture
def log(random_motion):
    """Return exact samples of all sensors, and the log of two burns at times of their own."""
    motion = replace(random_motion(40, 3), time=np.arange(40) * 0.1)
    samples = {
        "attitude": Samples(motion.time, motion.quaternion_WB),
        "position": Samples(motion.time, motion.p_WB),
        "encoders": Samples(motion.time, motion.q),
    }
    return Log(motion.joint_names, {**samples, THRUST: log_of_burns(BURNS)})


def rows_of(log, force, torque, names=THRUST_COLUMNS):
    """Return the columns of a log with thrust (40, 3) in every row."""
    columns = {"time": log.position.time}
    columns.update(zip(("qw", "qx", "qy", "qz"), log.attitude.value.T))
    columns.update(zip(("x", "y", "z"), log.position.value.T))
    columns.update(zip((f"q:{joint}" for joint in log.joint_names), log.encoders.value.T))
    columns.update(zip(names, np.hstack([torque, force]).T))
    return columns


def written(folder, columns, ending=".csv"):
    path = folder / f"log{ending}"
    write = FORMATS[ending][1]
    write(path, list(columns), np.stack(list(columns.values()), axis=1))
    return path


def test_overlapping_burns_add_up():
    held = log_of_burns(BURNS).held_at([0.7, 0.73, 1.6, 1.9, 2.4])
    both = BURNS[0].wrench_B + BURNS[1].wrench_B
    expected = [np.zeros(6), BURNS[0].wrench_B, both, BURNS[1].wrench_B, np.zeros(6)]
    np.testing.assert_array_equal(held, expected)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_what_is_written_is_read(log, tmp_path, ending):
    """Burns are rows with nothing else; in every format."""
    path = tmp_path / f"log.{ending}"
    write_log(path, log)
    read = read_log(path)
    np.testing.assert_allclose(read.thrust.held_at(TIMES), log.thrust.held_at(TIMES))
    np.testing.assert_array_equal(read.position.value, log.position.value)


def test_a_window_begins_with_the_thrust_that_holds(log, tmp_path):
    path = tmp_path / "log.csv"
    write_log(path, log)
    part = read_log(path).between(1.0, 2.0)
    inside = TIMES[(TIMES >= 1.0) & (TIMES <= 2.0)]
    np.testing.assert_allclose(part.thrust.held_at(inside), log.thrust.held_at(inside))


def test_force_alone_acts_at_the_origin_of_the_base(log, tmp_path):
    force, nothing = np.tile([1.0, -2.0, 3.0], (40, 1)), np.zeros((40, 0))
    columns = rows_of(log, force, nothing, THRUST_COLUMNS[3:])
    read = read_log(written(tmp_path, columns))
    np.testing.assert_array_equal(read.thrust.value[0], [0, 0, 0, 1.0, -2.0, 3.0])


def test_a_map_says_units_and_the_point_of_the_force(log, tmp_path):
    """The torque about B's origin is that about the point, plus that of the force there."""
    force, torque = np.tile([100.0, -200.0, 300.0], (40, 1)), np.tile([1.0, 2.0, 3.0], (40, 1))
    names = ("MX", "MY", "MZ", "FX", "FY", "FZ")
    path = written(tmp_path, rows_of(log, force, torque, names))
    (tmp_path / "map.yaml").write_text(
        "thrust: {force: [FX, FY, FZ], torque: [MX, MY, MZ], force_unit: mN, point_B: [1, 0, 2]}\n"
    )
    read = read_log(path, columns=tmp_path / "map.yaml")
    f = np.array([0.1, -0.2, 0.3])
    expected = [*(np.array([1.0, 2.0, 3.0]) + np.cross([1.0, 0.0, 2.0], f)), *f]
    np.testing.assert_allclose(read.thrust.value, np.tile(expected, (40, 1)))
    assert not len(read_log(path).thrust)


def test_a_log_on_a_table_needs_three_columns(log, tmp_path):
    columns = rows_of(log, np.ones((40, 3)), np.full((40, 3), 2.0))
    for name in ("qw", "qx", "qy", "qz", "z", "thrust_fz", "thrust_tx", "thrust_ty"):
        del columns[name]
    columns["yaw"] = np.linspace(0, 0.1, 40)
    read = read_log(written(tmp_path, columns))
    np.testing.assert_array_equal(read.thrust.value[0], [0, 0, 2.0, 1.0, 1.0, 0])


def test_openings_of_valves_become_one_log_of_their_changes(random_motion):
    names, values = table_of(random_motion(4, 3))
    columns = dict(zip(names, values.T))
    columns |= {"valve:right": np.array([0, 1, 1, 0.0]), "valve:left": np.array([0, 0, 0, 0.5])}
    log = from_columns(columns)
    suite = SensorSuite(
        encoders=JointSensor(), thrusters=Thrusters({"left": Valve(), "right": Valve()})
    )
    thrust = screen(log, suite).log.thrust
    np.testing.assert_array_equal(thrust.time, log.gyro.time[[0, 1, 3]])
    np.testing.assert_array_equal(thrust.value, [[0, 0], [0, 1], [0.5, 0]])
    for bad, phrase in (
        ({"valve:right": -columns["valve:right"]}, "openings must be numbers from 0"),
        ({"valve:up": columns["valve:left"]}, "have no valve 'up'"),
    ):
        with pytest.raises(InputError, match=phrase):
            screen(from_columns(columns | bad), suite)
