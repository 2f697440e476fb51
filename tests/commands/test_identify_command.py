"""`cpid identify`: what it prints and writes, and how it ends."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from flyer_cases import FREE_FLYER, SAMPLE

from cpid_drake import InertialParameters, load_sensors, read_log, write_log
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.files.dumping import dump_yaml
from cpid_drake.files.resources import models_directory
from cpid_drake.identification.description import principal_axes
from cpid_drake.identification.result_files import read_result

NOISY = (*FREE_FLYER, "--sensors", "testbed")
SERVICER = ("--spacecraft", "paper")
BAG = InertialParameters(
    8.5,
    [0.26, 0.02, -0.015],
    [[0.16, 0.012, -0.008], [0.012, 0.19, 0.01], [-0.008, 0.01, 0.25]],
)
CAD = "mass: 8\np_CTcm_C: [0.3, 0, 0]\nI_TTcm_C: [[0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]]\n"


@pytest.fixture
def exact(cpid, zero_momentum_motion, skewed_target):
    """A log of the servicer without any error: 60 states at random."""
    write_log("exact.csv", zero_momentum_motion(skewed_target, 60, 4))
    return Path("exact.csv")


@pytest.fixture
def halves(cpid):
    """The sample log in two files."""
    log = read_log(SAMPLE)
    write_log("first.csv", log.between(0.0, 4.999))
    write_log("second.csv", log.between(4.999, 20.0))
    return "first.csv", "second.csv"


@pytest.fixture
def two_samples(cpid, zero_momentum_motion, skewed_target):
    """Two logs of two exact samples each: both leave one combination open."""
    for seed in (1, 2):
        write_log(f"{seed}.csv", zero_momentum_motion(skewed_target, 2, seed))
    return "1.csv", "2.csv"


def test_the_result_holds_what_is_found_and_printed(cpid):
    code, stdout, stderr = cpid("identify", SAMPLE, *NOISY, "--json", "found.json")
    assert (code, stderr) == (0, "")
    found = json.loads(Path("found.json").read_text())
    values = np.array(found["parameters"])
    sigma = np.sqrt(np.diag(found["covariance"]))
    assert np.all(np.abs(values - BAG.to_vector()) < 4 * sigma)
    intervals = np.array(found["intervals"])
    nearly = (intervals - values[:, None]) / sigma[:, None]  # c and I are not linear in m c and J
    np.testing.assert_allclose(nearly, np.tile([-1.96, 1.96], (10, 1)), rtol=0.01)
    assert found["nearest"][0] == pytest.approx(8.5, rel=0.01)
    assert (found["rank"], found["sample_count"], found["rejected"]) == (10, 4004, {})
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


def test_a_printed_result_is_what_the_command_prints(cpid):
    """On a terminal: the warnings, which are on stderr, and the table."""
    _, stdout, stderr = cpid("identify", SAMPLE, *FREE_FLYER, "--to", "1", "--json", "found.json")
    assert "warning: " in stderr
    assert f"{read_result('found.json')}\n" == stderr + stdout


def test_sensors_beside_a_log_are_said_not_to_be_used(cpid):
    """Those of a run of `cpid simulate` are sensors.yaml; another log has its name before."""
    Path("run").mkdir()
    Path("run/telemetry.csv").write_bytes(SAMPLE.read_bytes())
    given = ("run/telemetry.csv", "--spacecraft", "free_flyer_payload", "--to", "2", "--quiet")
    said = "lies beside the log, and is not used: give --sensors"
    assert said not in cpid("identify", *given)[2]
    for name in ("sensors.yaml", "telemetry_sensors.yaml"):
        Path(f"run/{name}").write_text(dump_yaml(load_sensors("testbed")))
        assert f"warning: run/{name} {said} run/{name}\n" in cpid("identify", *given)[2]
        assert said not in cpid("identify", *given, "--sensors", f"run/{name}")[2]
        Path(f"run/{name}").unlink()


class TestScenario:
    """--spacecraft says of the spacecraft what single options say, and they override it."""

    OWN = (
        "model: craft/free_flyer.urdf\nbase: body\ncapture_frame: capture_point\nsensors: testbed\n"
        "momentum: unknown\nplanar: false\nknown_bodies: {mass: 0.01, grasp_mm: 3}\n"
    )

    def request(self, cpid, *options):
        arguments = ("--estimator", "least_squares", "--json", "r.json", "--force", "--quiet")
        assert cpid("identify", SAMPLE, *options, *arguments)[0] in (0, 3, 4)
        [source] = read_result("r.json").sources
        return source.request

    def test_of_a_file_of_the_spacecraft(self, cpid):
        Path("craft").symlink_to(models_directory() / "free_flyer")
        Path("own.yaml").write_text(self.OWN)
        found = self.request(cpid, "--spacecraft", "own.yaml")
        assert (found.sensors, found.momentum, found.planar) == ("testbed", "unknown", False)
        assert found.spacecraft.model == str(Path("craft/free_flyer.urdf").absolute())
        assert "mass=0.01" in found.known_bodies
        assert "grasp_mm=3.0" in found.known_bodies
        options = ("--momentum", "zero", "--known-bodies", "com=0.01", "--sensors", "flight")
        found = self.request(cpid, "--spacecraft", "own.yaml", *options)
        assert (found.momentum, found.known_bodies, found.sensors) == ("zero", "com=0.01", "flight")

    def test_a_model_alone_is_refused(self, refusal):
        message = refusal("identify", SAMPLE, "--spacecraft", "arm.urdf")
        assert "give it as --model, with --base and --capture-frame" in message

    def test_the_scenario_s_target_is_not_used(self, cpid):
        text = (models_directory() / "scenarios/free_flyer_payload.yaml").read_text()
        Path("other.yaml").write_text(text.replace("mass: 8.5", "mass: 85.0"))
        results = []
        for name in ("free_flyer_payload", "other.yaml"):
            self.request(cpid, "--spacecraft", name)
            results.append(read_result("r.json").parameters)
        np.testing.assert_array_equal(*results)

    def test_sensors_that_a_scenario_lists_itself_are_not_lost(self, refusal):
        text = (models_directory() / "scenarios/free_flyer_payload.yaml").read_text()
        suite = (models_directory() / "sensors/testbed.yaml").read_text()
        lines = [f"    {line}" for line in suite.splitlines()]
        Path("own.yaml").write_text("\n".join([text, "sensors:", "  explicit:", *lines]))
        message = refusal("identify", SAMPLE, "--spacecraft", "own.yaml")
        assert "lists its sensors itself" in message


def test_the_result_says_whether_the_spacecraft_is_taken_as_exact(cpid):
    """Of a log whose sensors are a preset for anybody's hardware, its bodies are not."""
    options = ("--to", "5", "--sensors", "testbed", "--json", "r.json", "--force")
    for more, is_exact in (((), False), (("--known-bodies", "exact"), True)):
        code, stdout, _ = cpid("identify", SAMPLE, *FREE_FLYER, *options, *more)
        found = read_result("r.json")
        assert code == 0
        assert found.given == (("spacecraft model",) if is_exact else ())
        assert ("for an exact spacecraft model" in stdout) == is_exact
        of_bodies = [row for row in found.budget if "mass of" in row.name]
        assert bool(of_bodies) != is_exact
        assert "all errors together" in stdout


