"""`cpid spacecraft`: what a model offers, and a command that goes on with it."""

import shlex

import pytest
from model_parts import joint, link, moments, urdf
from sensing_cases import mimic

from cpid_drake import Spacecraft, load_scenario, shipped_scenario

PARTS = (
    '<link name="world"/>',
    joint("mount", "world", "base", "fixed"),
    link("base", 50.0, inner="<self_collide>1</self_collide>"),
    link("arm"),
    link("left", 1.0, com="0.1 0 0", **moments(0.01, 0.01, 0.01)),
    link("right", 1.0, com="0.1 0 0", **moments(0.01, 0.01, 0.01)),
    '<link name="tool"/>',
    joint("turn", "base", "arm"),
    joint("fix", "arm", "tool", "fixed"),
    joint("grip", "arm", "left", "prismatic", limits=(0.0, 0.1)),
    joint("also", "arm", "right", "prismatic").replace("</joint>", mimic("grip", -1.0)),
)


@pytest.fixture
def show(run_cpid, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def make(text: str, *options: str) -> tuple[int, str]:
        (tmp_path / "m.urdf").write_text(text)
        code, stdout, stderr = run_cpid("spacecraft", "m.urdf", *options)
        assert stderr == ""
        return code, stdout

    return make


def command_of(stdout: str) -> dict[str, str]:
    words = shlex.split(stdout.splitlines()[-1].removeprefix("next: "))
    assert words[:3] == ["cpid", "identify", "LOG"]
    return dict(zip(words[3::2], words[4::2], strict=True))


def test_a_new_model_says_what_it_offers(show):
    code, stdout = show(urdf(*PARTS))
    assert code == 0
    assert "2 joints, and 1 that follow them, 5 bodies, 62 kg" in stdout
    assert "link 'base' is welded to the world in the model, and floats freely here" in stdout
    assert "self_collide (1)" in stdout
    [grip] = [line.split() for line in stdout.splitlines() if line.startswith(" grip ")]
    assert grip == ["grip", "0", "0.1", "m", "0.7", "m/s", "10", "N"]
    assert "follows grip, times -1" in stdout
    assert "tool (1), left (2), right (2)" in stdout


def test_the_command_to_go_on_with_loads_the_model(show, tmp_path):
    """The frame without a mass, before a gripper's fingers."""
    options = command_of(show(urdf(*PARTS))[1])
    assert options == {"--model": "m.urdf", "--base": "base", "--capture-frame": "tool"}
    Spacecraft(tmp_path / "m.urdf", base=options["--base"], capture_frame="tool")


def test_given_names_are_used(show):
    text = urdf(*PARTS[2:])
    options = command_of(show(text, "--base", "arm", "--capture-frame", "left")[1])
    assert (options["--base"], options["--capture-frame"]) == ("arm", "left")


def test_bodies_to_correct_are_in_one_table(show):
    bad = link("left", 1.0, com="0.1 0 0", **moments(1.0, 1.0, 3.0))
    large = link("right", 0.01, com="0.1 0 0", **moments(0.1, 0.1, 0.1))
    code, stdout = show(urdf(*PARTS[:4], bad, large, *PARTS[6:]))
    assert code == 4
    assert "link 'base' is welded to the world" in stdout
    assert "link 'left': the inertia [" in stdout
    table = stdout.partition("Bodies to correct")[2]
    rows = [line.split(maxsplit=2) for line in table.splitlines() if line.startswith(" ")]
    [impossible] = [row[2] for row in rows if row[:2] == ["left", "impossible"]]
    assert "none exceeds the sum of the other two; here they are 1, 1 and 3" in impossible
    [implausible] = [row[2] for row in rows if row[:2] == ["right", "implausible"]]
    assert "0.01 kg with a radius of gyration of 3.2 m" in implausible
    assert command_of(stdout)["--repair-bodies"] == "nearest"


def test_what_cannot_be_read_is_one_line(run_cpid, tmp_path):
    (tmp_path / "m.urdf").write_text(urdf(link("base", inner='<mas value="3"/>')))
    code, stdout, stderr = run_cpid("spacecraft", tmp_path / "m.urdf")
    assert (code, stdout) == (2, "")
    assert stderr.count("\n") == 1
    assert "<mas> in <link> is not read" in stderr


SCENARIOS = ("paper", "free_flyer_payload", "orbit", "air_bearing", "single_arm_wheels")


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_shipped_models_are_as_their_scenarios_name_them(run_cpid, name):
    reference = load_scenario(shipped_scenario(name)).spacecraft
    code, stdout, _ = run_cpid("spacecraft", reference.model)
    options = command_of(stdout)
    assert code == 0
    assert options["--base"] == reference.base
    assert options["--capture-frame"] == reference.capture_frame
