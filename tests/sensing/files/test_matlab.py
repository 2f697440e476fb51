"""MATLAB files: vectors, matrices and structs are columns; what cannot be read is named."""

from contextlib import suppress

import numpy as np
import pytest
from scipy.io import savemat

from cpid_drake import InputError, read_telemetry
from cpid_drake.sensing.files.telemetry_files import inspect_telemetry

N = 12
TIME = np.arange(N) * 0.1
ANGLES = np.stack([np.sin(TIME), np.cos(TIME)], axis=1)
MAP = """
    time: {column: log.t}
    position: {columns: ["p(:,1)", "p(:,2)", "p(:,3)"], unit: mm}
    joint_positions: {columns: {a: "q(:,1)", b: "q(:,2)"}, unit: deg}
"""
VARIABLES = {
    "log": {"t": TIME, "note": "a text"},
    "p": np.arange(3.0 * N).reshape(3, N),  # a sample is a column here, and a row in q
    "q": np.degrees(ANGLES),
    "gain": np.eye(2),
    "name": "free-flyer",
}


@pytest.fixture
def columns(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text(MAP)
    return path


def test_vectors_matrices_and_structs_are_columns(tmp_path, columns):
    savemat(tmp_path / "log.mat", VARIABLES)
    found = inspect_telemetry(tmp_path / "log.mat", columns=columns)
    np.testing.assert_array_equal(found.measurements.encoders.time, TIME)
    np.testing.assert_allclose(found.measurements.encoders.value, ANGLES, atol=1e-15)
    np.testing.assert_allclose(found.measurements.position.value, VARIABLES["p"].T / 1000)
    assert found.ignored == ("gain",)


def test_version_7_3_is_refused_with_a_remedy(tmp_path, columns):
    (tmp_path / "log.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))
    with pytest.raises(InputError, match=r"format 7.3 \(HDF5\) is not read; save .* '-v7'"):
        read_telemetry(tmp_path / "log.mat", columns=columns)


def test_a_damaged_file_raises_one_error_only(tmp_path, columns):
    savemat(tmp_path / "log.mat", VARIABLES, do_compression=True)
    data = (tmp_path / "log.mat").read_bytes()
    rng = np.random.default_rng(1)
    for cut in range(0, len(data), 97):
        damaged = bytearray(data[:cut] if cut % 2 else data)
        if damaged:
            damaged[rng.integers(len(damaged))] ^= 0x55
        (tmp_path / "bad.mat").write_bytes(damaged)
        with suppress(InputError):
            read_telemetry(tmp_path / "bad.mat", columns=columns)
