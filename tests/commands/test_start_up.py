"""What a command imports before it answers: help and errors do not wait for Drake or SciPy."""

import subprocess
import sys

import pytest

from cpid_drake.resources import models_directory

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


NUMERIC = {"numpy", "scipy", "pydrake", "matplotlib"}


@pytest.mark.parametrize(
    ("arguments", "answer", "absent"),
    [
        (["identify", "--help"], "Usage:", NUMERIC),
        (["paper", "--out", "x", "--scenario", "pape"], "did you mean 'paper'?", NUMERIC),
        (["identify", "text.csv", *CRAFT], "line 1: there is no column 'time'", HEAVY),
    ],
)
def test_help_and_refusals_do_not_wait_for_imports(arguments, answer, absent, tmp_path):
    (tmp_path / "text.csv").write_text("This is a text.\n")
    code, output, modules = run(tmp_path, *arguments)
    assert answer in output
    assert (code == 0) == ("--help" in arguments)
    assert not modules & absent