class TestOneLog:
    def test_too_little_motion_is_exit_code_3_and_what_is_known_is_written(self, cpid, exact):
        """Only the times asked for are used: two samples."""
        code, stdout, _ = cpid("identify", exact, *SERVICER, "--to", "1.5", "--json", "r.json")
        assert code == 3
        assert "Not identifiable: 1 combination of" in stdout
        assert "joints with different axes" in " ".join(stdout.split())
        found = read_result("r.json")
        assert (found.rank, found.sample_count, found.consistent) == (9, 2, None)
        assert found.parameters[0] == pytest.approx(60.0)
        assert np.isnan(found.parameters[4:]).all()

    def test_bad_rows_are_left_out_only_if_asked_for_and_counted(self, cpid, exact, refusal):
        lines = exact.read_text().splitlines()
        lines[7] = lines[7].replace(",", ",nan,", 1)
        exact.write_text("\n".join(lines))
        assert "line 8: " in refusal("identify", exact, *SERVICER)
        options = ("--leave-out-bad", "--json", "r.json")
        code, stdout, _ = cpid("identify", exact, *SERVICER, *options)
        assert code == 0
        assert "not used     1 of rows" in stdout
        assert read_result("r.json").rejected == {"rows": 1}

    @pytest.mark.parametrize(
        ("arguments", "phrase"),
        [
            (["--momentum", "some"], 'for --momentum. Choose from: "zero", "unknown"'),
            (["--from", "5", "--to", "2"], "the interval is empty"),
            (["--package", "robot"], "give NAME=FOLDER"),
            (["--topic", "imu=/imu"], "topics are for ROS bags"),
            (["--known-bodies", "mass=-1"], "mass must be greater than or equal to 0"),
            (
                ["--spacecraft", "free_flyer_payload"],
                "exact.csv: there is no column 'q:arm_joint1'",
            ),
        ],
    )
    def test_what_cannot_be_is_one_line(self, exact, refusal, arguments, phrase):
        assert phrase in refusal("identify", exact, *SERVICER, *arguments)


