"""A full disk leaves the old output, whole; an interrupt ends a command with one line."""

import os
import resource
import shutil
import signal
import time
from contextlib import suppress
from functools import partial

import pytest
from processes import HUNG, finish, start

from cpid_drake.files.resources import models_directory

MODELS = models_directory()
IDENTIFY = (
    "--spacecraft",
    "free_flyer_payload",
    "--estimator",
    "least_squares",
    "--json",
    "r.json",
)
SCENARIO = (MODELS / "scenarios/free_flyer_payload.yaml").read_text()
LIMIT = 500
"""Largest size of a file for a process without space [bytes]; every output is larger."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a result and a run of half a second, and inputs for longer ones."""
    folder = tmp_path_factory.mktemp("made")
    lines = (MODELS / "telemetry/free_flyer.csv").read_text().splitlines(keepends=True)
    for name, count, duration in (("old", 202, 0.5), ("new", 302, 1.0)):
        (folder / f"{name}.csv").write_text("".join(lines[:count]))
        text = SCENARIO.replace(
            "simulation:\n  duration: 10.0", f"simulation:\n  duration: {duration}"
        )
        (folder / f"{name}.yaml").write_text(text)
    for arguments in (("identify", "old.csv", *IDENTIFY), ("simulate", "old.yaml", "--out", "run")):
        assert finish(start("-m", "cpid_drake", *arguments, cwd=folder)).returncode in (0, 3, 4)
    return folder


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "copy")


COMMANDS = {
    "identify": ("identify", "new.csv", *IDENTIFY, "--force"),
    "simulate": ("simulate", "new.yaml", "--out", "run", "--force"),
}


def contents(folder) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in (folder / "r.json", *folder.glob("run/[!.]*"))}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_without_space_a_command_says_so_and_keeps_the_old_output(folder, command):
    before = contents(folder)
    no_space = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (LIMIT, LIMIT))
    ended = finish(
        start("-B", "-m", "cpid_drake", *COMMANDS[command], cwd=folder, preexec_fn=no_space)
    )
    [error] = [line for line in ended.stderr.splitlines() if "error" in line]
    assert ended.returncode == 2
    assert "cannot write there: File too large" in error
    assert contents(folder) == before
    assert not list(folder.glob("**/.cpid-draft*"))


LONG = {
    "simulate": ("simulate", "long.yaml", "--out", "run"),
    "plan": ("plan", "motion", "paper", "--candidates", "60000", "--out", "m.yaml"),
}
"""Commands that take minutes, so that none ends before its interrupt."""


@pytest.mark.parametrize("command", ["simulate", pytest.param("plan", marks=pytest.mark.slow)])
def test_an_interrupt_ends_a_command_with_one_line(command, tmp_path):
    """Also one with processes of its own."""
    (tmp_path / "long.yaml").write_text(SCENARIO.replace("duration: 10.0", "duration: 1000.0"))
    process = start(
        *("-m", "cpid_drake", *LONG[command], "--quiet"),
        cwd=tmp_path,
        start_new_session=True,
    )
    time.sleep(8.0)
    begin = time.perf_counter()
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    stdout, stderr = process.communicate(timeout=HUNG)
    assert (process.returncode, stdout) == (130, "")
    assert stderr.splitlines()[-1] == "cpid: interrupted"
    assert "Traceback" not in stderr
    with suppress(ProcessLookupError):  # the processes of the command end, too
        while time.perf_counter() - begin < HUNG:
            os.killpg(process.pid, 0)
    assert time.perf_counter() - begin < HUNG
    assert [file.name for file in tmp_path.iterdir()] == ["long.yaml"]
