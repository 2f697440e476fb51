"""Several files that make one log: one result, whatever the zeros of their clocks are."""

import csv

import numpy as np
import pytest

import cpid_drake as cpid
from cpid_drake.files.resources import models_directory
from cpid_drake.identification.identify_files import request_of_result
from cpid_drake.identification.request import Request
from cpid_drake.logs.formats import inspect_log
from cpid_drake.spacecraft.reference import SpacecraftReference

MODELS = models_directory()
SAMPLE = MODELS / "telemetry/free_flyer.csv"
CRAFT = SpacecraftReference(
    str(MODELS / "free_flyer/free_flyer.urdf"), base="body", capture_frame="capture_point"
)
POSE, GYRO = ("qw", "qx", "qy", "qz", "x", "y", "z"), ("bwx", "bwy", "bwz")


@pytest.fixture(scope="module")
def rows():
    with SAMPLE.open() as file:
        return [*csv.DictReader(line for line in file if not line.startswith("#"))]


@pytest.fixture(scope="module")
def joints(rows):
    return [name for name in rows[0] if name.startswith("q:")]


def write(path, rows, names, later=0.0, time="time", **renamed):
    """Write the rows that have some columns to a file with a clock of its own."""
    with path.open("w") as file:
        print(time, *(renamed.get(name, name) for name in names), sep=",", file=file)
        for row in rows:
            if any(row[name] for name in names):
                stamp = f"{float(row['time']) + later:.6f}"
                print(stamp, *(row[name] for name in names), sep=",", file=file)
    return str(path)


def request(log, sensors="testbed"):
    return Request(str(log), CRAFT, sensors=sensors)


def identified(log, **options):
    return cpid.identify_files([request(log, **options)]).result


@pytest.fixture(scope="module")
def whole():
    return identified(SAMPLE)


@pytest.mark.parametrize("later", [(0.3, -0.7), (-2.31, 4.1), (0.0, 0.05)])
def test_files_on_clocks_of_their_own_give_the_result_of_one(tmp_path, rows, joints, whole, later):
    parts = [
        write(tmp_path / "mocap.csv", rows, POSE, later[0]),
        write(tmp_path / "joints.csv", rows, joints),
        write(tmp_path / "imu.csv", rows, GYRO, later[1]),
    ]
    result = identified("+".join(parts))
    assert result.passed
    difference = (result.parameters - whole.parameters) / np.sqrt(np.diag(whole.covariance))
    assert np.abs(difference).max() < 0.3
    for name, delay in zip(("mocap.csv", "imu.csv"), later):
        texts = [text for text in result.warnings if text.startswith(f"the clock of {name} is ")]
        assert len(texts) == bool(delay)
        for text in texts:
            number, _, order = text.partition(" is ")[2].partition(" s ")
            assert abs(float(number) - abs(delay)) < 0.004
            assert order.startswith("ahead of" if delay > 0 else "behind")


def test_clocks_that_are_stated_exact_have_unknown_rests(tmp_path, rows, joints):
    """Samples tell delays to a millisecond, which exact clocks would not allow."""
    pose = write(tmp_path / "mocap.csv", rows, POSE, 0.3)
    both = pose + "+" + write(tmp_path / "joints.csv", rows, joints)
    text = (MODELS / "sensors/testbed.yaml").read_text()
    sensors = tmp_path / "exact.yaml"
    sensors.write_text(text + "unstated: exact\n")
    names = {effect.name for effect in identified(both, sensors=str(sensors)).effects}
    assert {"attitude.delay", "position.delay"} <= names


def test_a_result_of_several_files_is_read_back(tmp_path, rows, joints):
    parts = [
        write(tmp_path / f"{name}.csv", rows, names)
        for name, names in (("mocap", POSE), ("joints", joints))
    ]
    log = "+".join(parts)
    file = tmp_path / "result.json"
    cpid.write_result(file, identified(log))
    again = request_of_result(cpid.read_result(file), str(file))
    assert again.telemetry == log
    write(tmp_path / "joints.csv", rows[:-10], joints)
    with pytest.raises(cpid.InputError, match="has changed since"):
        request_of_result(cpid.read_result(file), str(file))


def test_log_map_reads_both(tmp_path, rows, joints, run_cpid):
    renamed = {name: f"{name[2:]}_deg" for name in joints}
    degrees = [
        {**row, **{n: str(np.degrees(float(row[n]))) for n in joints if row[n]}} for row in rows
    ]
    both = "+".join(
        [
            write(tmp_path / "mocap.csv", rows, POSE, 0.9, time="t"),
            write(tmp_path / "joints.csv", degrees, joints, time="t", **renamed),
        ]
    )
    out = tmp_path / "map.yaml"
    craft = ["--spacecraft", "free_flyer_payload"]
    assert run_cpid("log", "map", both, *craft, "--out", out)[0] == 0
    code, text, _ = run_cpid("log", "check", both, *craft, "--columns", out)
    assert code == 0
    assert "the clock of mocap.csv is 0.900 s ahead of" in " ".join(text.split())


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ({"names": POSE}, "the column 'qw' is in mocap.csv and in second.csv"),
        ({"names": ("z",), "other": "y"}, "x, y, z of one sensor are in mocap.csv and second.csv"),
        ({"later": 1.7e9}, "have no time in common"),
        ({"time": "stamp"}, "second.csv: there is no column 'time'"),
    ],
)
def test_files_that_do_not_fit_together_are_refused(tmp_path, rows, joints, second, message):
    pose = [name for name in POSE if name != second.pop("other", "")]
    pose = pose if second.get("names") != ("z",) else [*POSE[:-1]]
    first = write(tmp_path / "mocap.csv", rows, pose)
    names = (*joints, *second.pop("names", ()))
    path = write(tmp_path / "second.csv", rows, names, **second)
    with pytest.raises(cpid.InputError, match=message):
        inspect_log(f"{first}+{path}")


def test_problems_have_the_place_in_their_file(tmp_path, rows, joints):
    pose = write(tmp_path / "mocap.csv", rows, POSE)
    own = [row for row in rows if row[joints[0]]]
    bad = [*own[:5], {**own[5], joints[0]: "none"}, own[7], own[6], *own[8:]]
    path = write(tmp_path / "joints.csv", bad, joints)
    problems = inspect_log(f"{pose}+{path}").problems
    lines = [text.partition(",")[0] for text in problems]
    assert len(lines) == 2
    assert all(text.startswith("joints.csv: line ") for text in lines)


def test_a_file_is_named_once(tmp_path, rows):
    pose = write(tmp_path / "mocap.csv", rows, POSE)
    for text in (f"{pose}+{pose}", f"{pose}+"):
        with pytest.raises(cpid.InputError, match="name each file of the log once"):
            inspect_log(text)


def test_a_unit_is_named_on_another_clock(tmp_path, rows, joints):
    """The delay of a gyro in degrees is found all the same: sizes vary together in any unit."""
    degrees = [
        {**row, **{n: str(np.degrees(float(row[n] or "nan"))) for n in GYRO}} for row in rows
    ]
    parts = [
        write(tmp_path / "mocap.csv", rows, POSE),
        write(tmp_path / "joints.csv", rows, joints, 0.3),
        write(tmp_path / "imu.csv", degrees, GYRO, -2.2),
    ]
    with pytest.raises(cpid.InputError, match="the angular velocity is in degrees per second"):
        identified("+".join(parts))
