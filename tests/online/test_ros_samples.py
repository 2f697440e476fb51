"""ROS messages as samples, without ROS: what they say, and what is said about them."""

from types import SimpleNamespace as Message

import flyer_cases
import numpy as np
import pytest
from flyer_cases import SAMPLE, SENSORS_OF_SAMPLE

from cpid_drake import (
    InputError,
    OnlineIdentifier,
    load_sensors,
    read_log,
)
from cpid_drake.online.messages import OK, STALE, WARN
from cpid_drake.online.ros_samples import RosSamples, sources_of
from cpid_drake.sensors.sensors import JointSensor, VectorSensor

SENSORS = load_sensors(SENSORS_OF_SAMPLE)
TOPICS = {"joints": "/joints", "imu": "/imu", "pose": "/pose"}
EPOCH = 1_700_000_000 * 10**9


@pytest.fixture(scope="module")
def flyer():
    return flyer_cases.flyer()


@pytest.fixture(scope="module")
def log():
    return read_log(SAMPLE).between(0.0, 5.0)


class Heard(OnlineIdentifier):
    """An identifier that only remembers its samples."""

    def __init__(self, *given, **options) -> None:
        super().__init__(*given, **options)
        self.heard = []

    def add(self, sensor, time, value) -> None:
        self.heard.append((sensor, time, np.array(value)))


class Said(list):
    """What was said."""

    def __call__(self, text: str) -> None:
        self.append(text)


def header(stamp: int, frame: str = "") -> Message:
    seconds, rest = divmod(stamp, 10**9)
    return Message(stamp=Message(sec=seconds, nanosec=rest), frame_id=frame)


def xyz(values) -> Message:
    return Message(**dict(zip("xyz", map(float, values), strict=True)))


def wxyz(values) -> Message:
    return Message(**dict(zip("wxyz", map(float, values), strict=True)))


def joints(stamp: int, names, position, velocity=()) -> Message:
    return Message(header=header(stamp), name=names, position=position, velocity=velocity)


def imu(stamp: int, rate, orientation=None) -> Message:
    return Message(
        header=header(stamp),
        orientation=orientation or wxyz([0, 0, 0, 0]),
        orientation_covariance=[0.0 if orientation else -1.0] * 9,
        angular_velocity=xyz(rate),
        angular_velocity_covariance=[0.0] * 9,
    )


def pose(stamp: int, quaternion, position) -> Message:
    own = Message(orientation=wxyz(quaternion), position=xyz(position))
    return Message(header=header(stamp), pose=own)


def odometry(stamp: int, quaternion, position, velocity, rate) -> Message:
    own = Message(orientation=wxyz(quaternion), position=xyz(position))
    twist = Message(linear=xyz(velocity), angular=xyz(rate))
    return Message(header=header(stamp), pose=Message(pose=own), twist=Message(twist=twist))


def messages(log, shift: float = 0.0):
    """Yield a log's samples as messages; those of joints are in another order, with one more."""
    names = ["gripper", *reversed(log.joint_names)]
    for k, time in enumerate(log.encoders.time):
        stamp = EPOCH + round((time + shift) * 1e9)
        position = [0.3, *log.encoders.value[k, ::-1]]
        yield "joints", joints(stamp, names, position)
        yield "imu", imu(stamp, log.gyro.value[k])
        yield "pose", pose(stamp, log.attitude.value[k], log.position.value[k])


def play(samples: RosSamples, log, shift: float = 0.0) -> None:
    """Give a log's samples as messages, one at a time."""
    for kind, message in messages(log, shift):
        samples.take(kind, message, 0, 0.0)


def make(craft, topics=None, kind=Heard, suite=SENSORS, **options) -> RosSamples:
    reads = "thrust" in (topics or {})
    identifier = kind(craft, suite, reads_thrust=reads)
    return RosSamples(identifier, topics or TOPICS, say=Said(), **options)


@pytest.fixture(scope="module")
def direct(flyer, log):
    """Return what the samples give without messages."""
    identifier = OnlineIdentifier(flyer, SENSORS)
    for name, time, value in log.messages():
        identifier.add(name, time, value)
    return identifier.finish()


def test_messages_give_the_identification_of_their_samples(flyer, log, direct):
    samples = make(flyer, kind=OnlineIdentifier)
    play(samples, log)
    assert samples.say == []
    assert samples.newest == EPOCH + 5 * 10**9
    assert EPOCH + 4 * 10**9 <= samples.stamp <= samples.newest
    found = samples.identifier.finish()
    np.testing.assert_allclose(found.parameters, direct.parameters, rtol=1e-9)
    assert found.sample_count == direct.sample_count


