"""The benchmarks run, and the routes that they compare agree. No times are asserted."""

import json
import runpy
import sys
from pathlib import Path

import figure_cases
import figure_faults
import figure_trials
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.presets import load_sensors


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


def test_recursive_fit(run):
    report = run("recursive_fit.py", "--rounds", "1")
    assert {"block_over_factorization", "collecting_milliseconds"} < set(report)


@pytest.mark.parametrize("mode", [(), ("--hidden",)])
def test_effect_figures(monkeypatch, capsys, tmp_path, mode):
    out = tmp_path / "figures.json"
    rest = ("--effect", "none", "--effect", "acceleration", "--trials", "1", "--out", str(out))
    script = str(Path(__file__).with_name("effect_figures.py"))
    monkeypatch.setattr(sys, "argv", [script, *rest, *mode])
    runpy.run_path(script, run_name="__main__")
    none, acceleration = json.loads(out.read_text())
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert min(none["coverage"], acceleration["coverage"]) > 0.5
    if mode:
        assert none["named"] == none["doubted"] == 0
        assert acceleration["named"] == 1
    else:
        assert acceleration["failed"] == 0
        assert acceleration["worst_ratio"] < 4


def test_table_runs(monkeypatch, capsys):
    script = str(Path(__file__).with_name("table_runs.py"))
    monkeypatch.setattr(sys, "argv", [script, "--repetitions", "1", "--runs", "2"])
    runpy.run_path(script, run_name="__main__")
    words = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()}
    assert float(words["joint_in_single"][0]) >= 75
    assert float(words["truth_in_joint"][0]) >= 75
    assert float(words["yaw_over_noise"][1].rstrip(",")) < 3


def test_online_figures(monkeypatch, capsys, tmp_path):
    out = tmp_path / "figures.json"
    names = ("--case", "spikes_gyro", "--case", "planar")
    rest = ("--trials", "2", "--estimators", "trajectory_fit", "--out", str(out))
    script = str(Path(__file__).with_name("online_figures.py"))
    monkeypatch.setattr(sys, "argv", [script, *names, *rest])
    runpy.run_path(script, run_name="__main__")
    spikes, planar = json.loads(out.read_text())
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert spikes["failed"] == planar["failed"] == 0
    assert min(spikes["known"]) == spikes["known_by_bound"] == 10
    assert planar["known"] == [7, 7]
    assert planar["known_by_bound"] == 7
    assert planar["not_observed"] == 0


@pytest.mark.parametrize(
    "name", ["tumble_30", "wheels_changing", "planar", "heavy_target", "prismatic", "three_arms"]
)
def test_the_truth_of_online_figures(name, tmp_path):
    """Momentum is conserved, rates are those of the poses, and exact states give the target."""
    case = figure_cases.CASES[name].build(tmp_path)
    check = figure_trials.check_truth(case, case.spacecraft.make())
    assert check.momentum < 1e-9
    assert check.rates < 1e-5
    assert check.error < 1e-11
    assert check.known == (7 if name == "planar" else 10)


def test_faults_of_online_figures():
    """Spikes are 50 to 1000 σ large; a dropout and a stuck sensor last from 4 to 5 s."""
    suite, time = load_sensors("flight"), np.arange(1000) / 100.0
    turns = Rotation.random(1000, np.random.default_rng(2))
    samples = {
        "attitude": Samples(time, turns.as_quat(scalar_first=True)),
        "gyro": Samples(time, np.random.default_rng(3).normal(size=(1000, 3))),
    }
    before, rng = Measurements((), samples), np.random.default_rng(1)
    spikes = figure_faults.Spikes("attitude").apply(before, suite, rng)
    turned = Rotation.from_quat(spikes.attitude.value, scalar_first=True)
    error = (turns.inv() * turned).as_rotvec() @ suite["attitude"].R_BS / suite.sigmas("attitude")
    sizes = np.abs(error).max(axis=1)
    hit = sizes > 1e-3
    assert 3 <= hit.sum() <= 25
    assert 49.9 < sizes[hit].min() < sizes.max() < 1001
    assert spikes.gyro is before.gyro
    dropout = figure_faults.Dropout("gyro").apply(before, suite, rng).gyro
    np.testing.assert_array_equal(dropout.time, time[(time < 4) | (time >= 5)])
    stuck = figure_faults.Stuck("gyro").apply(before, suite, rng).gyro.value
    changed = (stuck != before.gyro.value).any(axis=1)
    np.testing.assert_array_equal(changed, (time >= 4) & (time < 5))
    assert (stuck[399:500] == stuck[399]).all()


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


def test_long_log(run):
    report = run("long_log.py", "--hours", "0.05")  # three minutes: several windows
    assert report["largest_error_in_sigma"] < 6
