"""`cpid identify` and `cpid telemetry check`: what they print and write, and how they end."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t as student

from cpid_drake import InertialParameters, read_telemetry, write_telemetry
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.identification.description import principal_axes
from cpid_drake.identification.result_files import read_result
from cpid_drake.resources import models_directory

SAMPLE = models_directory() / "telemetry/free_flyer.csv"
FREE_FLYER = (
    *("--spacecraft", models_directory() / "free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point"),
)
SERVICER = (
    *("--spacecraft", "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"),
    *("--base", "bus", "--capture-frame", "capture_point"),
)
BAG = InertialParameters(
    8.5,
    [0.26, 0.02, -0.015],
    [[0.16, 0.012, -0.008], [0.012, 0.19, 0.01], [-0.008, 0.01, 0.25]],
)


@pytest.fixture
def cpid(run_cpid, monkeypatch, tmp_path):
    """Return a function that runs `cpid` in an empty folder: (code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    return run_cpid


@pytest.fixture
def exact(tmp_path, zero_momentum_motion, skewed_target):
    """A log of the servicer without any error: 60 states at random."""
    motion = zero_momentum_motion(skewed_target, 60, 4)
    write_telemetry(tmp_path / "exact.csv", motion)
    return tmp_path / "exact.csv"


def refusal(outcome) -> str:
    code, stdout, stderr = outcome
    assert (code, stdout) == (2, "")
    assert stderr.startswith("cpid: error: ")
    assert stderr.count("\n") == 1
    return stderr


class TestSample:
    """The log that comes with the package, of which the truth is known."""

    @pytest.fixture
    def result(self, cpid):
        code, stdout, stderr = cpid(
            *("identify", SAMPLE, *FREE_FLYER, "--sensors", "testbed", "--json", "found.json")
        )
        assert (code, stderr) == (0, "")
        return stdout, json.loads(Path("found.json").read_text())

    def test_json_holds_what_was_found_and_what_is_printed(self, result):
        stdout, found = result
        values = np.array(found["parameters"])
        sigma = np.sqrt(np.diag(found["covariance"]))
        assert np.all(np.abs(values - BAG.to_vector()) < 4 * sigma)
        intervals = np.array(found["intervals"])
        np.testing.assert_allclose(intervals.mean(axis=1), values, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(np.diff(intervals).ravel() / 2, 1.96 * sigma, rtol=1e-3)
        assert found["nearest"][0] == pytest.approx(8.5, rel=0.01)
        assert found["rank"] == 10
        assert 1 < found["condition"] < 1000
        assert found["sample_count"] == 4004
        assert found["rejected"] == {}
        assert found["warnings"] == []
        assert all(check["passed"] for check in found["checks"])
        target = read_result("found.json").consistent
        (moments, axes), tensor = principal_axes(target), target.I_TTcm_C
        np.testing.assert_allclose(axes @ np.diag(moments) @ axes.T, tensor, atol=1e-15)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        lines = {line.split()[0]: line for line in stdout.splitlines() if line.strip()}
        for name, value in zip(PARAMETER_NAMES, values, strict=True):
            shown = lines[name].split()[1]
            assert float(shown) == pytest.approx(value, abs=10.0 ** -len(shown.split(".")[1]))
        assert lines["rank"].split()[1:] == ["10", "of", "10"]
        assert "physically consistent" in lines["consistency"]


class TestUncertainSpacecraft:
    OPTION = "mass=0.01,joint_axis_mrad=0.5,grasp_mm=3"

    @pytest.mark.slow
    def test_intervals_include_the_spacecraft(self, cpid):
        """The centre of mass is known no better than the frame in which it is expressed: 3 mm."""
        sigmas = []
        for option in ((), ("--known-bodies", self.OPTION)):
            options = ("--sensors", "testbed", *option, "--json", "r.json", "--force")
            code, out, _ = cpid("identify", SAMPLE, *FREE_FLYER, *options)
            assert code == 0
            assert ("an exact spacecraft model" in out) == (not option)
            found = json.loads(Path("r.json").read_text())
            sigmas.append(np.sqrt(np.diag(found["covariance"])))
        exact, uncertain = sigmas
        assert np.all(uncertain > exact)
        np.testing.assert_allclose(uncertain[1:4], np.hypot(exact[1:4], 0.003), rtol=0.01)
        assert found["sources"][0]["request"]["known_bodies"] == self.OPTION
        assert "--known-bodies" in read_result("r.json").command

    def test_rows_do_not_include_it(self, cpid):
        options = ("--known-bodies", "com=0.01", "--estimator", "least_squares")
        _, _, stderr = cpid("identify", SAMPLE, *FREE_FLYER, *options)
        assert "least_squares does not use the uncertainty of the spacecraft" in stderr

    @pytest.mark.parametrize(
        ("option", "problem"),
        [
            ("mass=-1", "mass=-1: mass must be a number >= 0"),
            ("weight=1", "unknown key 'weight'"),
            ("mass=a lot", "'mass=a lot' is not KEY=NUMBER; the keys are mass, com, "),
            ("mass=1,mass=2", "the key 'mass' is given twice"),
        ],
    )
    def test_impossible_uncertainty(self, cpid, option, problem):
        assert problem in refusal(cpid("identify", SAMPLE, *FREE_FLYER, "--known-bodies", option))


class TestIdentify:
    def test_an_exact_log_gives_the_target(self, cpid, exact, skewed_target):
        code, stdout, stderr = cpid("identify", exact, *SERVICER, "--json", "r.json", "--quiet")
        assert (code, stdout) == (0, "")
        # Its states belong to instants that are not connected.
        [line] = stderr.splitlines()
        assert line.startswith("warning: not checked: ")
        assert "no motion explains the positions closely" in line
        found = read_result("r.json")
        np.testing.assert_allclose(found.parameters, skewed_target.to_vector(), atol=1e-9)
        assert found.sources[0].request.telemetry == str(exact)

    def test_intervals_of_few_samples_are_students(self, cpid, zero_momentum_motion, skewed_target):
        """24 rows less ten unknowns are 14 degrees of freedom: 2.14 σ to each side, not 1.96."""
        write_telemetry("few.csv", zero_momentum_motion(skewed_target, 4, 4).rounded(4))
        assert cpid("identify", "few.csv", *SERVICER, "--json", "r.json", "--quiet")[0] == 0
        found = json.loads(Path("r.json").read_text())
        half = np.diff(found["intervals"]).ravel() / 2
        sigma = np.sqrt(np.diag(found["covariance"]))
        np.testing.assert_allclose(half / sigma, student.interval(0.95, 24 - 10)[1], rtol=1e-6)

    def test_too_little_motion_is_exit_code_3_and_what_is_known_is_written(self, cpid, exact):
        code, stdout, _ = cpid("identify", exact, *SERVICER, "--to", "1.5", "--json", "r.json")
        assert code == 3
        assert "Not known: 1 combination of" in stdout
        assert "joints with different axes" in " ".join(stdout.split())
        found = read_result("r.json")
        assert found.rank == 9
        assert found.consistent is None
        assert found.parameters[0] == pytest.approx(60.0)
        assert np.isnan(found.parameters[4:]).all()

    def test_only_times_asked_for_are_used(self, cpid, exact):
        cpid("identify", exact, *SERVICER, "--from", "10", "--to", "29", "--json", "r.json")
        found = read_result("r.json")
        assert found.sample_count == 20
        assert (found.sources[0].start, found.sources[0].end) == (10.0, 29.0)

    def test_seconds_since_1970_make_no_difference(self, cpid, exact):
        lines = exact.read_text().splitlines()
        later = [lines[0]]
        for line in lines[1:]:
            time, rest = line.split(",", 1)
            later.append(f"{float(time) + 1.7e9!r},{rest}")
        exact.with_name("later.csv").write_text("\n".join(later))
        for name in ("exact", "later"):
            cpid("identify", f"{name}.csv", *SERVICER, "--json", f"{name}.json")
        one, other = (read_result(f"{name}.json") for name in ("exact", "later"))
        np.testing.assert_array_equal(one.parameters, other.parameters)

    def test_bad_rows_are_left_out_only_if_asked_for_and_counted(self, cpid, exact):
        lines = exact.read_text().splitlines()
        lines[7] = lines[7].replace(",", ",nan,", 1)
        exact.write_text("\n".join(lines))
        assert "line 8: " in refusal(cpid("identify", exact, *SERVICER))
        code, stdout, _ = cpid(
            *("identify", exact, *SERVICER, "--leave-out-bad", "--json", "r.json")
        )
        assert code == 0
        assert "not used     1 of rows" in stdout
        assert read_result("r.json").rejected == {"rows": 1}

    def test_columns_that_mean_nothing_are_named(self, cpid, exact):
        lines = exact.read_text().splitlines()
        exact.write_text("\n".join([lines[0] + ",mode", *(line + ",7" for line in lines[1:])]))
        code, _, stderr = cpid("identify", exact, *SERVICER)
        assert code == 0
        assert "note: ignored columns: mode\n" in stderr

    @pytest.mark.parametrize(
        ("arguments", "phrase"),
        [
            (["--estimator", "magic"], "no estimator 'magic'; choose from least_squares"),
            (["--rows", "magic"], "no row family 'magic'; choose from eq18"),
            (["--sensors", "magic"], "no sensors: magic"),
            (["--from", "5", "--to", "2"], "the interval is empty"),
            (["--from", "1000"], "no samples between --from and --to"),
            (["--json", "nowhere/r.json"], "there is no folder nowhere"),
            (["--package", "robot"], "give NAME=FOLDER"),
            (["--topic", "imu=/imu"], "topics are for ROS 2 bags"),
            (["--base", "nothing"], "no body 'nothing'"),
        ],
    )
    def test_what_cannot_be_is_one_line(self, cpid, exact, arguments, phrase):
        assert phrase in refusal(cpid("identify", exact, *SERVICER, *arguments))

    def test_a_log_of_another_spacecraft_names_file_and_joints(self, cpid, exact):
        message = refusal(cpid("identify", exact, *FREE_FLYER))
        assert "exact.csv: there is no column 'q:arm_joint1'" in message


class TestCheck:
    def test_a_good_file(self, cpid):
        code, stdout, stderr = cpid("telemetry", "check", SAMPLE, *FREE_FLYER)
        assert (code, stderr) == (0, "")
        assert "1001 samples, 0 to 10 s, every 0.01 s" in stdout
        assert "joints             4: arm_joint1, arm_joint2" in stdout
        assert "no problems found" in stdout

    def test_every_problem_is_listed_with_its_line(self, cpid, exact):
        lines = exact.read_text().splitlines()
        lines[3] = lines[3].replace(",", ",,", 1)
        lines[5] = "0.5" + lines[5][lines[5].index(",") :]
        exact.write_text("\n".join(lines))
        code, stdout, stderr = cpid("telemetry", "check", exact)
        assert code == 2
        assert "error: line 4: 39 cells, but 38 columns" in stdout
        assert "error: line 6, column 'time': time 0.5 s comes after 3 s" in stdout
        assert stderr == f"cpid: error: {exact}: 2 problems found, listed above\n"

    def test_contradictions_are_problems(self, cpid):
        log = read_telemetry(SAMPLE)
        log.gyro.value[:] = np.degrees(log.gyro.value)
        write_telemetry("degrees.csv", log)
        code, stdout, _ = cpid("telemetry", "check", "degrees.csv")
        assert code == 2
        assert "is it in degrees/s? It must be in rad/s" in stdout

    def test_joints_are_compared_with_the_model(self, cpid, exact):
        code, stdout, _ = cpid("telemetry", "check", exact, *FREE_FLYER)
        assert code == 2
        assert "no column 'q:arm_joint1'; the spacecraft's joints are arm_joint1" in stdout

    def test_a_model_needs_its_frames(self, cpid, exact):
        message = refusal(cpid("telemetry", "check", exact, "--base", "bus"))
        assert "give all of --spacecraft" in message
