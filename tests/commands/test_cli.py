"""The `cpid` command as a user meets it: its output, its files, its exit codes."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from processes import finish, start

from cpid_drake import shipped_scenario
from cpid_drake.commands.main import main
from cpid_drake.resources import models_directory

FIGURES = (
    "figure3_configurations.png",
    "figure5_joint_motion.png",
    "figure6_base_response.png",
    "figure7_errors.png",
    "table2_decimals.png",
    "online_convergence.png",
)
PI_60 = [60.0, 0.4330127, 0.0, 0.0, 20.0, 30.0, 10.0, 0.0, 0.0, 0.0]


def assert_refused(run) -> str:
    assert run.returncode == 2, run.stderr
    assert run.stdout == ""
    assert run.stderr.startswith("cpid: error: ")
    assert run.stderr.endswith("\n")
    assert run.stderr.count("\n") == 1
    return run.stderr


def embedded_summary(page: str) -> dict:
    """The numbers that a report holds."""
    return json.loads(re.search(r'id="data-summary">(.*?)</script>', page, re.DOTALL)[1])


@pytest.fixture
def cpid(monkeypatch, capfd, tmp_path):
    """Return a function that runs `cpid` in an empty folder, in this process: it is quicker."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def run(*arguments) -> subprocess.CompletedProcess:
        monkeypatch.setattr(sys, "argv", ["cpid", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        return subprocess.CompletedProcess(arguments, ended.value.code, *capfd.readouterr())

    return run


@pytest.fixture(scope="module")
def lighter(tmp_path_factory):
    """The paper's study of a target of 60 kg, in a process of its own: (folder, process)."""
    folder = tmp_path_factory.mktemp("runs")
    text = shipped_scenario("paper").read_text()
    lighter = re.sub(r"\bmass: \S+", "mass: 60.0", text, count=1)
    lighter = re.sub(r"\baccuracy: \S+", "accuracy: 3.0e-10", lighter)
    assert "mass: 60.0" in lighter
    assert "accuracy: 3.0e-10" in lighter
    (folder / "lighter.yaml").write_text(lighter)
    arguments = ("paper", "--quiet", "--out", "lighter", "--scenario", "lighter.yaml")
    return folder, finish(start("-m", "cpid_drake", *arguments, cwd=folder))


@pytest.fixture(scope="module")
def summary(paper_run):
    return json.loads((paper_run.folder / "summary.json").read_text())


# -- a full run ----------------------------------------------------------------------------------


def test_the_folder_is_made_and_holds_figures_and_numbers(paper_run):
    files = {path.name: path.read_bytes() for path in paper_run.folder.iterdir()}
    assert files.keys() == {*FIGURES, "summary.json", "report.html"}
    for name in FIGURES:
        assert files[name].startswith(b"\x89PNG\r\n\x1a\n"), name
        assert len(files[name]) > 10_000, name


def test_the_report_holds_figures_tables_and_summary(paper_run, summary):
    page = (paper_run.folder / "report.html").read_text()
    assert embedded_summary(page) == summary
    assert page.count("<figure") == page.count("<svg") == 14  # the panels of the figures
    for title in ("Table 1.", "Table 2.", "Rank and error by number of samples", "Checks"):
        assert title in page
    assert len(page) < 5_000_000


def test_tables_go_to_stdout_and_progress_to_stderr(paper_run):
    for title in ("Table 1.", "Table 2.", "Rank and error by number of samples", "Checks"):
        assert title in paper_run.stdout
        assert title not in paper_run.stderr
    assert "8 files in new/paper" in paper_run.stderr
    assert "8 files" not in paper_run.stdout
    assert "\x1b" not in paper_run.stdout  # no colours where it is not a terminal


def test_quiet_prints_nothing(lighter):
    _, run = lighter
    assert run.returncode == 0
    assert run.stdout == ""
    assert run.stderr == ""


def test_table_1_of_the_summary(summary):
    """Exact samples give the target; six decimals give it to a thousandth."""
    table = summary["table1"]
    for case, error in (("exact", 1e-7), ("rounded6", 1e-3)):
        assert table[case].keys() == {
            *("mass", "com", "inertia", "relative_errors", "max_relative_error")
        }
        largest = np.abs(table[case]["relative_errors"]).max()
        assert largest == pytest.approx(table[case]["max_relative_error"])
        assert 0 < table[case]["max_relative_error"] < error
        assert table[case]["mass"] == pytest.approx(100.0, rel=error)
        np.testing.assert_allclose(table[case]["com"], [0.4330127, 0, 0], atol=error)
        np.testing.assert_allclose(
            table[case]["inertia"], [20, 30, 10, 0, 0, 0], rtol=0, atol=60 * error
        )


def test_table_2_of_the_summary(summary):
    """The error falls about a decade a decimal: there is no plateau from four decimals on."""
    table = summary["table2"]
    assert [row["decimals"] for row in table] == list(range(1, 13))
    keys = {"decimals", "mass", "max_relative_error", "objection"}
    assert all(row.keys() == keys for row in table)
    error = {row["decimals"]: row["max_relative_error"] for row in table}
    for decimals in range(4, 8):
        assert error[decimals + 2] < 0.2 * error[decimals]
    assert abs(table[8]["mass"] - 100.0) < 1e-4


def test_samples_of_the_summary(summary):
    """One sample has rank 6, two have rank 9, three determine everything."""
    table = summary["samples"]
    assert [row["n"] for row in table] == list(range(1, 11))
    assert [row["rank"] for row in table] == [6, 9] + 8 * [10]
    assert [row["max_relative_error"] is None for row in table] == 2 * [True] + 8 * [False]
    assert table[-1]["max_relative_error"] == pytest.approx(
        summary["table1"]["exact"]["max_relative_error"]
    )


def test_the_other_numbers_of_the_summary(summary):
    assert 0 < summary["momentum"]["max_linear_drift"] < 1e-8
    assert 0 < summary["momentum"]["max_angular_drift"] < 1e-8
    assert 0 < summary["figure7"]["max_attitude_relative_error"] < 0.0025  # the paper's own
    assert 0 < summary["figure7"]["max_position_relative_error"] < 0.0004  # the paper's own
    assert summary["online_minus_batch"] < 1e-9
    assert summary["wall_seconds"] > 0


def test_another_target_is_identified_as_that_one(lighter):
    """Nothing of the answer is in the program: change the truth and the answer follows."""
    folder, run = lighter
    assert run.returncode == 0, run.stderr
    table = json.loads((folder / "lighter" / "summary.json").read_text())["table1"]["exact"]
    found = [table["mass"], *table["com"], *table["inertia"]]
    np.testing.assert_allclose(found, PI_60, rtol=1e-5, atol=1e-4)


# -- usage ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [["--help"], ["paper", "--help"]])
def test_help_explains(cpid, arguments):
    run = cpid(*arguments)
    assert run.returncode == 0
    assert "Usage:" in run.stdout
    assert ("--scenario" if "paper" in arguments else "paper") in run.stdout
    assert run.stderr == ""


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["paper"], "--out"),
        (["paper", "--out"], "--out"),
        (["nonsense"], "nonsense"),
        (["--nonsense"], "--nonsense"),
        (["paper", "--out", "x", "--nonsense"], "--nonsense"),
        (["paper", "--out", "x", "extra"], "extra"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(cpid, arguments, cause):
    assert cause in assert_refused(cpid(*arguments))


def test_wrong_usage_makes_no_folder(cpid, tmp_path):
    cpid("paper", "--out", "x", "--nonsense")
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (None, "no such file"),
        ("", "mapping"),
        ("a: [1", "not YAML"),
        ("massive: 1", "massive"),
        ("spacecraft: 3", "spacecraft"),
        ("spacecraft: {model: 'a\n\n  b', base: b, capture_frame: c}", "target is missing"),
    ],
)
def test_a_bad_scenario_is_one_line_and_exit_code_2(cpid, tmp_path, text, cause):
    if text is not None:
        (tmp_path / "bad.yaml").write_text(text)
    message = assert_refused(cpid("paper", "--out", "x", "--scenario", "bad.yaml"))
    assert cause in message


