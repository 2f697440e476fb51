"""`cpid log`: logs of common tools are identified after `cpid log map`, without editing by hand."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from flyer_cases import SAMPLE
from scipy.spatial.transform import Rotation

from cpid_drake import load_scenario, read_log, read_result, shipped_scenario, write_log
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.files.resources import models_directory

CRAFT = ("--spacecraft", "free_flyer_payload")
ROS = models_directory() / "telemetry/free_flyer_ros.csv"
"""The sample at 25 Hz: ns since 1970, millimetres, degrees, xyzw, another joint."""

TRUTH = np.array([8.5, 0.26, 0.02, -0.015, 0.16, 0.19, 0.25, 0.012, -0.008, 0.01])
MARKER = np.array([0.12, -0.08, 0.15])


@pytest.fixture
def vicon(cpid):
    """The sample's motion by Vicon: a header of five lines, frames, mm, rotation vectors."""
    scenario = load_scenario(shipped_scenario("free_flyer_payload"))
    craft, time = scenario.spacecraft.make(), np.arange(161) / 16
    joint_motion = scenario.make_joint_motion(craft)
    phi = scenario.target_truth().to_standard_vector()
    base = propagate(craft.tree, joint_motion, phi, time)
    motion = base.to_motion(craft.joint_names, time, joint_motion)
    rotation = Rotation.from_quat(motion.quaternion_WB, scalar_first=True).as_rotvec(degrees=True)
    marker = motion.p_WB + np.einsum("nij,j->ni", motion.R_WB, MARKER)
    rng = np.random.default_rng(1)
    marker += 1e-4 * rng.standard_normal(marker.shape)
    rotation += 2e-3 * rng.standard_normal(rotation.shape)
    target = np.zeros((len(motion), 6))
    angles = np.degrees(motion.q)
    frames = np.arange(len(motion))[:, None] + 101
    table = np.hstack([frames, 0 * frames, target, rotation, marker * 1000, angles])
    joints = [f"{joint}" for joint in motion.joint_names]
    lines = [
        "Segments",
        "16",
        ",,Bag:Bag,,,,,,body:Base,,,,,," + ",".join("Joints" for _ in joints),
        "Frame,Sub Frame," + "RX,RY,RZ,TX,TY,TZ," * 2 + ",".join(joints),
        ",," + "deg,deg,deg,mm,mm,mm," * 2 + ",".join("deg" for _ in joints),
        *(",".join(map(repr, row)) for row in table.tolist()),
    ]
    Path("vicon.csv").write_text("\n".join(lines) + "\n")
    return Path("vicon.csv")


def test_a_log_of_ros_is_mapped_checked_and_identified(cpid):
    code, stdout, stderr = cpid("log", "map", ROS, *CRAFT, "--out", "map.yaml")
    assert code == 0, stderr
    assert Path("map.yaml").read_text() in stdout + "\n"
    columns = ("--columns", "map.yaml")
    assert "no problems found" in cpid("log", "check", ROS, *CRAFT, *columns)[1]
    write_log("house.csv", read_log(ROS, columns="map.yaml"))
    options = (*CRAFT, "--sensors", "testbed", "--json", "r.json", "--force")
    code, _, stderr = cpid("identify", ROS, *options, *columns)
    assert code == 0
    assert "ignored columns: field.header.frame_id, gripper/position" in stderr
    found = read_result("r.json")
    assert np.all(np.abs(found.parameters - TRUTH) < 4 * np.sqrt(np.diag(found.covariance)))
    assert cpid("identify", "house.csv", *options)[0] == 0
    again = read_result("r.json")
    np.testing.assert_allclose(again.parameters, found.parameters, rtol=1e-4, atol=1e-6)


def test_what_is_wrong_with_a_map_is_written_into_its_file(cpid):
    """Of a joint that turns the other way round than the model's."""
    log = read_log(SAMPLE)
    log.encoders.value[:, 3] *= -1
    write_log("turned.csv", log)
    code, _, stderr = cpid("log", "map", "turned.csv", *CRAFT, "--out", "map.yaml")
    assert code == 4
    text = " ".join(Path("map.yaml").read_text().replace("#", "").split())
    assert "does not agree with this map: q:arm_joint4 has the opposite sign" in text
    assert "(reversed_joints: [arm_joint4] in a map of columns)" in text
    assert "unit: deg" not in text  # 7 % of the motion would be left
    assert "q:arm_joint4 has the opposite sign" in stderr
    assert cpid("log", "map", SAMPLE, *CRAFT, "--out", "right.yaml")[0] == 0
    assert "does not agree" not in Path("right.yaml").read_text()


