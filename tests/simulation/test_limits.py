"""A scenario that asks too much is simulated all the same, and every limit it exceeds is named."""

import re

import pytest
import yaml

from cpid_drake import load_scenario, make_simulation, shipped_scenario
from cpid_drake.files.resources import models_directory
from cpid_drake.simulation.limits import check_limits


@pytest.fixture
def checked(tmp_path):
    """Return a function (scenario's name, edit of its YAML) -> its `LimitCheck`."""

    def check(name, edit, tag=""):
        text = shipped_scenario(name).read_text().replace("!MultiSineMotion", "")
        document = yaml.safe_load(text)
        edit(document)
        motion = document.pop("joint_motion")
        path = tmp_path / "edited.yaml"
        flow = yaml.safe_dump(motion, default_flow_style=True, width=1000)
        path.write_text(f"{yaml.safe_dump(document)}joint_motion: {tag} {flow}")
        return check_limits(make_simulation(load_scenario(path)))

    return check


def test_a_position_beyond_its_limits_is_named_with_its_time(checked):
    def edit(document):
        document["joint_motion"]["final"]["operating_arm_joint4"] = -3.3

    found = [text for text in checked("paper", edit).exceeded if "is at" in text]
    assert found == ["operating_arm_joint4 is at -3.3 rad at 10 s, its limits are -3.1 and 3.1 rad"]


def test_a_wheels_torque_is_that_of_its_rotor(checked):
    """A wheel that is 23 times as fast needs about the rotor's inertia times its acceleration."""

    def edit(document):
        sines = document["joint_motion"]
        sines["amplitudes"]["wheel1_spin"][0] *= 23

    (text,) = checked("single_arm_wheels", edit, "!MultiSineMotion").exceeded
    needed, time = re.match(
        r"wheel1_spin needs (\S+) N·m at (\S+) s, its motor gives 0.2 N·m$", text
    ).groups()
    scenario = load_scenario(shipped_scenario("single_arm_wheels"))
    motion = scenario.make_joint_motion(scenario.spacecraft.make())
    acceleration = 23 * motion.evaluate(float(time))[2, 0]
    assert float(needed) == pytest.approx(0.01815 * abs(acceleration), rel=0.05)
    assert float(needed) > 1.0


def test_an_arm_through_the_bus_is_named(checked):
    """Its shoulder turns the upper arm back by 2.4 rad, into the bus."""

    def edit(document):
        document["joint_motion"]["final"]["operating_arm_joint2"] = -2.4

    found = " ".join(checked("paper", edit).exceeded)
    assert re.search(r"bus and operating_arm_link2 overlap by 0\.\d+ m at \S+ s", found)


def test_the_efforts_are_those_of_the_scenarios_momentum(checked):
    """A capture that tumbles fast needs efforts that the same motion at rest does not need."""

    def edit(document):
        document["simulation"]["momentum_W"] = [0.0, 0.0, 1500.0, 0.0, 0.0, 0.0]

    assert checked("paper", lambda document: None).exceeded == ()
    assert any(" needs " in text for text in checked("paper", edit).exceeded)


def test_a_joint_without_an_effort_limit_is_said_to_be_unchecked(tmp_path):
    text = (models_directory() / "free_flyer" / "free_flyer.urdf").read_text()
    text = re.sub(r"  <transmission.*</transmission>\n", "", text, flags=re.S)
    (tmp_path / "flyer.urdf").write_text(text.replace(' effort="1"', ' effort="0"'))
    scenario = load_scenario(shipped_scenario("free_flyer_payload"))
    scenario.spacecraft.model = str(tmp_path / "flyer.urdf")
    found = check_limits(make_simulation(scenario))
    assert found.exceeded == ()
    assert found.unchecked == ("efforts of arm_joint4 (no limit in the model)",)
    assert re.fullmatch(r"0.17 m between body and captured_target at 7.\d+ s", found.closest)
