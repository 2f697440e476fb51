"""The `cpid` command as a user meets it: help, usage, lists."""

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
        (["simulate", "paper"], "--out"),
        (["simulate", "pape", "--out", "x"], "did you mean 'paper'?"),
        (["campaign", "run", "no.yaml", "--out", "x"], "no.yaml: no such file"),
        (["campaign", "report", "x"], "there is no folder x"),
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
