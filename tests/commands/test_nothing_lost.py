"""A killed or interrupted process and a full disk leave the old output or the new one, whole."""

import os
import random
import resource
import signal
import time
from contextlib import suppress
from functools import partial

import pytest
from killed_writers import WRITERS, Bench
from processes import HUNG, finish, start

from cpid_drake.resources import models_directory

LIMIT = 500
"""Largest size of a file for a process without space [bytes]; every output is larger."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("killed"))


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_killed_command_leaves_the_old_output_or_the_new_one(bench, name):
    """Soon after its first draft appears."""
    numbers = random.Random(name)
    for _ in range(2):
        assert set(bench.kill(name, numbers)) <= {"old", "new", "unfinished"}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_without_space_a_command_says_so_and_keeps_the_old_output(bench, name):
    writer = WRITERS[name]
    bench.restore(writer)
    no_space = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (LIMIT, LIMIT))
    ended = finish(
        start("-B", "-m", "cpid_drake", *writer.new, cwd=bench.folder, preexec_fn=no_space)
    )
    errors = [line for line in ended.stderr.splitlines() if "error" in line]
    assert ended.returncode == 2
    assert len(errors) == 1
    assert "cannot write there: File too large" in errors[0]
    assert set(bench.states(writer)) == {"old"}
    assert not bench.drafts()


COMMANDS = {
    "simulate": ("simulate", "long.yaml", "--out", "run"),
    "plan": ("plan", "motion", "paper", "--candidates", "60000", "--jobs", "2", "--out", "m.yaml"),
}
"""Commands that take minutes, so that none ends before its interrupt."""


@pytest.mark.parametrize(
    "command", ["simulate", pytest.param("plan", marks=pytest.mark.slow)], ids=str
)
def test_an_interrupt_ends_a_command_with_one_line(command, tmp_path):
    """Also one with processes of its own."""
    text = (models_directory() / "scenarios/exciting_motion.yaml").read_text()
    (tmp_path / "long.yaml").write_text(text.replace(" duration: 10.0", " duration: 1000.0"))
    process = start(
        *("-m", "cpid_drake", *COMMANDS[command], "--quiet"),
        cwd=tmp_path,
        start_new_session=True,
        # A background job of a shell, which the tests may be, ignores Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
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
