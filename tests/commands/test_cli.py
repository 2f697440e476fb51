"""The `cpid` command as a user meets it: help, usage, lists."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from processes import HUNG, finish, start

from cpid_drake.commands.main import COMMANDS


def test_help_names_all_commands_and_imports_none_of_their_libraries():
    code = "import sys\nfrom cpid_drake.commands.main import main\ntry: main()\nfinally: "
    code += "print(*sys.modules, file=sys.stderr)"
    ended = subprocess.run(
        [sys.executable, "-c", code, "--help"], text=True, capture_output=True, check=True
    )
    assert all(f" {name} " in ended.stdout for name in COMMANDS)
    assert not {"numpy", "scipy", "pydrake", "plotly"} & set(ended.stderr.split())


@pytest.mark.parametrize(
    ("arguments", "cause"),
    [
        (["nonsense"], "nonsense"),
        (["simulate", "paper"], "--out"),
        (["campaign", "report", "x"], "there is no folder x"),
        (["identify", "x.csv", "--spacecaft", "paper"], "Did you mean --spacecraft?"),
        (["log", "chek", "x.csv"], 'Did you mean "check"?'),
        (["log", "--install-completion"], "--install-completion"),
        (["plan", "motion", "paper", "--out", "x", "--targets", "1.5"], "1.5: give a whole number"),
        (["simulate", "paper", "--out"], "--out requires an argument"),
        (["log", "check", "a.csv", "b.csv"], "not expected: b.csv"),
    ],
)
def test_wrong_usage_is_one_line(refusal, tmp_path, arguments, cause):
    assert cause in refusal(*arguments)
    assert not list(tmp_path.iterdir())


def test_the_help_of_a_command_shows_what_its_options_take_and_its_exit_codes(tmp_path):
    """In a process of its own: a command is imported when it is used."""
    ended = finish(start("-m", "cpid_drake", "identify", "--help", cwd=tmp_path))
    assert (ended.returncode, ended.stderr) == (0, "")
    for option in ("--json FILE", "--from SECONDS", "--base NAME", "--momentum zero|unknown"):
        assert f" {option} " in ended.stdout
    assert "Base body of the spacecraft." in ended.stdout
    assert "3 not all are determined" in " ".join(ended.stdout.split())
    assert "--install-completion" not in ended.stdout


@pytest.mark.parametrize("arguments", ["list", "--help", "validate"])
def test_without_a_reader_a_command_ends_quietly(tmp_path, arguments):
    """As in `cpid list | head -1`, and with 141 as other commands do; an error is still said."""
    process = start("-m", "cpid_drake", arguments, cwd=tmp_path)
    process.stdout.close()
    error = process.stderr.read()
    code = process.wait(HUNG)
    process.stderr.close()
    if arguments == "validate":
        assert (code, error.count("\n")) == (2, 1)
    else:
        assert (code, error) == (141, "")


@pytest.mark.parametrize("arguments", [(), ("log",)])
def test_without_a_command_the_help_is_printed_and_the_usage_is_wrong(cpid, arguments):
    code, stdout, stderr = cpid(*arguments)
    assert (code, stderr) == (2, "")
    assert "Commands" in stdout


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no Bash")
@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("identify log.csv --mom", "--momentum"),
        ("identify log.csv --momentum z", "zero"),
        ("identify my_", "my_log.csv"),
        ("identify log.csv --sensors my_", "my_log.csv"),
        ("log c", "check"),
    ],
)
def test_bash_completes_options_values_files_and_commands(cpid, tmp_path, words, found):
    """After `cpid --install-completion`, in a folder with a log."""
    (tmp_path / "my_log.csv").touch()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HOME", str(tmp_path))
        assert cpid("--install-completion", "--shell", "bash")[0] == 0
    shell = f". .bashrc; COMP_WORDS=(cpid {words}); COMP_CWORD={len(words.split())}; _cpid\n"
    ended = subprocess.run(
        ["bash"], input=shell + "echo ${COMPREPLY[@]}", text=True, capture_output=True, cwd=tmp_path
    )
    assert (ended.stdout.strip(), ended.stderr) == (found, "")


def test_the_list_says_where_the_presets_files_are(cpid):
    code, stdout, stderr = cpid("list")
    assert (code, stderr) == (0, "")
    folder = re.search(r"Sensors \(--sensors\), files in (.+)", stdout)[1]
    assert Path(folder, "testbed.yaml").is_file()
    assert re.search(r"paper +The case study of Ning et al. 2016: a servicer", stdout)
