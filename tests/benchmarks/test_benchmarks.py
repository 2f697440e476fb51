"""The benchmarks run, and the routes that they compare agree. No times are asserted."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


def run(name: str, *arguments: str) -> dict:
    script = Path(__file__).with_name(name)
    command = [sys.executable, str(script), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout)
    assert all(value > 0 for value in report.values())
    return report


def test_identifier_update():
    pytest.importorskip("pinocchio", reason="the reference route needs the package 'pin'")
    report = run("identifier_update.py", "--blocks", "1", "--calls", "2")
    assert {"update_over_pinocchio", "solve_over_pinocchio"} < set(report)


def test_filter_update():
    report = run("filter_update.py", "--blocks", "2")
    assert "update_over_least_squares" in report


def test_base_motion():
    report = run("base_motion.py", "--targets", "3", "--repeats", "1")
    assert "propagator_over_simulation" in report


def test_recording():
    report = run("recording.py", "--duration", "1", "--repeats", "1")
    assert {"recorded_run_over_run", "replay_over_run"} < set(report)
    assert report["replay_megabytes"] < 10