class TestSeveralLogs:
    @pytest.mark.slow
    def test_the_joint_result_is_printed_written_and_reported(self, cpid, halves, short_reports):
        options = ("--json", "both.json", "--report", "both.html")
        code, stdout, _ = cpid("identify", *halves, *NOISY, *options)
        assert code == 0
        assert "The sources agree (χ²" in stdout
        assert "first.csv   rank 10" in stdout
        result = read_result("both.json")
        assert [source.request.telemetry for source in result.sources] == list(halves)
        assert result.command.startswith("cpid identify first.csv second.csv --model")
        assert result.sample_count == sum(log.sample_count for log in result.logs.values())
        own = [np.ptp(log.intervals, axis=1) for log in result.logs.values()]
        assert np.all(np.ptp(result.intervals, axis=1) < np.minimum(*own))
        assert cpid("report", "--result", "both.json", "--out", "again.html")[0] == 0
        for page in ("both.html", "again.html"):
            assert "second.csv" in Path(page).read_text()

    @pytest.mark.slow
    def test_one_may_have_other_sensors(self, cpid, halves, refusal, short_reports):
        Path("own.yaml").write_text(dump_yaml(load_sensors("testbed")))
        options = (*NOISY, "--sensors", "second.csv=own.yaml", "--json", "both.json")
        code, stdout, _ = cpid("identify", *halves, *options, "--report", "both.html")
        assert code == 0
        first, second = (line for line in stdout.splitlines() if " samples  agrees" in line)
        assert first.endswith("kg, sensors testbed")
        assert second.endswith("kg, sensors own.yaml")
        result = read_result("both.json")
        assert [each.request.sensors for each in result.sources] == ["testbed", "own.yaml"]
        owners = [each.hardware for each in result.effects if each.name == "gyro.scale"]
        assert owners == list(halves)
        assert "own.yaml" in Path("both.html").read_text()
        code, _, _ = cpid(*shlex.split(result.command)[1:], "--json", "again.json")
        again = read_result("again.json")
        np.testing.assert_array_equal(again.covariance, result.covariance)
        assert again.sources == result.sources
        write_log("third.csv", read_log(SAMPLE).between(2.0, 8.0))
        message = refusal("validate", "both.json", "third.csv")
        assert "both.json: its logs have different sensors; give --sensors" in message

    @pytest.mark.parametrize(
        ("options", "phrase"),
        [
            (["thrid.csv=flight"], "there is no log thrid.csv; the logs are first.csv, second.csv"),
            (["flight", "testbed"], "give one PRESET or YAML for all logs"),
            (["first.csv=flight", "first.csv=testbed"], "one NAME=PRESET or NAME=YAML for a log"),
            (["flight", "first.csv="], "one NAME=PRESET or NAME=YAML for a log"),
            (["flight", "first.csv=fligt"], "no sensors: fligt: no such file"),
        ],
    )
    def test_sensors_that_fit_no_log_are_one_line(self, halves, refusal, options, phrase):
        given = [each for option in options for each in ("--sensors", option)]
        assert phrase in refusal("identify", *halves, *FREE_FLYER, *given)

    def test_the_sensors_of_a_log_are_not_replaced(self, halves, refusal):
        Path("own.yaml").write_text(dump_yaml(load_sensors("testbed")))
        options = ("--sensors", "second.csv=own.yaml", "--json", "own.yaml", "--force")
        refusal("identify", *halves, *NOISY, *options)
        assert load_sensors("own.yaml")

    def test_without_time_the_result_so_far_fails_a_check(self, cpid, halves):
        code, stdout, _ = cpid("identify", halves[0], *NOISY, "--seconds", "0", "--json", "x.json")
        assert code == 4
        assert "failed check: the estimator did not converge" in stdout
        assert np.isfinite(read_result("x.json").parameters).any()

    def test_one_log_twice_is_refused(self, halves, refusal):
        Path("copy.csv").write_bytes(Path("first.csv").read_bytes())
        message = refusal("identify", *halves, "copy.csv", *NOISY)
        assert "copy.csv: is the same log as first.csv" in message


