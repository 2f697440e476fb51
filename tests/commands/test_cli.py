"""The `cpid` command as a user meets it: help, usage, the studies."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cpid_drake.commands.main import COMMANDS


def test_help_names_all_commands_and_imports_none_of_their_libraries():
    code = "import sys\nfrom cpid_drake.commands.main import main\ntry: main()\nfinally: "
    code += "print(*sys.modules, file=sys.stderr)"
    ended = subprocess.run(
        [sys.executable, "-c", code, "--help"], text=True, capture_output=True, check=True
    )
    assert all(f" {name} " in ended.stdout for name in COMMANDS)
    assert not {"numpy", "scipy", "pydrake", "matplotlib"} & set(ended.stderr.split())


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["nonsense"], "nonsense"),
        (["study", "paper"], "--out"),
        (["study", "paper", "--out", "x", "--nonsense"], "--nonsense"),
        (["study", "paper", "--out", "x", "--scenario", "pape"], "did you mean 'paper'?"),
        (["study", "accuracy", "paper", "--out", "x", "--sensors", "fligth"], "fligth"),
        (["study", "accuracy", "paper", "--out", "x", "--estimator", "kalman"], "'kalman'; choose"),
        (["study", "accuracy", "paper", "--out", "x", "--trials", "0"], "at least 1"),
        (["study", "techniques", "air_bearing", "--out", "x"], "floats freely"),
        (["study", "techniques", "tumbling_capture", "--out", "x"], "without momentum"),
        (["study", "techniques", "paper", "--out", "x", "--force-sensors", "no.yaml"], "no.yaml"),
    ],
)
def test_wrong_usage_is_one_line(refusal, tmp_path, arguments, cause):
    assert cause in refusal(*arguments)
    assert not list(tmp_path.iterdir())


def test_the_list_says_where_the_presets_files_are(cpid):
    code, stdout, stderr = cpid("list")
    assert (code, stderr) == (0, "")
    folder = re.search(r"Sensors \(--sensors\), files in (.+)", stdout)[1]
    assert Path(folder, "testbed.yaml").is_file()
    assert re.search(r"paper +The case study of Ning et al. 2016: a servicer", stdout)


@pytest.mark.slow
def test_the_study_of_accuracy_prints_and_writes_its_table(cpid, tmp_path):
    options = ("--trials", "2", "--sensors", "servicer", "--jobs", "1", "--out", "acc")
    code, stdout, stderr = cpid("study", "accuracy", "exciting_motion", *options)
    assert code == 0, stderr
    assert "servicer: RMS error over Cramér-Rao bound, 2 trials" in stdout
    summary = json.loads((tmp_path / "acc/summary.json").read_text())
    assert summary["scenario"] == "exciting_motion"
    # Most of what Eq. 18 tells here is noise of the velocity: it leaves the target open.
    failed = {entry["estimator"]: entry["failed"] for entry in summary["results"]}
    fits = ("standard", "relative", "recursive_fit", "trajectory_fit")
    assert failed == {"eq18": 2, **dict.fromkeys(fits, 0)}
    assert (tmp_path / "acc/figures.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "acc/report.html").read_text()
    assert "RMS error over Cramér-Rao bound" in page
    assert page.count("<img ") == 1
