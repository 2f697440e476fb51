"""The `cpid` command as a user meets it: its output, its files, its exit codes."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cpid_drake.commands.main import main


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


# -- usage ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["paper"], "--out"),
        (["nonsense"], "nonsense"),
        (["paper", "--out", "x", "--nonsense"], "--nonsense"),
        (["paper", "--out", "x", "extra"], "extra"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(cpid, tmp_path, arguments, cause):
    assert cause in assert_refused(cpid(*arguments))
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(
    not Path("/proc/self").is_dir(), reason="needs /proc/self, a folder that nobody can write"
)
def test_a_folder_that_cannot_be_written_is_refused_before_all_else(cpid):
    """It exists, so making it is no problem; a study later, the first figure would be."""
    run = cpid("paper", "--out", "/proc/self", "--scenario", "nowhere.yaml")
    assert "/proc/self" in assert_refused(run)


# -- cpid accuracy ---------------------------------------------------------------------------------

TRIAL = ("--trials", "2", "--preset", "servicer", "--jobs", "1")


@pytest.mark.slow
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
    # Most of what Eq. 18 tells here is noise of the velocity: it leaves the target open.
    assert {entry["estimator"]: entry["failed"] for entry in summary["results"]} == {
        "eq18": 2,
        "standard": 0,
        "relative": 0,
        "recursive_fit": 0,
        "trajectory_fit": 0,
    }
    assert (tmp_path / "acc" / "accuracy_servicer.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "acc" / "report.html").read_text()
    assert embedded_summary(page) == summary
    assert page.count("<figure") == page.count("<svg") == 2


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("paper", "--preset", "fligth"), "fligth"),
        (("paper", "--estimator", "kalman"), "no estimator 'kalman'; choose from eq18"),
        (("paper", "--trials", "0"), "trials must be at least 1"),
        (("paper", "--seed", "-3"), "seed must be >= 0"),
        ((), "Missing argument"),
    ],
)
def test_accuracy_refuses_what_it_cannot_do(cpid, arguments, problem):
    assert problem in assert_refused(cpid("accuracy", *arguments, "--out", "acc"))


def test_the_list_says_where_the_presets_files_are(run_cpid):
    """A preset can be changed in a copy of its file only."""
    code, stdout, stderr = run_cpid("list")
    assert (code, stderr) == (0, "")
    folder = Path(re.search(r"Sensors \(--sensors\), files in (.+)", stdout)[1])
    assert (folder / "testbed.yaml").is_file()