class TestPrior:
    @pytest.mark.slow
    def test_a_result_is_a_prior(self, cpid, halves):
        """As both logs together, of sensors without errors that both would share."""
        first, second = halves
        suite = dump_yaml(load_sensors("testbed", unstated="exact"))
        Path("exact.yaml").write_text(suite)
        known = (*FREE_FLYER, "--sensors", "exact.yaml")
        assert cpid("identify", first, *known, "--json", "1.json", "--quiet")[0] == 0
        assert cpid("identify", *halves, *known, "--json", "2.json", "--quiet")[0] == 0
        options = ("--prior", "1.json", "--json", "3.json")
        code, stdout, stderr = cpid("identify", second, *known, *options)
        assert code == 0
        assert "the prior 1.json was used; it determines" in stderr
        assert "the prior 1.json  rank 10" in stdout
        both, after = read_result("2.json"), read_result("3.json")
        sigma = np.sqrt(np.diag(both.covariance))
        assert np.all(np.abs(after.parameters - both.parameters) < 0.2 * sigma)
        assert "--prior 1.json" in after.command

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("mass: 8\n", "give sigma_mass, or sigma for all"),
            (CAD + "sigma: 0.1\nweight: 3\n", "weight"),
            ("p_CTcm_C: [1, 0, 0]\nsigma: 0.1\n", "give sigma_p_CTcm_C: sigma needs mass"),
        ],
    )
    def test_a_design_that_is_wrong_is_refused(self, refusal, text, words):
        Path("cad.yaml").write_text(text)
        assert words in refusal("identify", SAMPLE, *NOISY, "--prior", "cad.yaml")

    def test_a_prior_in_another_frame_is_refused(self, cpid, refusal, two_samples):
        cpid("identify", two_samples[0], *SERVICER, "--json", "1.json", "--quiet")
        text = Path("1.json").read_text().replace('"capture_point"', '"gripper"')
        Path("2.json").write_text(text)
        message = refusal("identify", two_samples[1], *SERVICER, "--prior", "2.json")
        assert "the prior is in the capture frame gripper" in message
