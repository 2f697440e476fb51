"""The benchmarks run, and the routes that they compare agree. No times are asserted."""

import json
import runpy
import sys
from pathlib import Path

import pytest


@pytest.fixture
def run(monkeypatch, capsys):
    """Return a function that runs a benchmark in this process, and returns what it prints."""

    def run_(name: str, *arguments: str) -> dict:
        script = str(Path(__file__).with_name(name))
        monkeypatch.setattr(sys, "argv", [script, *arguments])
        runpy.run_path(script, run_name="__main__")
        report = json.loads(capsys.readouterr().out)
        assert all(value > 0 for value in report.values())
        return report

    return run_


def test_identifier_update(run):
    pytest.importorskip("pinocchio", reason="the reference route needs the package 'pin'")
    report = run("identifier_update.py", "--blocks", "1", "--calls", "2")
    assert {"update_over_pinocchio", "solve_over_pinocchio"} < set(report)


def test_filter_update(run):
    report = run("filter_update.py", "--blocks", "2")
    assert "update_over_least_squares" in report


def test_base_motion(run):
    report = run("base_motion.py", "--targets", "3", "--repeats", "1")
    assert "propagator_over_simulation" in report


def test_recording(run):
    report = run("recording.py", "--duration", "1", "--repeats", "1")
    assert {"recorded_run_over_run", "replay_over_run"} < set(report)
    assert report["replay_megabytes"] < 10


def test_start_up(run):
    report = run("start_up.py", "--repeats", "1")
    assert {"help_cpu_seconds", "missing_log_cpu_seconds"} < set(report)
