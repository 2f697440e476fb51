"""Ctrl-C ends a command with one line, and leaves nothing half-written."""

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from processes import HUNG, start

from cpid_drake.resources import models_directory

MODELS = models_directory()
COMMANDS = {
    "identify": (
        *("identify", "{inputs}/long.npz", "--sensors", "testbed"),
        *("--spacecraft", MODELS / "free_flyer/free_flyer.urdf"),
        *("--base", "body", "--capture-frame", "capture_point"),
        *("--json", "r.json", "--report", "r.html"),
    ),
    "simulate": ("simulate", "{inputs}/exciting_motion.yaml", "--out", "run"),
    "plan": (
        "plan",
        "motion",
        "paper",
        "--candidates",
        "60000",
        "--jobs",
        "2",
        "--out",
        "motion.yaml",
    ),
}
"""Commands that take minutes, so that none ends before its interrupt."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Return a folder with a shipped scenario and the sample log, made a hundred times longer.

    The log goes forwards and backwards in turn, which conserves momentum just as well.
    """
    folder = tmp_path_factory.mktemp("inputs")
    text = (MODELS / "scenarios/exciting_motion.yaml").read_text()
    assert text.count(" duration: 10.0") == 2  # of the joint motion and of the simulation
    long = text.replace(" duration: 10.0", " duration: 1000.0")
    (folder / "exciting_motion.yaml").write_text(long)
    lines = (MODELS / "telemetry/free_flyer.csv").read_text().splitlines()
    lines = [line for line in lines if not line.startswith("#")]
    names, forwards = lines[0].split(","), np.loadtxt(lines[1:], delimiter=",")
    signs = [-1.0 if name in ("bwx", "bwy", "bwz") else 1.0 for name in names]
    values = np.tile(np.vstack([forwards[:-1], signs * forwards[:0:-1]]), (50, 1))
    columns = dict(zip(names, values.T)) | {"time": 0.01 * np.arange(len(values))}
    np.savez(folder / "long.npz", **columns)
    return folder


def heed_interrupts() -> None:
    """Undo that a shell's background job, which the tests may be, ignores Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def wait_until_handled(process: subprocess.Popen, number: int) -> None:
    """Wait until Python has started so far that the command handles this signal itself.

    How long that takes depends on the machine; before it, the system ends the process.
    """
    status = Path(f"/proc/{process.pid}/status")
    begin = time.perf_counter()
    while process.poll() is None:
        caught = re.search(r"^SigCgt:\s*(\w+)", status.read_text(), re.MULTILINE)
        if caught and int(caught[1], 16) >> (number - 1) & 1:
            return
        assert time.perf_counter() - begin < HUNG
        time.sleep(0.001)


def processes_of_group(group: int) -> list[str]:
    listed = subprocess.run(["pgrep", "-g", str(group)], text=True, capture_output=True)
    return listed.stdout.split()


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's process status")
@pytest.mark.parametrize(
    ("command", "seconds"),
    [
        ("identify", 6.0),
        *(pytest.param(each, 8.0, marks=pytest.mark.slow) for each in ("simulate", "plan")),
    ],
)
def test_an_interrupt_ends_a_command_with_one_line(command, seconds, inputs, tmp_path):
    """While a long computation runs, also with processes of its own."""
    process = start(
        *("-m", "cpid_drake", *(str(each).format(inputs=inputs) for each in COMMANDS[command])),
        "--quiet",
        cwd=tmp_path,
        start_new_session=True,
        preexec_fn=heed_interrupts,
    )
    wait_until_handled(process, signal.SIGINT)
    time.sleep(seconds)
    begin = time.perf_counter()
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    stdout, stderr = process.communicate(timeout=HUNG)
    assert (process.returncode, stdout) == (130, "")
    assert stderr.splitlines()[-1] == "cpid: interrupted"
    assert "Traceback" not in stderr
    while processes_of_group(process.pid):
        assert time.perf_counter() - begin < HUNG
    assert not list(tmp_path.iterdir())