def test_a_bad_model_is_one_line_too(cpid, tmp_path):
    """What Drake itself has to say of it must not come on top."""
    model = models_directory() / "dual_arm_servicer" / "dual_arm_servicer.urdf"
    text = model.read_text().replace('ixx="255"', 'ixx="9000"', 1)
    (tmp_path / "bad.urdf").write_text(text)
    scenario = shipped_scenario("paper").read_text()
    uri = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"
    assert uri in scenario
    (tmp_path / "bad.yaml").write_text(scenario.replace(uri, str(tmp_path / "bad.urdf")))
    assert "inertia" in assert_refused(cpid("paper", "--out", "x", "--scenario", "bad.yaml"))


def test_a_scenario_may_be_a_package_uri(cpid):
    """It gets as far as the file's name: the URI's slashes are kept."""
    uri = "package://cpid_drake_models/scenarios/nowhere.yaml"
    message = assert_refused(cpid("paper", "--out", "x", "--scenario", uri))
    assert uri in message
    assert str(models_directory()) in message


def test_an_output_that_is_a_file_is_refused(cpid, tmp_path):
    (tmp_path / "taken").write_text("")
    assert "--out taken" in assert_refused(cpid("paper", "--out", "taken"))
    assert "--out taken/x" in assert_refused(cpid("paper", "--out", "taken/x"))


