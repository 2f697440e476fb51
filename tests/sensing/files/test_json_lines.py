"""JSON-lines files: nested objects are columns; keys that are absent are no samples."""

import json

import numpy as np
import pytest

from cpid_drake import InputError, read_telemetry
from cpid_drake.sensing.files.telemetry_files import inspect_telemetry

MAP = """
    time: {column: header.stamp.sec, nanoseconds: header.stamp.nanosec}
    position: {columns: [pose.position.x, pose.position.y, pose.position.z]}
    joint_positions: {columns: {a: "position[0]", b: "position[1]"}}
"""
POSE = {"position": {"x": 1.0, "y": 2, "z": 3.0}}


@pytest.fixture
def columns(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text(MAP)
    return path


def line(k, **others):
    stamp = {"sec": k // 2, "nanosec": k % 2 * 500_000_000}
    return {"header": {"stamp": stamp, "frame_id": "map"}, "position": [k, -k], **others}


def write(folder, *lines):
    path = folder / "log.jsonl"
    path.write_text("\n".join(x if isinstance(x, str) else json.dumps(x) for x in lines) + "\n")
    return path


def test_nested_keys_are_columns_and_absent_ones_no_samples(tmp_path, columns):
    file = write(tmp_path, line(0), line(1, pose=POSE), "", line(2, pose=None))
    found = inspect_telemetry(file, columns=columns)
    np.testing.assert_array_equal(found.measurements.encoders.time, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(found.measurements.encoders.value, [[0, 0], [1, -1], [2, -2]])
    np.testing.assert_array_equal(found.measurements.position.time, [0.5])
    np.testing.assert_array_equal(found.measurements.position.value, [[1, 2, 3]])
    assert found.ignored == ("header.frame_id", "pose")


@pytest.mark.parametrize(
    ("bad", "phrase"),
    [
        ("{", "line 2: not a JSON object: "),
        ("[1]", "line 2: must be an object"),
        ('{"a": 1, "a": 2}', "line 2: not a JSON object: a key is given twice"),
        (line(1, position=["x", 0]), r"line 2: 'position\[0\]' is 'x', not a finite number"),
        (line(1, position=[float("nan"), 0]), r"line 2: 'position\[0\]' is nan"),
        (line(1, position=[10**400, 0]), "line 2: not a JSON object: int too large"),
        ("[" * 100_000, "line 2: not a JSON object"),
    ],
)
def test_bad_lines_are_named_and_can_be_left_out(tmp_path, columns, bad, phrase):
    file = write(tmp_path, line(0, pose=POSE), bad, line(2))
    with pytest.raises(InputError, match=phrase):
        read_telemetry(file, columns=columns)
    rest = read_telemetry(file, columns=columns, leave_out_bad=True)
    np.testing.assert_array_equal(rest.encoders.time, [0.0, 1.0])
