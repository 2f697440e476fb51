"""Logs of laboratories: each is read right, or asked about; none is read wrong in silence."""

import numpy as np
import pytest
from labs import LABS, Rows
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from cpid_drake import load_sensors, load_spacecraft, read_log
from cpid_drake.files.resources import models_directory
from cpid_drake.logs.common_clock import file_delays, with_delays
from cpid_drake.logs.formats import inspect_log
from cpid_drake.logs.screening import screen

pytestmark = pytest.mark.slow

ASKED = {
    "german_excel": "no columns are an attitude",
    "duplicated_rows": "--leave-out-bad",
    "dropouts_as_minus_9999": "the joint positions may be in rad or deg",
    "joints_from_the_tip": "the joint positions may be in rad or deg",
    "gyro_named_dps_in_rad": "the angular velocity",
    "px4": "direction of the attitude are not determined",
    "imu_tilted": "the joint positions may be in rad or deg",
    "tracked_body_turned": "the joint positions may be in rad or deg",
}
"""What `log map` says about the logs that it does not settle."""


@pytest.fixture(scope="module")
def rows():
    log = read_log(models_directory() / "telemetry/free_flyer.csv")
    R = Rotation.from_quat(log.attitude.value, scalar_first=True)
    whole = Rows(log.gyro.time, R, log.position.value, log.gyro.value, log.encoders.value)
    return whole.part(2)


@pytest.fixture(scope="module")
def craft():
    return load_spacecraft("free_flyer_payload").make()


@pytest.mark.parametrize("name", LABS)
def test_a_log_is_read_right_or_asked_about(name, rows, craft, tmp_path, monkeypatch, run_cpid):
    monkeypatch.chdir(tmp_path)
    files = LABS[name](rows)
    for file, text in files.items():
        (tmp_path / file).write_bytes(text if isinstance(text, bytes) else text.encode())
    log = "+".join(files)
    options = ("--spacecraft", "free_flyer_payload", "--out", "map.yaml")
    code, _, errors = run_cpid("log", "map", log, *options)
    if name in ASKED:
        assert code in (2, 4)
        assert ASKED[name] in errors
        return
    assert code == 0
    read = inspect_log(log, columns="map.yaml", joints=craft.joint_names).log
    read = with_delays(read, file_delays(read, craft.tree))
    read = screen(read, load_sensors("testbed")).log
    start = read.encoders.time[0] - rows.t[0]
    turned = Rotation.from_quat(read.attitude.value, scalar_first=True)
    true = CubicSpline(rows.t, np.unwrap(rows.R.as_rotvec(), axis=0))
    time = read.attitude.time - start
    inside = (time > rows.t[0]) & (time < rows.t[-1])
    apart = (Rotation.from_rotvec(true(time)).inv() * turned).magnitude()
    assert apart[inside].max() < 0.02
    for sensor, values, limit in (
        ("position", rows.p, 0.005),
        ("gyro", rows.w, 0.02),
        ("encoders", rows.q, 0.003),
    ):
        time = read[sensor].time - start
        inside = (time > rows.t[0]) & (time < rows.t[-1])
        error = read[sensor].value - CubicSpline(rows.t, values)(time)
        assert np.abs(error[inside]).max(initial=0.0) < limit, sensor
