"""`cpid simulate`: files of a run that agree with one another, with the truth and with a rerun."""

import json
import shlex
import shutil
import sys

import numpy as np
import pytest

from cpid_drake import identify, load_scenario, load_sensors
from cpid_drake.commands.main import main
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.errors import InputError
from cpid_drake.logs.files import read_telemetry
from cpid_drake.report.run_folder import read_run
from cpid_drake.report.sections.simulated import simulated_section
from cpid_drake.resources import models_directory


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("simulate")


@pytest.fixture(scope="module")
def short(folder):
    """Return a function (file name, changes) -> the template of 3 s with texts replaced."""
    template = (models_directory() / "scenario_template.yaml").read_text()

    def make(name, *changes):
        text = template
        duration = ("simulation:\n  duration: 10.0", "simulation:\n  duration: 3.0")
        for old, new in (duration, ("accuracy: 3.0e-11", "accuracy: 3.0e-10"), *changes):
            assert old in text
            text = text.replace(old, new)
        (folder / name).write_text(text)
        return folder / name

    return make


def cpid(*arguments):
    """Run `cpid` and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["cpid", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
    return ended.value.code


def run(*arguments):
    """Run `cpid simulate` and return its exit code."""
    return cpid("simulate", *arguments)


@pytest.fixture(scope="module")
def sensed(folder, short):
    """A run with sensors and the filter."""
    assert run(short("sensed.yaml"), "--out", folder / "sensed", "--quiet") == 0
    return folder / "sensed"


def read_json(path):
    return json.loads(path.read_text())


def test_what_the_sensors_gave_identifies_the_target_that_is_said_to_be_true(sensed):
    spacecraft = load_scenario(sensed / "scenario.yaml").spacecraft.make()
    truth = read_json(sensed / "truth.json")
    assert truth["inertia_entries"] == ["Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz"]
    pi = np.array([truth["mass"], *truth["com"], *truth["inertia"]])
    np.testing.assert_array_equal(pi, [60, 0.5, 0.05, -0.1, 6, 9, 8, -0.4, 0.2, 0.5])
    suite = load_sensors(sensed / "sensors.yaml")
    assert repr(suite) == repr(load_sensors("flight"))
    result = identify(spacecraft, read_telemetry(sensed / "telemetry.csv"), sensors=suite)
    error = result.parameters - pi
    assert error @ np.linalg.solve(result.covariance, error) < 30  # χ² of 10: 1 in 1000
    assert np.sqrt(result.covariance[0, 0]) < 0.6


def test_the_exact_motion_is_on_a_uniform_grid(sensed):
    truth = read_telemetry(sensed / "truth.csv")
    np.testing.assert_allclose(truth.encoders.time, np.arange(49) * 0.0625, rtol=0, atol=1e-9)
    assert len(truth.velocity) == len(truth.attitude) == 49
    scenario = load_scenario(sensed / "scenario.yaml")
    motion = scenario.make_joint_motion(scenario.spacecraft.make())
    expected = motion.evaluate(truth.encoders.time)[:, 0]
    np.testing.assert_allclose(truth.encoders.value, expected, rtol=0, atol=1e-6)


def test_a_run_says_how_it_came_about(sensed):
    about = read_json(sensed / "run.json")
    assert set(about["files"]) == {file.name for file in sensed.iterdir()}
    assert about["simulated_seconds"] == 3.0
    assert about["sensor_seed"] == 1
    assert set(about["versions"]) == {"python", "cpid-drake", "drake", "numpy", "scipy"}
    assert all(0 <= drift < 1e-5 for drift in about["momentum_drift"].values())
    found = about["online_identification"]
    assert found["estimator"] == "recursive_fit"
    assert list(found["estimate"]) == list(found["sigma"]) == list(PARAMETER_NAMES)
    assert abs(found["estimate"]["m"] - 60) < 5 * found["sigma"]["m"]


@pytest.mark.parametrize("name", ["telemetry.csv", "truth.csv"])
def test_a_run_with_a_log_that_was_cut_off_is_refused(sensed, tmp_path, name):
    copy = shutil.copytree(sensed, tmp_path / "copy")
    read_run(copy)
    lines = (copy / name).read_text().splitlines(keepends=True)
    (copy / name).write_text("".join(lines[: len(lines) // 2]))
    with pytest.raises(InputError, match=f"{name}: .* cut off"):
        read_run(copy)


@pytest.mark.slow
def test_the_complete_scenario_gives_the_same_run(sensed, folder, capsys):
    before = (sensed / "telemetry.csv").read_text()
    assert run(sensed / "scenario.yaml", "--out", folder / "again") == 0
    assert (folder / "again" / "telemetry.csv").read_text() == before
    assert (folder / "again" / "scenario.yaml").read_text() == (
        sensed / "scenario.yaml"
    ).read_text()
    assert "6 files in " in capsys.readouterr().err


@pytest.mark.slow
def test_the_printed_command_identifies_from_the_run(folder, short, capsys):
    """Also with spaces in the path, and with everything that the scenario says of the momentum."""
    scenario = short("printed.yaml", ("unknown_momentum: false", "unknown_momentum: true"))
    assert run(scenario, "--out", folder / "a run") == 0
    words = shlex.split(capsys.readouterr().out)
    assert words[:3] == ["cpid", "identify", str(folder / "a run" / "telemetry.csv")]
    assert words[-2:] == ["--momentum", "unknown"]
    assert cpid(*words[1:], "--quiet", "--json", folder / "result.json") == 0
    mass, found = (
        read_json(folder / "result.json")["parameters"][0],
        read_json(folder / "a run" / "run.json"),
    )
    sigma = found["online_identification"]["sigma"]["m"]
    assert abs(mass - 60.0) < 5 * sigma < 5.0


@pytest.mark.slow
def test_without_sensors_the_telemetry_is_the_exact_motion(folder, short, capsys):
    exact = short(
        "exact.yaml",
        ("  suite: flight #", '  suite: "" #'),
        ("estimator: recursive_fit #", "estimator: least_squares #"),
    )
    assert run(exact, "--out", folder / "exact", "--quiet") == 0
    assert capsys.readouterr() == ("", "")
    run_folder = folder / "exact"
    assert (run_folder / "telemetry.csv").read_text() == (run_folder / "truth.csv").read_text()
    assert not (run_folder / "sensors.yaml").exists()
    about = read_json(run_folder / "run.json")
    assert about["sensor_seed"] is None
    assert "sensors.yaml" not in about["files"]
    assert abs(about["online_identification"]["estimate"]["m"] - 60) < 1e-3


def test_a_possible_motion_has_no_warning(sensed):
    limits = read_json(sensed / "run.json")["limits"]
    assert limits["exceeded"] == []
    assert " m between " in limits["closest"]
    assert simulated_section(read_run(sensed)).warnings == []


def test_files_that_are_no_runs_are_not_overwritten(folder, short, capsys):
    mine = folder / "mine"
    mine.mkdir()
    (mine / "scenario.yaml").write_text(short("source.yaml").read_text())
    assert run(mine / "scenario.yaml", "--out", mine) == 2
    assert "scenario.yaml: is the input" in capsys.readouterr().err
    assert [file.name for file in mine.iterdir()] == ["scenario.yaml"]


def test_a_motion_that_cannot_be_simulated_is_one_line(folder, short, capsys):
    fast = short(
        "fast.yaml",
        ("momentum_W: [0.0,", "momentum_W: [1.0e+300,"),
        ("  suite: flight #", '  suite: "" #'),
        ("estimator: recursive_fit #", "estimator: least_squares #"),
    )
    assert run(fast, "--out", folder / "fast") == 2
    stdout, stderr = capsys.readouterr()
    assert stdout == ""
    assert stderr.startswith("cpid: error: ")
    assert "the simulation fails at t = " in stderr
    assert stderr.count("\n") == 1
