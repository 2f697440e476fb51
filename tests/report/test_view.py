"""Replays of telemetry: whole, honest about what is known, and whatever shapes the model has."""

import json
import re
from base64 import b64decode

import numpy as np
import pytest

from cpid_drake import InputError, Motion, Spacecraft, identify
from cpid_drake.report.replay import replay_html

INERTIAL = (
    '<inertial><mass value="5"/>'
    '<inertia ixx="1" iyy="1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def commands(page: str) -> bytes:
    """All that a page tells Meshcat to draw."""
    return b"".join(map(b64decode, re.findall(r"base64,([A-Za-z0-9+/=]{20,})", page)))


def steps(page: str) -> list:
    """The texts of a page, and the times from which they are shown."""
    return json.loads(re.search(r"const steps = (.*), zero = ", page)[1])


@pytest.fixture(scope="module")
def two_links(tmp_path_factory):
    """Return a function (visual or collision) -> spacecraft of two links, with that on the base."""

    def make(geometry: str) -> Spacecraft:
        path = tmp_path_factory.mktemp("model") / "two.urdf"
        path.write_text(
            f'<robot name="two"><link name="b">{INERTIAL}{geometry}</link>'
            f'<link name="a">{INERTIAL}</link><joint name="j" type="continuous">'
            '<parent link="b"/><child link="a"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint>'
            "</robot>"
        )
        return Spacecraft(path, base="b", capture_frame="a")

    return make


def at_rest(spacecraft: Spacecraft, time) -> Motion:
    zeros = np.zeros((len(time), 3))
    joints = np.zeros((len(time), len(spacecraft.joint_names)))
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
    return Motion(spacecraft.joint_names, time, attitude, zeros, zeros, zeros, joints, joints)


def test_a_replay_says_what_was_known_and_when(servicer, zero_momentum_motion, skewed_target):
    """Its clock starts with the log; without truth, none is drawn; text is text."""
    telemetry = zero_momentum_motion(skewed_target, 8, 3)
    later = Motion(**(vars(telemetry) | {"time": telemetry.time + 100.0}))
    found = [identify(servicer, later.select(slice(0, k)), rows="standard") for k in (1, 8)]
    page = replay_html(
        servicer, later, [(100.0, found[0]), (107.0, found[1])], title="</script><b>log & co"
    )
    assert "&lt;/script&gt;&lt;b&gt;log &amp; co" in page
    assert "<b>log" not in page
    assert len(page) < 10e6
    assert 'src="http' not in page
    assert [time for time, _ in steps(page)] == [0.0, 7.0]
    assert "not all ten" in steps(page)[0][1]
    assert "m 60.0" in steps(page)[1][1]
    assert "true" not in steps(page)[1][1]
    drawn = commands(page)
    assert b"cpid/estimate/inertia" in drawn
    assert b"captured_target" not in drawn
    assert "momentum P of the target" in page


def test_a_replay_with_truth_draws_it(servicer, zero_momentum_motion, skewed_target):
    telemetry = zero_momentum_motion(skewed_target, 4, 5)
    found = identify(servicer, telemetry, rows="standard")
    page = replay_html(servicer, telemetry, [(3.0, found)], truth=skewed_target)
    drawn = commands(page)
    assert b"captured_target" in drawn
    assert "true 60.0" in steps(page)[0][1]


def test_a_model_without_shapes_shows_ellipsoids_of_inertia(two_links):
    spacecraft = two_links("")
    drawn = commands(replay_html(spacecraft, at_rest(spacecraft, np.arange(3.0)), []))
    assert b"cpid/C" in drawn
    assert b"drake/inertia/InertiaVisualizer" in drawn


def test_shapes_that_cannot_be_drawn_are_named(two_links):
    spacecraft = two_links('<visual><geometry><mesh filename="nowhere.obj"/></geometry></visual>')
    with pytest.raises(InputError, match=r"nowhere\.obj"):
        replay_html(spacecraft, at_rest(spacecraft, np.arange(3.0)), [])
