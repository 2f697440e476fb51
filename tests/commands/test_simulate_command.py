"""`cpid simulate`: files of a run that agree with one another, with the truth and with a rerun."""

import json
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from cpid_drake import identify, load_scenario, load_sensors
from cpid_drake.commands.main import main
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import models_directory
from cpid_drake.logs.formats import read_log
from cpid_drake.report.run_folder import read_run
from cpid_drake.simulation.scenario_files import dump_scenario


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


@pytest.fixture(scope="module")
def sensed(folder, short):
    """A run with sensors and the filter."""
    with pytest.MonkeyPatch.context() as patch:
        out = str(folder / "sensed")
        patch.setattr(
            sys, "argv", ["cpid", "simulate", str(short("sensed.yaml")), "--out", out, "--quiet"]
        )
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code == 0
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
    assert repr(suite) == repr(load_sensors("flight", unstated="exact"))
    result = identify(spacecraft, read_log(sensed / "telemetry.csv"), sensors=suite)
    error = result.parameters - pi
    assert error @ np.linalg.solve(result.covariance, error) < 30  # χ² of 10: 1 in 1000
    assert np.sqrt(result.covariance[0, 0]) < 0.6


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
def test_the_printed_command_identifies_from_the_run(short, cpid):
    """Also with spaces in the path, and with everything that the scenario says of the momentum."""
    scenario = short("printed.yaml", ("momentum: zero", "momentum: unknown"))
    code, stdout, _ = cpid("simulate", scenario, "--out", "a run")
    assert code == 0
    words = shlex.split(stdout)
    assert words[:3] == ["cpid", "identify", "a run/telemetry.csv"]
    assert cpid(*words[1:], "--quiet", "--json", "result.json")[0] == 0
    found = read_json(Path("result.json"))
    assert found["momentum"] == "unknown"
    sigma = read_json(Path("a run/run.json"))["online_identification"]["sigma"]["m"]
    assert abs(found["parameters"][0] - 60.0) < 5 * sigma < 5.0


EXACT = (
    ("  suite: flight #", '  suite: "" #'),
    ("estimator: recursive_fit #", "estimator: least_squares #"),
)


def test_what_a_simulation_leaves_out_of_a_motion_is_said(short, cpid):
    """It is no limit that is exceeded."""
    code, _, stderr = cpid("simulate", short("cut.yaml"), "--check")
    assert (
        "warning: the joint motion takes 10 s, and simulation.duration is 3 s: the last 7 s"
        in stderr
    )
    whole = short("whole.yaml", ("  duration: 3.0", "  duration: 10.0"))
    assert (code, "left out" in cpid("simulate", whole, "--check")[2]) == (0, False)


def test_an_input_is_not_overwritten(short, refusal, tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "scenario.yaml").write_text(short("source.yaml").read_text())
    message = refusal("simulate", mine / "scenario.yaml", "--out", mine)
    assert "scenario.yaml: is the input" in message
    assert [file.name for file in mine.iterdir()] == ["scenario.yaml"]


def test_a_motion_that_cannot_be_simulated_is_one_line(short, refusal):
    fast = short("fast.yaml", ("momentum_W: [0.0,", "momentum_W: [1.0e+300,"), *EXACT)
    assert "the base rotates at 1.56e+297 rad/s at the start" in refusal(
        "simulate", fast, "--out", "fast"
    )


class TestCheck:
    """`cpid simulate --check`."""

    TEMPLATE = (models_directory() / "scenario_template.yaml").read_text()
    SHIPPED = tuple(
        pytest.param(file.stem, marks=() if file.stem == "paper" else pytest.mark.slow)
        for file in sorted((models_directory() / "scenarios").glob("*.yaml"))
    )

    @pytest.mark.parametrize("name", SHIPPED)
    def test_shipped_scenarios_are_all_right(self, cpid, name):
        """Also in what they ask of joints, motors and bodies."""
        code, stdout, stderr = cpid("simulate", name, "--check")
        assert (code, stderr) == (0, "")
        assert stdout.startswith(f"{name}: ok; spacecraft of ")
        assert stdout.count("\n") == 1
        assert "; closest bodies: 0." in stdout
        assert "not checked" not in stdout

    @pytest.mark.slow
    def test_a_limit_that_is_exceeded_is_named_and_fails_the_check(self, cpid):
        Path("mine.yaml").write_text(self.TEMPLATE.replace("mass: 60.0", "mass: 6000.0", 1))
        code, stdout, stderr = cpid("simulate", "mine.yaml", "--check")
        assert code == 4
        assert stdout.startswith("mine.yaml: 6 limits exceeded; spacecraft of ")
        lines = stderr.splitlines()
        assert len(lines) == 6
        for k, line in enumerate(lines, 1):
            assert line.startswith(f"warning: capture_arm_joint{k} needs ")
            assert " s, its motor gives " in line

    def test_the_template_is_all_right_and_has_every_key(self, cpid):
        Path("mine.yaml").write_text(self.TEMPLATE)
        code, stdout, _ = cpid("simulate", "mine.yaml", "--check")
        assert code == 0
        assert "sensors: attitude, gyro, position, encoders; estimator: recursive_fit" in stdout
        for line in dump_scenario(load_scenario("mine.yaml")).splitlines():
            key = line.strip(" -").partition(":")[0]
            assert key.startswith("[") or key in self.TEMPLATE, line
