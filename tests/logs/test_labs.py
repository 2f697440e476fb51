"""Logs of laboratories: each is read right, or asked about; none is read wrong in silence."""

import numpy as np
import pytest
from labs import LABS, Rows
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from cpid_drake import load_sensors, load_spacecraft, read_log
from cpid_drake.files.resources import models_directory
from cpid_drake.logs.column_map import load_column_map, with_entries
from cpid_drake.logs.common_clock import file_delays, with_delays
from cpid_drake.logs.conventions import check_conventions
from cpid_drake.logs.formats import inspect_log
from cpid_drake.logs.screening import screen

pytestmark = pytest.mark.slow

ASKED = {
    "german_excel": "no columns are an attitude",
    "duplicated_rows": "--leave-out-bad",
    "joints_from_the_tip": "the joints are numbered from the tip (joint_positions.columns: {",
    "gyro_named_dps_in_rad": "the angular velocity is in radians per second",
    "px4": "attitude and angular velocity belong to other axes of the base than the model's",
    "imu_tilted": "the axes of the gyro are turned by 30.0° about [0, -1, 0]",
    "tracked_body_turned": "the attitude is that of axes turned by 30.0° about [0, 0, 1]",
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


def written(name, rows, folder):
    """Write the files of a log to the folder; return its name."""
    files = LABS[name](rows)
    for file, text in files.items():
        (folder / file).write_bytes(text if isinstance(text, bytes) else text.encode())
    return "+".join(files)


def assert_right(log, column_map, rows, craft):
    """Assert that a log, read with a map, has the samples from which it was made."""
    read = inspect_log(log, columns=column_map, joints=craft.joint_names).log
    read = with_delays(read, file_delays(read, craft.tree))
    read = screen(read, load_sensors("testbed")).log
    joints = [read.joint_names.index(name) for name in craft.joint_names]
    start = read.encoders.time[0] - rows.t[0]
    true = CubicSpline(rows.t, np.unwrap(rows.R.as_rotvec(), axis=0))
    turned = Rotation.from_quat(read.attitude.value, scalar_first=True)
    apart = Rotation.from_rotvec(true(read.attitude.time - start)).inv() * turned
    for sensor, error, limit in (
        ("attitude", apart.as_rotvec(), 0.02),
        ("position", (read.position.value, rows.p), 0.005),
        ("gyro", (read.gyro.value, rows.w), 0.02),
        ("encoders", (read.encoders.value[:, joints], rows.q), 0.003),
    ):
        time = read[sensor].time - start
        if isinstance(error, tuple):
            value, values = error
            error = value - CubicSpline(rows.t, values)(time)
        inside = (time > rows.t[0]) & (time < rows.t[-1])
        assert np.abs(error[inside]).max(initial=0.0) < limit, sensor


@pytest.mark.parametrize("name", LABS)
def test_a_log_is_read_right_or_asked_about(name, rows, craft, tmp_path, monkeypatch, run_cpid):
    monkeypatch.chdir(tmp_path)
    log = written(name, rows, tmp_path)
    options = ("--spacecraft", "free_flyer_payload", "--out", "map.yaml")
    code, _, errors = run_cpid("log", "map", log, *options)
    if name in ASKED:
        assert code in (2, 4)
        assert ASKED[name] in errors
        return
    assert code == 0
    assert_right(log, "map.yaml", rows, craft)


@pytest.mark.parametrize(
    "name", ["joints_from_the_tip", "gyro_named_dps_in_rad", "imu_tilted", "tracked_body_turned"]
)
def test_the_remedy_reads_the_log_back(name, rows, craft, tmp_path, monkeypatch, run_cpid):
    monkeypatch.chdir(tmp_path)
    log = written(name, rows, tmp_path)
    run_cpid("log", "map", log, "--spacecraft", "free_flyer_payload", "--out", "map.yaml")
    read = screen(inspect_log(log, columns="map.yaml").log).log
    [better] = check_conventions(read, craft.tree).better
    assert_right(log, with_entries(load_column_map("map.yaml"), better.entries), rows, craft)