def test_messages_that_waited_are_not_late_because_of_another_topic(flyer, log, direct):
    """Two seconds of each topic at once, one topic after the other: a stall of the receiver."""
    samples = make(flyer, kind=OnlineIdentifier)
    rows = list(messages(log))
    for begin in range(0, len(rows), 600):
        waited = sorted(rows[begin : begin + 600], key=lambda row: row[0])
        samples.take_all(waited, 0, 0.0)
    found = samples.identifier.finish()
    np.testing.assert_allclose(found.parameters, direct.parameters, rtol=1e-9)
    assert found.rejected == direct.rejected


def test_time_that_jumps_back_begins_the_identification_again(flyer, log, direct):
    """A bag that is played twice says no more than once."""
    samples = make(flyer, kind=OnlineIdentifier)
    play(samples, log)
    play(samples, log)
    assert samples.restarts == 1
    assert samples.say == ["/joints: time jumped back by 5.0 s; the identification begins again"]
    found = samples.identifier.finish()
    np.testing.assert_allclose(found.covariance, direct.covariance, rtol=1e-6)
    assert found.sample_count == direct.sample_count
    assert found.rejected == direct.rejected


def test_a_late_message_is_no_jump_of_time(flyer, log):
    samples = make(flyer)
    samples.take("imu", imu(EPOCH, [0, 0, 0]), 0, 0.0)
    samples.take("imu", imu(EPOCH - 10**9 // 2, [0, 0, 0]), 0, 0.1)
    assert samples.restarts == 0
    assert [time for _, time, _ in samples.identifier.heard] == [0.0, -0.5]


def test_stamps_keep_their_nanoseconds(flyer):
    samples = make(flyer)
    for k in range(3):
        samples.take("imu", imu(EPOCH + k, [0, 0, 0]), 0, 0.0)
    assert [time for _, time, _ in samples.identifier.heard] == [0.0, 1e-9, 2e-9]


def test_the_velocity_of_odometry_is_turned_into_the_world(flyer):
    """A quarter turn about z: forward is along y."""
    suite = load_sensors("testbed")
    suite.velocity, suite.joint_rates = VectorSensor(100.0, 0.01), JointSensor(100.0, 0.01)
    samples = make(flyer, {"joints": "/joints", "odometry": "/odom"}, suite=suite)
    half = np.sqrt(0.5)
    given = odometry(EPOCH, [half, 0, 0, half], [1, 2, 3], [0.5, 0, 0], [0, 0, 0.1])
    samples.take("odometry", given, 0, 0.0)
    samples.take(
        "joints", joints(EPOCH, flyer.joint_names, [0.1, 0.2, 0.3, 0.4], [1, 2, 3, 4]), 0, 0.0
    )
    heard = {name: value for name, _, value in samples.identifier.heard}
    np.testing.assert_allclose(heard["velocity"], [0, 0.5, 0], atol=1e-12)
    np.testing.assert_allclose(heard["position"], [1, 2, 3])
    np.testing.assert_allclose(heard["gyro"], [0, 0, 0.1])
    np.testing.assert_allclose(heard["attitude"], [half, 0, 0, half])
    np.testing.assert_allclose(heard["joint_rates"], [1, 2, 3, 4])


def test_each_quantity_has_one_source(flyer):
    """The attitude is that of the pose, not that of the IMU, if both are there."""
    samples = make(flyer)
    samples.take("imu", imu(EPOCH, [1, 2, 3], wxyz([1, 0, 0, 0])), 0, 0.0)
    assert [name for name, *_ in samples.identifier.heard] == ["gyro"]
    alone = make(flyer, {"joints": "/joints", "imu": "/imu"})
    alone.take("imu", imu(EPOCH, [1, 2, 3], wxyz([1, 0, 0, 0])), 0, 0.0)
    assert {name for name, *_ in alone.identifier.heard} == {"attitude", "gyro"}


def test_transforms_are_those_between_the_named_frames(flyer):
    samples = make(flyer, {"joints": "/joints", "pose": "/tf:map:body"})

    def transform(frame: str, child: str, x: float) -> Message:
        own = Message(rotation=wxyz([1, 0, 0, 0]), translation=xyz([x, 0, 0]))
        return Message(header=header(EPOCH, frame), child_frame_id=child, transform=own)

    both = [transform("map", "other", 7.0), transform("map", "body", 2.0)]
    samples.take("pose", Message(transforms=both), 0, 0.0)
    heard = {name: value for name, _, value in samples.identifier.heard}
    np.testing.assert_array_equal(heard["position"], [2.0, 0, 0])
    unnamed = make(flyer, {"joints": "/joints", "pose": "/tf"})
    unnamed.take("pose", Message(transforms=both), 0, 0.0)
    assert "pose=/tf:world:base" in unnamed.say[0]


def test_thrust_is_mapped_and_stamped_with_its_arrival(flyer):
    """Two thrusters at x = ±1 m that push along y: both turn the base about z."""
    topics = TOPICS | {"thrust": "/thrust"}
    matrix = np.zeros((6, 2))
    matrix[2], matrix[4] = [1.0, -1.0], [1.0, 1.0]
    samples = make(flyer, topics, thrust_map=matrix)
    samples.take("thrust", Message(data=[2.0, 0.5]), EPOCH, 0.0)
    [(name, time, value)] = samples.identifier.heard
    assert (name, time) == ("thrust", 0.0)
    np.testing.assert_allclose(value, [0, 0, 1.5, 0, 2.5, 0])
    wrench = Message(torque=xyz([1, 2, 3]), force=xyz([4, 5, 6]))
    samples.take("thrust", Message(header=header(EPOCH + 10**9), wrench=wrench), 0, 0.0)
    _, time, value = samples.identifier.heard[-1]
    assert time == 1.0
    np.testing.assert_allclose(value, [1, 2, 3, 4, 5, 6])
    samples.take("thrust", Message(data=[1.0]), EPOCH, 0.0)
    assert "has 1 entries, but thrust_map has 2 columns" in samples.say[0]


@pytest.mark.parametrize(
    ("kind", "message", "says"),
    [
        ("imu", imu(0, [0, 0, 0]), "/imu: the header has no stamp"),
        ("joints", joints(EPOCH, ["arm_joint1"], [0.1]), "no position of arm_joint2, arm_joint3"),
        ("joints", joints(EPOCH, ["a", "a"], [0.1, 0.1]), "name every joint once"),
        ("joints", joints(EPOCH, ["a", "b"], [0.1]), "1 values for 2 joints"),
    ],
)
def test_a_message_that_cannot_be_used_is_counted_and_said_once(flyer, kind, message, says):
    samples = make(flyer)
    for _ in range(3):
        samples.take(kind, message, 0, 0.0)
    assert samples.identifier.heard == []
    [text] = samples.say
    assert says in text
    status = next(each for each in samples.watch(0.1) if each.name == TOPICS[kind])
    assert (status.level, status.values["unusable"]) == (WARN, 3)


def test_a_topic_that_is_lost_or_late_is_said_once(flyer):
    samples = make(flyer)
    levels = lambda now: {each.name: each.level for each in samples.watch(now)}  # noqa: E731
    assert set(levels(100.0).values()) == {OK}
    for k in range(20):
        samples.take("imu", imu(EPOCH + k * 10**8, [0, 0, 0]), 0, 100.0 + 0.1 * k)
    assert levels(102.0) == {"/joints": STALE, "/imu": OK, "/pose": STALE}
    assert levels(103.5) == {"/joints": STALE, "/imu": STALE, "/pose": STALE}
    samples.take("imu", imu(EPOCH + 3 * 10**9, [0, 0, 0]), 0, 104.0)
    assert levels(104.1)["/imu"] == OK
    assert samples.say == [
        "/joints: no message yet, after 2.0 s",
        "/pose: no message yet, after 2.0 s",
        "/imu: no message for 1.6 s",
        "/imu: messages arrive",
    ]


@pytest.mark.parametrize(
    ("kinds", "says"),
    [
        (("joints", "camera"), "no topics of kind 'camera'"),
        (("imu",), "no topic of joints"),
        (("joints",), "no topic of the base's motion"),
        (("joints", "thrust"), "no topic of the base's motion"),
    ],
)
def test_topics_that_show_no_motion_are_refused(kinds, says):
    with pytest.raises(InputError, match=says):
        sources_of(kinds, SENSORS)


@pytest.mark.parametrize("matrix", [np.eye(5), np.ones(6), np.full((6, 2), np.nan)])
def test_a_map_of_thrust_of_another_shape_is_refused(flyer, matrix):
    with pytest.raises(InputError, match="give 6 rows"):
        make(flyer, TOPICS | {"thrust": "/thrust"}, thrust_map=matrix)
