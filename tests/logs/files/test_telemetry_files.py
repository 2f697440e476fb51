"""Telemetry files: what is written is read again, and what is wrong is named with its place."""

from dataclasses import replace

import numpy as np
import pytest

from cpid_drake import InputError, Log, read_log, write_log
from cpid_drake.logs.formats import inspect_log
from cpid_drake.logs.log import ideal_log
from cpid_drake.sensors.sensors import SENSORS, AttitudeSensor, Gyro, JointSensor, VectorSensor
from cpid_drake.sensors.suite import SensorSuite

SUITE = SensorSuite(
    attitude=AttitudeSensor(rate=4.0),
    gyro=Gyro(rate=30.0),
    position=VectorSensor(rate=7.0),
    velocity=VectorSensor(rate=10.0),
    encoders=JointSensor(rate=20.0),
    joint_rates=JointSensor(rate=12.5),
)

HEADER = "time,qw,qx,qy,qz,bwx,bwy,bwz,q:a,q:b,qd:a,qd:b"
ROWS = [f"{t},1,0,0,0,0.1,0.2,0.3,{t},1,1,0" for t in (0.0, 0.5, 1.0)]


def write(folder, *lines, name="log.csv", end="\n", encoding="utf-8"):
    path = folder / name
    path.write_bytes(end.join([*lines, ""]).encode(encoding))
    return path


def assert_same(a: Log, b: Log, tolerance: float = 0.0) -> None:
    assert a.joint_names == b.joint_names
    for name in SENSORS:
        one, other = getattr(a, name), getattr(b, name)
        np.testing.assert_array_equal(one.time, other.time)
        np.testing.assert_allclose(one.value, other.value, rtol=0, atol=tolerance)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
class TestRoundTrip:
    def test_motion_comes_back_bit_by_bit(self, tmp_path, random_motion, ending):
        telemetry = random_motion(50, 1)
        write_log(tmp_path / f"log.{ending}", telemetry)
        read = read_log(tmp_path / f"log.{ending}")
        assert read.joint_names == telemetry.joint_names
        np.testing.assert_array_equal(read.position.value, telemetry.p_WB)
        np.testing.assert_array_equal(read.attitude.value, telemetry.quaternion_WB)
        np.testing.assert_array_equal(read.velocity.value, telemetry.v_WB)
        np.testing.assert_array_equal(read.encoders.value, telemetry.q)
        np.testing.assert_array_equal(read.joint_rates.value, telemetry.qdot)
        w_WB = np.einsum("nij,nj->ni", telemetry.R_WB, read.gyro.value)
        np.testing.assert_allclose(w_WB, telemetry.w_WB, rtol=0, atol=1e-15)

    def test_sensors_of_different_rates_come_back_bit_by_bit(self, tmp_path, random_motion, ending):
        names = random_motion(1, 0).joint_names
        measurements = ideal_log(
            SUITE, names, lambda t: replace(random_motion(len(t), 3), time=t), 2.0
        )
        write_log(tmp_path / f"log.{ending}", measurements)
        assert_same(read_log(tmp_path / f"log.{ending}"), measurements)


class TestCsv:
    @pytest.fixture
    def plain(self, tmp_path):
        return read_log(write(tmp_path, HEADER, *ROWS, name="plain.csv"))

    def test_empty_cells_are_absent_samples(self, tmp_path, plain):
        rows = [ROWS[0], ROWS[1].replace(",1,0,0,0,", ",,,,,", 1), ROWS[2]]
        read = read_log(write(tmp_path, HEADER, *rows))
        np.testing.assert_array_equal(read.attitude.time, [0.0, 1.0])
        np.testing.assert_array_equal(read.gyro.time, plain.gyro.time)

    def test_samples_there_in_part_only_are_counted_and_left_out(self, tmp_path):
        rows = [ROWS[0], ROWS[1].replace(",0.2,", ",,"), ROWS[2]]
        found = inspect_log(write(tmp_path, HEADER, *rows))
        assert found.partial == {"gyro": 1}
        np.testing.assert_array_equal(found.log.gyro.time, [0.0, 1.0])

    @pytest.mark.parametrize(
        ("old", "new", "phrase"),
        [
            ("time", "Time", "no column 'time'; did you mean 'Time'?"),
            ("qz", "qq", "attitude needs the columns qw, qx, qy, qz; missing: qz"),
            ("q:b", "q:a", "the column 'q:a' is there 2 times"),
            ("qd:b", "mode", "a column 'q:b', but no 'qd:b'"),
            ("bwx,bwy,bwz", "wx,wy,bwz", "missing: bwx, bwy"),
            ("qw,qx,qy,qz,bwx,bwy,bwz", "a,b,c,d,wx,wy,wz", "needs the attitude"),
            ("q:a,q:b,qd:a,qd:b", "e,f,g,h", "no joint positions"),
        ],
    )
    def test_bad_headers_are_named(self, tmp_path, old, new, phrase):
        path = write(tmp_path, HEADER.replace(old, new), *ROWS)
        with pytest.raises(InputError) as caught:
            read_log(path)
        assert phrase in str(caught.value)

    def test_time_that_goes_back_is_named(self, tmp_path):
        rows = [ROWS[0], ROWS[2], ROWS[1], ROWS[0].replace("0.0", "2.0", 1)]
        found = inspect_log(write(tmp_path, HEADER, *rows))
        assert found.problems == ["line 4, column 'time': time 0.5 s comes after 1 s"]
        np.testing.assert_array_equal(found.log.encoders.time, [0.0, 1.0, 2.0])
