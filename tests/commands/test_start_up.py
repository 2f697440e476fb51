"""What a command imports before it answers: help and errors do not wait for Drake or SciPy."""

import subprocess
import sys

import pytest

from cpid_drake.resources import models_directory

SAMPLE = models_directory() / "telemetry/free_flyer.csv"
MODEL = models_directory() / "free_flyer/free_flyer.urdf"
CRAFT = ("--spacecraft", MODEL, "--base", "body", "--capture-frame", "capture_point")
HEAVY = {"pydrake.multibody", "pydrake.systems", "scipy.spatial", "scipy.linalg", "matplotlib"}
RUN = """
import sys
from cpid_drake.commands.main import main
try:
    main()
finally:
    print(*sys.modules, file=sys.stderr)
"""


def run(folder, *arguments) -> tuple[int, str, set[str]]:
    """Run `cpid` in a new interpreter: exit code, all but the last line, modules it imported."""
    arguments = [sys.executable, "-c", RUN, *map(str, arguments)]
    ended = subprocess.run(arguments, cwd=folder, text=True, capture_output=True)
    *lines, modules = ended.stderr.splitlines()
    return ended.returncode, ended.stdout + "\n".join(lines), set(modules.split())


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["identify", "--help"], ["telemetry", "check", "--help"], ["scenario"]],
)
def test_help_imports_not_even_numpy(arguments, tmp_path):
    _, output, modules = run(tmp_path, *arguments)
    assert "Usage:" in output
    assert not modules & {"numpy", "scipy", "pydrake", "matplotlib"}


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["nonsense"], "No such command 'nonsense'"),
        (["paper", "--out", "x", "--nonsense"], "No such option"),
        (["paper", "--out", "x", "--scenario", "pape"], "did you mean 'paper'?"),
        (["paper", "--out", "taken/x"], "--out taken/x: cannot write there"),
        (["simulate", "nowhere.yaml", "--out", "x"], "nowhere.yaml: no such file"),
        (["accuracy", "nowhere", "--out", "x"], "no shipped scenario 'nowhere'"),
        (["scenario", "check", "nowhere"], "no shipped scenario 'nowhere'"),
        (["view", "nowhere", "--html", "x.html"], "no shipped scenario 'nowhere'"),
        (["view", SAMPLE, "--html", "x.html"], "give --spacecraft"),
        (["report", "nowhere", "--out", "x.html"], "nowhere: no such file"),
        (["export", "nowhere", "--format", "urdf", "--out", "x.urdf"], "nowhere: no such file"),
        (["identify", SAMPLE, *CRAFT, "--json", "no/x.json"], "there is no folder no"),
        (["identify", SAMPLE, *CRAFT, "--package", "a=no"], "no such folder: no"),
        (["identify", SAMPLE, *CRAFT, "--topic", "imu"], "give KIND=/NAME"),
    ],
)
def test_wrong_names_and_paths_are_found_without_numpy(arguments, problem, tmp_path):
    (tmp_path / "taken").write_text("")
    code, output, modules = run(tmp_path, *arguments)
    assert code == 2
    assert output.startswith("cpid: error: ")
    assert problem in output
    assert not modules & {"numpy", "scipy", "pydrake", "matplotlib"}


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["identify", "nowhere.csv", *CRAFT], "nowhere.csv: no such file"),
        (["identify", "text.csv", *CRAFT], "text.csv: line 1: there is no column 'time'"),
        (["identify", MODEL, *CRAFT], "telemetry is read from .csv"),
        (["identify", SAMPLE, "--spacecraft", "no.urdf", *CRAFT[2:]], "no.urdf: no such file"),
        (["identify", SAMPLE, *CRAFT, "--sensors", "testbad"], "no sensors: testbad"),
        (["accuracy", "paper", "--out", "x", "--preset", "testbad"], "no sensors: testbad"),
        (["view", "nowhere.csv", *CRAFT, "--html", "x.html"], "nowhere.csv: no such file"),
        (["paper", "--out", "x", "--scenario", "key.yaml"], "unknown key 'massive'"),
        (["telemetry", "check", "nowhere.csv"], "nowhere.csv: no such file"),
        (["telemetry", "check", "text.csv"], "text.csv: line 1: there is no column 'time'"),
    ],
)
def test_wrong_files_are_found_before_drake_is_imported(arguments, problem, tmp_path):
    (tmp_path / "text.csv").write_text("This is a text.\n")
    (tmp_path / "key.yaml").write_text("massive: 1\n")
    code, output, modules = run(tmp_path, *arguments)
    assert code == 2
    assert output.startswith("cpid: error: ")
    assert problem in output
    assert not modules & HEAVY


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--estimator", "best"], "no estimator 'best'; choose from least_squares"),
        (["--rows", "columns"], "no row family 'columns'; choose from eq18"),
        (["--momentum", "much"], "no momentum 'much'; choose from zero, unknown"),
    ],
)
def test_wrong_names_of_methods_are_found_before_drake_is_imported(options, problem, tmp_path):
    code, output, modules = run(tmp_path, "identify", SAMPLE, *CRAFT, *options)
    assert code == 2
    assert problem in output
    assert not modules & {"pydrake", "matplotlib"}