def test_a_log_of_vicon_with_a_marker_off_the_origin_gives_the_target(cpid, vicon):
    """Of noise of 0.1 mm and 0.002°; the marker's place is rounded to 0.1 mm."""
    code, stdout, _ = cpid("log", "map", vicon, *CRAFT, "--out", "map.yaml")
    assert code == 0
    point = yaml.safe_load(stdout)["position"]["point_B"]
    np.testing.assert_allclose(point, MARKER, atol=1e-3)
    assert cpid("identify", vicon, *CRAFT, "--columns", "map.yaml", "--json", "r.json")[0] == 0
    found = read_result("r.json")
    assert (np.abs(found.parameters - TRUTH) < 4 * np.sqrt(np.diag(found.covariance))).all()
    for part in (slice(0, 1), slice(1, 4), slice(4, 10)):
        right, size = TRUTH[part], np.abs(TRUTH[part]).max()
        np.testing.assert_allclose(found.parameters[part], right, atol=0.02 * size)


@pytest.mark.parametrize(
    ("drop", "exit_code", "phrase"),
    [
        ("arm_joint2", 2, "no column can be the position of joint 'arm_joint2'"),
        ("orientation.x", 4, "complete this map: no columns are an attitude"),
    ],
)
def test_what_is_missing_is_named(cpid, drop, exit_code, phrase):
    Path("log.csv").write_text(ROS.read_text().replace(drop, "thing"))
    code, _, stderr = cpid("log", "map", "log.csv", *CRAFT)
    assert code == exit_code
    assert phrase in stderr


@pytest.mark.slow
def test_reports_read_the_log_with_its_map(cpid, short_reports):
    assert cpid("log", "map", ROS, *CRAFT, "--out", "map.yaml")[0] == 0
    how = ("--columns", "map.yaml", "--sensors", "testbed")
    assert cpid("identify", ROS, *CRAFT, *how, "--json", "found.json")[0] == 0
    report = ("report", "--result", "found.json", "--out", "page.html")
    assert cpid(*report)[0] == 0
    page = Path("page.html").read_text()
    assert "Some sections are not shown" not in page
    assert "Map of columns" in page
    map_text = Path("map.yaml").read_text()
    Path("map.yaml").write_text(map_text.replace("unit: mm", "unit: cm"))
    assert cpid(*report, "--force")[0] == 0
    assert "map.yaml has changed since" in Path("page.html").read_text()


