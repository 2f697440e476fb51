"""An identification as ROS 2 messages: what a reader of bags finds is what was identified."""

import re

import numpy as np
import pytest

from cpid_drake import InputError, Request, SpacecraftReference, identify_files
from cpid_drake.files.resources import models_directory
from cpid_drake.report.mcap import DIAGNOSTICS_TOPIC, RESIDUALS, SIGMA, TARGET, write_mcap

rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="needs the package rosbags")
typesys = pytest.importorskip("rosbags.typesys")
MODELS = models_directory()
CRAFT = SpacecraftReference(
    str(MODELS / "free_flyer/free_flyer.urdf"), base="body", capture_frame="capture_point"
)
SENSORS = str(MODELS / "telemetry/free_flyer_sensors.yaml")
REQUEST = Request(str(MODELS / "telemetry/free_flyer.csv"), CRAFT, sensors=SENSORS)


@pytest.fixture(scope="module")
def evidence():
    return identify_files([REQUEST])


@pytest.fixture(scope="module")
def read(evidence, tmp_path_factory):
    """Return all messages by topic: stamps [s] and messages."""
    file = tmp_path_factory.mktemp("bag") / "found.mcap"
    write_mcap(file, evidence)
    assert [each.name for each in file.parent.iterdir()] == ["found.mcap"]
    store, found = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE), {}
    with rosbag2.Reader(file) as reader:
        for connection, stamp, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp * 1e-9, message))
    return found


def vector(inertia) -> np.ndarray:
    """Return π (10,) of a message."""
    com = inertia.com
    moments = (inertia.ixx, inertia.iyy, inertia.izz, inertia.ixy, inertia.ixz, inertia.iyz)
    return np.array([inertia.m, com.x, com.y, com.z, *moments])


def test_the_last_estimate_is_that_of_the_identification(read, evidence):
    found = evidence.result
    stamp, last = read[TARGET][-1]
    np.testing.assert_array_equal(vector(last.inertia), found.parameters)
    np.testing.assert_array_equal(
        vector(read[SIGMA][-1][1].inertia), np.sqrt(np.diag(found.covariance))
    )
    assert last.header.frame_id == "capture_point"
    assert stamp == pytest.approx(last.header.stamp.sec + 1e-9 * last.header.stamp.nanosec)
    assert stamp == pytest.approx(10.0, abs=0.02)


def test_the_residuals_are_white_noise_of_one_sigma(read, evidence):
    for name, samples in evidence.result.residuals.items():
        rows = read[RESIDUALS + name]
        np.testing.assert_allclose([stamp for stamp, _ in rows], samples.time, atol=1e-6)
        values = np.array([message.data for _, message in rows])
        np.testing.assert_array_equal(values, samples.value)
        assert 0.8 < np.std(values) < 1.2


def test_the_checks_stand_at_the_end(read, evidence):
    """With what is known, and what each error costs."""
    [(_, message)] = read[DIAGNOSTICS_TOPIC]
    names = [each.name.removeprefix("cpid: ") for each in message.status]
    checks = [check.name for check in evidence.result.checks]
    assert names == ["estimate", *checks, "error budget"]
    assert all(int.from_bytes([each.level]) == 0 for each in message.status)
    shares = {pair.key: pair.value for pair in message.status[-1].values}
    assert set(shares) == {row.name for row in evidence.result.budget}
    assert all(re.fullmatch(r"\d+%", share) for share in shares.values())


def test_what_cannot_be_written_is_refused(evidence, tmp_path):
    with pytest.raises(InputError, match=r"must end in \.mcap"):
        write_mcap(tmp_path / "found.bag", evidence)
    with pytest.raises(InputError, match="nowhere"):
        write_mcap(tmp_path / "nowhere" / "found.mcap", evidence)
