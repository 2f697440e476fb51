"""Processes that tests start, and how long anything may take before it counts as hung."""

import os
import signal
import subprocess
import sys
from pathlib import Path

HUNG = 1800.0
"""A wait ends here [s]. No claim about speed: a busy machine must not fail a test."""

ROOT = Path(__file__).resolve().parents[1]


def start(*arguments, cwd, **options) -> subprocess.Popen:
    """Start Python with these arguments; it imports the package of this checkout."""
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=os.environ | {"COLUMNS": "120", "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **{"preexec_fn": _take_interrupts} | options,
    )


def _take_interrupts():
    """A background job of a shell, which the tests may be, ignores Ctrl-C; what it starts, too."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def finish(process: subprocess.Popen, text: str = "") -> subprocess.CompletedProcess:
    """Write the text to the process, wait for its end and return what it printed."""
    with process:
        try:
            stdout, stderr = process.communicate(text, timeout=HUNG)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr)
