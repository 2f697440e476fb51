"""`cpid identify` with several logs and with a prior: output, files and exit codes."""

from pathlib import Path

import numpy as np
import pytest

from cpid_drake import read_telemetry, write_telemetry
from cpid_drake.identification.result_files import read_result
from cpid_drake.resources import models_directory

SAMPLE = models_directory() / "telemetry/free_flyer.csv"
FREE_FLYER = (
    *("--spacecraft", models_directory() / "free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point", "--sensors", "testbed"),
)
SERVICER = (
    *("--spacecraft", "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"),
    *("--base", "bus", "--capture-frame", "capture_point"),
)
CAD = "mass: 8\np_CTcm_C: [0.3, 0, 0]\nI_TTcm_C: [[0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]]\n"


@pytest.fixture
def cpid(run_cpid, monkeypatch, tmp_path):
    """Return a function that runs `cpid` in an empty folder: (code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    return run_cpid


@pytest.fixture
def halves(cpid):
    """The sample log in two files."""
    log = read_telemetry(SAMPLE)
    write_telemetry("first.csv", log.between(0.0, 4.999))
    write_telemetry("second.csv", log.between(4.999, 20.0))
    return "first.csv", "second.csv"


@pytest.fixture
def two_samples(tmp_path, zero_momentum_motion, skewed_target, cpid):
    """Two logs of two exact samples each: both leave one combination open."""
    for seed in (1, 2):
        write_telemetry(f"{seed}.csv", zero_momentum_motion(skewed_target, 2, seed))
    return "1.csv", "2.csv"


def refusal(outcome) -> str:
    code, stdout, stderr = outcome
    assert (code, stdout) == (2, "")
    assert stderr.count("\n") == 1
    return stderr


class TestLogs:
    @pytest.mark.slow
    def test_the_joint_result_is_printed_written_and_reported(self, cpid, halves, short_reports):
        options = ("--json", "both.json", "--report", "both.html")
        code, stdout, stderr = cpid("identify", *halves, *FREE_FLYER, *options)
        assert code == 0
        assert all("momentum may not be zero" in line for line in stderr.splitlines())
        assert "The sources agree (χ²" in stdout
        assert "first.csv   rank 10" in stdout
        result = read_result("both.json")
        assert [source.request.telemetry for source in result.sources] == list(halves)
        assert result.command.startswith("cpid identify first.csv second.csv --space")
        assert result.sample_count == sum(log.sample_count for log in result.logs.values())
        own = [np.ptp(log.intervals, axis=1) for log in result.logs.values()]
        assert np.all(np.ptp(result.intervals, axis=1) < np.minimum(*own))
        page = Path("both.html").read_text()
        for word in ("second.csv", "together", "Agreement"):
            assert word in page
        assert cpid("report", "both.json", "--out", "again.html")[0] == 0
        assert "Estimates with 95 % intervals" in Path("again.html").read_text()

    def test_logs_of_rank_nine_determine_all_together(self, cpid, two_samples):
        assert [cpid("identify", log, *SERVICER, "--quiet")[0] for log in two_samples] == [3, 3]
        assert cpid("identify", *two_samples, *SERVICER, "--quiet")[0] == 0

    def test_logs_of_two_targets_are_doubted(self, cpid, zero_momentum_motion, skewed_target):
        from cpid_drake import InertialParameters

        other = InertialParameters(61.0, skewed_target.p_CTcm_C, skewed_target.I_TTcm_C)
        write_telemetry("a.csv", zero_momentum_motion(skewed_target, 40, 1))
        write_telemetry("b.csv", zero_momentum_motion(other, 40, 2))
        code, stdout, _ = cpid("identify", "a.csv", "b.csv", *SERVICER, "--json", "x.json")
        assert code == 4
        stdout = " ".join(stdout.split())  # lines may be as long as the terminal is wide
        assert stdout.startswith("failed check: the logs do not have the same target")
        assert "differs from the rest, most in m" in stdout

    def test_one_log_twice_is_refused(self, cpid, halves):
        Path("copy.csv").write_bytes(Path("first.csv").read_bytes())
        outcome = cpid("identify", *halves, "copy.csv", *FREE_FLYER)
        assert "copy.csv: is the same log as first.csv" in refusal(outcome)


class TestPrior:
    @pytest.mark.slow
    def test_a_result_is_a_prior(self, cpid, halves):
        first, second = halves
        assert cpid("identify", first, *FREE_FLYER, "--json", "1.json", "--quiet")[0] == 0
        assert cpid("identify", *halves, *FREE_FLYER, "--json", "2.json", "--quiet")[0] == 0
        code, stdout, stderr = cpid(
            *("identify", second, *FREE_FLYER, "--prior", "1.json", "--json", "3.json")
        )
        assert code == 0
        assert "the prior 1.json was used; it determines" in stderr
        assert "the prior 1.json  rank 10" in stdout
        both, after = read_result("2.json"), read_result("3.json")
        sigma = np.sqrt(np.diag(both.covariance))
        assert np.all(np.abs(after.parameters - both.parameters) < 0.2 * sigma)
        assert after.sources[0].request.prior == "1.json"
        assert "--prior 1.json" in after.command

    def test_a_result_of_rank_nine_is_a_prior(self, cpid, two_samples):
        first, second = two_samples
        cpid("identify", first, *SERVICER, "--json", "1.json", "--quiet")
        combinations = read_result("1.json").combinations
        assert np.linalg.matrix_rank(combinations.information, hermitian=True) == 9
        options = ("--prior", "1.json", "--json", "2.json", "--quiet")
        assert cpid("identify", second, *SERVICER, *options)[0] == 0
        assert read_result("2.json").parameters[0] == pytest.approx(60.0, rel=1e-5)

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("mass: 8\n", "give sigma_mass, or sigma for all"),
            (CAD + "sigma: 0.1\nweight: 3\n", "weight"),
            ("p_CTcm_C: [1, 0, 0]\nsigma: 0.1\n", "give sigma_p_CTcm_C: sigma needs mass"),
        ],
    )
    def test_a_design_that_is_wrong_is_refused(self, cpid, text, words):
        Path("cad.yaml").write_text(text)
        outcome = cpid("identify", SAMPLE, *FREE_FLYER, "--prior", "cad.yaml")
        assert words in refusal(outcome)

    def test_a_prior_in_another_frame_is_refused(self, cpid, two_samples):
        cpid("identify", two_samples[0], *SERVICER, "--json", "1.json", "--quiet")
        text = Path("1.json").read_text().replace('"capture_point"', '"gripper"')
        Path("2.json").write_text(text)
        outcome = cpid("identify", two_samples[1], *SERVICER, "--prior", "2.json")
        assert "the prior is in the capture frame gripper" in refusal(outcome)
        outcome = cpid("identify", two_samples[1], *SERVICER, "--prior", "none.json")
        assert "--prior none.json: no such file" in refusal(outcome)