@pytest.mark.skipif(
    not Path("/proc/self").is_dir(), reason="needs /proc/self, a folder that nobody can write"
)
def test_a_folder_that_cannot_be_written_is_refused_before_all_else(cpid):
    """It exists, so making it is no problem; a study later, the first figure would be."""
    run = cpid("paper", "--out", "/proc/self", "--scenario", "nowhere.yaml")
    assert "/proc/self" in assert_refused(run)


# -- cpid accuracy ---------------------------------------------------------------------------------

TRIAL = ("--trials", "2", "--preset", "servicer", "--jobs", "1")


def test_accuracy_prints_its_table_and_writes_what_it_says(cpid, tmp_path):
    run = cpid("accuracy", "exciting_motion", *TRIAL, "--out", "acc")
    assert run.returncode == 0, run.stderr
    for text in (
        "servicer: RMS error over Cramér-Rao bound, 2 trials",
        "trajectory",
        "NEES",
        "Iyz",
    ):
        assert text in run.stdout
    summary = json.loads((tmp_path / "acc" / "summary.json").read_text())
    assert summary["scenario"] == "exciting_motion"
    assert {entry["estimator"] for entry in summary["results"]} == {
        "eq18",
        "standard",
        "relative",
        "recursive_fit",
        "trajectory_fit",
    }
    assert (tmp_path / "acc" / "accuracy_servicer.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "acc" / "report.html").read_text()
    assert embedded_summary(page) == summary
    assert page.count("<figure") == page.count("<svg") == 2


def test_accuracy_can_be_quiet(cpid):
    run = cpid(
        *("accuracy", "exciting_motion", *TRIAL, "--estimator", "relative"),
        *("--out", "acc", "--quiet"),
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("exciting",), "no shipped scenario 'exciting'; did you mean 'exciting_motion'?"),
        (("nowhere.yaml",), "nowhere.yaml"),
        (("paper", "--preset", "fligth"), "fligth"),
        (("paper", "--estimator", "kalman"), "no estimator 'kalman'; choose from eq18"),
        (("paper", "--trials", "0"), "trials must be at least 1"),
        (("paper", "--jobs", "0"), "jobs must be at least 1"),
        (("paper", "--seed", "-3"), "seed must be >= 0"),
        ((), "Missing argument"),
    ],
)
def test_accuracy_refuses_what_it_cannot_do(cpid, arguments, problem):
    assert problem in assert_refused(cpid("accuracy", *arguments, "--out", "acc"))