class TestCheck:
    def test_a_good_file(self, cpid):
        code, stdout, stderr = cpid("log", "check", SAMPLE, *CRAFT)
        assert (code, stderr) == (0, "")
        assert "changes of attitude and angular velocity differ by" in stdout
        assert "not checked" not in stdout
        assert "1001 rows, 0 to 10 s" in stdout
        assert "4 joints: arm_joint1, arm_joint2" in stdout
        lines = [line.split() for line in stdout.splitlines()]
        assert ["attitude", "1001", "100", "Hz", "-", "used", "-"] in lines
        assert ["velocity", "0", "-", "-", "none", "-"] in lines
        assert "no problems found" in stdout

    def test_after_a_warning_there_is_no_all_clear(self, cpid):
        """Of a gyro with another motion than the attitude, which no convention explains."""
        log = read_log(SAMPLE)
        log.gyro.value[:] = log.gyro.value[::-1].copy()
        write_log("other.csv", log)
        code, stdout, _ = cpid("log", "check", "other.csv", *CRAFT)
        assert code == 0
        assert "warning: changes of attitude and angular velocity differ by" in stdout
        assert "no problems found" not in stdout
        assert stdout.splitlines()[-1] == "no errors; warnings: 1, not checked: 2"

    def test_unusable_samples_are_a_warning(self, cpid):
        """Of a position without its x."""
        lines = SAMPLE.read_text().splitlines()
        cells = lines[500].split(",")
        cells[8] = ""
        Path("damaged.csv").write_text("\n".join([*lines[:500], ",".join(cells), *lines[501:]]))
        for options in ((), CRAFT):
            code, stdout, _ = cpid("log", "check", "damaged.csv", *options)
            assert code == 0
            assert "warning: unusable samples of position: 1" in stdout
            assert "no problems found" not in stdout

    @pytest.mark.parametrize("options", [(), CRAFT])
    def test_a_comparison_that_was_not_made_is_listed(self, cpid, options):
        """A gyro that shows no motion contradicts no attitude: nothing was compared."""
        log = read_log(SAMPLE)
        log.gyro.value[:] = 1e-9 * np.arange(len(log.gyro))[:, None] % 2e-9
        write_log("still.csv", log)
        _, stdout, _ = cpid("log", "check", "still.csv", *options)
        assert "angular velocity differ" not in stdout
        assert "not checked: attitude with measured rates" in stdout
        assert "no problems found" not in stdout

    def test_without_a_spacecraft_not_all_is_checked(self, cpid):
        code, stdout, _ = cpid("log", "check", SAMPLE)
        assert code == 0
        assert stdout.splitlines()[-1] == "no errors; warnings: 0, not checked: 2"

    def test_every_problem_is_listed_with_its_line(self, cpid):
        lines = SAMPLE.read_text().splitlines()[:20]
        lines[13] = lines[13].replace(",", ",,", 1)
        lines[15] = "-0.5" + lines[15][lines[15].index(",") :]
        Path("bad.csv").write_text("\n".join(lines))
        code, stdout, stderr = cpid("log", "check", "bad.csv")
        assert code == 2
        assert "error: line 14: 16 cells, but 15 columns" in stdout
        assert "error: line 16, column 'time': time -0.5 s comes after" in stdout
        assert stderr == "cpid: error: bad.csv: 2 problems found, listed above\n"

    def test_contradictions_are_problems(self, cpid):
        log = read_log(SAMPLE)
        log.gyro.value[:] = np.degrees(log.gyro.value)
        write_log("degrees.csv", log)
        code, stdout, _ = cpid("log", "check", "degrees.csv")
        assert code == 2
        assert "angular_velocity.unit: deg/s" in stdout
        assert "not checked: units of position, its point, signs of joints (needs --sp" in stdout

    def test_a_map_of_a_log_with_bad_rows_is_an_error_that_names_the_way_out(self, cpid):
        lines = SAMPLE.read_text().splitlines()
        Path("back.csv").write_text("\n".join([*lines[:9], *lines[7:]]) + "\n")
        code, _, stderr = cpid("log", "map", "back.csv", *CRAFT, "--out", "map.yaml")
        assert code == 2
        assert "line 10" in stderr
        assert "--leave-out-bad" in stderr
        assert Path("map.yaml").exists()

    @pytest.mark.parametrize(("start", "end"), [(2.0, 2.6), (4.0, 4.6), (0.0, 1.0)])
    def test_a_right_log_of_a_second_has_no_errors(self, cpid, start, end):
        """Other conventions explain it better, but noise explains it as it is."""
        write_log("short.csv", read_log(SAMPLE).between(start, end))
        code, stdout, _ = cpid("log", "check", "short.csv", *CRAFT)
        assert (code, "error:" in stdout) == (0, False)

    def test_positions_in_millimetres_are_named(self, cpid):
        """Relative rows do not use positions: their answer is right, with a warning."""
        log = read_log(SAMPLE)
        log.position.value[:] *= 1000
        write_log("mm.csv", log)
        code, stdout, stderr = cpid("log", "check", "mm.csv", *CRAFT)
        assert code == 2
        assert "the position is in millimetres" in stdout + stderr
        rows = ("--rows", "relative")
        code, stdout, stderr = cpid("identify", "mm.csv", *CRAFT, *rows)
        assert "momentum leaves 100% of the motion unexplained" in stderr
        given, expected, _ = cpid("identify", SAMPLE, *CRAFT, *rows)
        assert code == given == 4  # noise biases the rows
        values = [line for line in stdout.splitlines() if line[:4] in ("  m ", "  cx", "  Ix")]
        assert len(values) == 5
        assert set(values) <= set(expected.splitlines())
        Path("map.yaml").write_text("position: {unit: mm}\n")
        assert cpid("log", "check", "mm.csv", *CRAFT, "--columns", "map.yaml")[0] == 0


def test_the_sensors_that_a_log_shows_identify_it(cpid):
    code, stdout, stderr = cpid("log", "noise", SAMPLE, *CRAFT, "--out", "own_sensors.yaml")
    assert code == 0, stderr
    text = Path("own_sensors.yaml").read_text(encoding="utf-8")
    assert text in stdout + "\n"
    assert yaml.safe_load(text)["attitude"]["noise_deg"] == pytest.approx(0.05, rel=0.1)
    assert "differences of order" in text
    assert stderr.endswith("identify with --sensors own_sensors.yaml\n")
    options = ("--sensors", "own_sensors.yaml", "--json", "own.json", "--quiet")
    assert cpid("identify", SAMPLE, *CRAFT, *options)[0] == 0
    result = read_result("own.json")
    assert np.all(result.intervals[:, 0] < TRUTH)
    assert np.all(result.intervals[:, 1] > TRUTH)


def test_a_log_in_other_units_shows_no_sensors(cpid):
    log = read_log(SAMPLE)
    lines = Path(SAMPLE).read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    place = [rows[0].index(name) for name in ("bwx", "bwy", "bwz")]
    for row in rows[1:]:
        for k in place:
            row[k] = repr(float(row[k]) * 180 / np.pi) if row[k] else ""
    Path("degrees.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    code, stdout, stderr = cpid("log", "noise", "degrees.csv", *CRAFT, "--out", "none.yaml")
    assert len(log.gyro)
    assert (code, stdout, stderr.count("\n")) == (2, "", 1)
    assert not Path("none.yaml").exists()
