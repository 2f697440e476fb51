"""`cpid scenario check`: what it says of good and bad files."""

import pytest

from cpid_drake import load_scenario, shipped_scenario
from cpid_drake.resources import models_directory
from cpid_drake.scenario.files import dump_scenario

TEMPLATE = (models_directory() / "scenario_template.yaml").read_text()
SHIPPED = [
    pytest.param(file.stem, marks=() if file.stem == "paper" else pytest.mark.slow)
    for file in sorted(shipped_scenario("paper").parent.glob("*.yaml"))
]


@pytest.fixture
def cpid(run_cpid, monkeypatch, tmp_path):
    """Return a function that runs `cpid scenario` in an empty folder: (code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: run_cpid("scenario", *arguments)


def refusal(outcome) -> str:
    code, stdout, stderr = outcome
    assert (code, stdout) == (2, "")
    assert stderr.startswith("cpid: error: ")
    assert stderr.count("\n") == 1
    return stderr


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenarios_are_all_right(cpid, name):
    """Also in what they ask of joints, motors and bodies."""
    code, stdout, stderr = cpid("check", name, "--strict")
    assert (code, stderr) == (0, "")
    assert stdout.startswith(f"{name}: ok, spacecraft of ")
    assert stdout.count("\n") == 1
    assert "; closest bodies: 0." in stdout
    assert "not checked" not in stdout


@pytest.mark.slow
def test_a_limit_that_is_exceeded_is_named_and_fails_a_strict_check(cpid, tmp_path):
    (tmp_path / "mine.yaml").write_text(TEMPLATE.replace("mass: 60.0", "mass: 6000.0", 1))
    code, stdout, stderr = cpid("check", "mine.yaml")
    assert code == 0
    assert stdout.startswith("mine.yaml: 6 limits exceeded, spacecraft of ")
    lines = stderr.splitlines()
    assert len(lines) == 6
    for k, line in enumerate(lines, 1):
        assert line.startswith(f"warning: capture_arm_joint{k} needs ")
        assert " s, its motor gives " in line
    assert cpid("check", "mine.yaml", "--strict") == (1, stdout, stderr)


def test_the_template_is_all_right_and_has_every_key(cpid, tmp_path):
    (tmp_path / "mine.yaml").write_text(TEMPLATE)
    code, stdout, _ = cpid("check", "mine.yaml")
    assert code == 0
    assert "mine.yaml: ok, " in stdout
    assert "sensors: attitude, gyro, position, encoders; estimator: recursive_fit" in stdout
    for line in dump_scenario(load_scenario("mine.yaml")).splitlines():
        key = line.strip(" -").partition(":")[0]
        assert key.startswith("[") or key in TEMPLATE or key in ("start_time", REALTIME), line


REALTIME = "target_realtime_rate"


@pytest.mark.parametrize(
    ("old", "new", "cause"),
    [
        ("mass: 60.0", "mas: 60.0", "mine.yaml: unknown key 'target.mas'; did you mean 'mass'?"),
        ("base: bus", "base: hull", "no body 'hull'"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_key(cpid, tmp_path, old, new, cause):
    assert old in TEMPLATE
    (tmp_path / "mine.yaml").write_text(TEMPLATE.replace(old, new, 1))
    message = refusal(cpid("check", "mine.yaml"))
    assert "mine.yaml: " in message
    assert cause in message


def test_a_name_of_no_scenario_is_answered_with_the_nearest(cpid):
    message = refusal(cpid("check", "papr"))
    assert "did you mean 'paper'? choose from air_bearing, " in message
    assert "nowhere.yaml: no such file" in refusal(cpid("check", "nowhere.yaml"))
