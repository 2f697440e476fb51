"""What the scene of a live page draws: the spacecraft at the latest samples, near its camera."""

from time import monotonic, sleep
from types import SimpleNamespace as Message

import numpy as np
import pytest
from flyer_cases import SENSORS_OF_SAMPLE, flyer
from rich.console import Console
from scipy.spatial.transform import Rotation

from cpid_drake import InputError, LivePage, OnlineIdentifier, load_sensors
from cpid_drake.online.messages import OK, STALE, WARN, Status
from cpid_drake.online.ros_samples import RosSamples
from cpid_drake.report.live_view import NodeView, show_replay, state_of
from cpid_drake.report.scene import Scene

WORK = 0.3
"""Time for which a slow identifier works on a sample [s]; more than the period of a page."""

JOINTS = np.array([0.1, -0.2, 0.3, 0.4])
TURN = Rotation.from_rotvec([0.2, -0.1, 0.4])
RATES = {
    "gyro": np.array([0.01, 0.02, -0.03]),
    "velocity": np.array([0.1, 0.0, -0.1]),
    "joint_rates": np.array([0.2, 0.0, 0.1, -0.1]),
}


def test_without_joints_there_is_nothing_to_draw():
    assert state_of(flyer(), {"gyro": RATES["gyro"]}) is None


def test_what_is_not_measured_is_zero():
    motion = flyer().to_motion([0.0], [state_of(flyer(), {"encoders": JOINTS})])
    np.testing.assert_allclose(motion.q[0], JOINTS)
    np.testing.assert_allclose(motion.quaternion_WB[0], [1, 0, 0, 0])
    for zero in (motion.p_WB, motion.v_WB, motion.w_WB, motion.qdot):
        np.testing.assert_array_equal(zero, 0)


def test_all_rates_or_none():
    """The momentum of some of them alone would be another one."""
    pose = {"attitude": TURN.as_quat(scalar_first=True), "position": np.array([5.0, 1.0, 0.0])}
    latest = {"encoders": JOINTS, **pose, **RATES}
    motion = flyer().to_motion([0.0], [state_of(flyer(), latest)])
    np.testing.assert_allclose(motion.p_WB[0], pose["position"])
    np.testing.assert_allclose(motion.w_WB[0], TURN.apply(RATES["gyro"]))
    np.testing.assert_allclose(motion.v_WB[0], RATES["velocity"])
    np.testing.assert_allclose(motion.qdot[0], RATES["joint_rates"])
    for name in RATES:
        rest = {key: value for key, value in latest.items() if key != name}
        motion = flyer().to_motion([0.0], [state_of(flyer(), rest)])
        for zero in (motion.v_WB, motion.w_WB, motion.qdot):
            np.testing.assert_array_equal(zero, 0)


@pytest.mark.parametrize("quaternion", [np.zeros(4), np.full(4, np.nan)])
def test_what_is_no_attitude_is_refused(quaternion):
    with pytest.raises(InputError, match=r"quaternion|not finite"):
        state_of(flyer(), {"encoders": JOINTS, "attitude": quaternion})


def test_a_node_shows_its_topics_and_survives_messages_without_sense():
    sensors = load_sensors(SENSORS_OF_SAMPLE)
    topics = {"joints": "/joints", "pose": "/pose", "imu": "/imu"}
    samples = RosSamples(OnlineIdentifier(flyer(), sensors), topics, say=lambda text: None)
    stamp = Message(stamp=Message(sec=1_700_000_000, nanosec=0))
    joints = Message(header=stamp, name=flyer().joint_names, position=JOINTS * np.nan, velocity=[])
    with LivePage() as page:
        view, shown = NodeView(samples, flyer(), page), []
        page.show = lambda time, found, **texts: shown.append((time, texts))
        samples.take("joints", joints, 0, 0.0)
        view.draw()
        rows = [
            Status(STALE, "/imu", "no message yet, after 2.0 s"),
            Status(OK, "/pose", "", {"unusable": 0}),
            Status(WARN, "/joints", "a message has no position of 'a'", {"unusable": 3}),
        ]
        view.show(samples.identifier.estimate(), rows)
    [(time, texts)] = shown
    assert time == 1.7e9
    assert texts["problems"] == [
        "/imu: no message yet, after 2.0 s",
        "/joints: a message has no position of 'a'",
        "/joints: 3 messages cannot be used",
    ]


def test_a_scene_begins_in_front_of_its_camera():
    """Wherever a tracker of motions has its origin."""
    with LivePage() as page:
        scene, place = Scene(flyer(), page.meshcat), flyer().state_columns["p_WB"]
        for time, moved in enumerate([0.0, 0.25]):
            state = state_of(flyer(), {"encoders": JOINTS, "position": [40.0 + moved, -30.0, 2.0]})
            scene.draw(time, state)
            assert state[place][0] == 40.0 + moved  # the caller's state is as it was
            drawn = page.meshcat._GetPackedTransform("/drake/illustration/free_flyer/body")
            numbers = np.frombuffer(drawn[-16 * 9 :], dtype=[("type", "u1"), ("number", ">f8")])
            X_WB = numbers["number"].reshape(4, 4).T
            np.testing.assert_allclose(X_WB[:3, 3], [moved, 0, 0], atol=1e-9)


class SlowIdentifier(OnlineIdentifier):
    """Works for a while after some samples, as one that solves a large block."""

    def add(self, sensor, time, value):
        super().add(sensor, time, value)
        sleep(WORK if time >= 0.2 else 0.0)


def test_a_replay_that_computes_behind_its_samples_says_how_late_it_is():
    """Also while it has just computed, and at its end."""
    stream = [("encoders", k / 10, JOINTS) for k in range(5)]
    identifier, shown = SlowIdentifier(flyer(), SENSORS_OF_SAMPLE), []
    begin = monotonic()
    with LivePage() as page:
        page.show = lambda time, found, status: shown.append((time, float(status.split()[0])))
        show_replay(identifier, stream, 10.0, Console(quiet=True), page)
    late = dict(shown)  # the last of each time
    assert max(late.values()) <= monotonic() - begin
    for k in (2, 3, 4):
        assert late[k / 10] >= (k - 1) * WORK - k / 100 - 0.05
